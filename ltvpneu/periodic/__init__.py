"""Periodic, piecewise-constant systems z' = A_m z + B_m u + r_m: mathematics only, no pneumatics."""
