"""How a design function tells how far it has come."""

from collections.abc import Callable

Progress = Callable[[str, float], object]
"""Called with a text and a share done, 0 to 1."""
