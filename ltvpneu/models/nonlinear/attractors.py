"""What a machine settles on from different starts: every attracting orbit or stiction band that they lead to.

One orbit knows only its neighbourhood. Whether the machine has others, a free piston on either end stop for one, shows
only where simulations begin elsewhere. So starts are spread over the stroke and the pressures, each is followed until
it repeats, and those that end on the same orbit, or in the same band, are put together. That is no proof: an orbit
whose basin no start lies in is not found, so the starts are part of the answer.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, IntArray, finite_array, positive, read_only, whole
from ltvpneu._clock import Deadline, deadline
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError, NotSettledError, TimeLimitError
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.models.nonlinear.floquet import orbit_floquet
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.rest import positions_of_rest
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.settle import settle
from ltvpneu.models.nonlinear.simulation import check_state
from ltvpneu.periodic.orbits.floquet import Floquet
from ltvpneu.periodic.orbits.orbit import Orbit

SPREAD = 12
"""Starts over the stroke and the pressures, beside those at rest at zero and at the ends."""
SAME = 3e-3
"""Scaled distance within which two orbits are one, or two places of rest in one band [-]."""
LOOSE, LOOSE_RTOL = 1e-4, 1e-5
"""Tolerances with which a start is followed to an orbit that is known already [-]."""
LOOSE_PERIODS = 0.2
"""Periods that are simulated from starts but the first, over `max_periods` [-]."""
BETWEEN = 1000
"""Periods within which a piston set between two places of rest has to be at rest."""
CREEPS = 1e-5
"""Scaled change over a period up to which a state that has not settled is slow, and no orbit of its own [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Attractors(Value):
    """Every distinct attracting orbit, or stiction band, that a set of starts leads to, the most frequent first.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> lp.attractors(lp.load_machine("kunt_singh_1990"), 4.0).is_single
    True
    """

    machine: Machine
    frequency: float
    """[Hz]"""
    orbits: tuple[Orbit, ...]
    """Of a band, the member that the first of its starts led to."""
    starts: FloatArray
    """(n_starts, n)"""
    reached: IntArray
    """Number of the orbit that each start led to, -1 for none, (n_starts,)."""
    failures: tuple[FailedPoint, ...]
    """Starts that led to no orbit: why."""

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{100 * share:.0f} % to {describe(orbit)}" for share, orbit in zip(self.shares, self.orbits, strict=True)
        )
        lost = f", {len(self.failures)} starts to none (see .failures)" if self.failures else ""
        return f"<Attractors of {self.machine.name} at {self.frequency:g} Hz, {len(self.starts)} starts: {parts}{lost}>"

    @property
    def shares(self) -> FloatArray:
        """Share of the starts that led to each orbit [-], (n_orbits,); the rest led to none."""
        return np.array([np.count_nonzero(self.reached == i) for i in range(len(self.orbits))]) / self.reached.size

    @property
    def is_single(self) -> bool:
        """Whether all starts led to one orbit or band.

        A start that never repeats counts as another. One that is only slow, still on its way after `max_periods`, does
        not count, nor one from which the machine leaves what its equations describe, as a chamber swept empty.
        """
        return len(self.orbits) == 1 and not self.n_unsettled

    @property
    def n_unsettled(self) -> int:
        """How many starts led to what does not repeat."""
        return sum(isinstance(f.error, NotSettledError) and f.error.residual > CREEPS for f in self.failures)

    @property
    def multipliers(self) -> tuple[ComplexArray, ...]:
        """Floquet multipliers of each orbit [-]."""
        return tuple(one.multipliers for one in self.floquet)

    @cached_property
    def floquet(self) -> tuple[Floquet, ...]:
        """Stability of each orbit."""
        return tuple(orbit_floquet(self.machine, orbit) for orbit in self.orbits)


def describe(orbit: Orbit) -> str:
    """Return in a few words what an orbit is, for readers."""
    if orbit.rest:
        where = "" if orbit.rest.startswith("rests") else f" at {1e3 * orbit.mean(0):.4g} mm"
        return f"{orbit.rest}{where}"
    periods = f", {orbit.n_periods} periods" if orbit.n_periods > 1 else ""
    return f"mean {1e3 * orbit.mean(0):.4g} mm, amplitude {1e3 * orbit.amplitude(0):.4g} mm{periods}"


def attractors(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float,
    starts: ArrayLike | None = None,
    *,
    n_spread: int = SPREAD,
    generator: np.random.Generator | None = None,
    max_periods: int = 5000,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Attractors:
    """Return every distinct attracting orbit or stiction band of the nonlinear machine that a set of starts leads to.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    starts : array_like, shape (n_starts, n_states), optional
        Initial states [m, m/s, Pa, K]. By default: at rest at zero; at both ends of the stroke, with every chamber at
        the supply's and at the exhaust's pressure in turn; and `n_spread` at rest, spread over the stroke and the
        pressures. Where there is no end stop, the stroke ends where no pressure holds the piston.
    n_spread : int
    generator : numpy.random.Generator, optional
        Of the spread; by default one of a fixed seed.
    max_periods : int
        Valve periods to simulate from the first start before giving up, as of `nonlinear_orbit`; from the others a
        fifth of it.
    max_seconds : float, optional
        Time after which to give up [s]; by default never.
    progress : callable, optional
        Called with 1 after each start, such as the `update` of a tqdm bar.

    Returns
    -------
    Attractors
        A start that leads to no orbit is kept in `.failures`.

    Raises
    ------
    TimeLimitError
        `max_seconds` are over.
    ValueError
        Frequency or a start out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.attractors(lp.load_machine("kunt_singh_1990").with_duty(0.7), 20.0)
    >>> found.is_single, found.orbits[0].rest
    (True, 'held by stiction')
    """
    expect_machine(machine)
    positive("frequency", frequency, "Hz")
    if starts is None:
        generator = np.random.default_rng(0) if generator is None else generator
        states = default_starts(machine, whole("n_spread", n_spread, 0), generator)
    else:
        states = finite_array("starts", starts, (None, len(machine.states)))
        if len(states) == 0:
            raise ValueError("starts: found none, expected one state or more")
        for i, state in enumerate(states):
            check_state(machine, state, f"starts[{i}]")
    machine = machine.at(frequency)
    search = _Search(machine, float(frequency), deadline(max_seconds))
    reached = np.full(len(states), -1, dtype=np.int64)
    failures: list[FailedPoint] = []
    most = whole("max_periods", max_periods)
    for i, state in enumerate(states):
        try:
            reached[i] = search.follow(state, most if i == 0 else max(int(LOOSE_PERIODS * most), 1))
        except TimeLimitError:
            raise
        except LtvpneuError as error:
            failures.append(FailedPoint(model="nonlinear", frequency=float(frequency), duty=machine.duty, error=error))
        if progress is not None:
            progress(1)
        if search.end is not None:
            search.end.check(f"{i + 1} of {len(states)} starts followed")
    return _sorted(search, states, reached, tuple(failures))


def default_starts(machine: Machine, n_spread: int, generator: np.random.Generator) -> FloatArray:
    """Return the states that `attractors` starts from unless told otherwise, shape (n_starts, n)."""
    low, high = stroke_of(machine)
    sources = machine.exhaust_pressure, machine.supply_pressure
    n_chambers, pressures = len(machine.cylinder.chambers), slice(2, 2 + machine.n_volumes)
    found = [np.array(machine.rest_state)]
    for position, ends in itertools.product((low, high), itertools.product(sources, repeat=n_chambers)):
        state = np.array(machine.rest_state)
        state[0], state[2 : 2 + n_chambers] = position, ends
        found.append(state)
    # Each coordinate is spread evenly, and shuffled against the others (a Latin hypercube).
    strata = (np.arange(n_spread)[:, None] + generator.random((n_spread, 1 + machine.n_volumes))) / max(n_spread, 1)
    shares = generator.permuted(strata, axis=0)
    for share in shares:
        state = np.array(machine.rest_state)
        state[0] = low + share[0] * (high - low)
        state[pressures] = sources[0] + share[1:] * (sources[1] - sources[0])
        found.append(state)
    return read_only(np.array(found))


def stroke_of(machine: Machine) -> tuple[float, float]:
    """Return the ends of the stroke [m]: the stops, or where no pressure holds the piston beyond."""
    low, high = positions_of_rest(machine)
    length, cylinder = float(machine.state_scales[0]), machine.cylinder
    # Where nothing bounds it, a dead length away from zero; and not where a chamber is all but swept empty.
    low = low if math.isfinite(low) else -0.5 * length
    high = high if math.isfinite(high) else 0.5 * length
    for volume, slope, *_ in machine.volume_fields[: len(cylinder.chambers)]:
        edge = -0.5 * volume / slope
        low, high = (max(low, edge), high) if slope > 0 else (low, min(high, edge))
    low = cylinder.lower_stop if math.isfinite(cylinder.lower_stop) else low
    high = cylinder.upper_stop if math.isfinite(cylinder.upper_stop) else high
    return low, max(low, high)


class _Search:
    """The orbits found so far, and the starts followed to them."""

    def __init__(self, machine: Machine, frequency: float, end: Deadline | None) -> None:
        self.end = end
        self.machine, self.frequency, self.scales = machine, frequency, np.array(machine.state_scales)
        # Of a short stroke beside large dead volumes the stroke is the length that counts.
        low, high = stroke_of(machine)
        self.scales[0] = min(self.scales[0], high - low) or self.scales[0]
        self.orbits: list[Orbit] = []
        # Of each orbit all that joined it: of a band, its places of rest.
        self.members: list[list[Orbit]] = []
        settings = integration_settings(machine, LOOSE_RTOL)
        self.run = new_run(machine.record, settings, pieces_of(machine.openings, 1 / frequency))

    def follow(self, state: FloatArray, max_periods: int) -> int:
        """Return the number of the orbit that a start leads to."""
        start = np.array(state)
        if self.orbits:
            # Loosely, where it ends on an orbit that is known.
            loose = settle(start, self.run, self.scales, LOOSE, max_periods, self.end)
            if loose.last.status == OK and loose.n_periods > 0:
                known = self._known(loose.last.state, loose.n_periods)
                if known >= 0:
                    return known
                start = loose.last.state
        orbit = nonlinear_orbit(self.machine, self.frequency, start, max_periods=max_periods, max_seconds=self.left)
        known = self._known(orbit.initial_state, orbit.n_periods) if orbit.is_isolated else self._band(orbit)
        if known < 0:
            self.orbits.append(orbit)
            self.members.append([orbit])
            return len(self.orbits) - 1
        self.members[known].append(orbit)
        return known

    @property
    def left(self) -> float | None:
        """Time left [s]; none where there is no limit."""
        return None if self.end is None else self.end.left

    def _known(self, state: FloatArray, n_periods: int) -> int:
        """Return the isolated orbit that a state lies on, -1 for none."""
        for number, orbit in enumerate(self.orbits):
            if orbit.is_isolated and orbit.n_periods == n_periods and self._distance(orbit, state) <= SAME:
                return number
        return -1

    def _distance(self, orbit: Orbit, state: FloatArray) -> float:
        return float(np.min(np.max(np.abs(orbit.branches - state) / self.scales, axis=1)))

    def _band(self, orbit: Orbit) -> int:
        """Return the band that a place of rest belongs to, -1 for none: the piston rests between it and a member."""
        for number, members in enumerate(self.members):
            if members[0].is_isolated:
                continue
            nearest = min(members, key=lambda member: abs(member.mean(0) - orbit.mean(0)))
            if self._rests_between(orbit, nearest):
                return number
        return -1

    def _rests_between(self, one: Orbit, other: Orbit) -> bool:
        apart = abs(one.mean(0) - other.mean(0)) / self.scales[0]
        if apart <= SAME:
            return True
        middle = 0.5 * (one.initial_state + other.initial_state)
        middle[1] = 0.0
        found = settle(middle, self.run, self.scales, LOOSE, BETWEEN, self.end)
        stays = found.last.status == OK and found.n_periods > 0
        return stays and abs(float(found.last.state[0] - middle[0])) / self.scales[0] <= SAME


def _sorted(search: _Search, states: FloatArray, reached: IntArray, failures: tuple[FailedPoint, ...]) -> Attractors:
    counts = [int(np.count_nonzero(reached == i)) for i in range(len(search.orbits))]
    order = sorted(range(len(counts)), key=lambda i: -counts[i])
    place = {old: new for new, old in enumerate(order)}
    renamed = np.array([place.get(int(i), -1) for i in reached], dtype=np.int64)
    renamed.setflags(write=False)
    return Attractors(
        machine=search.machine,
        frequency=search.frequency,
        orbits=tuple(search.orbits[i] for i in order),
        starts=states,
        reached=renamed,
        failures=failures,
    )
