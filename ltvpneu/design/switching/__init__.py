"""Duties and edges of the valves, chosen by an optimizer."""
