"""What on-off valves do to commands: shortest pulses, delays of opening and closing."""

from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import not_negative, whole
from ltvpneu._values import Value


@final
@dataclass(frozen=True, kw_only=True)
class ValveLimits(Value):
    """What a valve can make of a command."""

    shortest_on: float = 0.0
    """[s]"""
    shortest_off: float = 0.0
    """[s]"""
    delay: int = 0
    """Whole periods between a measurement and the period whose duty it sets, in a closed loop."""
    opening_delay: float = 0.0
    """From the command to open until it is open [s]."""
    closing_delay: float = 0.0
    """From the command to close until it is shut [s]."""

    def __post_init__(self) -> None:
        not_negative("shortest_on", self.shortest_on, "s")
        not_negative("shortest_off", self.shortest_off, "s")
        not_negative("opening_delay", self.opening_delay, "s")
        not_negative("closing_delay", self.closing_delay, "s")
        whole("delay", self.delay, 0)

    def duties(self, frequency: float) -> tuple[float, float]:
        """Return the least and the greatest duty at a frequency."""
        least, most = self.shortest_on * frequency, 1 - self.shortest_off * frequency
        if least > most:
            raise ValueError(
                f"valve: found shortest times of {self.shortest_on:g} s on and {self.shortest_off:g} s off, more than "
                f"a period of {1 / frequency:g} s; choose a lower frequency"
            )
        return least, most

    def open_share(self, command: float, frequency: float) -> float:
        """Return for what share of the period the valve is open, if told to be on for a share `command` of it.

        Not at all where the command is shorter than the opening delay, throughout where the pause is shorter than the
        closing delay.
        """
        if command <= self.opening_delay * frequency:
            return 0.0
        if 1 - command <= self.closing_delay * frequency:
            return 1.0
        return min(max(command - self.lag * frequency, 0.0), 1.0)

    @property
    def lag(self) -> float:
        """By how much the valve is open for shorter than it is told to [s]."""
        return self.opening_delay - self.closing_delay
