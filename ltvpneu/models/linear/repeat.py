"""Marching until the linear steps repeat, after one or more valve periods. Compiled.

As `settle` does for the nonlinear equations. Where the piston never rests, the steps' own maps tell how the end of the
period follows its start, so that the start of the cycle is solved for and not waited for (Broyden's method, from
the steps' maps with the operating points frozen). Where a leap leads to rest, to a cycle that does not attract, or out
of what can be marched, it is taken back: where the piston rests depends on how it came there.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._clock import UNWATCHED, Watch, interruptible
from ltvpneu._compiled import compiled
from ltvpneu.models.linear.march import Marched, march_period
from ltvpneu.models.linear.plan import Plan, Steps, new_steps
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.periods import MAX_SUBHARMONIC, ROUNDING, is_settled, largest_change
from ltvpneu.periodic.algebra.small import exponential, multiply

WAIT = 2
"""Periods marched before the cycle's start is solved for."""
MAX_LEAPS = 40
SAFE_RADIUS = 0.9
"""Spectral radius up to which a cycle that was leapt to is taken to attract [-]."""
STATE_STEP = 1e-5
"""Step of differences over the scaled states of a cycle's start [-]."""
FURTHEST = 2.0
"""Longest leap, scaled [-]."""
LEAST_PRESSURE = 0.1
"""Share of a pressure that a leap leaves at least [-]."""


class Repeated(NamedTuple):
    """Where `repeat_march` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found, or a period could not be marched."""
    n_marched: int
    residual: float
    start: FloatArray
    """Start of the last period marched, scaled and augmented."""
    last: Marched


MANY_PERIODS, FLUTTER = 200, 1e-2
"""Periods after which a change of that share of the tolerance, neither shrinking nor adding up, ends the search."""


RESTING, RESTLESS = 16, 1e-3
"""Periods of rest after which pressures that go to and fro by no more than that, scaled, are taken as they are: over so
small ranges a fit is not of one piece."""


def _is_held(marched: Marched, steps: Steps) -> bool:
    return bool((steps.modes[: marched.n_steps] == STUCK).all())


def _goes_to_and_fro(done: int, history: FloatArray, change: float) -> bool:
    """Whether a state has gone no further over the last 16 periods than in a few of them."""
    ring = history.shape[0]
    return float(np.max(np.abs(history[done % ring] - history[(done - 16) % ring]))) <= 4.0 * change


def _rests(marched: Marched, steps: Steps) -> bool:
    return bool((steps.modes[: marched.n_steps] == STUCK).any())


@compiled
def _product(matrices: FloatArray, durations: FloatArray) -> FloatArray:
    """Return the product of the steps' own maps, (k, k), from shapes (n_steps, k, k) and (n_steps,)."""
    k = matrices.shape[1]
    whole, mean, one, work = np.eye(k), np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    for row in range(durations.size):
        exponential(matrices[row], durations[row], one, mean)
        multiply(one, whole, work)
        whole, work = work, whole
    return whole


def _map_over(marched: Marched, steps: Steps) -> FloatArray:
    """Return how the end of a period follows its start, by the steps' own maps, (n, n)."""
    return _product(steps.matrices[: marched.n_steps], steps.durations[: marched.n_steps])[:-1, :-1]


def _attracts(begin: FloatArray, marched: Marched, plan: Plan, steps: Steps) -> bool:
    """Whether the cycle from a start attracts: by the steps' maps, or if they say no, by differences of the march."""
    map_ = _map_over(marched, steps)
    if np.isfinite(map_).all() and not _rests(marched, steps) and _radius(map_) <= SAFE_RADIUS:
        return True
    beside = new_steps(plan)
    for i in range(begin.size - 1):
        moved = begin.copy()
        moved[i] += STATE_STEP
        end = march_period(moved, plan, beside)
        if end.status != OK:
            return False
        map_[:, i] = (end.state - marched.state)[:-1] / STATE_STEP
    return bool(np.isfinite(map_).all()) and _radius(map_) <= SAFE_RADIUS


def _radius(map_: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(map_))))


def _inverse_of_steps(map_: FloatArray) -> FloatArray | None:
    """Return the inverse of I - Phi, None where there is none."""
    try:
        inverse: FloatArray = np.linalg.inv(np.eye(len(map_)) - map_).astype(np.float64)
    except np.linalg.LinAlgError:
        return None
    return inverse


def _learnt(inverse: FloatArray, moved: FloatArray, less: FloatArray) -> FloatArray:
    """Return the inverse that takes the change `less` of what is left to the move that made it (Broyden)."""
    right = moved @ inverse
    scale = float(right @ less)
    return inverse + np.outer(moved - inverse @ less, right) / scale if abs(scale) > 1e-300 else inverse


@compiled
def _repeats_after(
    now: FloatArray, done: int, history: FloatArray, changes: FloatArray, tolerance: float
) -> tuple[int, float]:
    """Return after how many periods the state repeats, and how well; 0 and the least change if it does not."""
    ring, scales, best = history.shape[0], np.ones(now.size), math.inf
    drift = largest_change(now, history[(done - 16) % ring], scales) if done >= 16 else math.inf
    for back in range(1, min(MAX_SUBHARMONIC, done) + 1):
        change = largest_change(now, history[(done - back) % ring], scales)
        changes[done % ring, back] = change
        best = min(best, change)
        # After many periods, what neither drifts nor grows is the flutter that rounding or a table's seams leave.
        if done >= MANY_PERIODS and back == 1 and max(change, drift) <= FLUTTER * tolerance:
            return 1, change
        if is_settled(back, done, changes, drift, tolerance):
            return back, change
        # Steps that are cut one way and another in turn make a flutter too small to be a subharmonic.
        if change <= ROUNDING and changes[done % ring, 1] <= 1000.0 * tolerance:
            return 1, changes[done % ring, 1]
    return 0, best


def _may_leap(begin: FloatArray, move: FloatArray, tolerance: float) -> bool:
    """Whether a leap is no further than the machine is long, and none to next to no pressure."""
    leaves_pressure = bool((begin[2:] + move[2:] > LEAST_PRESSURE * begin[2:]).all())
    return leaves_pressure and tolerance < float(np.max(np.abs(move))) < FURTHEST


class _Leaps:
    """The search for the start of the cycle: how far to leap from the start of the period marched last."""

    def __init__(self, origin: FloatArray, known: FloatArray | None) -> None:
        self.origin = origin
        """Where the march goes on from if leaps are taken back."""
        self.count, self.size = 0, math.inf
        """Leaps tried, below zero once they are given up, and the largest part of the last."""
        self.is_known = known is not None
        """Whether the inverse is that of a cycle beside, which knows of events too."""
        self.inverse = known
        self.move, self.left = np.zeros(0), np.zeros(0)

    def take_back(self) -> FloatArray:
        """Give up leaping; return where to go on from."""
        self.count, self.is_known = -1, False
        return self.origin.copy()

    def loses(self, marched: Marched, steps: Steps) -> bool:
        """Whether a period after a leap is none to go on from."""
        if self.count <= 0:
            return False
        rests = _is_held(marched, steps) if self.is_known else _rests(marched, steps)
        return marched.status != OK or rests

    def next(self, begin: FloatArray, marched: Marched, steps: Steps) -> FloatArray | None:
        """Return how far to move the start of the period, (n,); None where the steps' maps do not tell."""
        n = begin.size - 1
        left = marched.state[:n] - begin[:n]
        if self.count > 0 and self.inverse is not None:
            self.inverse = _learnt(self.inverse, self.move, self.left - left)
        elif not self.is_known:
            self.inverse = None if _rests(marched, steps) else _inverse_of_steps(_map_over(marched, steps))
        if self.inverse is None:
            return None
        if self.count == 0:
            self.origin = marched.state.copy()
        self.left, self.move = left, self.inverse @ left
        self.count += 1
        return self.move


def repeat_march(  # noqa: PLR0913 - one call for one cycle
    start: FloatArray,
    plan: Plan,
    steps: Steps,
    tolerance: float,
    max_periods: int,
    watch: Watch = UNWATCHED,
    known: FloatArray | None = None,
) -> Repeated:
    """March valve periods from a scaled augmented state until the state repeats, after one or more of them.

    `known` is the inverse of I - P_z, (n, n) and scaled, of an attracting cycle beside that the start belongs to.

    Raises
    ------
    TimeLimitError
    """
    n, ring, own = start.size - 1, MAX_SUBHARMONIC + 1, plan.copy()
    history, changes = np.empty((ring, n)), np.full((ring, ring), np.inf)
    begin, leaps = start.copy(), _Leaps(start.copy(), known)
    history[0] = begin[:n]
    done, n_marched, best, resting = 0, 0, math.inf, 0
    while True:
        with interruptible():
            outcome = march_period(begin, own, steps)
        done, n_marched = done + 1, n_marched + 1
        watch.tick(f"{n_marched} valve periods of linear steps marched")
        leapt, taken_back = False, leaps.loses(outcome, steps)
        following = outcome.state.copy()
        if not taken_back:
            if outcome.status != OK:
                return Repeated(0, n_marched, best, begin, outcome)
            now = outcome.state[:n].copy()
            history[done % ring] = now
            period, best = _repeats_after(now, done, history, changes, tolerance)
            resting = resting + 1 if _is_held(outcome, steps) else 0
            if period == 0 and resting > RESTING and best <= RESTLESS and _goes_to_and_fro(done, history, best):
                period = 1
            if period > 0 and (leaps.count <= 0 or _attracts(begin, outcome, own, steps)):
                return Repeated(period, n_marched, best, begin, outcome)
            if n_marched >= max_periods:
                return Repeated(0, n_marched, best, begin, outcome)
            last = leaps.size
            waited = n_marched >= WAIT or leaps.is_known
            move = leaps.next(begin, outcome, steps) if waited and leaps.count >= 0 else None
            if move is not None:
                leaps.size = float(np.max(np.abs(move)))
                if leaps.size <= tolerance and _attracts(begin, outcome, own, steps):
                    return Repeated(1, n_marched, best, begin, outcome)
                # Nor many without getting nearer, nor to a cycle that does not attract.
                leapt = _may_leap(begin[:n], move, tolerance) and leaps.count <= MAX_LEAPS
                taken_back = not leapt or (leaps.count > 3 and leaps.size > last)
                following[:n] = begin[:n] + move
        if taken_back:
            following = leaps.take_back()
        if leapt or taken_back:
            done = 0
            changes.fill(np.inf)
            history[0] = following[:n]
        begin = following
