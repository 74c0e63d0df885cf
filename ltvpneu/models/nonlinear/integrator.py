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
from ltvpneu.models.machine.piston import mode_of
from ltvpneu.models.nonlinear.events import first_event, land, rest_at_source
from ltvpneu.models.nonlinear.runge_kutta import Run, Workspace, copy, first_length, fixed_length, start_rate, try_step

OK, TOO_MANY_STEPS, STEP_TOO_SMALL, LEFT_DOMAIN = 0, 1, 2, 3
"""How an integration ended."""


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
    steps: int
    state: FloatArray
    record: Record


class Progress(NamedTuple):
    """How far an integration has got."""

    status: int
    time: float
    steps: int
    kind: int
    """Event that it stopped at, as of `first_event`; below zero where it reached the end."""


class Log(NamedTuple):
    """Intervals recorded so far, in arrays with room for more."""

    rows: FloatArray
    """Start [s], span [s], mode, piece of the valve's cycle; (capacity, 4)."""
    coefficients: FloatArray
    """(capacity, 5, n_states)"""
    n_logged: int


@compiled
def _logged(log: Log, row: tuple[float, float, int, int], h: float, coefficients: FloatArray) -> Log:
    """Return the log with one more interval: start, span, mode, piece, and the interpolant over a step of length h."""
    rows, recorded, count = log.rows, log.coefficients, log.n_logged
    if count == rows.shape[0]:
        rows = np.empty((2 * count, 4))
        recorded = np.empty((2 * count, 5, coefficients.shape[1]))
        copy(log.rows.ravel(), rows.ravel())
        copy(log.coefficients.ravel(), recorded.ravel())
    rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = row
    scale = 1.0
    for power in range(5):
        for i in range(coefficients.shape[1]):
            recorded[count, power, i] = coefficients[power, i] * scale
        scale /= h
    return Log(rows, recorded, count + 1)


@compiled
def advance(
    begin: tuple[float, int, int], end: float, mode: int, run: Run, space: Workspace, log: Log
) -> tuple[Progress, Log]:
    """Integrate within one piece of the valve's cycle up to a time, or to an event of the piston, and land there.

    Parameters
    ----------
    begin : (float, int, int)
        Time [s], piece, and steps taken so far.
    end : float
        At most the end of the piece [s].
    mode : int
    run : Run
    space : Workspace
        With the state to start from; left with the state reached.
    log : Log
        `n_logged` below zero records nothing.
    """
    time, piece, steps = begin
    period = run.schedule.times[-1]
    adaptive = run.settings.fixed_step == 0.0
    # A length of zero asks for a first step; only the rate at its start can tell how long.
    h, fresh = (0.0 if adaptive else fixed_length(piece, run)), True
    while time < end:
        if steps >= run.settings.max_steps:
            return Progress(TOO_MANY_STEPS, time, steps, -1), log
        steps += 1
        if fresh and not start_rate(time, piece, mode, run, space):
            return Progress(LEFT_DOMAIN, time, steps, -1), log
        if h == 0.0:
            h = first_length(time, piece, mode, run, space)
        fresh = False
        copy(space.state, space.coefficients[0])
        last = time + 1.000001 * h >= end
        if last:
            h = end - time
        error = try_step(h, time, piece, mode, run, space)
        if error > 1.0:
            h *= max(0.2, 0.9 * error**-0.2)
            if h < 1e-15 * period or not adaptive:
                status = LEFT_DOMAIN if math.isinf(error) else STEP_TOO_SMALL
                return Progress(status, time, steps, -1), log
            continue
        share, kind = first_event(mode, space.coefficients, run.machine, space.rate)
        if not adaptive and kind >= 0:
            share = 1.0
        span = min(share, 1.0) * h
        if log.n_logged >= 0 and span > 0.0:
            log = _logged(log, (time, span, mode, piece), h, space.coefficients)
        time = end if last and share >= 1.0 else time + span
        if kind >= 0:
            land(kind, share, run, space)
            return Progress(OK, time, steps, kind), log
        copy(space.new, space.state)
        copy(space.stages[6], space.stages[0])
        if mode == STUCK:
            fresh = rest_at_source(run, space)
        if adaptive:
            h *= min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
    return Progress(OK, time, steps, -1), log


@compiled
def new_workspace(start: FloatArray, n_paths: int) -> Workspace:
    """Return arrays for an integration from `start`, shape (n_states,)."""
    n = start.size
    return Workspace(start.copy(), np.empty(n), np.empty(n), np.zeros((7, n)), np.zeros((5, n)), np.empty((2, n_paths)))


@compiled
def integrate_period(start: FloatArray, run: Run, recording: bool) -> Outcome:
    """Integrate over one valve period from `start`, shape (n_states,)."""
    n = start.size
    space = new_workspace(start, run.machine.paths.shape[0])
    log = (
        Log(np.empty((64, 4)), np.empty((64, 5, n)), 0) if recording else Log(np.empty((0, 4)), np.empty((0, 5, n)), -1)
    )
    progress = Progress(OK, 0.0, 0, -1)
    for piece in range(run.schedule.times.size - 1):
        end = run.schedule.times[piece + 1]
        mode = mode_of(space.state, run.machine)
        progress, log = advance((run.schedule.times[piece], piece, progress.steps), end, mode, run, space, log)
        while progress.kind >= 0 and progress.status == OK:
            mode = mode_of(space.state, run.machine)
            progress, log = advance((progress.time, piece, progress.steps), end, mode, run, space, log)
        if progress.status != OK:
            break
    rows = log.rows[: max(log.n_logged, 0)]
    record = Record(
        rows[:, 0].copy(),
        rows[:, 1].copy(),
        rows[:, 2].astype(np.int64),
        rows[:, 3].astype(np.int64),
        log.coefficients[: rows.shape[0]].copy(),
    )
    return Outcome(progress.status, progress.time, progress.steps, space.state, record)
