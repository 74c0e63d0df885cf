"""On-off valve: told to be on for a share of the period, it opens and closes with delays of its own.

A data sheet gives times in seconds. From the command on, nothing moves for `opening_delay`; then the spool travels for
`opening_time`, in whose first half the paths that were open close and in whose second half the others open. A command
that is withdrawn before the delay is over does nothing; a pause shorter than the closing delay is not noticed. So with
delays t_on and t_off the valve is open for a share d - (t_on - t_off) / T of the period T, not at all for a duty d up
to t_on / T, always from 1 - t_off / T on.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import final

from ltvpneu._arrays import finite, not_negative, positive
from ltvpneu._values import Value
from ltvpneu.physics.profile import TURN
from ltvpneu.physics.valve import check_duty
from ltvpneu.physics.window import Pulses, Window, check_pulses

_TIMES = ("opening_delay", "closing_delay", "opening_time", "closing_time", "shortest_on", "shortest_off")
LONGEST_TIME = 10.0
"""Beyond this a valve's time is more likely in milliseconds [s]."""


@final
@dataclass(frozen=True, kw_only=True)
class OnOffValve(Value):
    """A valve that is told to be on for a share `duty` of the period, in one piece or in several pulses.

    Parameters
    ----------
    duty : float
        Commanded on-time over period [-], 0 to 1.
    ramp : float
        Angle over which its paths open and close [rad]; of a valve whose travel is given as an angle.
    start : float
        Angle at which it is told to go on [rad]: the phase between valves, where there are several.
    pulses : Pulses or None
        Instead of `duty` and `start`, which are then theirs.
    opening_delay, closing_delay : float
        From the command until the spool moves [s].
    opening_time, closing_time : float
        From then until it has come to its other end [s].
    shortest_on, shortest_off : float
        Shortest command and shortest pause that its maker allows [s]: what designs keep to; models follow any command.

    Examples
    --------
    >>> valve = OnOffValve(duty=0.5, opening_delay=0.012, closing_delay=0.018)
    >>> round(valve.open_share(frequency=20.0), 3)
    0.62
    """

    duty: float = 0.5
    ramp: float = 0.0
    start: float = 0.0
    pulses: Pulses | None = None
    opening_delay: float = 0.0
    closing_delay: float = 0.0
    opening_time: float = 0.0
    closing_time: float = 0.0
    shortest_on: float = 0.0
    shortest_off: float = 0.0

    def __post_init__(self) -> None:
        not_negative("ramp", self.ramp, "rad")
        finite("start", self.start, "rad")
        for name in _TIMES:
            time = not_negative(name, getattr(self, name), "s")
            if time > LONGEST_TIME:
                raise ValueError(f"{name}: found {time:g} s, expected at most {LONGEST_TIME:g} s (12 ms is 0.012 s)")
        if self.ramp and (self.opening_time or self.closing_time):
            raise ValueError("ramp: found it beside opening_time or closing_time, expected an angle or times")
        if self.pulses is not None:
            object.__setattr__(self, "duty", min(self.pulses.width / TURN, 1.0))
            object.__setattr__(self, "start", self.pulses.edges[0])
        check_duty(self.duty)

    def with_duty(self, duty: float) -> "OnOffValve":
        """Return the valve with another duty cycle, in one piece."""
        return replace(self, duty=check_duty(duty), pulses=None)

    def with_pulses(self, pulses: Iterable[tuple[float, float]]) -> "OnOffValve":
        """Return the valve told to be on from angle to angle [rad]."""
        return replace(self, pulses=check_pulses(pulses, self.ramp))

    def on_window(self) -> Window | Pulses:
        """Return the arcs over which the valve is told to be on."""
        if self.pulses is not None:
            return self.pulses
        return Window(start=self.start, width=TURN * self.duty, ramp=self.ramp)

    @property
    def has_times(self) -> bool:
        """Whether when it opens and closes depends on the frequency: it has delays or travel times in seconds."""
        return (self.opening_delay, self.closing_delay, self.opening_time, self.closing_time) != (0.0, 0.0, 0.0, 0.0)

    def open_share(self, frequency: float) -> float:
        """Return the share of the period for which its "on" paths are open at a frequency [Hz]."""
        return min(self.open_window(frequency).width / TURN, 1.0)

    def duty_band(self, frequency: float) -> tuple[float, float]:
        """Return the commanded duties between which it opens and shuts, and is on and off for long enough, at [Hz]."""
        speed = positive("frequency", frequency, "Hz")
        least = max(self.opening_delay, self.shortest_on) * speed
        return min(least, 1.0), max(1 - max(self.closing_delay, self.shortest_off) * speed, 0.0)

    def open_window(self, frequency: float) -> Window | Pulses:
        """Return the arcs over which its "on" paths are open at a frequency [Hz]."""
        if not self.has_times:
            return self.on_window()
        speed = TURN * positive("frequency", frequency, "Hz")
        late_on, late_off = speed * self.opening_delay, speed * self.closing_delay
        ramp, closing_ramp = speed * self.opening_time / 2, speed * self.closing_time / 2
        arcs = [(on, off) for on, off in self._commands() if off - on > late_on]
        if not arcs:
            return Window(start=0.0, width=0.0)
        # A pause that is not noticed joins the pulses beside it.
        joined = [arcs[0]]
        for on, off in arcs[1:]:
            if on - joined[-1][1] <= late_off:
                joined[-1] = joined[-1][0], off
            else:
                joined.append((on, off))
        if len(joined) > 1 and joined[0][0] + TURN - joined[-1][1] <= late_off:
            first = joined.pop(0)
            joined[-1] = joined[-1][0], first[1] + TURN
        if len(joined) == 1 and joined[0][0] + TURN - joined[0][1] <= late_off:
            return Window(start=0.0, width=TURN)
        moved = [(on + late_on + ramp, off + late_off + closing_ramp) for on, off in joined]
        # A spool that is called back before it is half-way opens nothing.
        edges = [(on, off) for on, off in moved if off > on]
        if not edges:
            return Window(start=0.0, width=0.0)
        if len(edges) == 1:
            on, off = edges[0]
            return Window(start=on, width=min(off - on, TURN), ramp=ramp, closing_ramp=closing_ramp)
        flat = tuple(edge for pair in edges for edge in pair)
        return Pulses(edges=flat, ramp=ramp, closing_ramp=closing_ramp)

    def _commands(self) -> list[tuple[float, float]]:
        """Return the angles of going on and off of each pulse [rad]."""
        if self.pulses is None:
            return [(self.start, self.start + TURN * self.duty)]
        return list(zip(self.pulses.edges[::2], self.pulses.edges[1::2], strict=True))
