"""Integration of the nonlinear equations over one valve period, compiled.

No step crosses a switching instant. Within a piece of the valve's cycle the adaptive method runs with step control;
where the piston stops, breaks away or meets an end stop, the instant is the root of the interpolant and a new step
starts there. The fixed-step method ends its steps on the switching instants too, but takes stick and slip as they
are at the end of a step.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.openings import PieceRecord
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.events import first_event, first_reversal, land, rest_at_source
from ltvpneu.models.nonlinear.runge_kutta import (
    RunRecord,
    Workspace,
    copy,
    first_length,
    is_adaptive,
    is_tight,
    start_rate,
    try_step,
)

OK, TOO_MANY_STEPS, STEP_TOO_SMALL, LEFT_DOMAIN, PAUSED = range(5)
"""How an integration ended; one that paused at the end of its budget goes on when it is called again."""
START, SPAN, MODE, PIECE_NUMBER, POLYNOMIAL = range(5)
"""Columns of a log: start [s] and span [s] of an interval, mode of the piston, number of the piece, and the first of
the interpolant's coefficients, ascending powers of the time since the start, all states for each."""


NEXT_TO = 0.01
"""Share of a step next to its ends where it is not cut at the reversal of a flow."""


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
        coefficients=log[:, POLYNOMIAL:].copy().reshape(len(log), 5, (log.shape[1] - POLYNOMIAL) // 5),
    )


def joined(records: Sequence[Record], period: float) -> Record:
    """Return the records of consecutive periods as one."""
    if len(records) == 1:
        return records[0]
    return Record(
        starts=np.concatenate([number * period + record.starts for number, record in enumerate(records)]),
        spans=np.concatenate([record.spans for record in records]),
        modes=np.concatenate([record.modes for record in records]),
        # Numbered on through all periods: with one piece a turn, a new period is the only sign of it.
        pieces=np.concatenate(
            [number * (record.pieces[-1] + 1) + record.pieces for number, record in enumerate(records)]
        ),
        coefficients=np.concatenate([record.coefficients for record in records]),
    )


def log_of(record: Record) -> FloatArray:
    """Return the log that holds the intervals of a record, shape (n_intervals, columns)."""
    polynomials = record.coefficients.reshape(record.starts.size, -1)
    rows = [record.starts, record.spans, record.modes.astype(np.float64), record.pieces.astype(np.float64), polynomials]
    return np.column_stack(rows)


@compiled
def new_log(n_states: int) -> FloatArray:
    """Return an empty log, which grows as it fills."""
    return np.empty((64, POLYNOMIAL + 5 * n_states))


@inlined
def _logged(share: float, h: float, run: RunRecord, space: Workspace, log: FloatArray) -> FloatArray:
    """Return the log with one more interval: a share of a step of length h."""
    progress, n = run.progress, space.state.size
    count = progress.n_logged
    if count == log.shape[0]:
        longer = np.empty((2 * count, log.shape[1]))
        for row in range(count):
            for column in range(log.shape[1]):
                longer[row, column] = log[row, column]
        log = longer
    log[count, START], log[count, SPAN] = progress.time, share * h
    log[count, MODE], log[count, PIECE_NUMBER] = progress.mode, progress.piece
    scale = 1.0
    for power in range(5):
        for i in range(n):
            log[count, POLYNOMIAL + power * n + i] = space.coefficients[power, i] * scale
        scale /= h
    progress.n_logged = count + 1
    return log


@inlined
def _step(length: float, piece: PieceRecord, run: RunRecord, space: Workspace) -> float:
    """Count one more step, take it and return its scaled error; `space` is left with its interpolant."""
    run.progress.steps += 1
    run.progress.budget -= 1
    for i in range(space.state.size):
        space.coefficients[0, i] = space.state[i]
    return try_step(length, piece, run, space)


@inlined
def _go_on(run: RunRecord, space: Workspace) -> bool:
    """Set the state to the end of the step; return whether its rate has to be found anew."""
    for i in range(space.state.size):
        space.state[i] = space.new[i]
        space.stages[0, i] = space.stages[6, i]
    return run.progress.mode == STUCK and rest_at_source(run.machine, space)


@inlined
def _cut(tight: bool, machine: MachineRecord, space: Workspace) -> float:
    """Return the share at which a step has to be cut, as a flow reverses there; one where it has not."""
    reversal = first_reversal(space.coefficients, space.areas, machine, space.rate) if tight else 1.0
    return reversal if NEXT_TO < reversal < 1.0 - NEXT_TO else 1.0


@compiled
def advance(end: float, piece: PieceRecord, run: RunRecord, space: Workspace, log: FloatArray) -> FloatArray:
    """Integrate within one piece of the valve's cycle up to a time, or to an event of the piston, and land there.

    Parameters
    ----------
    end : float
        At most the end of the piece [s].
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
    progress, machine, adaptive, tight = run.progress, run.machine, is_adaptive(run), is_tight(run)
    progress.kind = -1
    # A length of zero asks for a first step; only the rate at its start can tell how long.
    h, fresh = 0.0, True
    while progress.time < end and progress.kind < 0 and progress.status == OK:
        if progress.steps >= run.settings.max_steps or progress.budget <= 0:
            progress.status = PAUSED if progress.budget <= 0 else TOO_MANY_STEPS
            break
        if fresh and not start_rate(piece, run, space):
            progress.status = LEFT_DOMAIN
            break
        if h == 0.0:
            h = first_length(piece, run, space)
        last, fresh = progress.time + 1.000001 * h >= end, False
        if last:
            h = end - progress.time
        error = _step(h, piece, run, space)
        if error > 1.0:
            h *= max(0.2, 0.9 * error**-0.2)
            if h < 1e-15 * run.period or not adaptive:
                progress.status = LEFT_DOMAIN if math.isinf(error) else STEP_TOO_SMALL
            continue
        cut = _cut(tight and progress.mode != STUCK, machine, space)
        if cut < 1.0:
            h *= cut
            continue
        share, kind = first_event(progress.mode, space.coefficients, machine, space.rate)
        share = min(share, 1.0) if adaptive else 1.0
        if share * h > 0.0:
            log = _logged(share, h, run, space, log)
        progress.time = end if last and share == 1.0 else progress.time + share * h
        progress.kind = kind
        if kind >= 0:
            land(kind, share, machine, space)
            continue
        fresh = _go_on(run, space)
        if adaptive:
            h *= min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
    return log


@compiled
def new_workspace(start: FloatArray, n_paths: int) -> Workspace:
    """Return arrays for an integration from `start`, shape (n_states,)."""
    n, state = start.size, np.empty(start.size)
    copy(start, state)
    return Workspace(state, np.empty(n), np.empty(n), np.zeros((7, n)), np.zeros((5, n)), np.empty((2, n_paths)))
