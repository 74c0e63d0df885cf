"""Marching until the linear steps repeat, after one or more valve periods. Compiled.

As `settle` does for the nonlinear equations. Where the piston never rests, the steps' own maps tell how the end of the
period follows its start, so that the start of the cycle is solved for and not waited for (Broyden's method, from
the steps' maps with the operating points frozen). Rest is never leapt over, for where the piston rests depends on how
it came there.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.dynamics import STUCK
from ltvpneu.models.integrator import OK
from ltvpneu.models.march import Marched, Plan, Steps, march_period
from ltvpneu.models.settle import MAX_SUBHARMONIC, is_settled, largest_change
from ltvpneu.periodic.small import exponential, multiply, solve

WAIT = 2
"""Periods marched before the cycle's start is solved for."""
MAX_LEAPS = 40


class Repeated(NamedTuple):
    """Where `repeat_march` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found, or a period could not be marched."""
    n_marched: int
    residual: float
    start: FloatArray
    """Start of the last period marched, scaled and augmented."""
    last: Marched


@compiled
def _inverse_of_steps(k: int, marched: Marched, steps: Steps, inverse: FloatArray) -> bool:
    """Write the inverse of I - Phi, Phi the product of the steps' own maps; False where the piston rests."""
    n = k - 1
    whole, mean, one, work = np.eye(k), np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    for row in range(marched.n_steps):
        if steps.table[row, 1] == STUCK:
            return False
        exponential(steps.matrices[row], steps.table[row, 2], one, mean)
        multiply(one, whole, work)
        whole, work = work, whole
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
def repeat_march(start: FloatArray, plan: Plan, steps: Steps, tolerance: float, max_periods: int) -> Repeated:
    """March valve periods from a scaled augmented state until the state repeats, after one or more of them."""
    n, ring = start.size - 1, MAX_SUBHARMONIC + 1
    scales = np.ones(n)
    history, changes, inverse = np.empty((ring, n)), np.full((ring, ring), np.inf), np.empty((n, n))
    begin, before, move = start.copy(), np.empty(n), np.zeros(n)
    history[0] = begin[:n]
    done, marched, best, leaps, size = 1, 1, math.inf, 0, math.inf
    outcome = march_period(begin, plan, steps)
    while outcome.status == OK:
        now = outcome.state[:n]
        history[done % ring] = now
        best = math.inf
        drift = largest_change(now, history[(done - 16) % ring], scales) if done >= 16 else math.inf
        for back in range(1, min(MAX_SUBHARMONIC, done) + 1):
            change = largest_change(now, history[(done - back) % ring], scales)
            changes[done % ring, back] = change
            best = min(best, change)
            if is_settled(back, done, changes, drift, tolerance):
                return Repeated(back, marched, change, begin, outcome)
        if marched >= max_periods:
            break
        following = outcome.state.copy()
        if marched >= WAIT and leaps >= 0:
            left = now - begin[:n]
            if leaps > 0:
                _learn(inverse, move, before - left)
            if leaps > 0 or _inverse_of_steps(n + 1, outcome, steps, inverse):
                leaps += 1
                last, size = size, _move(inverse, left, move)
                if size <= tolerance:
                    return Repeated(1, marched, best, begin, outcome)
                # No leap further than the machine is long, nor many without getting nearer; then the march goes on.
                if not size < 2.0 or (leaps > 3 and size > last) or leaps > MAX_LEAPS:
                    leaps = -1
                else:
                    before, done = left, 0
                    following[:n] = begin[:n] + move
                    changes.fill(np.inf)
                    history[0] = following[:n]
        begin = following
        outcome = march_period(begin, plan, steps)
        done += 1
        marched += 1
    return Repeated(0, marched, best, begin, outcome)
