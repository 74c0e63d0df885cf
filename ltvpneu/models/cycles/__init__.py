"""Figures of a cycle of either model, their derivatives, and sweeps of them."""
