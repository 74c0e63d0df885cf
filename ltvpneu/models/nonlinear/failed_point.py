"""A point of a sweep without an answer, kept as data."""

from dataclasses import dataclass
from typing import final

from ltvpneu._values import Value


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class FailedPoint(Value):
    """A point of a sweep that has no answer, and why."""

    model: str
    """Which model was asked: "nonlinear", "ltv" or "lti"."""
    frequency: float
    """[Hz]"""
    duty: float
    """[-]"""
    error: Exception

    @property
    def where(self) -> str:
        """Every coordinate of the point, for readers."""
        return f"{self.frequency:g} Hz, duty {self.duty:g}"
