"""What a machine is, and its equations; knows nothing of periodic systems."""
