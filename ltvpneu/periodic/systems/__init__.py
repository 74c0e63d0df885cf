"""Periodic systems: made, taken apart, joined, and handed to python-control and back."""
