"""Simulation of one valve period, or until the state repeats, after one or more, compiled."""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.piston import can_stick, mode_of
from ltvpneu.models.nonlinear.integrator import OK, Outcome, advance, new_log, new_workspace, record_of
from ltvpneu.models.nonlinear.runge_kutta import Run, copy

MAX_SUBHARMONIC = 64
"""Longest orbit looked for, in valve periods."""
ROUNDING = 1e-13
"""Scaled change over a period that is none: where it is all that is left, it no longer falls [-]."""


class Settled(NamedTuple):
    """Where `settle` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found."""
    n_simulated: int
    residual: float
    last: Outcome
    """The last period simulated."""


@compiled
def largest_change(now: FloatArray, before: FloatArray, scales: FloatArray) -> float:
    """Largest scaled difference of two states."""
    worst = 0.0
    for i in range(scales.size):
        worst = max(worst, abs(now[i] - before[i]) / scales[i])
    return worst


@compiled
def is_settled(k: int, done: int, changes: FloatArray, drift: float, tolerance: float) -> bool:
    """Whether the changes over k periods say that the state repeats after k.

    `changes` holds the changes over each k, one row a period, the last MAX_SUBHARMONIC + 1 periods in a ring; `drift`
    is how far the state has gone over the last 16 periods.
    """
    ring = changes.shape[0]
    change = changes[done % ring, k]
    # A multiple of the true number repeats just as well, and so does rounding: all smaller numbers must clearly fail.
    for smaller in range(1, k):
        if changes[done % ring, smaller] <= 1000.0 * tolerance:
            return False
    if done <= k:
        return change <= 1e-4 * tolerance
    if change <= ROUNDING:
        return True
    before = changes[(done - k) % ring, k]
    contraction = min(change / before, 1.0) if before > 0.0 else 0.0
    if change <= tolerance * (1.0 - contraction):
        return True
    # Where chambers rest at a source's pressure, step control leaves a floor of its own size. There the state goes to
    # and fro; one that still creeps towards its orbit goes as far in 16 periods as 16 changes.
    return k == 1 and change <= 10.0 * tolerance and drift <= 4.0 * change


@compiled
def _leaps(history: FloatArray, changes: FloatArray, done: int, scales: FloatArray, state: FloatArray) -> bool:
    """Set `state` to where a slow, steady contraction is heading, or say that there is none.

    Steady: the ratio q of successive changes has settled, so that what is left to go is q / (1 - q) times the last
    change (Aitken). The simulation goes on from there, so without dry friction a wrong guess costs time, not truth;
    with it the piston might be set past the place where it would have come to rest.
    """
    ring, n = history.shape
    q = changes[done % ring, 1] / changes[(done - 1) % ring, 1]
    if not 0.8 < q < 1.0:
        return False
    for back in range(1, 3):
        ratio = changes[(done - back) % ring, 1] / changes[(done - back - 1) % ring, 1]
        if not abs(ratio - q) < 0.05 * (1.0 - q):
            return False
    now, before, ahead = done % ring, (done - 1) % ring, q / (1.0 - q)
    for i in range(n):
        move = (history[now, i] - history[before, i]) * ahead
        # A leap beyond the size of the machine is no guess, nor one to a pressure below zero.
        if abs(move) > scales[i] or (i >= 2 and history[now, i] + move <= 0.1 * history[now, i]):
            return False
    for i in range(n):
        state[i] = history[now, i] + (history[now, i] - history[before, i]) * ahead
    return True


@compiled
def _settle(
    start: FloatArray, run: Run, scales: FloatArray, tolerance: float, max_periods: int
) -> tuple[int, int, float, FloatArray, FloatArray]:
    """As `settle`; returns its numbers, the state reached and the log of the last period."""
    record, pieces = run.records[0], run.pieces
    progress, machine = record.progress, record.machine
    n, ring = start.size, MAX_SUBHARMONIC + 1
    history, changes = np.empty((ring, n)), np.full((ring, ring), np.inf)
    space, log = new_workspace(start, machine.n_paths), new_log(n)
    state, sticks = space.state, can_stick(machine)
    # Counted from the start, or from where the state was last set ahead.
    done, simulated, best = 0, 0, math.inf
    copy(start, history[0])
    while simulated < max_periods:
        progress.status, progress.time, progress.steps, progress.n_logged = OK, 0.0, 0, 0
        for number in range(pieces.size):
            progress.piece, progress.kind = number, 0
            while progress.kind >= 0 and progress.status == OK:
                progress.mode = mode_of(state, machine)
                log = advance(pieces[number].end, pieces[number], record, space, log)
        done, simulated = done + 1, simulated + 1
        if progress.status != OK:
            break
        copy(state, history[done % ring])
        best = math.inf
        drift = largest_change(state, history[(done - 16) % ring], scales) if done >= 16 else math.inf
        for k in range(1, min(MAX_SUBHARMONIC, done) + 1):
            change = largest_change(state, history[(done - k) % ring], scales)
            changes[done % ring, k] = change
            best = min(best, change)
            if is_settled(k, done, changes, drift, tolerance):
                return k, simulated, change, state, log
        if done >= 24 and not sticks and simulated < max_periods and _leaps(history, changes, done, scales, state):
            done = 0
            changes.fill(np.inf)
            copy(state, history[0])
    return 0, simulated, best, state, log


def settle(start: FloatArray, run: Run, scales: FloatArray, tolerance: float, max_periods: int) -> Settled:
    """Simulate valve periods until the state repeats, after one or more of them.

    The change of the scaled state over k periods, r, bounds the distance from the orbit by r / (1 - q) where q is its
    contraction over the last k periods. The smallest k for which that falls below the tolerance is the orbit's. Where
    the contraction is slow and steady, and nothing sticks, the state is set ahead to where it is heading.

    Returns
    -------
    Settled
        With `n_periods` zero if the state never repeated, `residual` then being the smallest change over any k, or if
        the last period could not be integrated.
    """
    # The kernel notes its progress in the record: a run that others use too is left as it is.
    own = Run(run.records.copy(), run.pieces)
    n_periods, n_simulated, residual, state, log = _settle(
        np.array(start), own, np.array(scales), float(tolerance), max_periods
    )
    reached = own.records["progress"][0]
    rows = log[: int(reached["n_logged"])]
    last = Outcome(int(reached["status"]), float(reached["time"]), state, record_of(rows))
    return Settled(n_periods, n_simulated, residual, last)


def integrate_period(start: FloatArray, run: Run) -> Outcome:
    """Integrate over one valve period from `start`, shape (n_states,)."""
    return settle(start, run, np.ones(start.size), 0.0, 1).last
