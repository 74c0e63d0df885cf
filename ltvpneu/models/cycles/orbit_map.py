"""What kind of orbit the nonlinear machine has over frequency and duty, and whether it is the only one.

A machine with stiction has bands, where it rests anywhere within an interval; subharmonics; and between these, points
where the state never repeats. A free piston may go to either end stop: what it settles on depends on the start
(`attractors`). Chaos is told apart from slow settling by the Lyapunov exponent, the mean logarithm by which two
neighbours draw apart in a valve period: above zero it is chaos.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import BoolArray, FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.errors import NotSettledError
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.attractors import Attractors, attractors
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.physics.valve import check_duty

DEPENDS = "depends on the start"
KINDS = ("unique", "band", "subharmonic", "chaotic", DEPENDS, "failed")
"""Of one attractor that all starts lead to: an isolated orbit of one period, a band, an orbit of several; or none that
repeats; or several attractors; or no answer."""
WIDE = 0.2
"""Share of the means' range from which on a gap between them counts as positions that no duty holds [-]."""
SAID = {"unique": "one orbit from all starts", "band": "stiction band"}
"""Kinds as readers are told them, where that is not by their names."""
FINE = 0.0125
"""Steps of duty in which it is looked which positions a duty holds, where the piston may jump [-]."""
MAP_SPREAD = 6
"""Starts over the stroke and the pressures at each point of a map."""
CHAOS_PERIODS = 1000
NEIGHBOUR = 1e-6
"""Scaled distance at which neighbours are set [-]."""


@final
@dataclass(frozen=True, kw_only=True)
class Branch(Value):
    """One of the orbits that a machine settles on at a point of a map."""

    mean: float
    """Of the position [m]."""
    amplitude: float
    """Of the position [m]."""
    n_periods: int
    rest: str
    """What holds a piston that rests, as of `Orbit`."""
    is_isolated: bool
    share: float
    """Of the starts that lead to it [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitMap(Value):
    """Kinds of orbits over frequency (rows) and duty (columns), each array (n_frequencies, n_duties).

    Figures are those of the orbit that the machine settles on from rest at zero; `branches` has all that were found.
    """

    machine: Machine
    frequencies: FloatArray
    """[Hz]"""
    duties: FloatArray
    kinds: tuple[tuple[str, ...], ...]
    """Of `KINDS`."""
    n_periods: FloatArray
    """Valve periods after which the orbit repeats; nan where it does not."""
    amplitudes: FloatArray
    """Of the position [m]; nan likewise."""
    means: FloatArray
    n_simulated: FloatArray
    """Valve periods simulated to find it."""
    lyapunov_exponents: FloatArray
    """Per valve period [-], where the state never repeats; else nan."""
    branches: tuple[tuple[tuple[Branch, ...], ...], ...]
    """Of every row and column, all orbits that the starts led to."""
    columns: tuple[tuple[tuple[float, tuple[float, ...]], ...], ...]
    """At each frequency, duties and the means of all orbits there [m], rising; with more duties than the map's, where
    it is looked closer which positions a duty holds."""
    failures: tuple[FailedPoint, ...]

    @property
    def depends_on_start(self) -> BoolArray:
        """Whether starts led to different orbits, or some to none that repeats."""
        return np.array([[kind == DEPENDS for kind in row] for row in self.kinds])

    def row(self, frequency: float) -> int:
        """Return the number of a frequency of the map."""
        near = np.flatnonzero(np.isclose(self.frequencies, frequency, rtol=1e-9))
        if near.size == 0:
            known = ", ".join(f"{f:g}" for f in self.frequencies)
            raise ValueError(f"frequency: found {frequency:g} Hz, expected one of the map's: {known}")
        return int(near[0])

    def unheld(self, frequency: float) -> tuple[float, float] | None:
        """Return the mean positions that no duty of the map's range holds at a frequency, from and to [m]; or None.

        They lie between orbits of which the start decides, or where a piston without a spring jumps within `FINE` of
        duty. No orbit that was found lies among them.

        Parameters
        ----------
        frequency : float
            One of the map's [Hz].
        """
        columns = [list(means) for _, means in self.columns[self.row(frequency)] if means]
        found = np.unique([mean for column in columns for mean in column])
        # One duty says nothing of others.
        if found.size < 2 or self.duties.size < 2:
            return None
        steps = [pair for column in columns for pair in pairwise(column)]
        if self.machine.load.spring_stiffness == 0:
            steps += [(min(a[-1], b[-1]), max(a[0], b[0])) for a, b in pairwise(columns)]
        # What lies in such a step and between neighbours of all that was found is not held.
        gaps = [(float(a), float(b)) for a, b in pairwise(found) if any(lo <= a and b <= hi for lo, hi in steps)]
        low, high = max(gaps, key=lambda gap: gap[1] - gap[0], default=(0.0, 0.0))
        return (low, high) if high - low > WIDE * (found[-1] - found[0]) else None

    def remark(self, frequency: float | None = None) -> str:
        """Return what no duty of the map's range holds, and what does, in a sentence; nothing where all is held.

        Parameters
        ----------
        frequency : float, optional
            One of the map's [Hz]; by default all of them.
        """
        asked = self.frequencies if frequency is None else np.array([frequency])
        found = {float(f): gap for f in asked if (gap := self.unheld(float(f))) is not None}
        if not found:
            return ""
        low, high = max(gap[0] for gap in found.values()), min(gap[1] for gap in found.values())
        if low >= high:
            # They have nothing in common: the widest alone.
            widest = max(found, key=lambda f: found[f][1] - found[f][0])
            found, (low, high) = {widest: found[widest]}, found[widest]
        where = ", ".join(f"{f:.4g}" for f in sorted(found))
        spring = ", or give the piston a spring" if self.machine.load.spring_stiffness == 0 else ""
        return (
            f"At {where} Hz no duty holds a mean position between {1e3 * low:.4g} and {1e3 * high:.4g} mm: from there "
            "the piston goes to one side or the other. Feedback holds it: measure the position and set the duty anew "
            f"each period (design.simulate_closed_loop){spring}."
        )

    def count(self, kind: str) -> int:
        """Return at how many points the orbit is of a kind."""
        if kind not in KINDS:
            raise ValueError(f"kind: found {kind!r}, expected one of {', '.join(KINDS)}")
        return sum(row.count(kind) for row in self.kinds)


def orbit_map(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    duties: ArrayLike,
    frequencies: ArrayLike,
    *,
    n_spread: int = MAP_SPREAD,
    starts: ArrayLike | None = None,
    fine: float = FINE,
    max_periods: int = 5000,
    progress: Callable[[int], object] | None = None,
) -> OrbitMap:
    """Return what kind of orbit the nonlinear machine settles on over duty and frequency, and whether on no other.

    Parameters
    ----------
    machine : Machine
    duties : array_like, shape (n_duties,)
        Between 0 and 1.
    frequencies : array_like, shape (n_frequencies,)
        [Hz], above zero.
    n_spread : int
        Starts spread over the stroke at each point, beside those of `attractors` at rest at zero and at the ends.
    starts : array_like, shape (n_starts, n_states), optional
        Instead of all these.
    fine : float
        Step of the duty [-] with which it looks closer where the piston may jump between two duties of the map.
    max_periods : int
        As of `attractors`.
    progress : callable, optional
        Called with 1 after each point, such as the `update` of a tqdm bar.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.orbit_map(lp.load_machine("kunt_singh_1990"), [0.5, 0.7, 0.86], [5.4, 20.0])
    >>> found.kinds
    (('unique', 'unique', 'subharmonic'), ('unique', 'band', 'band'))
    """
    expect_machine(machine)
    duty_grid, frequency_grid = grid_of(duties, frequencies)
    shape = (frequency_grid.size, duty_grid.size)
    names = ("n_periods", "amplitudes", "means", "n_simulated", "lyapunov_exponents")
    arrays = {name: np.full(shape, np.nan) for name in names}
    kinds, failures = [["failed"] * shape[1] for _ in range(shape[0])], list[FailedPoint]()
    branches: list[list[tuple[Branch, ...]]] = [[()] * shape[1] for _ in range(shape[0])]

    def found_at(frequency: float, duty: float) -> Attractors:
        return attractors(machine.with_duty(duty), frequency, starts, n_spread=n_spread, max_periods=max_periods)

    for row, column in np.ndindex(shape):
        present, frequency = machine.with_duty(float(duty_grid[column])), float(frequency_grid[row])
        found = found_at(frequency, float(duty_grid[column]))
        first = found.failures[0].error if found.reached[0] < 0 else None
        branches[row][column] = _branches(found)
        kinds[row][column] = _kind(found)
        if first is None:
            orbit = found.orbits[found.reached[0]]
            arrays["n_periods"][row, column] = orbit.n_periods
            arrays["amplitudes"][row, column] = orbit.amplitude("position")
            arrays["means"][row, column] = orbit.mean("position")
            arrays["n_simulated"][row, column] = orbit.n_simulated
        else:
            failures.append(found.failures[0])
        if isinstance(first, NotSettledError):
            exponent = _lyapunov_exponent(present, frequency, np.asarray(first.last_state))
            arrays["lyapunov_exponents"][row, column] = exponent
            arrays["n_simulated"][row, column] = first.n_simulated
            if not found.orbits and exponent > 0:
                kinds[row][column] = "chaotic"
        if progress is not None:
            progress(1)
    columns = [
        _looked_closer(
            partial(found_at, float(frequency)),
            duty_grid,
            branches[row],
            (machine.load.spring_stiffness == 0, fine),
        )
        for row, frequency in enumerate(frequency_grid)
    ]
    return OrbitMap(
        machine=machine,
        frequencies=frequency_grid,
        duties=duty_grid,
        columns=tuple(columns),
        kinds=tuple(tuple(line) for line in kinds),
        branches=tuple(tuple(line) for line in branches),
        failures=tuple(failures),
        **{name: read_only(values) for name, values in arrays.items()},
    )


def _looked_closer(
    settled: Callable[[float], Attractors],
    duties: FloatArray,
    row: Sequence[tuple[Branch, ...]],
    how: tuple[bool, float],
) -> tuple[tuple[float, tuple[float, ...]], ...]:
    """Return duties and means, with duties between two of the map's where the piston may jump from one to the other."""
    (springless, fine), order = how, np.argsort(duties)
    columns = [(float(duties[i]), tuple(sorted(branch.mean for branch in row[i]))) for i in order]
    known = [mean for _, means in columns for mean in means]
    reach = WIDE * (max(known) - min(known)) if known else 0.0
    found = columns[:1]
    for before, after in pairwise(columns):
        ends = [*before[1], *after[1]]
        jumps = len(before[1]) > 1 or len(after[1]) > 1 or (springless and len(ends) > 1)
        if jumps and max(ends) - min(ends) > reach:
            count = math.ceil((after[0] - before[0]) / fine - 1e-9)
            for duty in np.linspace(before[0], after[0], count + 1)[1:-1].tolist():
                found.append((duty, tuple(sorted(orbit.mean("position") for orbit in settled(duty).orbits))))
        found.append(after)
    return tuple(found)


def _kind(found: Attractors) -> str:
    if not found.orbits:
        return "failed"
    if not found.is_single:
        return DEPENDS
    orbit = found.orbits[0]
    if not orbit.is_isolated:
        return "band"
    return "subharmonic" if orbit.n_periods > 1 else "unique"


def _branches(found: Attractors) -> tuple[Branch, ...]:
    return tuple(
        Branch(
            mean=orbit.mean("position"),
            amplitude=orbit.amplitude("position"),
            n_periods=orbit.n_periods,
            rest=orbit.rest,
            is_isolated=orbit.is_isolated,
            share=float(share),
        )
        for orbit, share in zip(found.orbits, found.shares, strict=True)
    )


def grid_of(duties: ArrayLike, frequencies: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return duties and frequencies as arrays, checked."""
    duty_grid = finite_array("duties", duties, (None,))
    for i, duty in enumerate(duty_grid):
        check_duty(float(duty), f"duties[{i}]")
    frequency_grid = finite_array("frequencies", frequencies, (None,))
    for name, grid in (("duties", duty_grid), ("frequencies", frequency_grid)):
        if grid.size == 0:
            raise ValueError(f"{name}: found none, expected one or more")
    if (frequency_grid <= 0).any():
        raise ValueError(f"frequencies: found {frequency_grid.min():g} Hz, expected numbers above zero")
    return duty_grid, frequency_grid


def _lyapunov_exponent(machine: Machine, frequency: float, state: FloatArray) -> float:
    """Return the mean logarithm by which a neighbour draws away in a valve period, set near again after each."""
    machine = machine.at(frequency)
    pieces = pieces_of(machine.openings, 1 / frequency)
    run = new_run(machine.record, integration_settings(machine, 1e-11), pieces)
    scales = machine.state_scales
    apart = np.zeros(scales.size)
    apart[0] = NEIGHBOUR
    total, counted = 0.0, 0
    for _ in range(CHAOS_PERIODS):
        one, other = integrate_period(state, run), integrate_period(state + apart * scales, run)
        if one.status != OK or other.status != OK:
            break
        difference = (other.state - one.state) / scales
        size = float(np.linalg.norm(difference))
        if size == 0:
            # Both stuck at the same place: nothing draws apart faster than that it comes together.
            return -math.inf
        total += math.log(size / NEIGHBOUR)
        counted += 1
        apart, state = difference * (NEIGHBOUR / size), one.state
    return total / counted if counted else math.nan
