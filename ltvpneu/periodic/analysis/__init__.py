"""Gramians, norms, harmonic responses, and optimal control and estimation."""
