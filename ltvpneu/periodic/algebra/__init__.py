"""Products and exponentials of matrices, without over- and underflow; no systems."""
