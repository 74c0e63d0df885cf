"""Simulation of valve periods one after another, compiled: until the state repeats, or the sequence of events does."""

import math
from typing import Any, NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._clock import Deadline, interruptible
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.openings import Pieces
from ltvpneu.models.machine.piston import at_stop, can_stick, mode_of
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.integrator import (
    MODE,
    OK,
    PAUSED,
    PIECE_NUMBER,
    POLYNOMIAL,
    Outcome,
    advance,
    record_of,
)
from ltvpneu.models.nonlinear.runge_kutta import Run, RunRecord, Workspace, copy

MAX_SUBHARMONIC = 64
"""Longest orbit looked for, in valve periods."""
ROUNDING = 1e-13
"""Scaled change over a period that is none: where it is all that is left, it no longer falls [-]."""
CHUNK = 20_000
"""Steps between two looks at the clock, and at the keyboard."""
FAILED, REPEATS, LOOK, WAITED, LIMIT = range(1, 6)
"""Why a march ended: a period could not be integrated, the state repeats, its events do, so many periods are over, or
as many as may be simulated."""
_PRIME, _MODULUS = 31, 2**40


class Plan(NamedTuple):
    """When a march ends."""

    tolerance: float
    """Scaled change, over one less the contraction, at which a state repeats [-]."""
    near: float
    """Scaled change over a period below which it ends where the events repeat [-]."""
    look: int
    """Periods after which it ends where they do."""
    wait: int
    """Periods after which it ends."""
    until: int
    """Periods after which it ends, all told."""


class History(NamedTuple):
    """What a march goes by: the states of the last periods, and their changes, in rings."""

    states: FloatArray
    """Physical, (MAX_SUBHARMONIC + 1, n)."""
    changes: FloatArray
    """Scaled, over each number of periods, one row a period, (MAX_SUBHARMONIC + 1, MAX_SUBHARMONIC + 1)."""
    scales: FloatArray


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
def _sequence(log: FloatArray, count: int, machine: MachineRecord) -> int:
    """Return a number that stands for a period's sequence of events: the pieces, how the piston moves, the stops."""
    found, last, sticks = 0, -1, can_stick(machine)
    for row in range(count):
        mode = int(log[row, MODE])
        if not sticks and mode != STUCK:
            # Without dry friction it turns without an event.
            mode = 1
        code = (int(log[row, PIECE_NUMBER]) * 4 + mode + 1) * 3 + at_stop(log[row, POLYNOMIAL], machine) + 1
        if code != last:
            found, last = (found * _PRIME + code + 1) % _MODULUS, code
    return found


@compiled
def _note(run: RunRecord, state: FloatArray, log: FloatArray, history: History, plan: Plan) -> None:
    """Note the state after a period, and whether the march ends there."""
    progress, done = run.progress, run.progress.done
    states, changes, scales = history
    ring, before = states.shape[0], progress.sequence
    copy(state, states[done % ring])
    progress.sequence = _sequence(log, progress.n_logged, run.machine)
    progress.change = math.inf
    drift = largest_change(state, states[(done - 16) % ring], scales) if done >= 16 else math.inf
    for k in range(1, min(MAX_SUBHARMONIC, done) + 1):
        change = largest_change(state, states[(done - k) % ring], scales)
        changes[done % ring, k] = change
        progress.change = min(progress.change, change)
        if is_settled(k, done, changes, drift, plan.tolerance):
            progress.repeats, progress.change, progress.ended = k, change, REPEATS
            return
    change = changes[done % ring, 1]
    # Not where the next period will do.
    near = change <= plan.near and change * change > plan.tolerance * changes[(done - 1) % ring, 1]
    if done >= 2 and progress.sequence == before and (done >= plan.look or near):
        progress.ended = LOOK
    elif progress.simulated >= plan.until:
        progress.ended = LIMIT
    elif done >= plan.wait:
        progress.ended = WAITED


@compiled
def _march(
    run: RunRecord, pieces: Pieces, space: Workspace, log: FloatArray, history: History, plan: Plan
) -> FloatArray:
    """March periods until a plan says to end, or the budget of steps is spent; returns the log of the last one.

    The state is in `space`, the number of periods and why it ended in the run's `progress`.
    """
    progress, machine, state = run.progress, run.machine, space.state
    progress.ended = 0
    while progress.ended == 0:
        if progress.status == PAUSED:
            progress.status = OK
        else:
            progress.status, progress.time, progress.steps, progress.n_logged, progress.piece = OK, 0.0, 0, 0, 0
        for number in range(progress.piece, pieces.size):
            progress.piece, progress.kind = number, 0
            while progress.kind >= 0 and progress.status == OK:
                progress.mode = mode_of(state, machine)
                log = advance(pieces[number].end, pieces[number], run, space, log)
            if progress.status == PAUSED:
                return log
        progress.done, progress.simulated = progress.done + 1, progress.simulated + 1
        if progress.status != OK:
            progress.ended = FAILED
            break
        _note(run, space.state, log, history, plan)
    return log


class March:
    """Periods of a run, one after another, from a start on."""

    def __init__(self, start: FloatArray, run: Run, scales: FloatArray, deadline: Deadline | None = None) -> None:
        # The kernel notes its progress in the record: a run that others use too is left as it is.
        self.run = Run(run.records.copy(), run.pieces)
        self.scales, self.deadline = np.array(scales), deadline
        n, ring = start.size, MAX_SUBHARMONIC + 1
        self.history = History(np.empty((ring, n)), np.empty((ring, ring)), self.scales)
        areas = np.empty((2, int(run.records["machine"]["n_paths"][0])))
        self._space = Workspace(np.empty(n), np.empty(n), np.empty(n), np.zeros((7, n)), np.zeros((5, n)), areas)
        self._log = np.empty((64, POLYNOMIAL + 5 * n))
        self.progress: Any = self.run.records["progress"][0]
        self.restart(start)

    def restart(self, start: FloatArray) -> None:
        """Go on from another state."""
        self._space.state[:] = start
        self.history.states[0] = start
        self.history.changes.fill(np.inf)
        self.progress["done"] = self.progress["sequence"] = 0

    def go(self, plan: Plan) -> int:
        """March until the plan says to end; return why.

        Raises
        ------
        TimeLimitError
        """
        # Read before the kernel: Python sees signals, and the clock, between chunks of steps.
        while True:
            self.progress["budget"] = CHUNK
            with interruptible():
                self._log = _march(self.run.records[0], self.run.pieces, self._space, self._log, self.history, plan)
            if self.progress["ended"]:
                return int(self.progress["ended"])
            if self.deadline is not None:
                self.deadline.check(f"{int(self.progress['simulated'])} valve periods simulated")

    @property
    def machine(self) -> MachineRecord:
        """What is marched."""
        return self.run.records[0]["machine"]

    @property
    def state(self) -> FloatArray:
        """The state reached, physical."""
        return self._space.state

    @property
    def log(self) -> FloatArray:
        """Of the last period, as of `advance`."""
        return self._log[: int(self.progress["n_logged"])]

    @property
    def change(self) -> FloatArray:
        """Scaled change of the state over the last period, (n,)."""
        done, ring = int(self.progress["done"]), MAX_SUBHARMONIC + 1
        return (self.state - self.history.states[(done - 1) % ring]) / self.scales

    def last_states(self, count: int) -> FloatArray:
        """Return the states after the last periods, (count, n); that many are over since the start."""
        done = int(self.progress["done"])
        return self.history.states[np.arange(done - count + 1, done + 1) % (MAX_SUBHARMONIC + 1)]

    @property
    def outcome(self) -> Outcome:
        """The last period."""
        now = self.progress
        return Outcome(int(now["status"]), float(now["time"]), self.state.copy(), record_of(self.log))


_ONE = Plan(0.0, 0.0, 2, 2, 1)


def integrate_period(start: FloatArray, run: Run, deadline: Deadline | None = None) -> Outcome:
    """Integrate over one valve period from `start`, shape (n_states,).

    Raises
    ------
    TimeLimitError
    """
    march = March(start, run, np.ones(start.size), deadline)
    march.go(_ONE)
    return march.outcome
