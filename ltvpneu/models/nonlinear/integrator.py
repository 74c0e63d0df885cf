"""Integration of the nonlinear equations over one valve period, compiled.

No step crosses a switching instant. Within a piece of the valve's cycle the adaptive method runs with step control;
where the piston stops, breaks away or meets an end stop, the instant is the root of the interpolant and a new step
starts there. The fixed-step method ends its steps on the switching instants too, but takes stick and slip as they
are at the end of a step.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.openings import PieceRecord
from ltvpneu.models.nonlinear.events import first_event, land, rest_at_source
from ltvpneu.models.nonlinear.runge_kutta import (
    RunRecord,
    Workspace,
    copy,
    first_length,
    is_adaptive,
    start_rate,
    try_step,
)

OK, TOO_MANY_STEPS, STEP_TOO_SMALL, LEFT_DOMAIN = 0, 1, 2, 3
"""How an integration ended."""
START, SPAN, MODE, PIECE_NUMBER, POLYNOMIAL = range(5)
"""Columns of a log: start [s] and span [s] of an interval, mode of the piston, number of the piece, and the first of
the interpolant's coefficients, ascending powers of the time since the start, all states for each."""


class Record(NamedTuple):
    """One period, as polynomials in the time since the start of each interval."""

    starts: FloatArray
    """Interval starts [s], shape (n_intervals,)."""
    spans: FloatArray
    """Interval lengths [s]."""
    modes: IntArray
    """+1 or -1 in slip, `STUCK` while held."""
    pieces: IntArray
    """Piece of the valve's cycle."""
    coefficients: FloatArray
    """Ascending powers, shape (n_intervals, 5, n_states)."""


class Outcome(NamedTuple):
    """Where an integration over one period got to."""

    status: int
    time: float
    state: FloatArray
    record: Record


def record_of(log: FloatArray) -> Record:
    """Return the intervals of a log, one row each."""
    return Record(
        starts=log[:, START].copy(),
        spans=log[:, SPAN].copy(),
        modes=log[:, MODE].astype(np.int64),
        pieces=log[:, PIECE_NUMBER].astype(np.int64),
        coefficients=log[:, POLYNOMIAL:].copy().reshape(len(log), 5, -1),
    )


@compiled
def new_log(n_states: int) -> FloatArray:
    """Return an empty log, which grows as it fills."""
    return np.empty((64, POLYNOMIAL + 5 * n_states))


@compiled
def _logged(
    log: FloatArray, number: int, span: float, h: float, mode: int, run: RunRecord, space: Workspace
) -> FloatArray:  # noqa: PLR0913 - one interval has as many parts
    """Return the log with one more interval, the interpolant over a step of length h."""
    count, n = run.progress.n_logged, space.state.size
    if count == log.shape[0]:
        longer = np.empty((2 * count, log.shape[1]))
        for row in range(count):
            for column in range(log.shape[1]):
                longer[row, column] = log[row, column]
        log = longer
    log[count, START], log[count, SPAN] = run.progress.time, span
    log[count, MODE], log[count, PIECE_NUMBER] = mode, number
    scale = 1.0
    for power in range(5):
        for i in range(n):
            log[count, POLYNOMIAL + power * n + i] = space.coefficients[power, i] * scale
        scale /= h
    run.progress.n_logged = count + 1
    return log


@compiled
def advance(  # noqa: PLR0913 - compiled, and called once per piece and event
    end: float, mode: int, number: int, piece: PieceRecord, run: RunRecord, space: Workspace, log: FloatArray
) -> FloatArray:
    """Integrate within one piece of the valve's cycle up to a time, or to an event of the piston, and land there.

    Parameters
    ----------
    end : float
        At most the end of the piece [s].
    mode : int
    number : int
        Of the piece, for the log.
    piece : PieceRecord
    run : RunRecord
        Its `progress` says where to start from, and then where it got to.
    space : Workspace
        With the state to start from; left with the state reached.
    log : ndarray, shape (capacity, columns)

    Returns
    -------
    ndarray
        The log, or a longer one.
    """
    progress, machine, period = run.progress, run.machine, run.period
    adaptive = is_adaptive(run)
    progress.kind = -1
    # A length of zero asks for a first step; only the rate at its start can tell how long.
    h, fresh = 0.0, True
    while progress.time < end:
        if progress.steps >= run.settings.max_steps:
            progress.status = TOO_MANY_STEPS
            break
        progress.steps += 1
        if fresh and not start_rate(mode, piece, run, space):
            progress.status = LEFT_DOMAIN
            break
        if h == 0.0:
            h = first_length(mode, piece, run, space)
        fresh = False
        for i in range(space.state.size):
            space.coefficients[0, i] = space.state[i]
        last = progress.time + 1.000001 * h >= end
        if last:
            h = end - progress.time
        error = try_step(h, mode, piece, run, space)
        if error > 1.0:
            h *= max(0.2, 0.9 * error**-0.2)
            if h < 1e-15 * period or not adaptive:
                progress.status = LEFT_DOMAIN if math.isinf(error) else STEP_TOO_SMALL
                break
            continue
        share, kind = first_event(mode, space.coefficients, machine, space.rate)
        if not adaptive and kind >= 0:
            share = 1.0
        span = min(share, 1.0) * h
        if span > 0.0:
            log = _logged(log, number, span, h, mode, run, space)
        progress.time = end if last and share >= 1.0 else progress.time + span
        if kind >= 0:
            land(kind, share, machine, space)
            progress.kind = kind
            break
        for i in range(space.state.size):
            space.state[i] = space.new[i]
            space.stages[0, i] = space.stages[6, i]
        if mode == STUCK:
            fresh = rest_at_source(machine, space)
        if adaptive:
            h *= min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
    return log


@compiled
def new_workspace(start: FloatArray, n_paths: int) -> Workspace:
    """Return arrays for an integration from `start`, shape (n_states,)."""
    n, state = start.size, np.empty(start.size)
    copy(start, state)
    return Workspace(state, np.empty(n), np.empty(n), np.zeros((7, n)), np.zeros((5, n)), np.empty((2, n_paths)))
