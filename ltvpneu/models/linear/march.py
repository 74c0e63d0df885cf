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

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled
from ltvpneu.models.linear.fit import Visited, fit_visited, mean_visited
from ltvpneu.models.machine.arrays import temperature_place
from ltvpneu.models.machine.chord import Tangent, augmented, come_to_rest, tangent_at
from ltvpneu.models.machine.dynamics import STUCK, chamber_volume
from ltvpneu.models.machine.piston import after_event, at_stop, is_pressed, margin_at, mode_of
from ltvpneu.models.nonlinear.integrator import OK, Log, advance, new_workspace
from ltvpneu.models.nonlinear.runge_kutta import Run, Workspace, copy
from ltvpneu.periodic.small import advanced, apply, exponential, solve
from ltvpneu.physics.liquid import vapor_pressure
from ltvpneu.physics.properties import LIQUID

TOO_MANY_EVENTS, NOT_CONVERGED = 11, 12
"""How a march ended, beside the integrator's ways."""
MAX_HALVINGS = 20
LEAST_SHARE = 0.01
"""Share of a dead volume, and of the supply pressure, below which a linear step has left the equations' domain [-]."""
MAX_EVENTS = 200
"""Steps that a cell may be cut into by stick and slip."""


class Plan(NamedTuple):
    """What is marched through, and how."""

    run: Run
    """Nonlinear equations; the pieces of its schedule end at cell boundaries at least."""
    first_pieces: IntArray
    """First piece of each cell, and the number of pieces, (n_cells + 1,)."""
    areas: FloatArray
    """Means of the effective areas over each cell, (n_cells, 2, n_paths)."""
    scales: FloatArray
    """(n,)"""
    fitted: bool
    """Whether steps are fitted; else tangents at their own means."""
    distance: float
    """As of `tangent_at`."""
    tolerance: float
    """Scaled difference from a step's means at which its operating point counts as found."""
    max_iterations: int


class Steps(NamedTuple):
    """The steps of one period."""

    matrices: FloatArray
    """Scaled augmented matrices, (capacity, n + 1, n + 1)."""
    starts: FloatArray
    """Scaled augmented states, (capacity, n + 1)."""
    points: FloatArray
    """Operating points, (capacity, n)."""
    inputs: FloatArray
    """Slopes over the inputs, (capacity, n, 4)."""
    held: FloatArray
    """Half-widths of chords, (capacity, n)."""
    table: FloatArray
    """Cell, mode, duration [s], local error, iterations; (capacity, 5)."""


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


@compiled
def _physical(state: FloatArray, scales: FloatArray, z: FloatArray) -> None:
    for i in range(scales.size):
        z[i] = state[i] * scales[i]


@compiled
def _on_event(
    matrix: FloatArray, state: FloatArray, guess: tuple[float, float], kind: int, mode: int, plan: Plan
) -> tuple[FloatArray, float]:
    """Return the state and the duration at which the linear step itself has the event, near a guess of its duration.

    `guess` holds the duration at which `state` is, and the longest one; newton's method with a difference quotient.
    """
    duration, longest = guess
    z = np.empty(plan.scales.size)
    small = 1e-6 * duration
    for _ in range(12):
        _physical(state, plan.scales, z)
        margin = margin_at(z, kind, mode, plan.run.machine)
        _physical(advanced(matrix, state, small), plan.scales, z)
        slope = (margin_at(z, kind, mode, plan.run.machine) - margin) / small
        if slope == 0.0 or not math.isfinite(slope):
            break
        step = max(min(-margin / slope, longest - duration), -0.5 * duration)
        state = advanced(matrix, state, step)
        duration += step
        if abs(step) <= 1e-14 * longest:
            break
    return state, duration


@compiled
def _is_pressed(start: FloatArray, point: FloatArray, plan: Plan) -> bool:
    """Whether a step of rest lies at a stop that the piston is pressed on, at its start or its operating point."""
    if at_stop(start[0] * plan.scales[0], plan.run.machine) == 0:
        return False
    z = np.empty(plan.scales.size)
    _physical(start, plan.scales, z)
    if is_pressed(z, plan.run.machine):
        return True
    for k in range(2, z.size):
        z[k] = point[k]
    return is_pressed(z, plan.run.machine)


@compiled
def _follow(
    start: FloatArray, where: tuple[int, int, int, int], span: tuple[float, float], visited: Visited,
    plan: Plan, steps: Steps,
) -> tuple[bool, FloatArray, FloatArray, float]:  # fmt: skip
    """Build one step's linear model at its operating point and follow it.

    `where`: cell, mode, event, row; `span`: duration looked at, longest one. Returns whether the equations hold at the
    operating point, the scaled means and the scaled state at the step's end, and its duration.
    """
    cell, mode, kind, row = where
    duration, longest = span
    n = plan.scales.size
    matrix, point = steps.matrices[row], steps.points[row]
    found = Tangent(np.empty((n, n)), steps.inputs[row], np.empty(n), steps.held[row], np.empty(n))
    result, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    end, means = np.empty(n + 1), np.empty(n + 1)
    if not tangent_at(point, plan.areas[cell], mode, plan.run.machine, plan.distance, found):
        return False, means, end, duration
    if mode == STUCK:
        come_to_rest(duration, found.sweeps, _is_pressed(start, point, plan), found.A)
    augmented(found.A, point, found.rate, plan.scales, matrix)
    if plan.fitted:
        fit_visited(visited, point, plan.run.machine, mode, plan.scales, matrix)
    exponential(matrix, duration, result, mean)
    apply(result, start, end)
    if kind >= 0:
        end, duration = _on_event(matrix, end, (duration, longest), kind, mode, plan)
        exponential(matrix, duration, result, mean)
    apply(mean, start, means)
    if mode == STUCK:
        # To the last bit: it does not move.
        means[0], means[1], end[0] = start[0], 0.0, start[0]
    return True, means, end, duration


@compiled
def _set_point(means: FloatArray, scales: FloatArray, point: FloatArray) -> None:
    for i in range(scales.size):
        point[i] = means[i] * scales[i]
    for k in range(2, scales.size):
        # A guess on the way is kept where the equations hold; where the search ends, it is the mean itself.
        point[k] = max(point[k], 1e-3 * scales[k])


@compiled
def _defect(found: bool, means: FloatArray, guess: FloatArray) -> float:
    """Largest difference between a step's means and its operating point; infinite where the equations do not hold."""
    worst = 0.0
    for i in range(guess.size):
        worst = max(worst, abs(means[i] - guess[i]))
    return worst if found and math.isfinite(worst) else math.inf


@compiled
def _linear_step(
    start: FloatArray, where: tuple[int, int, int, int], span: tuple[float, float], visited: Visited,
    plan: Plan, steps: Steps,
) -> Ended:  # fmt: skip
    """Find one step's linear model, whose operating point is the mean of the step itself, and follow it.

    By taking the means for the next operating point while that closes in by half or better each time; else by damped
    Newton steps with a matrix of difference quotients.
    """
    n = plan.scales.size
    point, guess = steps.points[where[3]], np.empty(n)
    copy(mean_visited(visited), point)
    for i in range(n):
        guess[i] = point[i] / plan.scales[i]
    found, means, end, duration = _follow(start, where, span, visited, plan, steps)
    if plan.fitted:
        for i in range(n):
            point[i] = means[i] * plan.scales[i]
        return Ended(end, duration, 0.0 if found else math.inf, 1)
    defect, iterations, newton = _defect(found, means, guess), 1, False
    while defect > plan.tolerance and iterations < plan.max_iterations and math.isfinite(defect):
        step = means[:n] - guess
        if newton and not _newton_step(start, where, span, visited, plan, steps, guess, means, step):
            break
        share, following, moved, others = 1.0, math.inf, guess, means
        while share > 1e-4:
            moved = guess + share * step
            _set_point(moved, plan.scales, point)
            found, others, end, duration = _follow(start, where, span, visited, plan, steps)
            iterations += 1
            following = _defect(found, others, moved)
            if not newton or following <= (1.0 - 0.5 * share) * defect or following <= plan.tolerance:
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
    start: FloatArray, where: tuple[int, int, int, int], span: tuple[float, float], visited: Visited,
    plan: Plan, steps: Steps, guess: FloatArray, means: FloatArray, step: FloatArray,
) -> bool:  # fmt: skip
    """Turn `step`, means less guess, into Newton's, with difference quotients over the operating point."""
    n = guess.size
    matrix, point = np.empty((n, n)), steps.points[where[3]]
    for j in range(n):
        moved = guess.copy()
        small = 1e-6 * max(1.0, abs(guess[j]))
        moved[j] += small
        _set_point(moved, plan.scales, point)
        _, others, _, _ = _follow(start, where, span, visited, plan, steps)
        for i in range(n):
            matrix[i, j] = (1.0 if i == j else 0.0) - (others[i] - means[i]) / small
    return solve(matrix, step)


@compiled
def _visit(
    begin: tuple[float, int], end: float, mode: int, plan: Plan, space: Workspace, log: Log
) -> tuple[int, float, int, int, Log]:
    """Integrate from a time in a piece to a later time, or to an event; log what is visited.

    Returns the status, the time, the event and the piece reached.
    """
    time, piece = begin
    log = Log(log.rows, log.coefficients, 0)
    while True:
        until = min(end, plan.run.schedule.times[piece + 1])
        progress, log = advance((time, piece, 0), until, mode, plan.run, space, log)
        time = progress.time
        if progress.status != OK or progress.kind >= 0 or until >= end:
            return progress.status, time, progress.kind, piece, log
        piece += 1


@compiled
def _is_inside(state: FloatArray, plan: Plan) -> bool:
    """Whether the equations hold at a scaled state, with room to spare."""
    for i in range(plan.scales.size):
        if not abs(state[i]) < 1e6:
            return False
    machine = plan.run.machine
    for k in range(machine.chambers.shape[0]):
        volume = chamber_volume(k, state[0] * plan.scales[0], machine)
        # A liquid may well fall to a small share of its supply pressure; where it cavitates it ends.
        least = LEAST_SHARE
        if machine.medium.kind == LIQUID:
            least = vapor_pressure(machine.medium.table) / plan.scales[2 + k]
        if volume < LEAST_SHARE * machine.chambers[k, 0] or state[2 + k] < least:
            return False
        place = temperature_place(k, machine)
        if place >= 0 and state[place] < LEAST_SHARE:
            return False
    return True


class _Place(NamedTuple):
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
def _take_step(place: _Place, end: float, plan: Plan, steps: Steps, space: Workspace, log: Log) -> _Taken:
    """Take one step from a place to the end of its cell, or to an event, or less far.

    Where no operating point is found, or the step leaves the equations' domain, half of it is tried, and so on.
    """
    longest, n = end - place.time, plan.scales.size
    taken = _Taken(NOT_CONVERGED, place.time, -1, place.state, place.piece, math.inf, True)
    for _ in range(MAX_HALVINGS):
        _physical(place.state, plan.scales, space.state)
        until = place.time + longest if longest < end - place.time else end
        status, stop, kind, piece, log = _visit((place.time, place.piece), until, place.mode, plan, space, log)
        if status != OK:
            reached = place.state.copy()
            for i in range(n):
                reached[i] = space.state[i] / plan.scales[i]
            return _Taken(status, stop, -1, reached, piece, math.inf, True)
        if log.n_logged == 0 or stop <= place.time:
            return _Taken(OK, place.time, kind, place.state, piece, 0.0, False)
        duration = stop - place.time
        visited = Visited(log.rows[: log.n_logged, 1], log.coefficients[: log.n_logged])
        where, span = (place.cell, place.mode, kind, place.row), (duration, end - place.time)
        one = _linear_step(place.state, where, span, visited, plan, steps)
        taken = _Taken(
            NOT_CONVERGED, place.time + one.duration if kind >= 0 else stop, kind, one.state, piece, one.defect, True
        )
        if one.defect <= plan.tolerance and _is_inside(one.state, plan):
            error = abs(one.duration - duration) / plan.run.schedule.times[-1]
            for i in range(n):
                error = max(error, abs(one.state[i] - space.state[i] / plan.scales[i]))
            copy(place.state, steps.starts[place.row])
            table = steps.table[place.row]
            table[0], table[1], table[2], table[3], table[4] = (
                place.cell,
                place.mode,
                one.duration,
                error,
                one.iterations,
            )
            return _Taken(OK, taken.time, kind, one.state, piece, one.defect, True)
        longest = 0.5 * duration
    return taken


@compiled
def march_period(start: FloatArray, plan: Plan, steps: Steps) -> Marched:
    """March through one valve period from a scaled augmented state, shape (n + 1,); fill in `steps`."""
    machine, scales, times = plan.run.machine, plan.scales, plan.run.schedule.times
    n = scales.size
    z, state = np.empty(n), start
    _physical(state, scales, z)
    space = new_workspace(z, machine.paths.shape[0])
    log = Log(np.empty((64, 4)), np.empty((64, 5, n)), 0)
    row, worst, mode = 0, 0.0, mode_of(z, machine)
    for cell in range(plan.areas.shape[0]):
        piece: int = plan.first_pieces[cell]
        time = float(times[piece])
        end = float(times[plan.first_pieces[cell + 1]])
        if mode != STUCK and state[1] != 0.0:
            mode = 1 if state[1] > 0.0 else -1
        events = 0
        while time < end:
            if row >= steps.table.shape[0] or events > MAX_EVENTS:
                return Marched(TOO_MANY_EVENTS, row, time, state, worst)
            taken = _take_step(_Place(time, piece, state, mode, row, cell), end, plan, steps, space, log)
            worst = max(worst, taken.defect)
            if taken.status != OK:
                return Marched(taken.status, row, taken.time, taken.state, worst)
            if taken.is_recorded:
                row += 1
            time, piece, state = taken.time, taken.piece, taken.state.copy()
            while piece < times.size - 2 and time >= times[piece + 1]:
                piece += 1
            while time < times[piece]:
                piece -= 1
            if taken.kind < 0 or time >= end:
                continue
            events += 1
            mode = after_event(taken.kind, state, scales, machine)
    return Marched(OK, row, times[-1], state, worst)
