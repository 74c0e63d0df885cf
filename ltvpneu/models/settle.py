"""Simulation until the state repeats, after one or more valve periods, compiled."""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.integrator import OK, Outcome, integrate_period
from ltvpneu.models.runge_kutta import Run, copy

MAX_SUBHARMONIC = 64
"""Longest orbit looked for, in valve periods."""


class Settled(NamedTuple):
    """Where `settle` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found."""
    n_simulated: int
    residual: float
    last: Outcome
    """The last period simulated."""


@compiled
def _is_settled(k: int, done: int, changes: FloatArray, tolerance: float) -> bool:
    """Whether the changes over k periods say that the state repeats after k.

    `changes` holds the changes over each k, one row a period, the last MAX_SUBHARMONIC + 1 periods in a ring.
    """
    ring = changes.shape[0]
    change = changes[done % ring, k]
    if done <= k:
        return change <= 0.01 * tolerance
    # A multiple of the true number repeats just as well, and so does rounding: all smaller numbers must clearly fail.
    for smaller in range(1, k):
        if changes[done % ring, smaller] <= 1000.0 * tolerance:
            return False
    contraction = min(change / changes[(done - k) % ring, k], 1.0)
    if change <= max(tolerance * (1.0 - contraction), 0.01 * tolerance):
        return True
    # Where chambers rest at a source's pressure, step control leaves a floor of its own size: no more change to wait
    # for.
    back = 16 * k
    if change <= 10.0 * tolerance and back < ring and done > back + k:
        return change > 0.5 * changes[(done - back) % ring, k]
    return False


@compiled
def settle(start: FloatArray, run: Run, scales: FloatArray, tolerance: float, max_periods: int) -> Settled:
    """Simulate valve periods until the state repeats, after one or more of them.

    The change of the scaled state over k periods, r, bounds the distance from the orbit by r / (1 - q) where q is its
    contraction over the last k periods. The smallest k for which that falls below the tolerance is the orbit's.

    Returns
    -------
    Settled
        With `n_periods` zero if the state never repeated, `residual` then being the smallest change over any k, or if
        the last period could not be integrated.
    """
    n, ring = start.size, MAX_SUBHARMONIC + 1
    history, changes = np.empty((ring, n)), np.full((ring, ring), np.inf)
    copy(start, history[0])
    done, best = 1, math.inf
    outcome = integrate_period(start, run, True)
    while outcome.status == OK:
        copy(outcome.state, history[done % ring])
        best = math.inf
        for k in range(1, min(MAX_SUBHARMONIC, done) + 1):
            change = 0.0
            for i in range(n):
                change = max(change, abs(outcome.state[i] - history[(done - k) % ring, i]) / scales[i])
            changes[done % ring, k] = change
            best = min(best, change)
            if _is_settled(k, done, changes, tolerance):
                return Settled(k, done, change, outcome)
        if done == max_periods:
            break
        outcome = integrate_period(outcome.state, run, True)
        done += 1
    return Settled(0, done, best, outcome)
