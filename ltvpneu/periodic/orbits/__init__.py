"""Orbits of periodic systems, their stability and their derivatives."""
