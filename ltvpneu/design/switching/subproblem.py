"""The convex problem of one step of sequential convex programming: built once, given new numbers each time.

Its constraints may be broken at a price, so that it always has an answer; objective and constraints are scaled by how
much they change over the bounds of the settings.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, cast, final

import cvxpy as cp
import numpy as np
from cvxpy.constraints.nonpos import Inequality
from cvxpy.constraints.zero import Equality
from cvxpy.error import SolverError as CvxpySolverError

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.design.solving import TIGHT, why_not_convex
from ltvpneu.errors import LtvpneuError, NotConvexError, SolverError
from ltvpneu.models.cycles.figures import CycleFigures, Figure

SIZED_BY = 1e-2
"""Share of the bounds over which the sizes of objective and constraints are taken [-]."""


@final
class FigureBlock:
    """Figures that belong together: a cvxpy variable, and the numbers of its linearization."""

    def __init__(self, *, scenario: str, figures: tuple[Figure, ...], scale: float) -> None:
        self.scenario, self.figures, self.scale = scenario, figures, scale
        self.variable = cp.Variable(len(figures))


@final
class BlockFigures:
    """A block's values, and its slopes over the settings when asked for, in the block's scale."""

    def __init__(self, cycle: CycleFigures, rows: slice, widths: FloatArray, scale: float) -> None:
        self.cycle, self._rows, self._widths, self._scale = cycle, rows, widths, scale
        self.values = cycle.values[rows] / scale

    @cached_property
    def jacobian(self) -> FloatArray:
        """Slopes of the figures over the settings, (n_figures, n_variables)."""
        return self.cycle.jacobian[self._rows] * self._widths / self._scale


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Task(Value):
    """What is to be solved."""

    step: cp.Variable
    setting: cp.Variable
    blocks: tuple[FigureBlock, ...]
    objective: cp.Minimize | cp.Maximize
    constraints: dict[str, cp.Constraint]
    limits: dict[str, cp.Constraint]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Answer(Value):
    """What one convex problem says."""

    step: FloatArray
    merit: float
    """Foretold, without the curvature's part."""
    curvature: float
    figure_duals: FloatArray
    """Of the figures, one after the other: what one unit more of each costs."""
    duals: dict[str, FloatArray]
    """Of the constraints, scaled."""


@final
class Subproblem:
    """The convex problem, built once."""

    def __init__(self, task: Task) -> None:
        self.task = task
        sign = 1.0 if isinstance(task.objective, cp.Minimize) else -1.0
        self.sign = sign
        self._expression: Any = sign * task.objective.args[0]
        for name, constraint in task.constraints.items():
            if not isinstance(constraint, Inequality | Equality):
                raise TypeError(f"{name}: found {type(constraint).__name__}, expected a comparison by <=, >= or ==")
        named: dict[str, cp.Constraint] = {**task.constraints, **task.limits}
        known = {v.id for v in (task.setting, *(block.variable for block in task.blocks))}
        for name, part in {"objective": task.objective, **named}.items():
            if any(v.id not in known for v in part.variables()):
                raise ValueError(
                    f"{name}: found a variable that is none of this problem's; expected expressions of its cycles and "
                    "`variables` alone. An upper bound that is to be small needs none: minimize the expression itself"
                )
        plain = cp.Problem(task.objective, list(named.values()))
        if not plain.is_dcp():
            raise NotConvexError(why_not_convex(plain, task.objective, named))
        p = task.step.size
        m = sum(block.variable.size for block in task.blocks)
        self.n_figures, self.n_variables = m, p
        self._values, self._slopes = cp.Parameter(m), cp.Parameter((m, p))
        self._at, self._root, self._radius = cp.Parameter(p), cp.Parameter((p, p)), cp.Parameter(nonneg=True)
        self._penalty, self._weight = cp.Parameter(nonneg=True), 1.0
        self._sizes: dict[str, float] = {}
        self._problems: dict[bool, cp.Problem] = {}
        self._links: list[Any] = []
        self._kept: dict[str, Any] = {}
        self._excess: Any = cp.Constant(0.0)

    # Values at figures
    # -----------------------------------------------------------------------------------------------------

    def put(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> None:
        """Give the expressions the values that figures have at a setting."""
        # Without cvxpy's checks of the values: variables of real numbers have any.
        self.task.setting.save_value(setting)
        for block, one in zip(self.task.blocks, figures, strict=True):
            block.variable.save_value(one.values)

    def measured(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> tuple[float, dict[str, float]]:
        """Return the objective, and by how much each constraint is broken, in the user's units."""
        self.put(setting, figures)
        value = _number(self.task.objective.args[0])
        broken = {name: float(np.max(np.atleast_1d(_violation(c)))) for name, c in self.task.constraints.items()}
        return value, broken

    def merit(self, setting: FloatArray, figures: Sequence[BlockFigures], penalty: float) -> tuple[float, float]:
        """Return the merit, and the sum of the scaled violations."""
        self.put(setting, figures)
        broken = sum(
            float(np.sum(_violation(constraint))) / self._sizes[name]
            for name, constraint in self.task.constraints.items()
        )
        return self._weight * _number(self._expression) / self._sizes[""] + penalty * broken, broken

    def slack(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> dict[str, FloatArray]:
        """Return the scaled residuals of the constraints: below zero, kept with room."""
        self.put(setting, figures)
        return {
            name: np.asarray(cast(Any, constraint).expr.value, dtype=np.float64) / self._sizes[name]
            for name, constraint in self.task.constraints.items()
        }

    # The convex problem
    # -----------------------------------------------------------------------------------------------------

    def scale(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> None:
        """Set the sizes of objective and constraints from their slopes at the first point."""
        if self._sizes:
            return
        self.put(setting, figures)
        slopes = np.vstack([one.jacobian for one in figures]) if figures else np.zeros((0, self.n_variables))
        self._sizes = {"": max(self._size(self._expression, slopes), 1e-300)}
        for name, constraint in self.task.constraints.items():
            self._sizes[name] = max(self._size(cast(Any, constraint).expr, slopes), 1e-300)

    def widen(self, sizes: Mapping[str, float]) -> None:
        """Make the sizes no smaller than given ones; the objective's has an empty name.

        For where the first point is a flat one, whose slopes tell too little.
        """
        self._sizes = {name: max(size, sizes.get(name, 0.0)) for name, size in self._sizes.items()}
        self._problems = {}

    @property
    def is_scaled(self) -> bool:
        """Whether `scale` has been called."""
        return bool(self._sizes)

    @property
    def sizes(self) -> dict[str, float]:
        """By what each constraint's violation is divided, in its own unit."""
        return {name: size for name, size in self._sizes.items() if name}

    def measure_by(self, sizes: Mapping[str, float]) -> None:
        """Divide the constraints' violations by other sizes from now on, each in the constraint's own unit."""
        self._sizes = {"": self._sizes[""], **sizes}
        self._problems = {}

    def noted(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> "Noted":
        """Return what objective and constraints are at a setting."""
        self.put(setting, figures)
        differences = {
            name: np.ravel(np.asarray(cast(Any, constraint).expr.value, dtype=np.float64))
            for name, constraint in self.task.constraints.items()
        }
        equations = frozenset(name for name, one in self.task.constraints.items() if isinstance(one, Equality))
        return Noted(setting, differences, equations, _number(self._expression))

    def magnitudes(self) -> dict[str, float]:
        """Return the larger of each constraint's sides, of what was put last, in its own unit."""
        return {
            name: max(float(np.max(np.abs(_array(side)), initial=0.0)) for side in cast(Any, constraint).args)
            for name, constraint in self.task.constraints.items()
        }

    def worth(self, noted: "Noted") -> tuple[float, float]:
        """Return the scaled objective, and the sum of the scaled violations, at a setting looked at."""
        return noted.objective / self._sizes[""], self.distance(noted)

    def distance(self, noted: "Noted") -> float:
        """Return the sum of the scaled violations at a setting looked at."""
        return sum(
            float(np.sum(np.abs(rows) if name in noted.equations else np.maximum(rows, 0.0))) / self._sizes[name]
            for name, rows in noted.differences.items()
        )

    def _size(self, expression: Any, slopes: FloatArray) -> float:
        """Return how much an expression changes over the bounds of the settings, by its slopes; else its value."""
        blocks, setting = self.task.blocks, np.asarray(self.task.setting.value, dtype=np.float64)
        present, values = _array(expression), [np.asarray(block.variable.value) for block in blocks]
        found = float(np.max(np.abs(present), initial=0.0)) * 1e-3
        for j, direction in enumerate(np.eye(self.n_variables)):
            first = 0
            for block, value in zip(blocks, values, strict=True):
                block.variable.value = value + SIZED_BY * slopes[first : first + value.size, j]
                first += value.size
            self.task.setting.value = setting + SIZED_BY * direction
            change = np.abs(_array(expression) - present) / SIZED_BY
            found = max(found, float(np.max(np.nan_to_num(change, posinf=0.0), initial=0.0)))
        for block, value in zip(blocks, values, strict=True):
            block.variable.value = value
        self.task.setting.value = setting
        return found or 1.0

    def _build(self) -> None:
        task, p = self.task, self.n_variables
        all_figures = cp.hstack([block.variable for block in task.blocks]) if task.blocks else None
        self._links = [task.setting == self._at + task.step]
        if all_figures is not None:
            self._links.insert(0, all_figures == self._values + self._slopes @ task.step)
        hard: list[Any] = [cp.abs(task.step) <= self._radius, task.setting >= 0, task.setting <= 1]
        hard += list(task.limits.values())
        excess: list[Any] = []
        self._kept = {}
        for name, constraint in task.constraints.items():
            left = cast(Any, constraint).expr / self._sizes[name]
            over = cp.Variable(left.shape, nonneg=True)
            excess.append(cp.sum(over))
            if isinstance(constraint, Equality):
                under = cp.Variable(left.shape, nonneg=True)
                excess.append(cp.sum(under))
                self._kept[name] = left == over - under
            else:
                self._kept[name] = left <= over
        self._excess = cp.sum(cp.hstack(excess)) if excess else cp.Constant(0.0)
        curvature = 0.5 * cp.sum_squares(self._root @ task.step) if p else cp.Constant(0.0)
        every = [*self._links, *hard, *self._kept.values()]
        for with_objective in (True, False):
            goal = self.goal if with_objective else cp.Constant(0.0)
            self._problems[with_objective] = cp.Problem(
                cp.Minimize(goal + self._penalty * self._excess + curvature), every
            )

    def ask(
        self, setting: FloatArray, linear: tuple[FloatArray, FloatArray], root: FloatArray, radius: float,
        penalty: float,
    ) -> Answer:  # fmt: skip
        """Solve the convex problem about a setting; `linear` are the figures' values and slopes.

        Raises
        ------
        SolverError
        """
        values, slopes = linear
        if self.n_figures:
            self._values.save_value(values)
            self._slopes.save_value(slopes)
        self._at.save_value(setting)
        self._root.save_value(root)
        self._radius.save_value(radius)
        self._penalty.save_value(penalty)
        if not self._problems:
            self._build()
        problem = self._problems[self._weight > 0]
        try:
            with warnings.catch_warnings():
                # cvxpy's warning of an inaccurate answer: what comes of it is checked against the cycle itself.
                warnings.simplefilter("ignore", UserWarning)
                problem.solve(solver=cp.CLARABEL, **TIGHT)
        except CvxpySolverError as error:
            raise SolverError(f"the solver failed: {error}", status="solver_error") from None
        if problem.status in ("infeasible", "infeasible_inaccurate"):
            raise SolverError(
                "no setting within the bounds keeps the limits on pulses, pauses and variables: they contradict each "
                "other",
                status="infeasible",
            )
        if problem.status not in ("optimal", "optimal_inaccurate"):
            raise SolverError(f"the solver ended with status {problem.status!r}", status=str(problem.status))
        step = np.asarray(self.task.step.value, dtype=np.float64)
        bent = 0.5 * float(np.sum((root @ step) ** 2))
        return Answer(
            step=step,
            merit=float(cast(float, problem.value)) - bent,
            curvature=bent,
            figure_duals=-np.asarray(self._links[0].dual_value) if self.n_figures else np.zeros(0),
            duals={name: np.asarray(kept.dual_value, dtype=np.float64) for name, kept in self._kept.items()},
        )

    def without_objective(self) -> None:
        """From now on, only the constraints' violation counts."""
        self._weight = 0.0

    def restore(self) -> None:
        """From now on, the objective counts again."""
        self._weight = 1.0

    @property
    def goal(self) -> Any:
        """The objective, scaled, to be made small."""
        return self._expression / self._sizes[""]

    def in_user_units(self, value: float) -> float:
        """Return a scaled objective in the user's unit."""
        return self.sign * value * self._sizes[""]

    @property
    def has_objective(self) -> bool:
        """Whether the objective counts."""
        return self._weight > 0

    def user_duals(self, duals: Mapping[str, FloatArray]) -> dict[str, float]:
        """Return the constraints' duals in the user's units, their sum where a constraint has several rows."""
        size = self._sizes[""]
        return {name: float(np.sum(dual)) * size / self._sizes[name] for name, dual in duals.items()}


class Noted(NamedTuple):
    """What the constraints are at a setting looked at."""

    setting: FloatArray
    differences: dict[str, FloatArray]
    """What the sides of each differ by, left less right: (n_rows,)."""
    equations: frozenset[str]
    """Names of those that are equations."""
    objective: float
    """What is to be made small."""


@final
@dataclass(eq=False, kw_only=True)
class Search:
    """A convex problem, and where its figures come from."""

    subproblem: Subproblem
    evaluate: Callable[[FloatArray], list[BlockFigures]]
    """From a setting, shares of the bounds, to the figures of every block."""
    look: Callable[[FloatArray], list[BlockFigures]]
    """Likewise, cheaply: on the nonlinear machine, loosely integrated, without derivatives."""
    n_cycles: int = 0
    n_failed: int = 0
    reason: LtvpneuError | ValueError | None = None
    """Why the last setting without a cycle has none."""
    noted: list[Noted] = field(default_factory=list[Noted])
    """The settings looked at before the search."""
    mixes: bool = True
    """Whether slopes on both sides of a kink are mixed for steps along it, which takes many convex problems."""

    def note(self, setting: FloatArray, figures: Sequence[BlockFigures]) -> Noted:
        """Remember what objective and constraints are at a setting looked at."""
        self.noted.append(self.subproblem.noted(setting, figures))
        return self.noted[-1]

    def with_slopes(self, setting: FloatArray) -> list[BlockFigures] | None:
        """Return the figures at a setting; None where a model has no cycle there, or its figures no slopes."""
        found = self.figures(setting)
        return found if found is not None and self.has_slopes(found) else None

    def has_slopes(self, figures: Sequence[BlockFigures]) -> bool:
        """Whether the figures have slopes: not where switching instants change their order, or ramps meet."""
        try:
            stacked(figures, self.subproblem.n_variables)
        except (LtvpneuError, ValueError) as error:
            self.n_failed += 1
            self.reason = error
            return False
        return True

    def figures(self, setting: FloatArray) -> list[BlockFigures] | None:
        """Return the figures at a setting; None where a model has no cycle there."""
        return self._found(self.evaluate, setting)

    def looked_at(self, setting: FloatArray) -> list[BlockFigures] | None:
        """Return the figures at a setting, roughly; None where the machine has no cycle there."""
        return self._found(self.look, setting)

    def _found(
        self, evaluate: Callable[[FloatArray], list[BlockFigures]], setting: FloatArray
    ) -> list[BlockFigures] | None:
        try:
            found = evaluate(setting)
        except (LtvpneuError, ValueError) as error:
            self.n_failed += 1
            self.reason = error
            return None
        self.n_cycles += 1
        return found


def within_limits(task: Task, setting: FloatArray) -> bool:
    """Whether a setting keeps the limits."""
    task.setting.save_value(setting)
    return all(bool(np.all(_violation(limit) <= 1e-9)) for limit in task.limits.values())


def stacked(figures: Sequence[BlockFigures], p: int) -> tuple[FloatArray, FloatArray]:
    """Return values and slopes of all blocks, one after the other, over p settings."""
    if not figures:
        return np.zeros(0), np.zeros((0, p))
    return np.concatenate([one.values for one in figures]), np.vstack([one.jacobian for one in figures])


def _violation(constraint: Any) -> FloatArray:
    value = np.atleast_1d(np.asarray(constraint.expr.value, dtype=np.float64))
    return np.abs(value) if isinstance(constraint, Equality) else np.maximum(value, 0.0)


def _array(expression: Any) -> FloatArray:
    return np.asarray(expression.value, dtype=np.float64)


def _number(expression: Any) -> float:
    return float(np.asarray(expression.value))
