"""Marching until the linear steps repeat, after one or more valve periods. Compiled.

As `settle` does for the nonlinear equations. Where the piston never rests, the steps' own maps tell how the end of the
period follows its start, so that the start of the cycle is solved for (a Newton step with the operating points
frozen) and not waited for; rest is never leapt over, for where the piston rests depends on how it came there.
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
def _correction(start: FloatArray, marched: Marched, steps: Steps, change: FloatArray) -> bool:
    """Write how far the cycle's start is from `start`, with the steps' maps as they are; False where that fails."""
    k = start.size
    n = k - 1
    whole, mean, one, work = np.eye(k), np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    for row in range(marched.count):
        if steps.table[row, 1] == STUCK:
            return False
        exponential(steps.matrices[row], steps.table[row, 2], one, mean)
        multiply(one, whole, work)
        whole, work = work, whole
    matrix = np.empty((n, n))
    for i in range(n):
        change[i] = marched.state[i] - start[i]
        for j in range(n):
            matrix[i, j] = (1.0 if i == j else 0.0) - whole[i, j]
    if not solve(matrix, change):
        return False
    for i in range(n):
        # No leap further than the machine is long.
        if not abs(change[i]) < 2.0:
            return False
    return True


@compiled
def repeat_march(start: FloatArray, plan: Plan, steps: Steps, tolerance: float, max_periods: int) -> Repeated:
    """March valve periods from a scaled augmented state until the state repeats, after one or more of them."""
    k = start.size
    n, ring = k - 1, MAX_SUBHARMONIC + 1
    scales = np.ones(n)
    history, changes = np.empty((ring, n)), np.full((ring, ring), np.inf)
    begin, correction = start.copy(), np.zeros(n)
    history[0] = begin[:n]
    done, marched, best, distance, leaping = 1, 1, math.inf, math.inf, True
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
        if leaping and marched >= WAIT and _correction(begin, outcome, steps, correction):
            size = 0.0
            for i in range(n):
                size = max(size, abs(correction[i]))
            if size <= tolerance:
                return Repeated(1, marched, best, begin, outcome)
            leaping = size < 0.7 * distance
            distance = size
            if leaping:
                for i in range(n):
                    following[i] = begin[i] + correction[i]
                done = 0
                changes.fill(np.inf)
                history[0] = following[:n]
        begin = following
        outcome = march_period(begin, plan, steps)
        done += 1
        marched += 1
    return Repeated(0, marched, best, begin, outcome)
