r"""Sequential convex programming on figures with exact derivatives.

With figures F(x), in settings x scaled to their bounds, and the user's convex objective phi and constraints c, each
step solves one convex problem, built once and given new numbers,

.. math:: \min_d \; \phi(y, x_k + d) + \sigma \sum_i t_i + \tfrac12 |L d|^2, \quad y = F(x_k) + F'(x_k) d, \quad
          c_i(y, x_k + d) \le t_i, \quad |d|_\infty \le \Delta

The duals of y = ... are what one more unit of each figure is worth, so nu^T F is the figures' part of the Lagrangian;
L^T L is its curvature by damped BFGS updates. A step is taken if the merit, objective plus penalties, falls by a share
of what the convex problem foretold; else the trust region Delta shrinks. In the end the convex problem with L = I is
solved once more: the step that it still takes is the gradient of the Lagrangian, the residual of optimality.

Figures have kinks, as where the piston begins to rest within the cycle, and optima like to lie on them. There no step
by the slopes of one side makes good what it foretells; so the slopes met on both sides are mixed, steps along the kink
are tried by that mixture, and the residual is that of Clarke's generalized gradient [Clarke1983]_.

.. [Clarke1983] F. H. Clarke, "Optimization and Nonsmooth Analysis", Wiley, 1983, section 2.3.
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
from scipy.stats import qmc

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu.design.solving import TIGHT, why_not_convex
from ltvpneu.errors import LtvpneuError, NotConvexError, SolverError
from ltvpneu.models.cycle_figures import CycleFigures, Figure

Progress = Callable[[str, float], object]

FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.1, 0.5, 1e-9
"""Of the trust region, as a share of each variable's bounds [-]."""
NEAREST_TO_NONE = 1e-6
"""Radius below which a setting next to those without a cycle is not brought any nearer to them [-]."""
FIRST_PENALTY, LARGEST_PENALTY = 10.0, 1e6
"""On the constraints' scaled violation."""
LEAST_SHARE = 0.05
"""Share of the foretold fall of the merit that a step must make true [-]."""
REFINEMENTS, ROUGH, MOST_LOOKS = 2, 0.01, 500
"""Rounds in which intervals of a grid are halved, change of a figure's step from one interval to the next, over its
span, from which they are, and settings looked at at most."""
AT_A_KINK, BESIDE = 1e-5, 1e-3
"""Radius from which on slopes beside are mixed with those here, and how far off they may be, of the bounds [-]."""
MOST_BESIDE, MOST_PIECES, MIXINGS = 16, 12, 24
"""Settings remembered, sides of a kink that are mixed at most, and rounds of bisection between two."""
MOST_MIXTURES = 10
RANKED_BY = (10.0, 300.0, 1e4)
"""Penalties by which settings to start from are ranked."""
STARTS_EACH = 3
"""Settings started from at most, by each ranking."""
FELT_FROM, FELT_TO = 1e-2, 1e-5
"""Steps that are tried without derivatives, as shares of the bounds [-]."""
MOST_FELT = 4
"""Settings up to which they are tried."""
ROUNDING = 1e-9
"""Changes of the merit that the cycles' own accuracy does not tell from none [-]."""
FIRST_CURVATURE = 0.1
SIZED_BY = 1e-2
"""Share of the bounds over which the sizes of objective and constraints are taken [-]."""
FEASIBLE = 1e-7
"""Scaled violation up to which a constraint counts as kept [-]."""
ACTIVE = 1e-6
"""Scaled dual above which a constraint counts as active [-]."""


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
class Task:
    """What is to be solved."""

    step: cp.Variable
    setting: cp.Variable
    blocks: tuple[FigureBlock, ...]
    objective: cp.Minimize | cp.Maximize
    constraints: dict[str, cp.Constraint]
    limits: dict[str, cp.Constraint]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Answer:
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
        self.task.setting.value = setting
        for block, one in zip(self.task.blocks, figures, strict=True):
            block.variable.value = one.values

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
        """Set the sizes of objective and constraints from their slopes at the first point, and build the problem."""
        if self._sizes:
            return
        self.put(setting, figures)
        slopes = np.vstack([one.jacobian for one in figures]) if figures else np.zeros((0, self.n_variables))
        self._sizes = {"": max(self._size(self._expression, slopes), 1e-300)}
        for name, constraint in self.task.constraints.items():
            self._sizes[name] = max(self._size(cast(Any, constraint).expr, slopes), 1e-300)
        self._build()

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
            self._values.value, self._slopes.value = values, slopes
        self._at.value, self._root.value, self._radius.value, self._penalty.value = setting, root, radius, penalty
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


@final
@dataclass(eq=False, kw_only=True)
class Search:
    """A convex problem, and where its figures come from."""

    subproblem: Subproblem
    evaluate: Callable[[FloatArray], list[BlockFigures]]
    """From a setting, shares of the bounds, to the figures of every block."""
    n_cycles: int = 0
    n_failed: int = 0
    reason: LtvpneuError | ValueError | None = None
    """Why the last setting without a cycle has none."""

    def figures(self, setting: FloatArray) -> list[BlockFigures] | None:
        """Return the figures at a setting; None where a model has no cycle there."""
        try:
            found = self.evaluate(setting)
        except (LtvpneuError, ValueError) as error:
            self.n_failed += 1
            self.reason = error
            return None
        self.n_cycles += 1
        return found


@final
@dataclass(eq=False, kw_only=True)
class Found:
    """Where a search ended."""

    setting: FloatArray
    figures: list[BlockFigures]
    status: str = "stopped"
    residual: float = np.inf
    duals: dict[str, float] = field(default_factory=dict[str, float])
    active: tuple[str, ...] = ()
    merits: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    n_cycles: int = 0
    n_failed: int = 0
    at_kink: bool = False
    first_broken: float = 0.0
    """Scaled violation at the start."""


def best_starts(search: Search, own: FloatArray, count: int, progress: Progress | None) -> list[FloatArray]:
    """Return a few settings to start from, the best first, among one's own and a grid's or a Sobol sequence's.

    Of one or two settings, those that are better than their neighbours on the grid; by the merit with low and high
    penalties, as a setting that keeps the constraints may lie far from one that nearly does. A grid of one
    setting is made finer where figures jump or bend, as where the cycle changes its kind.
    """
    p = own.size
    side = max(round(count ** (1 / p)), 2)
    if p > 2:
        points = qmc.Sobol(p, rng=0).random(count) if count else np.zeros((0, p))
    else:
        points = np.stack(np.meshgrid(*[np.linspace(0, 1, side)] * p, indexing="ij"), axis=-1).reshape(-1, p)
    looks = [_look(search, own)]
    for number, setting in enumerate(points):
        if progress is not None:
            progress("looking at settings", number / len(points))
        looks.append(_look(search, setting))
    if p == 1:
        looks[1:] = _refined(search, looks[1:], progress)
    if not any(np.isfinite(look.merits).all() for look in looks):
        if search.reason is not None:
            raise search.reason
        return [own]
    shape = (side,) * p if p == 2 else (len(looks) - 1,)
    chosen: list[int] = []
    for column in range(len(RANKED_BY)):
        merits = np.array([look.merits[column] for look in looks])
        good = [int(i) for i in np.argsort(merits) if np.isfinite(merits[i])]
        if p <= 2:
            lowest = _lower_than_neighbours(merits[1:].reshape(shape))
            good = [i for i in good if i == 0 or lowest.ravel()[i - 1]]
        chosen += [i for i in good[:STARTS_EACH] if i not in chosen]
    return [looks[i].setting for i in chosen]


class _Look(NamedTuple):
    """What a setting looks like; infinite merits and no values where it has no cycle."""

    setting: FloatArray
    merits: tuple[float, ...]
    """With each of the penalties of `RANKED_BY`."""
    values: FloatArray


def _look(search: Search, setting: FloatArray) -> _Look:
    sub, nothing = search.subproblem, _Look(setting, (np.inf,) * len(RANKED_BY), np.zeros(0))
    figures = search.figures(setting) if _within(sub.task, setting) else None
    if figures is None:
        return nothing
    try:
        sub.scale(setting, figures)
    except LtvpneuError:
        return nothing
    merits = tuple(sub.merit(setting, figures, penalty)[0] for penalty in RANKED_BY)
    return _Look(setting, merits, np.concatenate([one.values for one in figures]) if figures else np.zeros(1))


def _refined(search: Search, looks: list[_Look], progress: Progress | None) -> list[_Look]:
    """Return looks along one setting with those between that a jump, a bend or the end of all cycles asks for."""
    for number in range(REFINEMENTS):
        rough = _rough_intervals(looks)
        if len(looks) + rough.size > MOST_LOOKS:
            break
        if progress is not None:
            progress("looking closer where figures jump", number / REFINEMENTS)
        for i in rough[::-1].tolist():
            looks.insert(i + 1, _look(search, 0.5 * (looks[i].setting + looks[i + 1].setting)))
    return looks


def _rough_intervals(looks: Sequence[_Look]) -> IntArray:
    """Return the numbers of the intervals over which values cannot be trusted to go on as they do beside."""
    m = max(look.values.size for look in looks)
    values = np.array([look.values if look.values.size else np.full(m, np.nan) for look in looks])
    places = np.array([look.setting[0] for look in looks])
    known = np.logical_and.reduce(np.isfinite(values), axis=1)
    spans = np.ptp(values[known], axis=0) if known.any() else np.zeros(m)
    slopes = np.diff(values, axis=0) / np.diff(places)[:, None]
    widths = np.minimum(places[1:-1] - places[:-2], places[2:] - places[1:-1])
    # What a straight line through two neighbours would be off by.
    off = np.nan_to_num(np.abs(np.diff(slopes, axis=0)) * widths[:, None] / np.maximum(spans, 1e-300))
    bent = np.concatenate([[False], off.max(axis=1) > ROUGH, [False]])
    return np.flatnonzero((known[:-1] != known[1:]) | ((bent[:-1] | bent[1:]) & known[:-1] & known[1:]))


def _lower_than_neighbours(values: FloatArray) -> BoolArray:
    padded = np.pad(values, 1, constant_values=np.inf)
    lowest = np.isfinite(values)
    middle = (slice(1, -1),) * values.ndim
    for axis in range(values.ndim):
        for shift in (-1, 1):
            lowest &= values <= np.roll(padded, shift, axis)[middle]
    return lowest


def best_from(
    search: Search, starts: Sequence[FloatArray], tolerance: float, max_iterations: int, progress: Progress | None
) -> Found:
    """Go from each of several settings to a local optimum; return the best, one that keeps the constraints first."""
    best: tuple[float, float, Found] | None = None
    reason: Exception | None = None
    for start in starts:
        for penalty in (FIRST_PENALTY, 1e3 * FIRST_PENALTY):
            search.subproblem.restore()
            try:
                found = converge(search, start, tolerance, max_iterations, progress, penalty=penalty)
            except (LtvpneuError, ValueError) as error:
                # Other starts may do; if none does, this is the reason.
                reason = error
                break
            search.subproblem.restore()
            merit, broken = search.subproblem.merit(found.setting, found.figures, 0.0)
            rank = (broken if broken > max(FEASIBLE, tolerance) else 0.0, merit)
            if best is None or rank < best[:2]:
                best = (*rank, found)
            # A way that led out of what was allowed is walked again with more weight on staying.
            if rank[0] <= found.first_broken:
                break
    search.subproblem.restore()
    if best is None:
        assert reason is not None
        raise reason
    found = best[2]
    if found.status not in ("optimal", "infeasible") and found.setting.size <= MOST_FELT:
        found = feel_about(search, found, tolerance)
    found.n_cycles, found.n_failed = search.n_cycles, search.n_failed
    return found


def is_better(search: Search, one: Found, other: Found) -> bool:
    """Whether one keeps the constraints better, or as well and has the better objective."""
    ranks: list[tuple[float, float]] = []
    for found in (one, other):
        merit, broken = search.subproblem.merit(found.setting, found.figures, 0.0)
        ranks.append((broken if broken > FEASIBLE else 0.0, merit))
    return ranks[0] < ranks[1]


def feel_about(search: Search, found: Found, tolerance: float) -> Found:
    """Go on without derivatives, by steps along each setting that halve when none is better.

    For where they end: at a kink of the model, or next to settings without a cycle.
    """
    sub, penalty = search.subproblem, 1e3 * FIRST_PENALTY
    merit, length, p = sub.merit(found.setting, found.figures, penalty)[0], FELT_FROM, found.setting.size
    setting, figures = found.setting, found.figures
    while length > FELT_TO:
        moved = False
        for direction in [*np.eye(p), *-np.eye(p)]:
            tried = np.clip(setting + length * direction, 0.0, 1.0)
            there = search.figures(tried) if _within(sub.task, tried) else None
            if there is None:
                continue
            new = sub.merit(tried, there, penalty)[0]
            if new < merit:
                found.merits.append((merit, new))
                setting, figures, merit, moved = tried, there, new, True
        length *= 1.0 if moved else 0.5
    if setting is not found.setting:
        state = _State(search, Found(setting=setting, figures=figures, merits=found.merits), tolerance, penalty)
        state.blocked = True
        state.finish()
        return state.found
    return found


def _within(task: Task, setting: FloatArray) -> bool:
    """Whether a setting keeps the limits."""
    task.setting.value = setting
    return all(bool(np.all(_violation(limit) <= 1e-9)) for limit in task.limits.values())


def converge(
    search: Search, begin: FloatArray, tolerance: float, max_iterations: int, progress: Progress | None = None,
    *, penalty: float = FIRST_PENALTY,
) -> Found:  # fmt: skip
    """Go from a setting to a local optimum."""
    sub = search.subproblem
    begin = _projected(sub.task, begin)
    figures = search.figures(begin)
    if figures is None:
        assert search.reason is not None
        raise search.reason
    sub.scale(begin, figures)
    state = _State(search, Found(setting=begin, figures=figures), tolerance, penalty)
    state.found.first_broken = state.broken
    for number in range(max_iterations):
        if progress is not None:
            progress(f"step {number + 1}, residual {state.found.residual:.1e}", min(1.0, number / max_iterations))
        if state.advance():
            break
    state.finish()
    found = state.found
    found.n_cycles, found.n_failed = search.n_cycles, search.n_failed
    return found


class _State:
    """Where the iteration is."""

    def __init__(self, search: Search, found: Found, tolerance: float, penalty: float) -> None:
        self.search, self.sub, self.found, self.tolerance = search, search.subproblem, found, tolerance
        p = found.setting.size
        self.curvature, self.updated = FIRST_CURVATURE * np.eye(p), False
        self.radius, self.penalty, self.raised = FIRST_RADIUS, penalty, penalty
        self.blocked, self.collapsed = False, False
        self.given_up = False
        self.beside: list[tuple[FloatArray, list[BlockFigures]]] = []
        """Settings that were left or refused, the last ones; and the mixture of their slopes with those here."""
        self.mixture: FloatArray | None = None
        self.linear = stacked(found.figures, p)
        self.merit, self.broken = self.sub.merit(found.setting, found.figures, self.penalty)

    def advance(self) -> bool:
        """Take or refuse one step; return whether the iteration is over."""
        sub, found = self.sub, self.found
        if not sub.has_objective and self.broken <= FEASIBLE and not self.given_up:
            return self._settled()
        root: FloatArray = np.linalg.cholesky(self.curvature).T.astype(np.float64)
        answer = sub.ask(found.setting, self.linear, root, self.radius, self.penalty)
        foretold = self.merit - answer.merit - answer.curvature
        if foretold <= ROUNDING or float(np.max(np.abs(answer.step))) <= 0.1 * self.tolerance:
            if self._certified() or self.radius < 10 * SMALLEST_RADIUS:
                return self._settled()
            if foretold <= 1e-6 * ROUNDING:
                return self._settled()
        setting, figures = self._trial(answer)
        self.blocked = figures is None
        taken = self._try(answer, setting, figures, foretold)
        if not taken and figures is not None:
            # Once more, with the figures' bend put right at the step's end (second-order correction).
            values = np.concatenate([one.values for one in figures]) if figures else self.linear[0]
            values = values - self.linear[1] @ (setting - found.setting)
            again = sub.ask(found.setting, (values, self.linear[1]), root, self.radius, self.penalty)
            taken = self._try(again, *self._trial(again), foretold)
        if not taken:
            self.radius = 0.25 * min(self.radius, float(np.max(np.abs(answer.step))))
            if self.radius < AT_A_KINK and self.mixture is None and self._along_a_kink(root):
                return False
            if self.mixture is not None and self._certified():
                return self._settled()
            if self.radius < (NEAREST_TO_NONE if self.blocked else SMALLEST_RADIUS):
                self.collapsed = True
                return self._settled()
        return False

    def _trial(self, answer: Answer) -> tuple[FloatArray, list[BlockFigures] | None]:
        setting = np.clip(self.found.setting + answer.step, 0.0, 1.0)
        return setting, self.search.figures(setting)

    def _try(self, answer: Answer, setting: FloatArray, figures: list[BlockFigures] | None, foretold: float) -> bool:
        if figures is None:
            return False
        self.beside = [*self.beside, (setting, figures)][-MOST_BESIDE:]
        merit, broken = self.sub.merit(setting, figures, self.penalty)
        fall = self.merit - merit
        if not (fall >= LEAST_SHARE * foretold and fall > 0):
            if not (foretold <= ROUNDING and abs(fall) <= ROUNDING):
                return False
            # Below what the cycle is computed to, the residual decides.
            if self._residual(setting, figures)[0] >= self.found.residual:
                return False
        if fall > 0.7 * foretold and float(np.max(np.abs(answer.step))) > 0.9 * self.radius:
            self.radius = min(2 * self.radius, LARGEST_RADIUS)
        linear = stacked(figures, setting.size)
        self._bend(setting - self.found.setting, (linear[1] - self.linear[1]).T @ answer.figure_duals)
        self.found.merits.append((self.merit, min(merit, self.merit)) if fall <= 0 else (self.merit, merit))
        self.beside[-1] = self.found.setting, self.found.figures
        self.found.setting, self.found.figures, self.mixture = setting, figures, None
        self.linear, self.merit, self.broken = linear, merit, broken
        return True

    def _along_a_kink(self, root: FloatArray) -> bool:
        """Try steps by the mixture of slopes on the sides of a kink; return whether one was taken."""
        for radius in (1e-2, 1e-3, 1e-4):
            self.mixture = self._mixed()
            if self.mixture is None:
                return False
            setting, linear = self.found.setting, (self.linear[0], self.mixture)
            answer = self.sub.ask(setting, linear, root, radius, self.penalty)
            foretold = self.merit - answer.merit - answer.curvature
            if foretold <= ROUNDING:
                return False
            if self._try(answer, *self._trial(answer), foretold):
                self.radius = radius
                return True
        return False

    def _mixed(self) -> FloatArray | None:
        r"""Return the mean of slopes here and beside, weighted so that the convex problem foretells the least.

        Where the model has a kink that is the one of Clarke's derivatives that decides: with weights w, by minimax
        duality, the greatest over w of the least merit over steps is the least over steps of the greatest merit.
        """
        here, p = self.found.setting, self.found.setting.size
        pieces = [self.linear[1]]
        for setting, figures in reversed(self.beside):
            distance = float(np.max(np.abs(setting - here)))
            if not 0 < distance <= BESIDE or len(pieces) == MOST_PIECES:
                continue
            try:
                values, slopes = stacked(figures, p)
            except LtvpneuError:
                continue
            sizes = [float(np.max(np.abs(one), initial=0.0)) for one in (*pieces, slopes)]
            jumps = float(np.max(np.abs(values - self.linear[0]), initial=0.0)) > 10 * max(sizes) * distance
            if not jumps and all(np.max(np.abs(slopes - one), initial=0.0) > 1e-4 * max(sizes) for one in pieces):
                pieces.append(slopes)
        if len(pieces) == 1:
            return None
        stack, weights = np.array(pieces), np.eye(len(pieces))[0]
        for _ in range(MOST_MIXTURES):
            answer = self._foretold(np.tensordot(weights, stack, 1))
            worth = np.array([answer.figure_duals @ (one @ answer.step) for one in pieces])
            if np.max(np.abs(answer.step)) <= 0.1 * self.tolerance or np.max(worth) - weights @ worth <= 1e-18:
                break
            weights = self._between(stack, weights, np.eye(len(pieces))[int(np.argmax(worth))])
        return np.asarray(np.tensordot(weights, stack, 1), dtype=np.float64)

    def _between(self, stack: FloatArray, weights: FloatArray, other: FloatArray) -> FloatArray:
        """Return the weights between two, by bisection, from which neither way foretells less."""
        low, high = 0.0, 1.0
        change = np.tensordot(other - weights, stack, 1)
        for _ in range(MIXINGS):
            share = 0.5 * (low + high)
            answer = self._foretold(np.tensordot((1 - share) * weights + share * other, stack, 1))
            if answer.figure_duals @ (change @ answer.step) > 0:
                low = share
            else:
                high = share
        share = 0.5 * (low + high)
        return (1 - share) * weights + share * other

    def _foretold(self, slopes: FloatArray) -> Answer:
        p = self.found.setting.size
        return self.sub.ask(self.found.setting, (self.linear[0], slopes), np.eye(p), 1.0, self.penalty)

    def _bend(self, step: FloatArray, change: FloatArray) -> None:
        """Damped BFGS update of the Lagrangian's curvature."""
        along = float(step @ change)
        if not self.updated and along > 0:
            self.curvature = np.eye(step.size) * min(max(float(change @ change) / along, 1e-4), 1e4)
            self.updated = True
        bent = self.curvature @ step
        size = float(step @ bent)
        if size <= 1e-300:
            return
        if along < 0.2 * size:
            share = 0.8 * size / (size - along)
            change = share * change + (1 - share) * bent
            along = float(step @ change)
        new = self.curvature - np.outer(bent, bent) / size + np.outer(change, change) / along
        lowest = float(np.min(np.linalg.eigvalsh(new)))
        if np.isfinite(new).all():
            self.curvature = (new + new.T) / 2 + max(1e-6 - lowest, 0.0) * np.eye(step.size)

    def _residual(self, setting: FloatArray, figures: list[BlockFigures]) -> tuple[float, Answer]:
        p = setting.size
        linear = stacked(figures, p)
        if self.mixture is not None and setting is self.found.setting:
            linear = linear[0], self.mixture
        answer = self.sub.ask(setting, linear, np.eye(p), 1.0, self.penalty)
        broken = self.sub.merit(setting, figures, self.penalty)[1]
        room = self.sub.slack(setting, figures)
        idle = max((float(np.max(np.abs(answer.duals[name] * room[name]), initial=0.0)) for name in room), default=0.0)
        stationary = float(np.max(np.abs(answer.step), initial=0.0))
        if self.sub.has_objective:
            return max(stationary, broken, idle if broken <= FEASIBLE else 0.0), answer
        return stationary, answer

    def _certified(self) -> bool:
        """Whether the present setting keeps the conditions of optimality; leaves the residual and the duals."""
        found = self.found
        found.residual, answer = self._residual(found.setting, found.figures)
        found.at_kink = self.mixture is not None
        found.duals = self.sub.user_duals(answer.duals) if self.sub.has_objective else {}
        found.active = tuple(
            name for name, dual in answer.duals.items() if float(np.max(np.abs(dual), initial=0.0)) > ACTIVE
        )
        return found.residual <= self.tolerance

    def _settled(self) -> bool:
        """Where the merit is stationary: over, or the constraints alone, or the objective with a higher penalty."""
        sub, kept = self.sub, self.broken <= max(FEASIBLE, self.tolerance)
        if self.given_up or kept == sub.has_objective:
            return True
        if sub.has_objective:
            sub.without_objective()
            self.given_up = self.penalty >= LARGEST_PENALTY
        else:
            sub.restore()
            self.raised = min(100 * self.raised, LARGEST_PENALTY)
        self.penalty = self.raised if sub.has_objective else 1.0
        self.radius, self.collapsed = FIRST_RADIUS, False
        self.merit, self.broken = sub.merit(self.found.setting, self.found.figures, self.penalty)
        return False

    def finish(self) -> None:
        """Set the status."""
        found = self.found
        ok = self._certified()
        if self.broken > max(FEASIBLE, self.tolerance):
            found.status = "infeasible" if not self.sub.has_objective and (ok or self.collapsed) else "stopped"
        elif ok and self.sub.has_objective:
            found.status = "optimal"
        else:
            found.status = "edge" if self.blocked else "stopped"


def _projected(task: Task, setting: FloatArray) -> FloatArray:
    """Return the setting nearest to one that keeps the limits."""
    if _within(task, setting):
        return setting
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(task.setting - setting)),
        [task.setting >= 0, task.setting <= 1, *task.limits.values()],
    )
    problem.solve(solver=cp.CLARABEL)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise ValueError(
            f"limits: no setting within the bounds keeps {', '.join(task.limits)}; they contradict each other"
        )
    return np.clip(np.asarray(task.setting.value, dtype=np.float64), 0.0, 1.0)


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
