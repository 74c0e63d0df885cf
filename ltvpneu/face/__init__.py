"""What people see: machine files, reports, pictures, the command line."""
