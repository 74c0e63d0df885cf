"""Marching until the linear steps repeat, after one or more valve periods. Compiled.

As `settle` does for the nonlinear equations. Where the piston never rests, the steps' own maps tell how the end of the
period follows its start, so that the start of the cycle is solved for and not waited for (Broyden's method, from
the steps' maps with the operating points frozen). Where a leap leads to rest, to a cycle that does not attract by its
own maps, or out of what can be marched, it is taken back: where the piston rests depends on how it came there.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.linear.march import Marched, Plan, Steps, march_period
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.settle import MAX_SUBHARMONIC, ROUNDING, is_settled, largest_change
from ltvpneu.periodic.small import exponential, multiply, solve

WAIT = 2
"""Periods marched before the cycle's start is solved for."""
MAX_LEAPS = 40
SAFE_RADIUS = 0.9
"""Spectral radius of the steps' maps up to which a cycle that was leapt to is taken to attract [-]."""
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


@compiled
def _rests(marched: Marched, steps: Steps) -> bool:
    rests = False
    for row in range(marched.n_steps):
        rests = rests or steps.modes[row] == STUCK
    return rests


@compiled
def _product(k: int, marched: Marched, steps: Steps) -> FloatArray:
    """Return the product of the steps' own maps, (k, k)."""
    whole, mean, one, work = np.eye(k), np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    for row in range(marched.n_steps):
        exponential(steps.matrices[row], steps.durations[row], one, mean)
        multiply(one, whole, work)
        whole, work = work, whole
    return whole


@compiled
def _attracts(k: int, marched: Marched, steps: Steps) -> bool:
    """Whether the spectral radius of the steps' maps, by 64 of their powers, is at most `SAFE_RADIUS`."""
    n = k - 1
    power, work = _product(k, marched, steps)[:n, :n].copy(), np.empty((n, n))
    logarithm = 0.0
    for _ in range(6):
        multiply(power, power, work)
        power, work = work, power
        size = np.max(np.abs(power))
        if size == 0.0:
            return True
        for i in range(n):
            for j in range(n):
                power[i, j] /= size
        logarithm = 2.0 * logarithm + math.log(size)
    return logarithm <= 64.0 * math.log(SAFE_RADIUS)


@compiled
def _inverse_of_steps(k: int, marched: Marched, steps: Steps, inverse: FloatArray) -> bool:
    """Write the inverse of I - Phi, Phi the product of the steps' own maps; False where the piston rests."""
    n = k - 1
    if _rests(marched, steps):
        return False
    whole = _product(k, marched, steps)
    matrix, column = np.empty((n, n)), np.empty(n)
    for j in range(n):
        for i in range(n):
            column[i] = 1.0 if i == j else 0.0
            for c in range(n):
                matrix[i, c] = (1.0 if i == c else 0.0) - whole[i, c]
        if not solve(matrix, column):
            return False
        for i in range(n):
            inverse[i, j] = column[i]
    return True


@compiled
def _learn(inverse: FloatArray, moved: FloatArray, less: FloatArray) -> None:
    """Update the inverse so that it takes the change `less` of what is left to the move that made it (Broyden)."""
    n = moved.size
    left, right, scale = np.empty(n), np.empty(n), 0.0
    for i in range(n):
        left[i] = moved[i]
        right[i] = 0.0
        for j in range(n):
            left[i] -= inverse[i, j] * less[j]
            right[i] += moved[j] * inverse[j, i]
    for i in range(n):
        scale += right[i] * less[i]
    if abs(scale) > 1e-300:
        for i in range(n):
            for j in range(n):
                inverse[i, j] += left[i] * right[j] / scale


@compiled
def _move(inverse: FloatArray, left: FloatArray, move: FloatArray) -> float:
    """Write how far to move the start of the cycle, from what a period leaves to go; return the largest part."""
    size = 0.0
    for i in range(left.size):
        move[i] = 0.0
        for j in range(left.size):
            move[i] += inverse[i, j] * left[j]
        size = max(size, abs(move[i])) if math.isfinite(move[i]) else math.inf
    return size


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


@compiled
def _may_leap(begin: FloatArray, move: FloatArray, size: float, tolerance: float) -> bool:
    """Whether a leap is no further than the machine is long, and none to next to no pressure."""
    for i in range(2, move.size):
        if not begin[i] + move[i] > LEAST_PRESSURE * begin[i]:
            return False
    return tolerance < size < 2.0


@compiled
def repeat_march(start: FloatArray, plan: Plan, steps: Steps, tolerance: float, max_periods: int) -> Repeated:
    """March valve periods from a scaled augmented state until the state repeats, after one or more of them."""
    n, ring = start.size - 1, MAX_SUBHARMONIC + 1
    history, changes, inverse = np.empty((ring, n)), np.full((ring, ring), np.inf), np.empty((n, n))
    begin, before, move, following = start.copy(), np.empty(n), np.zeros(n), start.copy()
    history[0] = begin[:n]
    # Where the march goes on from if leaps are taken back.
    origin = start.copy()
    done, marched, best, leaps, size = 0, 0, math.inf, 0, math.inf
    while True:
        outcome = march_period(begin, plan, steps)
        done, marched = done + 1, marched + 1
        leapt, taken_back = False, leaps > 0 and (outcome.status != OK or _rests(outcome, steps))
        if not taken_back:
            if outcome.status != OK:
                break
            now = outcome.state[:n]
            history[done % ring] = now
            period, best = _repeats_after(now, done, history, changes, tolerance)
            if period > 0 and (leaps <= 0 or _attracts(n + 1, outcome, steps)):
                return Repeated(period, marched, best, begin, outcome)
            if marched >= max_periods:
                break
            following = outcome.state.copy()
            if marched >= WAIT and leaps >= 0:
                left = now - begin[:n]
                if leaps > 0:
                    _learn(inverse, move, before - left)
                if leaps > 0 or _inverse_of_steps(n + 1, outcome, steps, inverse):
                    origin = following.copy() if leaps == 0 else origin
                    leaps += 1
                    last, size = size, _move(inverse, left, move)
                    if size <= tolerance and _attracts(n + 1, outcome, steps):
                        return Repeated(1, marched, best, begin, outcome)
                    # Nor many without getting nearer, nor to a cycle that does not attract.
                    leapt = _may_leap(begin, move, size, tolerance) and leaps <= MAX_LEAPS
                    taken_back = not leapt or (leaps > 3 and size > last)
                    before, following[:n] = left, begin[:n] + move
        if taken_back:
            leaps, following = -1, origin.copy()
        if leapt or taken_back:
            done = 0
            changes.fill(np.inf)
            history[0] = following[:n]
        begin = following
    return Repeated(0, marched, best, begin, outcome)
