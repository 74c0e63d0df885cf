"""Integration of the nonlinear equations over valve periods, compiled.

No step crosses a switching instant. Within a piece of the valve's cycle the Dormand-Prince pair (coefficients from scipy's RK45,
with its quartic interpolant) runs with step control; where the piston stops, breaks away or meets an end stop, the instant is
the root of the interpolant and a new step starts there. The paper's fixed-step Runge-Kutta method of fourth order is the
alternative: it ends its steps on the switching instants too, but takes stick and slip as they are at the end of a step.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import RK45

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled
from ltvpneu.models.dynamics import STUCK, external_force, source_range, state_rate
from ltvpneu.models.machine import MachineArrays
from ltvpneu.physics.friction import holding_force, slip_direction

OK, TOO_MANY_STEPS, STEP_TOO_SMALL, VOLUME_GONE = 0, 1, 2, 3
"""How an integration ended."""


class Schedule(NamedTuple):
    """One valve period: when the openings change, and what they are between."""

    times: FloatArray
    """Piece ends [s], from 0 to the period, shape (n_pieces + 1,)."""
    areas: FloatArray
    """As `OpeningTable.areas`."""


class Settings(NamedTuple):
    """How to integrate."""

    rtol: float
    """Tolerated error of a step relative to the state [-]; unused with a fixed step."""
    atol: FloatArray
    """The same, absolute, per state, shape (n_states,)."""
    fixed_step: float
    """Longest step of the fixed-step method [s]; 0 for the adaptive one."""
    max_steps: int
    """Steps a period may take."""


class Record(NamedTuple):
    """One period, as polynomials in the time since the start of each interval."""

    starts: FloatArray
    """Interval starts [s], shape (n_intervals,)."""
    spans: FloatArray
    """Interval lengths [s]."""
    modes: IntArray
    """+1 or -1 in slip, `STUCK` while held."""
    coefficients: FloatArray
    """Ascending powers, shape (n_intervals, 5, n_states)."""


class Outcome(NamedTuple):
    """Where an integration over one period got to."""

    status: int
    time: float
    steps: int
    state: FloatArray
    record: Record


_STAGES = np.vstack([RK45.A, np.append(RK45.B, 0.0)[None, :5]])
_NODES = np.append(RK45.C, 1.0)
_WEIGHTS = RK45.B
_ERROR = RK45.E
_INTERPOLANT = RK45.P


@compiled
def _areas_at(time: float, piece: int, schedule: Schedule, areas: FloatArray) -> None:
    """Write the effective areas at a time within a piece into `areas`, shape (2, n_paths)."""
    begin, end = schedule.times[piece], schedule.times[piece + 1]
    share = (time - begin) / (end - begin)
    for path in range(areas.shape[1]):
        for row in range(2):
            at_start = schedule.areas[piece, 2 * row, path]
            at_end = schedule.areas[piece, 2 * row + 1, path]
            # Not interpolated where equal: an absent second restriction is infinite at both ends.
            areas[row, path] = at_start if at_start == at_end else at_start + share * (at_end - at_start)


@compiled
def _holds(position: float, machine: MachineArrays) -> tuple[float, float]:
    """Forces that a resting piston withstands towards lower and higher positions [N]."""
    hold = holding_force(machine.load.dry_friction, machine.load.stiction)
    down = math.inf if position <= machine.load.lower_stop else hold
    up = math.inf if position >= machine.load.upper_stop else hold
    return down, up


@compiled
def mode_of(state: FloatArray, machine: MachineArrays) -> int:
    """Mode of the piston: the direction of its velocity; at rest, `STUCK` or the direction in which it breaks away."""
    if state[1] > 0.0:
        return 1
    if state[1] < 0.0:
        return -1
    down, up = _holds(state[0], machine)
    direction = slip_direction(external_force(state, machine), down, up)
    return STUCK if direction == 0 else direction


@compiled
def _value(coefficients: FloatArray, component: int, share: float) -> float:
    """Interpolant of one state at a share of its step; coefficients (5, n_states) in powers of the share."""
    value = coefficients[4, component]
    for power in range(3, -1, -1):
        value = value * share + coefficients[power, component]
    return value


@compiled
def _margin(
    share: float, kind: int, mode: int, coefficients: FloatArray, machine: MachineArrays, state: FloatArray
) -> float:
    """What an event waits for to fall below zero. Kinds: 0 velocity reverses, 1 lower, 2 upper stop, 3 break-away."""
    if kind == 0:
        return mode * _value(coefficients, 1, share)
    if kind == 1:
        return _value(coefficients, 0, share) - machine.load.lower_stop
    if kind == 2:
        return machine.load.upper_stop - _value(coefficients, 0, share)
    state[0] = coefficients[0, 0]
    for k in range(2, state.size):
        state[k] = _value(coefficients, k, share)
    force = external_force(state, machine)
    down, up = _holds(state[0], machine)
    return min(up - force, force + down)


@compiled
def _first_event(
    mode: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray
) -> tuple[float, int]:
    """Share of the step at which the first event happens, and its kind; 2.0 where none does.

    Also looked for at the middle of the step, so that a short excursion is not passed over.
    """
    first, found = 2.0, -1
    for kind in range(4):
        if (kind == 3) != (mode == STUCK):
            continue
        if kind == 0 and holding_force(machine.load.dry_friction, machine.load.stiction) == 0.0:
            continue
        high = 1.0
        if _margin(0.5, kind, mode, coefficients, machine, work) < 0.0:
            high = 0.5
        elif _margin(1.0, kind, mode, coefficients, machine, work) >= 0.0:
            continue
        low = 0.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            if _margin(middle, kind, mode, coefficients, machine, work) < 0.0:
                high = middle
            else:
                low = middle
        # The far side of the bracket: the event has happened there, so it does not happen again.
        if high < first:
            first, found = high, kind
    return first, found


@compiled
def _adaptive_step(
    h: float, time: float, piece: int, mode: int, schedule: Schedule, machine: MachineArrays,
    settings: Settings, areas: FloatArray, k: FloatArray, new: FloatArray,
    work: FloatArray, coefficients: FloatArray,
) -> float:  # fmt: skip
    """Try one Dormand-Prince step from the state in `coefficients[0]`, whose rate is in `k[0]`; return the scaled error.

    Writes the new state, its rate `k[6]` and, if the error is at most one, the interpolant. Infinite where a stage left
    the domain of the equations.
    """
    n = new.size
    for stage in range(1, 7):
        for i in range(n):
            total = 0.0
            for j in range(stage):
                total += (_STAGES[stage, j] if stage < 6 else _WEIGHTS[j]) * k[j, i]
            new[i] = coefficients[0, i] + h * total
        _areas_at(time + _NODES[stage] * h, piece, schedule, areas)
        if not state_rate(new, areas, mode, machine, work):
            return math.inf
        for i in range(n):
            k[stage, i] = work[i]
    worst = 0.0
    for i in range(n):
        error = 0.0
        for j in range(7):
            error += _ERROR[j] * k[j, i]
        scale = settings.atol[i] + settings.rtol * max(abs(coefficients[0, i]), abs(new[i]))
        worst = max(worst, abs(h * error) / scale)
    if worst <= 1.0:
        for i in range(n):
            for power in range(4):
                total = 0.0
                for j in range(7):
                    total += _INTERPOLANT[j, power] * k[j, i]
                coefficients[power + 1, i] = h * total
    return worst


@compiled
def _fixed_step(
    h: float, time: float, piece: int, mode: int, schedule: Schedule, machine: MachineArrays,
    areas: FloatArray, k: FloatArray, new: FloatArray,
    work: FloatArray, coefficients: FloatArray,
) -> bool:  # fmt: skip
    """Take one classical Runge-Kutta step of fourth order; interpolant: the cubic through both states and rates."""
    n = new.size
    for stage in range(1, 5):
        share = 0.5 if stage < 3 else 1.0
        for i in range(n):
            slope = k[stage - 1, i]
            if stage == 4:
                slope = (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i]) / 6.0
            new[i] = coefficients[0, i] + share * h * slope
        _areas_at(time + share * h, piece, schedule, areas)
        if not state_rate(new, areas, mode, machine, work):
            return False
        for i in range(n):
            k[stage, i] = work[i]
    for i in range(n):
        rise = new[i] - coefficients[0, i]
        begin, end = h * k[0, i], h * k[4, i]
        coefficients[1, i] = begin
        coefficients[2, i] = 3.0 * rise - 2.0 * begin - end
        coefficients[3, i] = begin + end - 2.0 * rise
        coefficients[4, i] = 0.0
    return True


@compiled
def _rest_at_source(
    h: float,
    before: FloatArray,
    rate: FloatArray,
    areas: FloatArray,
    machine: MachineArrays,
    state: FloatArray,
) -> None:
    """Let a chamber of a resting piston come to rest at the pressure of the one source it is open to.

    The flow is like the root of the pressure difference d, so d reaches zero in the finite time 2 d / |d'| and stays there.
    Left alone, an explicit method would go on in tiny steps beside that pressure, where the slope is infinite.
    """
    for k in range(machine.chambers.shape[0]):
        low, high = source_range(k, areas, machine)
        if low == high:
            difference = before[2 + k] - low
            passed = difference * (state[2 + k] - low) <= 0.0
            if passed or h * abs(rate[2 + k]) >= 2.0 * abs(difference):
                state[2 + k] = low


@compiled
def _land(kind: int, state: FloatArray, machine: MachineArrays) -> None:
    """Bring the piston to rest at an event: at the stop that it met, without rebound, or where its velocity is zero."""
    state[1] = 0.0
    if kind == 1:
        state[0] = machine.load.lower_stop
    elif kind == 2:
        state[0] = machine.load.upper_stop


@compiled
def _grown(array: FloatArray) -> FloatArray:
    larger = np.empty((2 * array.shape[0], *array.shape[1:]))
    larger[: array.shape[0]] = array
    return larger


@compiled
def integrate_period(
    start: FloatArray, schedule: Schedule, machine: MachineArrays, settings: Settings, recording: bool
) -> Outcome:
    """Integrate over one valve period from `start`, shape (n_states,)."""
    n, n_paths = start.size, machine.path_chamber.size
    period = schedule.times[-1]
    k, coefficients = np.zeros((7, n)), np.zeros((5, n))
    state, new, work = start.copy(), np.empty(n), np.empty(n)
    areas = np.empty((2, n_paths))
    capacity = 64 if recording else 1
    log, log_coefficients, count = np.empty((capacity, 3)), np.empty((capacity, 5, n)), 0
    mode = mode_of(state, machine)
    adaptive = settings.fixed_step == 0.0
    time, steps, status = 0.0, 0, OK
    for piece in range(schedule.times.size - 1):
        time, end = schedule.times[piece], schedule.times[piece + 1]
        h = min(1e-3 * period, end - time)
        if not adaptive:
            h = (end - time) / math.ceil((end - time) / settings.fixed_step * (1.0 - 1e-12))
        fresh = True
        while time < end:
            if steps >= settings.max_steps:
                status = TOO_MANY_STEPS
                break
            steps += 1
            if fresh:
                _areas_at(time, piece, schedule, areas)
                if not state_rate(state, areas, mode, machine, work):
                    status = VOLUME_GONE
                    break
                k[0] = work
                fresh = False
            coefficients[0] = state
            last = time + 1.000001 * h >= end
            if last:
                h = end - time
            if adaptive:
                error = _adaptive_step(
                    h, time, piece, mode, schedule, machine, settings, areas, k, new, work, coefficients
                )
                if error > 1.0:
                    h *= max(0.2, 0.9 * error**-0.2)
                    if h < 1e-15 * period:
                        status = VOLUME_GONE if math.isinf(error) else STEP_TOO_SMALL
                        break
                    continue
                share, kind = _first_event(mode, coefficients, machine, work)
            else:
                if not _fixed_step(
                    h, time, piece, mode, schedule, machine, areas, k, new, work, coefficients
                ):
                    status = VOLUME_GONE
                    break
                error, (share, kind) = 1.0, _first_event(mode, coefficients, machine, work)
                share = 1.0 if kind >= 0 else 2.0
            span = min(share, 1.0) * h
            if recording and span > 0.0:
                if count == log.shape[0]:
                    log, log_coefficients = _grown(log), _grown(log_coefficients)
                log[count, 0], log[count, 1], log[count, 2] = time, span, mode
                for power in range(5):
                    log_coefficients[count, power] = coefficients[power] / h**power
                count += 1
            if kind >= 0:
                for i in range(n):
                    state[i] = _value(coefficients, i, share)
                _land(kind, state, machine)
                mode = mode_of(state, machine)
                time = end if last and share == 1.0 else time + span
                fresh = True
                if adaptive:
                    h = min(h, 1e-3 * period)
                continue
            state[:] = new
            time = end if last else time + h
            if mode == STUCK:
                _rest_at_source(h, coefficients[0], k[0], areas, machine, state)
            fresh = mode == STUCK
            k[0] = k[6] if adaptive else k[4]
            if adaptive:
                h *= min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
        if status != OK:
            break
    modes = log[:count, 2].astype(np.int64)
    record = Record(log[:count, 0].copy(), log[:count, 1].copy(), modes, log_coefficients[:count].copy())
    return Outcome(status, time, steps, state, record)


class Settled(NamedTuple):
    """Where `settle` got to."""

    status: int
    n_periods: int
    n_simulated: int
    residual: float
    time: float
    state: FloatArray


MAX_SUBHARMONIC = 64
"""Longest orbit looked for, in valve periods."""


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
    # Where chambers rest at a source's pressure, step control leaves a floor of its own size: no more change to wait for.
    back = 16 * k
    if change <= 10.0 * tolerance and back < ring and done > back + k:
        return change > 0.5 * changes[(done - back) % ring, k]
    return False


@compiled
def settle(
    start: FloatArray, schedule: Schedule, machine: MachineArrays, settings: Settings,
    scales: FloatArray, tolerance: float, max_periods: int,
) -> Settled:  # fmt: skip
    """Simulate valve periods until the state repeats, after one or more of them.

    The change of the scaled state over k periods, r, bounds the distance from the orbit by r / (1 - q) where q is its
    contraction over the last k periods. The smallest k for which that falls below the tolerance is the orbit's.

    Returns
    -------
    Settled
        With `n_periods` zero if the state never repeated; `residual` is then the smallest change over any k.
    """
    n, ring = start.size, MAX_SUBHARMONIC + 1
    history, changes = np.empty((ring, n)), np.full((ring, ring), np.inf)
    state = start.copy()
    history[0] = state
    best = math.inf
    for done in range(1, max_periods + 1):
        outcome = integrate_period(state, schedule, machine, settings, False)
        state = outcome.state
        history[done % ring] = state
        if outcome.status != OK:
            time = (done - 1) * schedule.times[-1] + outcome.time
            return Settled(outcome.status, 0, done, best, time, state)
        best = math.inf
        for k in range(1, min(MAX_SUBHARMONIC, done) + 1):
            change = 0.0
            for i in range(n):
                change = max(change, abs(state[i] - history[(done - k) % ring, i]) / scales[i])
            changes[done % ring, k] = change
            best = min(best, change)
            if _is_settled(k, done, changes, tolerance):
                return Settled(OK, k, done, change, 0.0, state)
    return Settled(OK, 0, max_periods, best, 0.0, state)
