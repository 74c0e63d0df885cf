"""The usual goals of a design of switching, written down for `duty_problem`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, final

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import finite, finite_array, positive
from ltvpneu._values import Value
from ltvpneu.design.switching.cycle import LinearizedCycle
from ltvpneu.design.switching.duty_problem import NOMINAL, DutyProblem
from ltvpneu.models.machine.machine import Machine

Wanted = float | tuple[float | None, float | None]
"""A value, or the least and the greatest one, None for no bound."""
OBJECTIVES = ("amplitude", "air_use", "mean_error", "tracking", "switching")


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Goals(Value):
    """What is wanted of a cycle, by state; SI units.

    Parameters
    ----------
    mean : mapping of str to float or (float or None, float or None)
        Time means: a value, which holds for the machine as it is, or bounds, which hold in every scenario.
    amplitude : mapping likewise
        Half peak-to-peak: one value is the most.
    maximum, minimum : mapping of str to float
        Upper bound of the greatest, lower bound of the least value, in every scenario.
    air_use : float, optional
        The most mass flow from the supply, mean [kg/s].
    speed : float or (float or None, float or None), optional
        Of the piston, in either direction [m/s]: one value is the most. The least is that of half the velocity's
        peak-to-peak.
    impact_energy : float, optional
        The most that the moving mass may have anywhere in the cycle, and so at a stop [J].
    life : (float, float), optional
        Hours that the valve has to last, and the switches that it is good for.
    cycle : mapping of str to (array_like, array_like), optional
        A wanted cycle: angles [rad] and a state's values there, for `minimize="tracking"`.
    """

    mean: Mapping[str, Wanted] | None = None
    amplitude: Mapping[str, Wanted] | None = None
    maximum: Mapping[str, float] | None = None
    minimum: Mapping[str, float] | None = None
    air_use: float | None = None
    speed: Wanted | None = None
    impact_energy: float | None = None
    life: tuple[float, float] | None = None
    cycle: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None


def objective_of(problem: DutyProblem, goals: Goals, minimize: str) -> Any:
    """Return what `minimize` names as a cvxpy expression, in several scenarios of the worst one."""
    kind, _, signal = check_objective(minimize).partition(" ")
    if kind == "switching":
        return problem.switching()
    if kind == "mean_error" and not goals.mean:
        raise ValueError('minimize: found "mean_error" without wanted means; give mean={"position": ...}')
    if kind == "tracking" and not goals.cycle:
        raise ValueError('minimize: found "tracking" without a wanted cycle; give goals=Goals(cycle=...)')

    def of(cycle: LinearizedCycle) -> Any:
        if kind == "amplitude":
            return cycle.amplitude(signal or "position")
        if kind == "air_use":
            return cycle.air_use()
        if kind == "mean_error":
            return sum(_mean_error(cycle, name, wanted) for name, wanted in (goals.mean or {}).items())
        return sum(_distance(cycle, name, *wanted) for name, wanted in (goals.cycle or {}).items())

    return cp.maximum(*found) if len(found := [of(c) for c in problem.scenarios.values()]) > 1 else found[0]


def check_objective(minimize: str) -> str:
    """Return the name of an objective.

    Raises
    ------
    ValueError
        There is none of that name.
    """
    kind, _, signal = str(minimize).partition(" ")
    if kind not in OBJECTIVES or (signal and kind != "amplitude"):
        near = get_close_matches(str(minimize), OBJECTIVES, 1, 0.4)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"minimize: found {minimize!r}, expected one of {', '.join(OBJECTIVES)}{hint}")
    return minimize


def _mean_error(cycle: LinearizedCycle, signal: str, wanted: Wanted) -> Any:
    mean, size = cycle.mean(signal), cycle.size(signal)
    low, high = wanted_bounds(f"mean[{signal!r}]", wanted)
    if low is not None and low == high:
        return cp.square((mean - low) / size)
    over = 0 if high is None else cp.square(cp.pos((mean - high) / size))
    under = 0 if low is None else cp.square(cp.pos((low - mean) / size))
    return over + under


def _distance(cycle: LinearizedCycle, signal: str, angles: ArrayLike, values: ArrayLike) -> Any:
    places = finite_array(f"cycle[{signal!r}]: angles", np.asarray(angles, dtype=np.float64), (None,))
    wanted = finite_array(f"cycle[{signal!r}]: values", np.asarray(values, dtype=np.float64), places.shape)
    return cp.sum_squares((cycle.at(signal, places) - wanted) / cycle.size(signal)) / places.size


def constraints_of(problem: DutyProblem, goals: Goals, minimize: str) -> dict[str, cp.Constraint]:
    """Return what is wanted as cvxpy constraints by name; no means where `minimize` is the distance from them."""
    found: dict[str, Any] = {}
    if goals.life is not None:
        found["life"] = problem.switching() <= most_switching(goals.life)
    for name, cycle in problem.scenarios.items():
        where = "" if name == NOMINAL else f", {name}"
        for signal, wanted in (goals.mean or {}).items():
            if minimize == "mean_error":
                break
            low, high = wanted_bounds(f"mean[{signal!r}]", wanted)
            if not isinstance(wanted, tuple):
                if name == NOMINAL:
                    found[f"mean {signal}"] = cycle.mean(signal) == low
                continue
            _between(found, f"mean {signal}", where, (cycle.mean(signal), cycle.mean(signal)), (low, high))
        for signal, wanted in (goals.amplitude or {}).items():
            low, high = wanted_bounds(f"amplitude[{signal!r}]", wanted if isinstance(wanted, tuple) else (None, wanted))
            sides = cycle.affine_amplitude(signal) if low is not None else None, cycle.amplitude(signal)
            _between(found, f"amplitude {signal}", where, sides, (low, high))
        for signal, high in (goals.maximum or {}).items():
            found[f"maximum {signal}{where}"] = cycle.maximum(signal) <= finite(f"maximum[{signal!r}]", high)
        for signal, low in (goals.minimum or {}).items():
            found[f"minimum {signal}{where}"] = cycle.minimum(signal) >= finite(f"minimum[{signal!r}]", low)
            if signal in (goals.maximum or {}) and (goals.maximum or {})[signal] < low:
                raise ValueError(
                    f"minimum, maximum: found at least {low:g} and at most {(goals.maximum or {})[signal]:g} for "
                    f"{signal!r}; they contradict each other"
                )
        for kind, (low, high) in speeds(goals, cycle.machine).items():
            if low is not None:
                found[f"least {kind}{where}"] = cycle.affine_amplitude("velocity") >= low
            if high is not None:
                found[f"{kind} out{where}"] = cycle.maximum("velocity") <= high
                found[f"{kind} in{where}"] = cycle.minimum("velocity") >= -high
        if goals.air_use is not None:
            found[f"air_use{where}"] = cycle.air_use() <= finite("air_use", goals.air_use, "kg/s")
    return found


def speeds(goals: Goals, machine: Machine) -> dict[str, tuple[float | None, float | None]]:
    """Return the least and the greatest speed that goals ask for [m/s], by the goal's name."""
    found: dict[str, tuple[float | None, float | None]] = {}
    if goals.speed is not None:
        wanted = goals.speed if isinstance(goals.speed, tuple) else (None, goals.speed)
        low, high = wanted_bounds("speed", wanted)
        for value in (low, high):
            if value is not None:
                positive("speed", value, "m/s")
        found["speed"] = low, high
    if goals.impact_energy is not None:
        found["impact_energy"] = (
            None,
            math.sqrt(2 * positive("impact_energy", goals.impact_energy, "J") / machine.load.mass),
        )
    return found


def most_switching(life: tuple[float, float]) -> float:
    """Return how often a valve may switch for it to last [1/s], from hours and the switches that it is good for."""
    asked: Any = life
    if not isinstance(asked, tuple) or len(life) != 2:
        raise ValueError(f"life: found {asked!r}, expected hours, and the switches that the valve is good for")
    hours, switches = (
        positive(f"life: {what}", value) for what, value in zip(("hours", "switches"), life, strict=True)
    )
    return switches / (3600 * hours)


def _between(
    found: dict[str, Any], name: str, where: str, sides: tuple[Any, Any], bounds: tuple[float | None, float | None]
) -> None:
    low, high = bounds
    if low is not None:
        found[f"least {name}{where}"] = sides[0] >= low
    if high is not None:
        found[f"most {name}{where}" if low is not None else f"{name}{where}"] = sides[1] <= high


def wanted_bounds(name: str, wanted: Any) -> tuple[float | None, float | None]:
    """Return the least and the greatest value that are wanted, equal where it is one value."""
    if not isinstance(wanted, tuple):
        value = finite(name, wanted)
        return value, value
    pair: tuple[Any, ...] = wanted
    if len(pair) != 2 or pair == (None, None):
        raise ValueError(f"{name}: found {wanted!r}, expected a number, or the least and the greatest value")
    low, high = (None if value is None else finite(name, value) for value in pair)
    if low is not None and high is not None and low > high:
        raise ValueError(f"{name}: found at least {low:g} and at most {high:g}; they contradict each other")
    return low, high
