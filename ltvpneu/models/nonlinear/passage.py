"""The nonlinear machine through several positions of its valves, each held for some time: a move, not a cycle.

Within a part nothing depends on time, so a part that lasts dt longer moves its end by the rate there, and what follows
by the derivative of the later parts over the states that they start from (variational equation, saltation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, final

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import with_values
from ltvpneu.models.machine.piston import at_stop
from ltvpneu.models.nonlinear.integrator import Record
from ltvpneu.models.nonlinear.mass_drawn import mass_drawn
from ltvpneu.models.nonlinear.method import DormandPrince
from ltvpneu.models.nonlinear.period_map import PeriodMap, Turn
from ltvpneu.models.nonlinear.polynomial import polynomial_extremes
from ltvpneu.physics.on_off_valve import OnOffValve

Position = tuple[bool, ...]
"""Whether each valve is on, the machine's own first."""
RTOL = 1e-9
JUST_BEFORE = 1e-9
"""Share of a part [-]."""


def without_delays(machine: Machine) -> Machine:
    """Return the machine with on-off valves that switch at once, whatever times and ramps they have."""
    prompt = [_prompt(valve) for valve in (machine.valve, *machine.more_valves)]
    return replace(machine, valve=prompt[0], more_valves=tuple(prompt[1:]), switching_frequency=None)


def _prompt(valve: Any) -> Any:
    if not isinstance(valve, OnOffValve):
        return valve
    return replace(
        valve,
        pulses=None,
        start=0.0,
        ramp=0.0,
        opening_delay=0.0,
        closing_delay=0.0,
        opening_time=0.0,
        closing_time=0.0,
    )


def positions_of(machine: Machine) -> dict[Position, Machine]:
    """Return the machine with its valves held in each combination of on and off, two that open the same once."""
    found: dict[Position, Machine] = {}
    seen: set[bytes] = set()
    for position in product((False, True), repeat=1 + len(machine.more_valves)):
        names = ("duty", *(f"duty_{i + 2}" for i in range(len(machine.more_valves))))
        held = with_values(machine, {name: float(on) for name, on in zip(names, position, strict=True)})
        table = held.openings
        if table.fractions.size != 2 or table.ramped.any():
            raise ValueError("machine: found a valve that moves while it is held on or off, expected one that switches")
        opened = table.areas.tobytes()
        if opened not in seen:
            seen.add(opened)
            found[position] = held
    return found


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Passage(Value):
    """A machine's way through parts, in each of which its valves stand still."""

    maps: tuple[PeriodMap, ...]
    """One of each part; its period is how long the part lasts."""
    turns: tuple[Turn, ...]

    def __repr__(self) -> str:
        return f"<Passage of {len(self.turns)} parts, {self.duration:g} s, to position {self.end[0]:.6g} m>"

    @property
    def start(self) -> FloatArray:
        """The first state, (n_states,)."""
        return self.turns[0].start

    @property
    def end(self) -> FloatArray:
        """The last state, (n_states,)."""
        return self.turns[-1].end

    @property
    def durations(self) -> FloatArray:
        """Durations of the parts [s], (n_parts,)."""
        return np.array([1 / one.frequency for one in self.maps])

    @property
    def duration(self) -> float:
        """Of the whole way [s]."""
        return float(np.sum(self.durations))

    @cached_property
    def end_slopes(self) -> FloatArray:
        """Derivatives of the end over the parts' durations, (n_states, n_parts)."""
        columns: list[FloatArray] = []
        after = np.eye(self.end.size)
        for period, turn in zip(reversed(self.maps), reversed(self.turns), strict=True):
            columns.append(after @ _rate_at_end(turn.record))
            if turn is not self.turns[0]:
                after = after @ period.derivative(turn)
        return np.stack(columns[::-1], axis=1)

    @cached_property
    def unheld_end(self) -> tuple[FloatArray, FloatArray]:
        """The last state as it would be had nothing stopped the piston, to first order, and its derivatives.

        Where friction holds the piston in the end, its velocity is zero and stays so for a longer move: an equation
        that asks for rest has no slope there. So the velocity goes on by the deceleration with which it stopped; and on
        a stop, the position by the velocity with which it was met. Both are as asked at the moment of coming to rest
        only. (n_states,), and (n_states, n_parts).
        """
        stopped = self._stopped()
        if stopped is None:
            return self.end, self.end_slopes
        part, until, row = stopped
        # Just before what stops it, whose saltation is not to be in the slopes.
        first = PeriodMap(
            machine=self.maps[part].machine, frequency=1 / ((1 - JUST_BEFORE) * until), method=self.maps[part].method
        )
        before = Passage(
            maps=(*self.maps[:part], first), turns=(*self.turns[:part], first.turn(self.turns[part].start))
        )
        rate = float(before.end_slopes[row, -1])
        end, slopes = self.end.copy(), self.end_slopes.copy()
        end[row] = before.end[row] + rate * (self.duration - before.duration)
        slopes[row, : part + 1], slopes[row, part + 1 :] = before.end_slopes[row], rate
        return end, slopes

    def _stopped(self) -> tuple[int, float, int] | None:
        """Return in which part and when since its start the piston came to the rest that it is at in the end.

        And which state stopped: the velocity by friction, the position by a stop. None where it moves, or never did.
        """
        if self.turns[-1].record.modes[-1] != STUCK:
            return None
        for part in range(len(self.turns) - 1, -1, -1):
            moving = np.flatnonzero(self.turns[part].record.modes != STUCK)
            if moving.size:
                record, last = self.turns[part].record, int(moving[-1])
                on_stop = at_stop(float(self.end[0]), self.maps[0].machine.record)
                return part, float(record.starts[last] + record.spans[last]), 0 if on_stop else 1
        return None

    @property
    def air_mass(self) -> float:
        """Drawn from the supply [kg]."""
        pairs = zip(self.maps, self.turns, strict=True)
        return sum(mass_drawn(turn.record, one.machine, one.frequency) for one, turn in pairs)

    @property
    def impact_energy(self) -> float:
        """The most that a stop takes of the moving mass, or would take of what still moves at the end [J]."""
        speeds = [self.end[1], *(speed for turn in self.turns for speed in self._arrivals(turn))]
        return float(self.maps[0].machine.load.mass * max(speed**2 for speed in speeds) / 2)

    def _arrivals(self, turn: Turn) -> list[float]:
        """Return the velocities that stops take away."""
        record, machine = turn.record, self.maps[0].machine
        before = np.einsum("ip,ip->i", record.spans[:, None] ** np.arange(5), record.coefficients[:, :, 1])
        places = np.append(record.coefficients[1:, 0, 0], turn.end[0])
        after = np.append(record.coefficients[1:, 0, 1], turn.end[1])
        return [
            float(lost)
            for place, lost in zip(places.tolist(), (before - after).tolist(), strict=True)
            if at_stop(place, machine.record)
        ]

    def extreme(self, state: int, *, greatest: bool) -> float:
        """Return a state's greatest or least value on the way."""
        pairs = [
            polynomial_extremes(turn.record.coefficients[:, :, state].copy(), turn.record.spans.copy())
            for turn in self.turns
        ]
        return max(high for _, high in pairs) if greatest else min(low for low, _ in pairs)

    def at(self, times: FloatArray) -> FloatArray:
        """Return the states at times since the start [s], (n_states, n_times)."""
        ends = np.cumsum(self.durations)
        part = np.minimum(np.searchsorted(ends, times, side="right"), len(self.turns) - 1)
        begins = np.concatenate([[0.0], ends[:-1]])
        found = np.empty((self.end.size, times.size))
        for number, turn in enumerate(self.turns):
            here = part == number
            if here.any():
                local = np.clip(times[here] - begins[number], 0.0, 1 / self.maps[number].frequency)
                found[:, here] = turn.trajectory.at(local)
        return found


def passage(machines: Sequence[Machine], durations: FloatArray, start: FloatArray, rtol: float = RTOL) -> Passage:
    """Return the way of a machine from a state through parts.

    Parameters
    ----------
    machines : sequence of Machine
        One a part, with valves that stand still: see `positions_of`.
    durations : ndarray, shape (n_parts,)
        Above zero [s].
    start : ndarray, shape (n_states,)
    rtol : float

    Raises
    ------
    IntegrationError
        The equations could not be integrated on.
    """
    maps: list[PeriodMap] = []
    turns: list[Turn] = []
    for machine, duration in zip(machines, durations.tolist(), strict=True):
        maps.append(PeriodMap(machine=machine, frequency=1 / duration, method=DormandPrince(rtol=rtol)))
        turns.append(maps[-1].turn(start))
        start = turns[-1].end
    return Passage(maps=tuple(maps), turns=tuple(turns))


def _rate_at_end(record: Record) -> FloatArray:
    """Return the rate of the state where a record ends, (n_states,)."""
    powers = np.arange(1, 5) * record.spans[-1] ** np.arange(4)
    rate: FloatArray = powers @ record.coefficients[-1, 1:]
    return read_only(rate)
