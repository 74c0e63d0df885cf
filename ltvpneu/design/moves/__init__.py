"""Moves from rest to rest: when the valves switch."""
