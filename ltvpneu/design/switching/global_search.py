r"""Global optima over one or two settings, by branch and bound.

In a box with centre x_c and half-widths h, figures are known up to a remainder,

.. math:: |F(x) - F(x_c) - F'(x_c)(x - x_c)| \le r = \tfrac12 M |h|^2

with M from how F' changes between the box's centre and its parts', times a margin. The convex problem with figures
free within r bounds the user's objective from below on the box; boxes whose bound is no better than what has been
found, or that cannot keep the constraints, are done with. So the answer is global as far as M holds, which is an
estimate from the sweep itself, finer and finer where it matters, and no proof by interval arithmetic.
"""

import heapq
import itertools
from typing import Any, NamedTuple, cast

import cvxpy as cp
import numpy as np
from cvxpy.error import SolverError as CvxpySolverError

from ltvpneu._arrays import FloatArray
from ltvpneu.design.progress import Progress
from ltvpneu.design.solving import TIGHT
from ltvpneu.design.switching.sequential import FEASIBLE, FIRST_PENALTY, Found, best_from
from ltvpneu.design.switching.subproblem import Search, stacked
from ltvpneu.errors import LtvpneuError

FIRST_PARTS = {1: 16, 2: 8}
"""Parts that each side is cut into first."""
MARGIN = 2.0
"""On the curvature seen between centres [-]."""
GAP = 1e-3
"""Of the objective, relative to its change over the bounds, at which a search is over [-]."""
MOST_BOXES = 4000
POLISHED = 3
"""Best centres from which local searches start."""


class Box(NamedTuple):
    """A part of the bounds, its figures' values and slopes at the centre, and their curvature."""

    centre: FloatArray
    half: FloatArray
    values: FloatArray
    slopes: FloatArray
    curvature: FloatArray
    """(n_figures,)"""


class _Relaxation:
    """The convex problem over a box, with room for the figures' remainder."""

    def __init__(self, search: Search) -> None:
        sub = search.subproblem
        task, m, p = sub.task, sub.n_figures, sub.n_variables
        self.values, self.slopes = cp.Parameter(m), cp.Parameter((m, p))
        self.centre, self.half, self.room = cp.Parameter(p), cp.Parameter(p, nonneg=True), cp.Parameter(m, nonneg=True)
        move = cp.Variable(p)
        every: list[Any] = [cp.abs(move) <= self.half, task.setting == self.centre + move]
        every += [*task.limits.values(), *task.constraints.values()]
        if m:
            figures = cp.hstack([block.variable for block in task.blocks])
            every.append(cp.abs(figures - self.values - self.slopes @ move) <= self.room)
        self.problem = cp.Problem(cp.Minimize(sub.goal), every)

    def bound(self, box: Box) -> float:
        """Return the least objective, scaled; infinite where the constraints cannot be kept."""
        self.values.value, self.slopes.value = box.values, box.slopes
        self.centre.value, self.half.value = box.centre, box.half
        self.room.value = 0.5 * box.curvature * float(box.half @ box.half) + FEASIBLE
        try:
            self.problem.solve(solver=cp.CLARABEL, **TIGHT)
        except CvxpySolverError:
            # Nothing is known of the box: it is looked at in parts.
            return -np.inf
        status = str(self.problem.status)
        if status.startswith("infeasible"):
            return np.inf
        if status.startswith("unbounded"):
            return -np.inf
        if not status.startswith("optimal"):
            return -np.inf
        return float(cast(float, self.problem.value))


def search_globally(
    search: Search, tolerance: float, max_iterations: int, progress: Progress | None
) -> tuple[Found, float]:
    """Return the best setting within the bounds, and a lower bound of the objective over all of them.

    Settings where the model has no cycle are left out; how many were met is counted.

    Raises
    ------
    ValueError
        More than two variables.
    """
    p = search.subproblem.n_variables
    if p > 2:
        raise ValueError(f"globally: found {p} variables, expected one or two; leave it out for a local search")
    tree = _Tree(search)
    best = _polished(search, tree.tries, tolerance, max_iterations, None)
    while tree.heap and len(tree.tries) < MOST_BOXES:
        upper = _value(search, best)
        if progress is not None:
            gap = upper - tree.heap[0][0]
            progress(f"{len(tree.tries)} settings, gap {gap:.1e}", min(1.0, len(tree.tries) / MOST_BOXES))
        if tree.heap[0][0] >= upper - GAP:
            break
        tree.split_lowest()
        better = min(tree.tries, key=lambda one: one[0])
        if better[0] < upper - GAP:
            best = _polished(search, [better], tolerance, max_iterations, best)
    lower = min(tree.heap[0][0] if tree.heap else np.inf, _value(search, best))
    best.n_cycles, best.n_failed = search.n_cycles, search.n_failed
    return best, search.subproblem.in_user_units(lower)


class _Tree:
    """The boxes that are left, the lowest bound first."""

    def __init__(self, search: Search) -> None:
        self.search = search
        self.heap: list[tuple[float, int, Box]] = []
        self.tries: list[tuple[float, FloatArray]] = []
        """Merits and centres."""
        self._count = itertools.count()
        sub, p = search.subproblem, search.subproblem.n_variables
        parts = FIRST_PARTS[p]
        centres = {place: (np.array(place) + 0.5) / parts for place in itertools.product(range(parts), repeat=p)}
        known = {place: found for place, centre in centres.items() if (found := _looked_at(search, centre)) is not None}
        if not known:
            assert search.reason is not None
            raise search.reason
        first = next(iter(known))
        sub.scale(centres[first], known[first][2])
        self._relaxation = _Relaxation(search)
        for place, (values, slopes, figures) in known.items():
            near = [known[other] for other in _neighbours(place) if other in known]
            bent = [np.linalg.norm(slopes - other[1], axis=1) * parts for other in near] or [np.zeros(values.size)]
            curvature = MARGIN * np.max(bent, axis=0)
            self._keep(Box(centres[place], np.full(p, 0.5 / parts), values, slopes, curvature), figures)

    def _keep(self, box: Box, figures: Any) -> None:
        self.search.note(box.centre, figures)
        self.tries.append((self.search.subproblem.merit(box.centre, figures, FIRST_PENALTY)[0], box.centre))
        heapq.heappush(self.heap, (self._relaxation.bound(box), next(self._count), box))

    def split_lowest(self) -> None:
        """Cut the box of the lowest bound in two, across its longer side."""
        _, _, box = heapq.heappop(self.heap)
        side = int(np.argmax(box.half))
        half = box.half.copy()
        half[side] *= 0.5
        parts: list[tuple[FloatArray, tuple[FloatArray, FloatArray, Any]]] = []
        for sign in (-1, 1):
            centre = box.centre.copy()
            centre[side] += sign * half[side]
            found = _looked_at(self.search, centre)
            if found is not None:
                parts.append((centre, found))
        distance = float(half[side])
        bent = [np.linalg.norm(slopes - box.slopes, axis=1) / distance for _, (_, slopes, _) in parts]
        if len(parts) == 2:
            bent.append(np.linalg.norm(parts[0][1][1] - parts[1][1][1], axis=1) / (2 * distance))
        for centre, (values, slopes, figures) in parts:
            # No less than half of what the whole box bent: where it is straight by chance promises nothing.
            curvature = np.maximum(MARGIN * np.max(bent, axis=0), 0.5 * box.curvature)
            self._keep(Box(centre, half, values, slopes, curvature), figures)


def _looked_at(search: Search, setting: FloatArray) -> tuple[FloatArray, FloatArray, Any] | None:
    figures = search.figures(setting)
    if figures is None:
        return None
    try:
        return (*stacked(figures, setting.size), figures)
    except (LtvpneuError, ValueError) as error:
        search.reason = error
        return None


def _neighbours(place: tuple[int, ...]) -> list[tuple[int, ...]]:
    found: list[tuple[int, ...]] = []
    for i in range(len(place)):
        for side in (-1, 1):
            found.append((*place[:i], place[i] + side, *place[i + 1 :]))
    return found


def _polished(
    search: Search,
    tries: list[tuple[float, FloatArray]],
    tolerance: float,
    max_iterations: int,
    best: Found | None,
) -> Found:
    starts = [centre for _, centre in sorted(tries, key=lambda one: one[0])[:POLISHED]]
    found = best_from(search, starts, tolerance, max_iterations, None)
    return found if best is None or _value(search, found) < _value(search, best) else best


def _value(search: Search, found: Found) -> float:
    """Return the scaled objective; infinite where constraints are broken."""
    if found.status == "infeasible":
        return np.inf
    sub = search.subproblem
    merit, broken = sub.merit(found.setting, found.figures, 0.0)
    return merit if broken <= 1e-6 else np.inf
