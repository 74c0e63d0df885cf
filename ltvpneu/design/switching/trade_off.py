"""Trade-off of two objectives: the front on which neither gets better without the other getting worse.

The first is minimized for each of several bounds of the second (epsilon constraints [Haimes1971]_), every problem from
the solution of the one before. The dual of the bound is the front's slope.

.. [Haimes1971] Y. Y. Haimes, L. S. Lasdon, D. A. Wismer, "On a bicriterion formulation of the problems of integrated
   system identification and system optimization", IEEE Trans. Syst. Man Cybern. 1, 1971.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, read_only, whole
from ltvpneu._values import Value
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.duty_problem import DutyProblem, ModelKind, Scenario, duty_problem
from ltvpneu.design.switching.duty_solution import DutySolution
from ltvpneu.design.switching.duty_variables import Bounds
from ltvpneu.design.switching.goals import Goals, Wanted, constraints_of, objective_of
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine, expect_machine

BOUND = "trade-off"
"""Name of the constraint that bounds the second objective."""
NO_CONFLICT = 1e-4
"""Share of an objective by which it may differ between the ends of a front that is one point."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TradeOff(Value):
    """A front of two objectives, from the least of the first to the least of the second."""

    minimize: tuple[str, str]
    """The objectives, as of `optimize_duty`."""
    values: FloatArray
    """Of both, of the model that was designed on, SI units, (n_points, 2)."""
    nonlinear_values: FloatArray
    """The same on the nonlinear machine; nan where it has no cycle."""
    slopes: FloatArray
    """How much the first gets less for each unit more that the second may have, never below zero, (n_points,); nan
    where the second was not bounded."""
    solutions: tuple[DutySolution, ...]
    """Of each point."""
    failures: tuple[tuple[float, str], ...]
    """Bounds of the second objective for which no setting was found, and why."""

    def __repr__(self) -> str:
        first, second = self.minimize
        if self.is_single:
            return f"<TradeOff: {first} and {second} do not conflict; one point, {self.values[0]}>"
        ends = f"{self.values[0]} to {self.values[-1]}"
        return f"<TradeOff of {first} and {second}: {len(self.values)} points, {ends}>"

    @property
    def is_single(self) -> bool:
        """Whether one setting is best for both, so that there is nothing to trade."""
        return len(self.values) == 1

    @property
    def is_dominated(self) -> BoolArray:
        """Whether another point is better on the nonlinear machine in one objective and no worse in the other."""
        found = np.zeros(len(self.values), dtype=np.bool_)
        for i, one in enumerate(self.nonlinear_values):
            better = (self.nonlinear_values <= one).all(axis=1) & (self.nonlinear_values < one).any(axis=1)
            found[i] = bool(better.any())
        return found


def trade_off(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float | Bounds,
    variables: Mapping[str, Bounds] | None = None,
    *,
    minimize: Sequence[str] = ("air_use", "amplitude"),
    points: int = 20,
    goals: Goals | None = None,
    mean: Mapping[str, Wanted] | None = None,
    scenarios: Mapping[str, Scenario] | None = None,
    valve: ValveLimits | None = None,
    model: ModelKind = "fitted",
    progress: Progress | None = None,
) -> TradeOff:
    """Return the front between two objectives: for each value of the second the least of the first.

    Parameters
    ----------
    machine, frequency, variables, goals, mean, scenarios, valve, model
        As of `optimize_duty`.
    minimize : (str, str)
        Two objectives of `optimize_duty`: "air_use", "amplitude", "amplitude pressure_1", "switching" and so on.
    points : int
        Of the front, its ends included, evenly over the second objective.
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Returns
    -------
    TradeOff
        One point where the objectives do not conflict.

    Raises
    ------
    ValueError
        Not two objectives, or goals that no setting keeps.
    LtvpneuError
        No setting looked at has a cycle.

    Examples
    --------
    Air against ripple, at a mean of 45 mm:

    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> front = design.trade_off(
    ...     lp.load_machine("kunt_singh_1990"), (6.0, 18.0), mean={"position": 0.045}, points=3)
    >>> for air, ripple in front.values:
    ...     print(f"{1e3 * air:.2f} g/s, {1e3 * ripple:.2f} mm")
    2.26 g/s, 15.21 mm
    2.26 g/s, 8.57 mm
    2.28 g/s, 1.93 mm
    """
    expect_machine(machine)
    if isinstance(minimize, str) or len(minimize) != 2:
        raise ValueError(f'minimize: found {minimize!r}, expected two objectives, such as ("air_use", "amplitude")')
    pair = (str(minimize[0]).strip(), str(minimize[1]).strip())
    if pair[0] == pair[1]:
        raise ValueError(f"minimize: found {pair[0]!r} twice, expected two objectives")
    points = whole("points", points, 2)
    goals = Goals() if goals is None else goals
    goals = replace(goals, mean={**(goals.mean or {}), **(mean or {})})
    problem = duty_problem(machine, frequency, variables, scenarios=scenarios, valve=valve)
    # A wanted mean is no constraint where the distance from it is an objective.
    kept = constraints_of(problem, goals, "mean_error" if "mean_error" in pair else pair[0])
    objectives = objective_of(problem, goals, pair[0]), objective_of(problem, goals, pair[1])
    return _Front(problem, kept, pair, objectives, model).traced(points, progress)


class _Front:
    """A problem with two objectives."""

    def __init__(
        self,
        problem: DutyProblem,
        constraints: dict[str, cp.Constraint],
        names: tuple[str, str],
        objectives: tuple[Any, Any],
        model: ModelKind,
    ) -> None:
        self.problem, self.constraints, self.names = problem, constraints, names
        self.model: ModelKind = model
        self.first, self.second = objectives

    def traced(self, points: int, progress: Progress | None) -> TradeOff:
        """Return the front, from the least of the first objective on."""

        def told(number: int) -> None:
            if progress is not None:
                progress(f"point {number} of {points}", (number - 1) / points)

        told(1)
        start = self._end(self.first, None)
        told(2)
        end = self._end(self.second, start.values)
        found, failures = [start], list[tuple[float, str]]()
        (_, most), (_, least) = self._values(start, self.model), self._values(end, self.model)
        if most - least <= NO_CONFLICT * max(abs(most), abs(least)):
            return self._result(found, failures)
        bounds = np.linspace(most, least, points)[1:]
        for number, bound in enumerate(bounds, start=2):
            told(number)
            # At the very end the bound is kept by one setting alone, which rounding must not take away.
            limit = bound + (1e-6 * (most - least) if number == points else 0.0)
            try:
                found.append(self._bounded(limit, (found[-1].values, end.values)))
            except (LtvpneuError, ValueError) as error:
                failures.append((float(bound), str(error)))
        return self._result(found, failures)

    def _end(self, objective: Any, start: Mapping[str, float] | None) -> DutySolution:
        """Return the best setting for one objective alone, from a start if that leads to one, else from many."""
        goal, found = cp.Minimize(objective), None
        if start is not None:
            found = self.problem.solve(goal, self.constraints, model=self.model, start=start)
        if found is None or found.status != "optimal":
            found = self.problem.solve(goal, self.constraints, model=self.model)
        if found.status == "infeasible":
            missed = ", ".join(name for name, by in found.constraints.items() if by > 0)
            raise ValueError(f"goals: found no setting that keeps {missed or 'all of them'}; the nearest: {found!r}")
        return found

    def _bounded(self, bound: float, starts: tuple[Mapping[str, float], Mapping[str, float]]) -> DutySolution:
        """Return the best setting for the first objective with the second bounded, from whichever start leads to one.

        Raises
        ------
        ValueError
            None does.
        """
        constraints = {**self.constraints, BOUND: self.second <= bound}
        status = ""
        for start in starts:
            found = self.problem.solve(cp.Minimize(self.first), constraints, model=self.model, start=start)
            status = found.status
            if status in ("optimal", "edge"):
                return found
        raise ValueError(f"no optimum was found with {self.names[1]} at most {bound:.6g}: {status}")

    def _values(self, found: DutySolution, model: ModelKind) -> tuple[float, float]:
        first, second = self.problem.values_of((self.first, self.second), found.values, model)
        return first, second

    def _result(self, found: list[DutySolution], failures: list[tuple[float, str]]) -> TradeOff:
        values = np.array([self._values(one, self.model) for one in found])
        nonlinear = np.full(values.shape, np.nan)
        for i, one in enumerate(found):
            try:
                nonlinear[i] = self._values(one, "nonlinear")
            except (LtvpneuError, ValueError):
                continue
        return TradeOff(
            minimize=self.names,
            values=read_only(values),
            nonlinear_values=read_only(nonlinear),
            slopes=read_only(np.array([one.duals.get(BOUND, np.nan) for one in found])),
            solutions=tuple(found),
            failures=tuple(failures),
        )
