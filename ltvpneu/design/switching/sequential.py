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

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, final

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.kink import Here, mixed_slopes
from ltvpneu.design.switching.subproblem import Answer, BlockFigures, Search, Task, stacked, within_limits
from ltvpneu.errors import LtvpneuError

FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.1, 0.5, 1e-9
"""Of the trust region, as a share of each variable's bounds [-]."""
NEAREST_TO_NONE = 1e-6
"""Radius at which a search ends beside settings without a cycle, and where the constraints cannot be kept [-]."""
FIRST_PENALTY, LARGEST_PENALTY = 10.0, 1e6
"""On the constraints' scaled violation."""
LEAST_SHARE = 0.05
"""Share of the foretold fall of the merit that a step must make true [-]."""
AT_A_KINK = 1e-5
"""Radius from which on slopes beside are mixed with those here, as a share of the bounds [-]."""
MOST_BESIDE = 16
"""Settings beside that are remembered."""
FELT_FROM, FELT_TO = 1e-2, 1e-5
"""Steps that are tried without derivatives, as shares of the bounds [-]."""
MOST_FELT = 4
"""Settings up to which they are tried."""
ROUNDING = 1e-9
"""Changes of the merit that the cycles' own accuracy does not tell from none [-]."""
LEADS_OUT = 0.1
"""Scaled violation, on top of twice that at the start, beyond which a way leads out of what is allowed [-]."""
NEARLY_KEPT = 0.01
"""Scaled violation up to which steps without derivatives are tried from where a search ended [-]."""
CLEARLY = 0.95
"""Share of a violation that is clearly less than it [-]."""
SAME_BASIN = 0.03
"""Distance from a known optimum, as a share of the bounds, at which a way that is worse is left."""
MOST_FAILURES = 1
"""Settings without a cycle after which a way that is worse than a known optimum is left."""
MUCH_WORSE, MOST_REFUSED = 0.1, 2
"""A way that is worse by that much in the scaled objective is left after more refused steps in a row than that."""
FIRST_CURVATURE = 0.1
FEASIBLE = 1e-7
"""Scaled violation up to which a constraint counts as kept [-]."""
ACTIVE = 1e-6
"""Scaled dual above which a constraint counts as active [-]."""


@final
@dataclass(eq=False, kw_only=True)
class Found:
    """Where a search ended."""

    setting: FloatArray
    figures: list[BlockFigures]
    status: str = "stopped"
    residual: float = np.inf
    duals: dict[str, float] = field(default_factory=dict[str, float])
    figure_duals: FloatArray = field(default_factory=lambda: np.zeros(0))
    """What one more unit of each figure costs, scaled."""
    active: tuple[str, ...] = ()
    merits: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    n_cycles: int = 0
    n_failed: int = 0
    at_kink: bool = False
    first_broken: float = 0.0
    """Scaled violation at the start."""
    left: str = ""
    """Why the way was left before its end: `BEATEN` or `LED_OUT`; empty where it was not."""


BEATEN, LED_OUT = "beaten", "led out"


class Rival(NamedTuple):
    """An optimum that is known, or a setting nearest to keeping the constraints."""

    setting: FloatArray
    merit: float
    """Scaled objective."""
    broken: float
    """Scaled violation; zero of an optimum."""


class Way(NamedTuple):
    """How a search goes: one with the first penalty is left where it breaks the constraints more and more."""

    penalty: float
    rival: Rival | None = None
    """What it has to beat."""


def best_from(
    search: Search, starts: Sequence[FloatArray], tolerance: float, max_iterations: int, progress: Progress | None
) -> Found:
    """Go from each of several settings to a local optimum; return the best, one that keeps the constraints first.

    Once there is one, ways that lead back to it, or to nothing better, are left.
    """
    best: tuple[float, float, Found] | None = None
    rival: Rival | None = None
    reason: Exception | None = None
    for start in starts:
        for penalty in (FIRST_PENALTY, 1e3 * FIRST_PENALTY):
            search.subproblem.restore()
            try:
                found = converge(search, start, tolerance, max_iterations, progress, Way(penalty, rival))
            except (LtvpneuError, ValueError) as error:
                # Other starts may do; if none does, this is the reason.
                reason = error
                break
            search.subproblem.restore()
            merit, broken = search.subproblem.merit(found.setting, found.figures, 0.0)
            rank = (broken if broken > max(FEASIBLE, tolerance) else 0.0, merit)
            if best is None or rank < best[:2]:
                best = (*rank, found)
                if found.status in ("optimal", "infeasible"):
                    rival = Rival(found.setting, merit, rank[0])
            # A way that led out of what was allowed is walked again with more weight on staying.
            if found.left == BEATEN or (not found.left and rank[0] <= found.first_broken):
                break
    search.subproblem.restore()
    if best is None:
        assert reason is not None
        raise reason
    found = best[2]
    may_be_felt = found.setting.size <= MOST_FELT and best[0] <= NEARLY_KEPT
    if found.status not in ("optimal", "infeasible") and may_be_felt:
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
            there = search.figures(tried) if within_limits(sub.task, tried) else None
            if there is None:
                continue
            new = sub.merit(tried, there, penalty)[0]
            if new < merit and search.has_slopes(there):
                found.merits.append((merit, new))
                setting, figures, merit, moved = tried, there, new, True
        length *= 1.0 if moved else 0.5
    if setting is not found.setting:
        found = Found(setting=setting, figures=figures, merits=found.merits)
        state = _State(search, found, tolerance, Way(penalty))
        state.blocked = True
        state.finish()
        return state.found
    return found


def converge(
    search: Search,
    begin: FloatArray,
    tolerance: float,
    max_iterations: int,
    progress: Progress | None,
    way: Way,
) -> Found:
    """Go from a setting to a local optimum, or until the way is left."""
    sub = search.subproblem
    begin = _projected(sub.task, begin)
    figures = search.with_slopes(begin)
    if figures is None:
        assert search.reason is not None
        raise search.reason
    sub.scale(begin, figures)
    state = _State(search, Found(setting=begin, figures=figures), tolerance, way)
    found = state.found
    found.first_broken = state.broken
    for number in range(max_iterations):
        if progress is not None:
            progress(f"step {number + 1}, residual {state.found.residual:.1e}", min(1.0, number / max_iterations))
        found.left = state.is_to_leave()
        if found.left or state.advance():
            break
    if not found.left:
        state.finish()
    found.n_cycles, found.n_failed = search.n_cycles, search.n_failed
    return found


class _State:
    """Where the iteration is."""

    def __init__(self, search: Search, found: Found, tolerance: float, way: Way) -> None:
        self.way = way
        self.search, self.sub, self.found, self.tolerance = search, search.subproblem, found, tolerance
        p = found.setting.size
        self.curvature, self.updated = FIRST_CURVATURE * np.eye(p), False
        self.radius, self.penalty, self.raised = FIRST_RADIUS, way.penalty, way.penalty
        self.blocked, self.collapsed = False, False
        self.given_up = False
        self.failures, self.refused = 0, 0
        """Settings without a cycle that were come upon, and steps refused since the last one taken."""
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
        self.refused = 0 if taken else self.refused + 1
        if not taken:
            self.radius = 0.25 * min(self.radius, float(np.max(np.abs(answer.step))))
            if self.radius < AT_A_KINK and self.mixture is None and self._along_a_kink(root):
                return False
            if self.mixture is not None and self._certified():
                return self._settled()
            if self.radius < (NEAREST_TO_NONE if self.blocked or not self.sub.has_objective else SMALLEST_RADIUS):
                self.collapsed = True
                return self._settled()
        return False

    def is_to_leave(self) -> str:
        """Return why the way is left here; empty where it goes on."""
        if self.way.penalty == FIRST_PENALTY and self.broken > 2 * self.found.first_broken + LEADS_OUT:
            return LED_OUT
        rival = self.way.rival
        if rival is None:
            return ""
        if rival.broken > 0:
            is_worse = is_far_worse = self.broken > CLEARLY * rival.broken
            given_up = False
        else:
            is_worse, is_far_worse = self.merit >= rival.merit - ROUNDING, self.merit > rival.merit + MUCH_WORSE
            given_up = not self.sub.has_objective
        leads_back = float(np.max(np.abs(self.found.setting - rival.setting))) <= SAME_BASIN
        is_stuck = self.failures > MOST_FAILURES or (is_far_worse and self.refused > MOST_REFUSED)
        return BEATEN if given_up or (is_worse and (leads_back or is_stuck)) else ""

    def _trial(self, answer: Answer) -> tuple[FloatArray, list[BlockFigures] | None]:
        setting = np.clip(self.found.setting + answer.step, 0.0, 1.0)
        figures = self.search.figures(setting)
        self.failures += int(figures is None)
        return setting, figures

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
            if not self.search.has_slopes(figures) or self._residual(setting, figures)[0] >= self.found.residual:
                return False
        if not self.search.has_slopes(figures):
            # Better, but from where ramps meet or edges change their order: no way on from there.
            self.beside.pop()
            self.blocked = True
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
        if not self.search.mixes:
            return False
        for radius in (1e-2, 1e-3, 1e-4):
            self.mixture = mixed_slopes(self._here(), self.beside)
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

    def _here(self) -> Here:
        return Here(self.sub, self.found.setting, self.linear, self.penalty, self.tolerance)

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
        if np.isfinite(new).all():
            values, vectors = np.linalg.eigh((new + new.T) / 2)
            # Beside a large one, rounding may leave the smallest below zero.
            floor = max(1e-6, 1e-13 * float(values[-1]))
            self.curvature = (vectors * np.maximum(values, floor)) @ vectors.T

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
        found.figure_duals = answer.figure_duals
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
    if within_limits(task, setting):
        return setting
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(task.setting - setting)),
        [task.setting >= 0, task.setting <= 1, *task.limits.values()],
    )
    problem.solve(solver=cp.CLARABEL)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        names = list(task.limits)
        more = f" and {len(names) - 4} more" if len(names) > 4 else ""
        raise ValueError(
            f"limits: no setting within the bounds keeps {', '.join(names[:4])}{more}; they contradict each other"
        )
    return np.clip(np.asarray(task.setting.value, dtype=np.float64), 0.0, 1.0)
