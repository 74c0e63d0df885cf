"""Integration of the nonlinear equations over valve periods, compiled.

No step crosses a switching instant. Within a piece of the valve's cycle the Dormand-Prince pair (coefficients from
scipy's RK45,
with its quartic interpolant) runs with step control; where the piston stops, breaks away or meets an end stop, the
instant is
the root of the interpolant and a new step starts there. The paper's fixed-step Runge-Kutta method of fourth order is
the
alternative: it ends its steps on the switching instants too, but takes stick and slip as they are at the end of a step.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import RK45

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu._compiled import compiled, inlined
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
    ramped: BoolArray
    """Whether any area changes within the piece, shape (n_pieces,)."""


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


class Run(NamedTuple):
    """What is integrated, and how."""

    schedule: Schedule
    machine: MachineArrays
    settings: Settings


class Workspace(NamedTuple):
    """Arrays that the steps write into."""

    state: FloatArray
    """(n_states,)"""
    new: FloatArray
    """State at the end of the step that is tried, (n_states,)."""
    rate: FloatArray
    """(n_states,)"""
    stages: FloatArray
    """Rates at the stages; the first is that of the state, (7, n_states)."""
    coefficients: FloatArray
    """Interpolant in powers of the share of the step; the first row is the state, (5, n_states)."""
    areas: FloatArray
    """(2, n_paths)"""


class Progress(NamedTuple):
    """How far an integration has got."""

    status: int
    time: float
    steps: int
    mode: int


class Log(NamedTuple):
    """Intervals recorded so far, in arrays with room for more."""

    rows: FloatArray
    """Start [s], span [s], mode, piece of the valve's cycle; (capacity, 4)."""
    coefficients: FloatArray
    """(capacity, 5, n_states)"""
    n_logged: int


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


# The last stage is the step's end, whose weights are the method's own: its rate starts the next step.
_STAGES = np.zeros((7, 6))
_STAGES[:6, :5] = RK45.A
_STAGES[6] = RK45.B
_NODES = np.append(RK45.C, 1.0)
_ERROR = RK45.E
_INTERPOLANT = RK45.P


@inlined
def _copy(source: FloatArray, target: FloatArray) -> None:
    """Write one vector into another entry by entry: numba takes seconds to compile what checks the shapes of slices."""
    for i in range(source.size):
        target[i] = source[i]


@inlined
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
    """Return the forces that a resting piston withstands towards lower and higher positions [N]."""
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


@inlined
def _value(coefficients: FloatArray, component: int, share: float) -> float:
    """Interpolant of one state at a share of its step; coefficients (5, n_states) in powers of the share."""
    value = coefficients[4, component]
    for power in range(3, -1, -1):
        value = value * share + coefficients[power, component]
    return value


@inlined
def _margin(
    share: float, kind: int, mode: int, coefficients: FloatArray, machine: MachineArrays, state: FloatArray
) -> float:
    """Return what an event waits for to fall below zero.

    Kinds: 0 velocity reverses, 1 lower, 2 upper stop, 3 break-away.
    """
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
def _event_share(kind: int, mode: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray) -> float:
    """Return the share of the step at which an event of a kind happens, 2.0 if it does not.

    Also looked for at the middle of the step, so that a short excursion is not passed over.
    """
    high = 2.0
    if _margin(0.5, kind, mode, coefficients, machine, work) < 0.0:
        high = 0.5
    elif _margin(1.0, kind, mode, coefficients, machine, work) < 0.0:
        high = 1.0
    if high <= 1.0:
        low = 0.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            if _margin(middle, kind, mode, coefficients, machine, work) < 0.0:
                high = middle
            else:
                low = middle
    # The far side of the bracket: the event has happened there, so it does not happen again.
    return high


@inlined
def _first_event(mode: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray) -> tuple[float, int]:
    """Return the share of the step at which the first event happens, and its kind; 2.0 and -1 where none does."""
    first, found = 2.0, -1
    if mode == STUCK:
        first, found = _event_share(3, mode, coefficients, machine, work), 3
    else:
        # Looked at here, without a call: in slip this is asked at every step.
        slowed = mode * _value(coefficients, 1, 0.5) < 0.0 or mode * _value(coefficients, 1, 1.0) < 0.0
        if slowed and holding_force(machine.load.dry_friction, machine.load.stiction) > 0.0:
            first, found = _event_share(0, mode, coefficients, machine, work), 0
        if machine.load.lower_stop > -math.inf:
            share = _event_share(1, mode, coefficients, machine, work)
            if share < first:
                first, found = share, 1
        if machine.load.upper_stop < math.inf:
            share = _event_share(2, mode, coefficients, machine, work)
            if share < first:
                first, found = share, 2
    return first, found if first <= 1.0 else -1


@inlined
def _adaptive_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Try one Dormand-Prince step and return its scaled error; infinite where a stage left the equations' domain.

    Writes the new state, its rate as the seventh stage and, if the error is at most one, the interpolant.
    """
    state, new, stages, settings = space.state, space.new, space.stages, run.settings
    # Areas that do not change were written when the piece began.
    n, ramped = new.size, run.schedule.ramped[piece]
    for stage in range(1, 7):
        for i in range(n):
            total = 0.0
            for j in range(stage):
                total += _STAGES[stage, j] * stages[j, i]
            new[i] = state[i] + h * total
        if ramped:
            _areas_at(time + _NODES[stage] * h, piece, run.schedule, space.areas)
        if not state_rate(new, space.areas, mode, run.machine, space.rate):
            return math.inf
        _copy(space.rate, stages[stage])
    worst = 0.0
    for i in range(n):
        error = 0.0
        for j in range(7):
            error += _ERROR[j] * stages[j, i]
        scale = settings.atol[i] + settings.rtol * max(abs(state[i]), abs(new[i]))
        worst = max(worst, abs(h * error) / scale)
    if worst <= 1.0:
        for i in range(n):
            for power in range(4):
                total = 0.0
                for j in range(7):
                    total += _INTERPOLANT[j, power] * stages[j, i]
                space.coefficients[power + 1, i] = h * total
    return worst


@compiled
def _fixed_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Take one classical Runge-Kutta step of fourth order; return 0, or infinity as `_adaptive_step`.

    The interpolant is the cubic through both states and rates.
    """
    state, new, stages, coefficients = space.state, space.new, space.stages, space.coefficients
    for stage in range(1, 5):
        share = 0.5 if stage < 3 else 1.0
        for i in range(new.size):
            slope = stages[stage - 1, i]
            if stage == 4:
                slope = (stages[0, i] + 2.0 * stages[1, i] + 2.0 * stages[2, i] + stages[3, i]) / 6.0
            new[i] = state[i] + share * h * slope
        _areas_at(time + share * h, piece, run.schedule, space.areas)
        if not state_rate(new, space.areas, mode, run.machine, space.rate):
            return math.inf
        _copy(space.rate, stages[stage])
    # Where the next step looks for the rate of its start.
    _copy(stages[4], stages[6])
    for i in range(new.size):
        rise, begin, end = new[i] - state[i], h * stages[0, i], h * stages[4, i]
        coefficients[1, i] = begin
        coefficients[2, i] = 3.0 * rise - 2.0 * begin - end
        coefficients[3, i] = begin + end - 2.0 * rise
        coefficients[4, i] = 0.0
    return 0.0


@compiled
def _rest_at_source(run: Run, space: Workspace) -> None:
    """Let a chamber of a resting piston come to rest at the pressure of the one source it is open to.

    The flow is like the root of the pressure difference d, so d reaches zero in the finite time 2 d / |d'| and stays.
    Left alone, an explicit method would go on in tiny steps beside that pressure, where the slope is infinite.
    """
    state, before = space.state, space.coefficients[0]
    for k in range(run.machine.chambers.shape[0]):
        low, high = source_range(k, space.areas, run.machine)
        if low == high:
            difference = before[2 + k] - low
            # The interpolant's first power is the rate at the start of the step, times its length.
            change = space.coefficients[1, 2 + k]
            if difference * (state[2 + k] - low) <= 0.0 or abs(change) >= 2.0 * abs(difference):
                state[2 + k] = low


@compiled
def _land(kind: int, share: float, run: Run, space: Workspace) -> None:
    """Bring the piston to rest at an event: at the stop that it met, without rebound, or where its velocity is zero."""
    for i in range(space.state.size):
        space.state[i] = _value(space.coefficients, i, share)
    space.state[1] = 0.0
    if kind == 1:
        space.state[0] = run.machine.load.lower_stop
    elif kind == 2:
        space.state[0] = run.machine.load.upper_stop


@compiled
def _logged(log: Log, row: tuple[float, float, int, int], h: float, coefficients: FloatArray) -> Log:
    """Return the log with one more interval: start, span, mode, piece, and the interpolant over a step of length h."""
    rows, recorded, count = log.rows, log.coefficients, log.n_logged
    if count == rows.shape[0]:
        rows = np.empty((2 * count, 4))
        recorded = np.empty((2 * count, 5, coefficients.shape[1]))
        _copy(log.rows.ravel(), rows.ravel())
        _copy(log.coefficients.ravel(), recorded.ravel())
    rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = row
    scale = 1.0
    for power in range(5):
        for i in range(coefficients.shape[1]):
            recorded[count, power, i] = coefficients[power, i] * scale
        scale /= h
    return Log(rows, recorded, count + 1)


@compiled
def _fixed_length(piece: int, run: Run) -> float:
    """Length of the fixed-step method's steps in a piece, a whole number of which fill it [s]."""
    length = run.schedule.times[piece + 1] - run.schedule.times[piece]
    return length / math.ceil(length / run.settings.fixed_step * (1.0 - 1e-12))


@inlined
def _scaled_size(values: FloatArray, state: FloatArray, settings: Settings) -> float:
    """Largest of some values in units of the tolerated error."""
    worst = 0.0
    for i in range(state.size):
        worst = max(worst, abs(values[i]) / (settings.atol[i] + settings.rtol * abs(state[i])))
    return worst


@compiled
def _first_length(time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Length of the adaptive method's first step after a switch or an event [s].

    A short Euler step tells how fast the rate changes: in a time tau the rate, d in units of the tolerated error,
    becomes another. A method of fifth order then errs by about d tau (h / tau)^5 / 100 units, which is to be a small
    part of one.
    """
    period = run.schedule.times[-1]
    rate = _scaled_size(space.stages[0], space.state, run.settings)
    if rate == 0.0:
        return 1e-3 * period
    small = min(0.01 * _scaled_size(space.state, space.state, run.settings) / rate, 1e-4 * period)
    for i in range(space.state.size):
        space.new[i] = space.state[i] + small * space.stages[0, i]
    _areas_at(time + small, piece, run.schedule, space.areas)
    if small == 0.0 or not state_rate(space.new, space.areas, mode, run.machine, space.rate):
        return 1e-6 * period
    for i in range(space.state.size):
        space.new[i] = (space.rate[i] - space.stages[0, i]) / small
    change = _scaled_size(space.new, space.state, run.settings)
    tau = rate / change if change > 0.0 else period
    return min(0.5 * tau * (100.0 / (rate * tau)) ** 0.2, period)


@inlined
def _start_rate(time: float, piece: int, mode: int, run: Run, space: Workspace) -> bool:
    """Write the rate at the state as the first stage; False outside the equations' domain."""
    _areas_at(time, piece, run.schedule, space.areas)
    inside = state_rate(space.state, space.areas, mode, run.machine, space.rate)
    _copy(space.rate, space.stages[0])
    return inside


@inlined
def _try_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    if run.settings.fixed_step > 0.0:
        return _fixed_step(h, time, piece, mode, run, space)
    return _adaptive_step(h, time, piece, mode, run, space)


@compiled
def _integrate_piece(piece: int, steps: int, mode: int, run: Run, space: Workspace, log: Log) -> tuple[Progress, Log]:
    """Integrate over one piece of the valve's cycle; `log.n_logged` below zero records nothing."""
    time, end, period = run.schedule.times[piece], run.schedule.times[piece + 1], run.schedule.times[-1]
    adaptive = run.settings.fixed_step == 0.0
    # A length of zero asks for a first step; only the rate at its start can tell how long.
    h, fresh = (0.0 if adaptive else _fixed_length(piece, run)), True
    while time < end:
        if steps >= run.settings.max_steps:
            return Progress(TOO_MANY_STEPS, time, steps, mode), log
        steps += 1
        if fresh and not _start_rate(time, piece, mode, run, space):
            return Progress(VOLUME_GONE, time, steps, mode), log
        if h == 0.0:
            h = _first_length(time, piece, mode, run, space)
        fresh = False
        _copy(space.state, space.coefficients[0])
        last = time + 1.000001 * h >= end
        if last:
            h = end - time
        error = _try_step(h, time, piece, mode, run, space)
        if error > 1.0:
            h *= max(0.2, 0.9 * error**-0.2)
            if h < 1e-15 * period or not adaptive:
                status = VOLUME_GONE if math.isinf(error) else STEP_TOO_SMALL
                return Progress(status, time, steps, mode), log
            continue
        share, kind = _first_event(mode, space.coefficients, run.machine, space.rate)
        if not adaptive and kind >= 0:
            share = 1.0
        span = min(share, 1.0) * h
        if log.n_logged >= 0 and span > 0.0:
            log = _logged(log, (time, span, mode, piece), h, space.coefficients)
        time = end if last and share >= 1.0 else time + span
        if kind >= 0:
            _land(kind, share, run, space)
            mode, fresh = mode_of(space.state, run.machine), True
            h = 0.0 if adaptive else h
            continue
        _copy(space.new, space.state)
        _copy(space.stages[6], space.stages[0])
        if mode == STUCK:
            _rest_at_source(run, space)
            fresh = True
        if adaptive:
            h *= min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
    return Progress(OK, time, steps, mode), log


@compiled
def integrate_period(start: FloatArray, run: Run, recording: bool) -> Outcome:
    """Integrate over one valve period from `start`, shape (n_states,)."""
    n, n_paths = start.size, run.machine.path_chamber.size
    space = Workspace(
        start.copy(), np.empty(n), np.empty(n), np.zeros((7, n)), np.zeros((5, n)), np.empty((2, n_paths))
    )
    log = (
        Log(np.empty((64, 4)), np.empty((64, 5, n)), 0) if recording else Log(np.empty((0, 4)), np.empty((0, 5, n)), -1)
    )
    progress = Progress(OK, 0.0, 0, mode_of(space.state, run.machine))
    for piece in range(run.schedule.times.size - 1):
        progress, log = _integrate_piece(piece, progress.steps, progress.mode, run, space, log)
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


class Settled(NamedTuple):
    """Where `settle` got to."""

    n_periods: int
    """Least number of periods after which the state repeats; 0 if none was found."""
    n_simulated: int
    residual: float
    last: Outcome
    """The last period simulated."""


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
    _copy(start, history[0])
    done, best = 1, math.inf
    outcome = integrate_period(start, run, True)
    while outcome.status == OK:
        _copy(outcome.state, history[done % ring])
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


@compiled
def polynomial_extremes(coefficients: FloatArray, spans: FloatArray) -> tuple[float, float]:
    """Return the least and the greatest value of a piecewise quartic.

    On each interval they lie at an end or at a root of the derivative, a cubic. Between the cubic's own extremes, roots
    of a parabola, it is monotone, so a change of sign brackets each root.

    Parameters
    ----------
    coefficients : ndarray, shape (n_intervals, 5)
        Ascending powers of the time since the start of the interval.
    spans : ndarray, shape (n_intervals,)
    """
    low, high = math.inf, -math.inf
    cuts = np.empty(4)
    for i in range(spans.size):
        c, span = coefficients[i], spans[i]
        cuts[0], cuts[3] = 0.0, span
        # Second derivative 2 c2 + 6 c3 t + 12 c4 t^2; its roots outside the interval cut nothing off.
        discriminant = 9.0 * c[3] * c[3] - 24.0 * c[2] * c[4]
        root = math.sqrt(max(discriminant, 0.0))
        larger = -(3.0 * c[3] + math.copysign(root, c[3]))
        first = larger / (12.0 * c[4]) if c[4] != 0.0 else span
        second = 2.0 * c[2] / larger if larger != 0.0 else span
        cuts[1] = min(max(min(first, second), 0.0), span)
        cuts[2] = min(max(max(first, second), 0.0), span)
        for time in (0.0, span):
            value = _quartic(c, time)
            low, high = min(low, value), max(high, value)
        for j in range(3):
            if _quartic_slope(c, cuts[j]) * _quartic_slope(c, cuts[j + 1]) < 0.0:
                value = _quartic(c, _slope_root(c, cuts[j], cuts[j + 1]))
                low, high = min(low, value), max(high, value)
    return low, high


@compiled
def _quartic(c: FloatArray, t: float) -> float:
    return c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))


@compiled
def _quartic_slope(c: FloatArray, t: float) -> float:
    return c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))


@compiled
def _slope_root(c: FloatArray, begin: float, end: float) -> float:
    rising = _quartic_slope(c, end) > 0.0
    for _ in range(60):
        middle = 0.5 * (begin + end)
        if (_quartic_slope(c, middle) > 0.0) == rising:
            end = middle
        else:
            begin = middle
    return 0.5 * (begin + end)
