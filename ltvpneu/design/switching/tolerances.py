"""Goals over ranges of what is not known well: the nonlinear machine at corners and inside, and how many keep them."""

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from ltvpneu._arrays import FloatArray, finite, whole
from ltvpneu.design.air_use import air_use
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.cycle import signal_scales
from ltvpneu.design.switching.duty_problem import KEPT_WITHIN, Scenario
from ltvpneu.design.switching.duty_solution import DutySolution, GoalCheck
from ltvpneu.design.switching.goals import Goals, check_objective, speeds, wanted_bounds
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.parameters import present_value, with_values
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.periodic.orbits.orbit import Orbit

Ranges = Mapping[str, tuple[float, float] | str]
"""The least and the greatest value of numbers of the machine [SI], or a text such as "+-10 %"."""
MOST_CORNERS = 6
"""Parameters of which all corners are looked at; of more, as many points as six have, on the faces."""
INSIDE = 32
"""Points inside at which a worst case is checked."""
MOST_SCENARIOS = 24
"""Points that a design takes as scenarios."""


class _Goal(NamedTuple):
    """One bound of one figure."""

    name: str
    figure: Callable[[Machine, Orbit], float]
    bound: float
    sign: float
    """1 where the figure is to be at most the bound, -1 where at least."""


def check_goals(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float,
    ranges: Ranges,
    *,
    goals: Goals,
    minimize: str = "amplitude",
    n: int = 200,
    corners: bool = True,
    spread: Literal["uniform", "normal"] = "uniform",
    generator: np.random.Generator | None = None,
    progress: Progress | None = None,
) -> GoalCheck:
    """Return how the nonlinear machine keeps goals while numbers of it vary.

    Parameters
    ----------
    machine : Machine
        As designed.
    frequency : float
        [Hz]
    ranges : mapping of str to (float, float) or str
        Least and greatest values of numbers of the machine, as in `parameter_sensitivity`; or texts as "+-10 %", of the
        present value.
    goals : Goals
        Those of `mean` that are one value belong to the machine as it is, and are left out.
    minimize : str
        Whose value is followed too, as of `optimize_duty`.
    n : int
        Points inside.
    corners : bool
        Look at the corners of the ranges too.
    spread : {"uniform", "normal"}
        How the points inside are spread: evenly, or about the middle with three standard deviations to either end.
    generator : numpy.random.Generator, optional
        Draws the points inside. By default they are a Sobol sequence's, which fills the ranges more evenly.
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Raises
    ------
    ValueError
        Unknown numbers, ranges that contradict themselves, no ranges.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> machine = lp.load_machine("kunt_singh_1990").with_duty(0.42)
    >>> found = design.check_goals(
    ...     machine, 15.0, {"supply_pressure": "+-5 %", "load.dry_friction": (5.0, 13.3)},
    ...     goals=design.Goals(mean={"position": (0.040, 0.048)}), n=64)
    >>> print(f"{found.share:.2f} keep it; the worst is {1e3 * found.worst('most mean position'):.1f} mm beyond")
    0.92 keep it; the worst is 1.4 mm beyond
    """
    expect_machine(machine)
    spans = spans_of(machine, frequency, ranges, ())
    if spread not in ("uniform", "normal"):
        raise ValueError(f'spread: found {spread!r}, expected "uniform" or "normal"')
    inside = _inside(len(spans), whole("n", n, 0), spread, generator)
    shares = np.vstack([_corners(len(spans)), inside]) if corners else inside
    return _checked(machine, frequency, spans, (shares, len(inside)), (goals, check_objective(minimize)), progress)


def spans_of(
    machine: Machine, frequency: float, ranges: Ranges, free: Collection[str]
) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest values of what varies; `free` are variables, which cannot vary as well."""
    if not ranges:
        raise ValueError('ranges: found none, expected some, such as {"supply_pressure": "+-10 %"}')
    found: dict[str, tuple[float, float]] = {}
    for name, asked in ranges.items():
        if name in free:
            raise ValueError(
                f"ranges: found {name!r}, which is a variable of the design; expected it in one of the two"
            )
        value = present_value(machine, frequency, name)
        low, high = _span(name, asked, value)
        if low > high:
            raise ValueError(f"ranges: found {low:g} to {high:g} of {name!r}; they contradict each other")
        for end in (low, high):
            try:
                with_values(machine, {name: end})
            except ValueError as error:
                raise ValueError(f"ranges: found {end:g} for {name!r}: {error}") from None
        found[name] = low, high
    return found


def _span(name: str, asked: Any, value: float) -> tuple[float, float]:
    if isinstance(asked, str):
        match = re.fullmatch(r"\s*\+-\s*(\d+\.?\d*)\s*%\s*", asked)
        if match is None:
            raise ValueError(f"ranges[{name!r}]: found {asked!r}, expected two values, or a text such as '+-10 %'")
        if value == 0:
            raise ValueError(
                f"ranges[{name!r}]: found {asked!r} of a number that is zero, expected its least and greatest value"
            )
        part = abs(value) * float(match[1]) / 100
        return value - part, value + part
    if not isinstance(asked, Sequence) or len(asked) != 2:  # pyright: ignore[reportUnknownArgumentType]
        raise ValueError(f"ranges[{name!r}]: found {asked!r}, expected two values, or a text such as '+-10 %'")
    low, high = (finite(f"ranges[{name!r}]", end) for end in asked)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    return low, high


def _corners(k: int) -> FloatArray:
    """Return corners of the ranges, as shares, (n_corners, k); of many, both ends of each and some of the others."""
    if k <= MOST_CORNERS:
        return np.array(list(product((0.0, 1.0), repeat=k)))
    return np.rint(qmc.Sobol(k, rng=0).random(2**MOST_CORNERS))


def _inside(k: int, n: int, spread: str, generator: np.random.Generator | None) -> FloatArray:
    if not n:
        return np.zeros((0, k))
    shares = (
        qmc.Sobol(k, rng=0).random(1 << (n - 1).bit_length())[:n] if generator is None else generator.random((n, k))
    )
    if spread == "uniform":
        return shares
    # Within three standard deviations: the rest, 0.3 %, would be at the ends.
    return np.clip(0.5 + ndtri(np.clip(shares, 1e-12, 1 - 1e-12)) / 6, 0.0, 1.0)


def _checked(
    machine: Machine,
    frequency: float,
    spans: Mapping[str, tuple[float, float]],
    points: tuple[FloatArray, int],
    wanted: tuple[Goals, str],
    progress: Progress | None,
) -> GoalCheck:
    shares, n_inside = points
    goals, minimize = wanted
    lows, highs = np.array(list(spans.values())).T
    values = lows + shares * (highs - lows)
    bounds = _bounds(goals, machine)
    missed = {goal.name: np.full(len(values), math.nan) for goal in bounds}
    objectives, failures = np.full(len(values), math.nan), dict[int, str]()
    for number, point in enumerate(values):
        if progress is not None:
            progress("checking over the ranges", number / len(values))
        varied = with_values(machine, dict(zip(spans, point.tolist(), strict=True)))
        try:
            orbit = nonlinear_orbit(varied, frequency)
        except LtvpneuError as error:
            failures[number] = str(error)
            continue
        if not orbit.is_isolated:
            failures[number] = "stiction holds the piston: where it rests depends on how it came there"
            continue
        for goal in bounds:
            missed[goal.name][number] = max(goal.sign * (goal.figure(varied, orbit) - goal.bound), 0.0)
        objectives[number] = _objective(varied, frequency, orbit, goals, minimize)
    return GoalCheck(
        names=tuple(spans),
        points=values,
        n_inside=n_inside,
        missed=missed,
        tolerances={goal.name: KEPT_WITHIN * abs(goal.bound) for goal in bounds},
        objectives=objectives,
        failures=failures,
    )


def _bounds(goals: Goals, machine: Machine) -> list[_Goal]:
    """Return the bounds that hold for every machine, under the names that their constraints have."""
    found: list[_Goal] = []

    def add(name: str, figure: Callable[[Machine, Orbit], float], bounds: tuple[float | None, float | None]) -> None:
        low, high = bounds
        if low is not None:
            found.append(_Goal(f"least {name}", figure, low, -1.0))
        if high is not None:
            found.append(_Goal(f"most {name}" if low is not None else name, figure, high, 1.0))

    for signal, wanted in (goals.mean or {}).items():
        if isinstance(wanted, tuple):
            add(f"mean {signal}", lambda _, orbit, s=signal: orbit.mean(s), wanted_bounds(f"mean[{signal!r}]", wanted))
    for signal, wanted in (goals.amplitude or {}).items():
        pair = wanted if isinstance(wanted, tuple) else (None, wanted)
        bounds = wanted_bounds(f"amplitude[{signal!r}]", pair)
        add(f"amplitude {signal}", lambda _, orbit, s=signal: orbit.amplitude(s), bounds)
    for signal, high in (goals.maximum or {}).items():
        found.append(_Goal(f"maximum {signal}", lambda _, orbit, s=signal: orbit.maximum(s), high, 1.0))
    for signal, low in (goals.minimum or {}).items():
        found.append(_Goal(f"minimum {signal}", lambda _, orbit, s=signal: orbit.minimum(s), low, -1.0))
    for kind, (low, high) in speeds(goals, machine).items():
        if low is not None:
            found.append(_Goal(f"least {kind}", lambda _, orbit: orbit.amplitude("velocity"), low, -1.0))
        if high is not None:
            found.append(_Goal(f"{kind} out", lambda _, orbit: orbit.maximum("velocity"), high, 1.0))
            found.append(_Goal(f"{kind} in", lambda _, orbit: orbit.minimum("velocity"), -high, -1.0))
    if goals.air_use is not None:
        found.append(_Goal("air_use", air_use, goals.air_use, 1.0))
    return found


def _objective(machine: Machine, frequency: float, orbit: Orbit, goals: Goals, minimize: str) -> float:
    """Return the value of what is minimized; nan of what does not depend on the cycle."""
    kind, _, signal = minimize.partition(" ")
    if kind == "amplitude":
        return orbit.amplitude(signal or "position")
    if kind == "air_use":
        return air_use(machine, orbit)
    scales = signal_scales(machine)
    total = 0.0
    if kind == "mean_error":
        for name, wanted in (goals.mean or {}).items():
            low, high = wanted_bounds(f"mean[{name!r}]", wanted)
            over = 0.0 if high is None else max(orbit.mean(name) - high, 0.0)
            under = 0.0 if low is None else max(low - orbit.mean(name), 0.0)
            total += ((over + under) / scales[name]) ** 2
        return total
    if kind == "tracking":
        for name, (angles, values) in (goals.cycle or {}).items():
            times = np.asarray(angles, dtype=np.float64) / (2 * np.pi * frequency)
            missed = orbit.at(times)[orbit.signals.index(name)] - np.asarray(values, dtype=np.float64)
            total += float(np.mean((missed / scales[name]) ** 2))
        return total
    return math.nan


Solve = Callable[[Mapping[str, Scenario]], DutySolution]


def over_ranges(
    spans: Mapping[str, tuple[float, float]],
    wanted: tuple[Goals, str],
    solve: Solve,
    progress: Progress | None,
) -> DutySolution:
    """Return the design for the worst of ranges, and what was checked of it.

    Designs again and again, each with those points as scenarios at which the one before misses a goal, or is worth
    less, most: the worst case of all points comes from the few that matter.
    """
    shares = np.vstack([_corners(len(spans)), _inside(len(spans), INSIDE, "uniform", None)])
    scenarios: dict[str, Scenario] = {}
    while True:
        found = solve(scenarios)
        last = found.corrected or found
        check = _checked(last.machine, last.frequency, spans, (shares, INSIDE), wanted, progress)
        points = {_named(spans, check.points[i]): check.points[i] for i in _worst(check, last)}
        new = {name: point for name, point in points.items() if name not in scenarios}
        if found.status == "infeasible" or not new or len(scenarios) + len(new) > MOST_SCENARIOS:
            return replace(found, ranges=check)
        for name, point in new.items():
            scenarios[name] = _scenario(dict(zip(spans, point.tolist(), strict=True)))


def _worst(check: GoalCheck, found: DutySolution) -> set[int]:
    """Return the points at which goals are missed most, and the one that is worth least."""
    # Where the machine has no cycle, another setting has to give it one.
    chosen = set(list(check.failures)[:1])
    for name, by in check.missed.items():
        if np.isfinite(by).any() and np.nanmax(by) > check.tolerances[name]:
            chosen.add(int(np.nanargmax(by)))
    worths = check.objectives
    if np.isfinite(worths).any() and math.isfinite(found.nonlinear_objective):
        most = float(np.nanmax(worths))
        if most > found.nonlinear_objective + KEPT_WITHIN * abs(found.nonlinear_objective):
            chosen.add(int(np.nanargmax(worths)))
    return chosen


def _named(names: Collection[str], point: FloatArray) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in zip(names, point, strict=True))


def _scenario(values: dict[str, float]) -> Scenario:
    return lambda machine: with_values(machine, values)
