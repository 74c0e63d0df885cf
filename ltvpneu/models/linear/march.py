"""Marching a model of linear steps through valve periods, each step linearized about its own motion. Compiled.

A step's linear model depends on what the step visits, and that on where it starts: a map from the state at the start
of a step to the state at its end, like a one-step integrator's, only that what is kept is the linear model itself. So a
periodic model whose operating points belong to its own cycle is a periodic orbit of this map, and is found as the
machine finds its own: by going on until the state repeats. That asks for no solver in all operating points at once,
and stiction bands and subharmonics come out as they are.

Each step first has the nonlinear equations integrated over it from its start: they say when the piston stops or breaks
away, where a step is then cut, and give the fit its data, or the tangent a first guess of its mean. The difference
between both ends is the step's local error.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import by_field, compiled, inlined
from ltvpneu.models.linear.fit import Visited, fit_visited, mean_visited
from ltvpneu.models.linear.plan import Plan, Steps
from ltvpneu.models.machine.chord import Tangent, augmented, come_to_rest, tangent_at
from ltvpneu.models.machine.dynamics import STUCK, chamber_volume
from ltvpneu.models.machine.piston import after_event, at_stop, is_pressed, margin_at, mode_of
from ltvpneu.models.machine.records import GeneralRecord, MachineRecord, temperature_place
from ltvpneu.models.nonlinear.integrator import OK, advance, new_log, new_workspace
from ltvpneu.models.nonlinear.runge_kutta import Workspace, copy
from ltvpneu.periodic.algebra.small import advanced, apply, exponential, solve
from ltvpneu.physics.liquid import vapor_pressure
from ltvpneu.physics.properties import LIQUID

TOO_MANY_EVENTS, NOT_CONVERGED = 11, 12
"""How a march ended, beside the integrator's ways."""
MOST_STEPS = 400_000
"""Steps of the integrator that the march over a period may take."""
MAX_HALVINGS = 20
LEAST_SHARE = 0.01
"""Share of a dead volume, and of the supply pressure, below which a linear step has left the equations' domain [-]."""
MAX_EVENTS = 200
"""Steps that a cell may be cut into by stick and slip."""


class Marched(NamedTuple):
    """Where a march over one period got to."""

    status: int
    n_steps: int
    """Steps taken."""
    time: float
    state: FloatArray
    """Scaled and augmented, at the end, (n + 1,)."""
    defect: float
    """Largest difference between a step's scaled means and its operating point."""


class Ended(NamedTuple):
    """End of one linear step."""

    state: FloatArray
    duration: float
    defect: float
    iterations: int


class Place(NamedTuple):
    """Which step it is, and how far it may go."""

    cell: int
    mode: int
    kind: int
    """Of the event that it ends with; below zero for none."""
    row: int
    """Its number among the steps."""
    duration: float
    """Looked at [s]."""
    longest: float
    """To the end of the cell [s]."""


@inlined
def _physical(state: FloatArray, scales: FloatArray, z: FloatArray) -> None:
    for i in range(scales.size):
        z[i] = state[i] * scales[i]


@compiled
def _on_event(
    matrix: FloatArray, state: FloatArray, place: Place, machine: MachineRecord, scales: FloatArray
) -> tuple[FloatArray, float]:
    """Return the state and the duration at which the linear step itself has the event, near the duration looked at.

    `state` is that at the duration looked at; Newton's method with a difference quotient.
    """
    duration, z, small = place.duration, np.empty(scales.size), 1e-6 * place.duration
    for _ in range(12):
        _physical(state, scales, z)
        margin = margin_at(z, place.kind, place.mode, machine)
        _physical(advanced(matrix, state, small), scales, z)
        slope = (margin_at(z, place.kind, place.mode, machine) - margin) / small
        if slope == 0.0 or not math.isfinite(slope):
            break
        step = max(min(-margin / slope, place.longest - duration), -0.5 * duration)
        state = advanced(matrix, state, step)
        duration += step
        if abs(step) <= 1e-14 * place.longest:
            break
    return state, duration


@compiled
def _is_pressed(start: FloatArray, point: FloatArray, machine: MachineRecord, scales: FloatArray) -> bool:
    """Whether a step of rest lies at a stop that the piston is pressed on, at its start or its operating point."""
    if at_stop(start[0] * scales[0], machine) == 0:
        return False
    z = np.empty(scales.size)
    _physical(start, scales, z)
    if is_pressed(z, machine):
        return True
    for k in range(2, z.size):
        z[k] = point[k]
    return is_pressed(z, machine)


@compiled
def _follow(
    start: FloatArray, place: Place, visited: Visited, plan: Plan, steps: Steps
) -> tuple[bool, FloatArray, FloatArray, float]:
    """Build one step's linear model at its operating point and follow it.

    Returns whether the equations hold at the operating point, the scaled means and the scaled state at the step's end,
    and its duration.
    """
    record, scales, n = plan.records[0], plan.scales, plan.scales.size
    machine, duration = record.run.machine, place.duration
    matrix, point = steps.matrices[place.row], steps.points[place.row]
    found = Tangent(np.empty((n, n)), steps.inputs[place.row], np.empty(n), steps.held[place.row], np.empty(n))
    result, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    end, means = np.empty(n + 1), np.empty(n + 1)
    if not tangent_at(point, plan.areas[place.cell], place.mode, machine, record.distance, found):
        return False, means, end, duration
    if place.mode == STUCK:
        come_to_rest(duration, found.sweeps, _is_pressed(start, point, machine, scales), found.A)
    augmented(found.A, point, found.rate, scales, matrix)
    if record.fitted:
        fit_visited(visited, point, machine, place.mode, scales, matrix)
    exponential(matrix, duration, result, mean)
    apply(result, start, end)
    if place.kind >= 0:
        end, duration = _on_event(matrix, end, place, machine, scales)
        exponential(matrix, duration, result, mean)
    apply(mean, start, means)
    if place.mode == STUCK:
        # To the last bit: it does not move.
        means[0], means[1], end[0] = start[0], 0.0, start[0]
    return True, means, end, duration


@inlined
def _set_point(means: FloatArray, scales: FloatArray, point: FloatArray) -> None:
    for i in range(scales.size):
        point[i] = means[i] * scales[i]
    for k in range(2, scales.size):
        # A guess on the way is kept where the equations hold; where the search ends, it is the mean itself.
        point[k] = max(point[k], 1e-3 * scales[k])


@inlined
def _defect(found: bool, means: FloatArray, guess: FloatArray) -> float:
    """Largest difference between a step's means and its operating point; infinite where the equations do not hold."""
    worst = 0.0
    for i in range(guess.size):
        worst = max(worst, abs(means[i] - guess[i]))
    return worst if found and math.isfinite(worst) else math.inf


@compiled
def _linear_step(start: FloatArray, place: Place, visited: Visited, plan: Plan, steps: Steps) -> Ended:
    """Find one step's linear model, whose operating point is the mean of the step itself, and follow it.

    By taking the means for the next operating point while that closes in by half or better each time; else by damped
    Newton steps with a matrix of difference quotients.
    """
    record, n = plan.records[0], plan.scales.size
    point, guess = steps.points[place.row], np.empty(n)
    copy(mean_visited(visited), point)
    for i in range(n):
        guess[i] = point[i] / plan.scales[i]
    found, means, end, duration = _follow(start, place, visited, plan, steps)
    if record.fitted:
        for i in range(n):
            point[i] = means[i] * plan.scales[i]
        return Ended(end, duration, 0.0 if found else math.inf, 1)
    defect, iterations, newton = _defect(found, means, guess), 1, False
    while defect > record.tolerance and iterations < record.max_iterations and math.isfinite(defect):
        step = means[:n] - guess
        if newton and not _newton_step(start, place, visited, plan, steps, guess, means, step):
            break
        share, following, moved, others = 1.0, math.inf, guess, means
        while share > 1e-4:
            moved = guess + share * step
            _set_point(moved, plan.scales, point)
            found, others, end, duration = _follow(start, place, visited, plan, steps)
            iterations += 1
            following = _defect(found, others, moved)
            if not newton or following <= (1.0 - 0.5 * share) * defect or following <= record.tolerance:
                break
            share *= 0.5
        if following >= defect:
            if newton:
                break
            newton = True
            continue
        newton = newton or following > 0.5 * defect
        defect, guess, means = following, moved, others
    return Ended(end, duration, defect, iterations)


@compiled
def _newton_step(  # noqa: PLR0913 - compiled, and called from one place
    start: FloatArray,
    place: Place,
    visited: Visited,
    plan: Plan,
    steps: Steps,
    guess: FloatArray,
    means: FloatArray,
    step: FloatArray,
) -> bool:
    """Turn `step`, means less guess, into Newton's, with difference quotients over the operating point."""
    n = guess.size
    matrix, point = np.empty((n, n)), steps.points[place.row]
    for j in range(n):
        moved = guess.copy()
        small = 1e-6 * max(1.0, abs(guess[j]))
        moved[j] += small
        _set_point(moved, plan.scales, point)
        _, others, _, _ = _follow(start, place, visited, plan, steps)
        for i in range(n):
            matrix[i, j] = (1.0 if i == j else 0.0) - (others[i] - means[i]) / small
    return solve(matrix, step)


@compiled
def _visit(piece: int, end: float, plan: Plan, space: Workspace, log: FloatArray) -> tuple[int, FloatArray]:
    """Integrate on from the present time, in a piece, to a later time or to an event; log what is visited.

    Returns the piece reached, and the log.
    """
    run = plan.records[0].run
    run.progress.status, run.progress.n_logged = OK, 0
    while True:
        run.progress.steps = 0
        until = min(end, plan.pieces[piece].end)
        log = advance(until, plan.pieces[piece], run, space, log)
        if run.progress.status != OK or run.progress.kind >= 0 or until >= end:
            return piece, log
        piece += 1


def _least_of_any(scale: float, machine: GeneralRecord) -> float:
    # A liquid may well fall to a small share of its supply pressure; where it cavitates it ends.
    return vapor_pressure(machine.medium.table) / scale if machine.medium.kind == LIQUID else LEAST_SHARE


def _least_of_gas(scale: float, machine: MachineRecord) -> float:
    return LEAST_SHARE


_least_pressure = by_field("medium", "machine", _least_of_any, _least_of_gas)
"""Scaled pressure below which a linear step has left the equations' domain [-]."""


@compiled
def _is_inside(state: FloatArray, machine: MachineRecord, scales: FloatArray) -> bool:
    """Whether the equations hold at a scaled state, with room to spare."""
    for i in range(scales.size):
        if not abs(state[i]) < 1e6:
            return False
    for k in range(machine.n_volumes):
        volume = chamber_volume(k, state[0] * scales[0], machine)
        if volume < LEAST_SHARE * machine.volumes[k].size or state[2 + k] < _least_pressure(scales[2 + k], machine):
            return False
        place = temperature_place(k, machine)
        if place >= 0 and state[place] < LEAST_SHARE:
            return False
    return True


class _Here(NamedTuple):
    """Where a march is: time [s], piece, scaled augmented state, mode, steps taken, cell."""

    time: float
    piece: int
    state: FloatArray
    mode: int
    row: int
    cell: int


class _Taken(NamedTuple):
    """How one step went: status, where it ended, the event there (below zero for none), and the defect."""

    status: int
    time: float
    kind: int
    state: FloatArray
    piece: int
    defect: float
    is_recorded: bool


@compiled
def _take_step(here: _Here, end: float, plan: Plan, steps: Steps, space: Workspace, log: FloatArray) -> _Taken:
    """Take one step from a place to the end of its cell, or to an event, or less far.

    Where no operating point is found, or the step leaves the equations' domain, half of it is tried, and so on.
    """
    record, scales, n = plan.records[0], plan.scales, plan.scales.size
    progress, longest = record.run.progress, end - here.time
    taken = _Taken(NOT_CONVERGED, here.time, -1, here.state, here.piece, math.inf, True)
    for _ in range(MAX_HALVINGS):
        _physical(here.state, scales, space.state)
        progress.time, progress.mode = here.time, here.mode
        until = here.time + longest if longest < end - here.time else end
        piece, log = _visit(here.piece, until, plan, space, log)
        stop, kind = progress.time, progress.kind
        if progress.status != OK:
            reached = here.state.copy()
            for i in range(n):
                reached[i] = space.state[i] / scales[i]
            return _Taken(progress.status, stop, -1, reached, piece, math.inf, True)
        if progress.n_logged == 0 or stop <= here.time:
            return _Taken(OK, here.time, kind, here.state, piece, 0.0, False)
        duration = stop - here.time
        place = Place(here.cell, here.mode, kind, here.row, duration, end - here.time)
        one = _linear_step(here.state, place, Visited(log, progress.n_logged), plan, steps)
        ended = here.time + one.duration if kind >= 0 else stop
        taken = _Taken(NOT_CONVERGED, ended, kind, one.state, piece, one.defect, True)
        if one.defect <= record.tolerance and _is_inside(one.state, record.run.machine, scales):
            error = abs(one.duration - duration) / record.run.period
            for i in range(n):
                error = max(error, abs(one.state[i] - space.state[i] / scales[i]))
            copy(here.state, steps.starts[here.row])
            steps.cells[here.row], steps.modes[here.row] = here.cell, here.mode
            steps.durations[here.row], steps.errors[here.row] = one.duration, error
            steps.iterations[here.row] = one.iterations
            return _Taken(OK, ended, kind, one.state, piece, one.defect, True)
        longest = 0.5 * duration
    return taken


@compiled
def march_period(start: FloatArray, plan: Plan, steps: Steps) -> Marched:
    """March through one valve period from a scaled augmented state, shape (n + 1,); fill in `steps`."""
    machine, scales, pieces = plan.records[0].run.machine, plan.scales, plan.pieces
    n = scales.size
    z, state = np.empty(n), start
    _physical(state, scales, z)
    space, log = new_workspace(z, machine.n_paths), new_log(n)
    plan.records[0].run.progress.budget = MOST_STEPS
    row, worst, mode, time = 0, 0.0, mode_of(z, machine), 0.0
    for cell in range(plan.areas.shape[0]):
        piece = int(plan.first_pieces[cell])
        time, end = pieces[piece].begin, pieces[int(plan.first_pieces[cell + 1]) - 1].end
        if mode != STUCK and state[1] != 0.0:
            mode = 1 if state[1] > 0.0 else -1
        events = 0
        while time < end:
            if row >= steps.cells.size or events > MAX_EVENTS:
                return Marched(TOO_MANY_EVENTS, row, time, state, worst)
            taken = _take_step(_Here(time, piece, state, mode, row, cell), end, plan, steps, space, log)
            worst = max(worst, taken.defect)
            if taken.status != OK:
                return Marched(taken.status, row, taken.time, taken.state, worst)
            if taken.is_recorded:
                row += 1
            time, piece, state = taken.time, taken.piece, taken.state.copy()
            while piece < pieces.size - 1 and time >= pieces[piece].end:
                piece += 1
            while time < pieces[piece].begin:
                piece -= 1
            if taken.kind < 0 or time >= end:
                continue
            events += 1
            mode = after_event(taken.kind, state, scales, machine)
    return Marched(OK, row, time, state, worst)
