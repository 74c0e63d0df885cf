r"""How a small disturbance of the nonlinear equations fares along a solution. Compiled.

Between events a disturbance follows d' = J(t) d, J the full tangent in the mode of motion. Each interval of the
integrator is taken in parts by Magnus' method of fourth order,

.. math:: \Omega = \tfrac h2 (J_1 + J_2) + \tfrac{\sqrt3}{12} h^2 (J_2 J_1 - J_1 J_2), \qquad d \to e^\Omega d

with J at the two Gauss points, or of second order, with J at the middle. Where the piston stops, reverses, breaks away
or meets an end stop, a disturbance also shifts the instant, and jumps by the saltation matrix

.. math:: S = D R + \frac{(f^+ - D R f^-)\, \nabla h'}{\nabla h' f^-}

with the rates f before and after, the event function h and the reset R (at an end stop: v = 0) [Leine2004]_.

.. [Leine2004] R. I. Leine and H. Nijmeijer, "Dynamics and Bifurcations of Non-Smooth Mechanical Systems", Springer,
   2004.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.chord import Tangent, tangent_at
from ltvpneu.models.machine.dynamics import STUCK, state_rate
from ltvpneu.models.machine.openings import Pieces, write_areas
from ltvpneu.models.machine.piston import at_stop, is_pressed
from ltvpneu.models.machine.records import N_INPUTS, MachineRecord
from ltvpneu.models.nonlinear.integrator import MODE, PIECE_NUMBER, POLYNOMIAL, SPAN, START
from ltvpneu.periodic.algebra.small import exponential, multiply, rough_exponential

NEAREST_SOURCE = 1e-5
"""Relative distance from a source's pressure within which the chord to it replaces an ever steeper slope [-]."""
ROUGH_INTERVALS = 48
"""Intervals, or several at once, that a rough derivative is taken in, about [-]."""
JUMP = 1e-6
"""Scaled change of the velocity that is a jump [-]."""
_GAUSS = math.sqrt(3.0) / 6.0


class TurnMaps(NamedTuple):
    """Maps of a disturbance along a solution, in the order of time, in scaled states."""

    factors: FloatArray
    """(n_maps, n, n)"""
    durations: FloatArray
    """[s]; zero for what happens at once, as at a stop; (n_maps,)."""
    firsts: IntArray
    """Number of the map that each interval of the solution begins with, (n_intervals,)."""


class _Solution(NamedTuple):
    """What the maps are taken along."""

    log: FloatArray
    machine: MachineRecord
    pieces: Pieces
    scales: FloatArray


class _Place(NamedTuple):
    """A place along a solution: state, areas, and the mode of motion there."""

    state: FloatArray
    areas: FloatArray
    mode: int


@compiled
def _state_at(along: _Solution, interval: int, time: float, state: FloatArray) -> None:
    """Write the state at a time since the start of an interval."""
    log = along.log
    n = state.size
    for i in range(n):
        value = log[interval, POLYNOMIAL + 4 * n + i]
        for power in range(3, -1, -1):
            value = value * time + log[interval, POLYNOMIAL + power * n + i]
        state[i] = value


@compiled
def _areas_at(along: _Solution, interval: int, time: float, areas: FloatArray) -> None:
    """Write the areas at a time since the start of an interval."""
    log, pieces = along.log, along.pieces
    number = int(log[interval, PIECE_NUMBER])
    turn, piece = number // pieces.size, number % pieces.size
    write_areas(log[interval, START] + time - turn * pieces[pieces.size - 1].end, pieces[piece], areas)


@compiled
def _back_on_stop(state: FloatArray, areas: FloatArray, along: _Solution, found: Tangent, jump: FloatArray) -> None:
    """Write what becomes of a disturbance where the piston is pressed on a stop.

    Set beside it the piston goes back at once, and sweeps the chambers' volumes on the way.
    """
    tangent_at(state, areas, STUCK, along.machine, NEAREST_SOURCE, found)
    _write_identity(jump)
    jump[0, 0] = jump[1, 1] = 0.0
    for k in range(2, state.size):
        jump[k, 0] = -found.sweeps[k] * along.scales[0] / along.scales[k]


@compiled
def _write_identity(matrix: FloatArray) -> None:
    matrix.fill(0.0)
    for i in range(matrix.shape[0]):
        matrix[i, i] = 1.0


@compiled
def _saltation(arriving: _Place, leaving: _Place, machine: MachineRecord, scales: FloatArray, jump: FloatArray) -> bool:
    """Write the jump of a disturbance between two places at one instant; False where there is none."""
    n, before, after = scales.size, arriving.mode, leaving.mode
    if before == after and abs(arriving.state[1] - leaving.state[1]) <= JUMP * scales[1]:
        return False
    rate_before, rate_after, gradient = np.empty(n), np.empty(n), np.zeros(n)
    state_rate(arriving.state, arriving.areas, before, machine, rate_before)
    state_rate(leaving.state, arriving.areas, after, machine, rate_after)
    met = at_stop(leaving.state[0], machine) != 0 and abs(arriving.state[1]) > JUMP * scales[1]
    if before == STUCK:
        # Breaks away where the external force reaches what holds it.
        gradient[0] = -machine.load.spring_stiffness * scales[0]
        for k in range(machine.n_volumes):
            slope = machine.volumes[k].push_area - after * machine.volumes[k].friction_area
            gradient[2 + k] = slope * scales[2 + k]
    else:
        gradient[0 if met else 1] = 1.0
    speed = 0.0
    for i in range(n):
        rate_before[i] /= scales[i]
        rate_after[i] /= scales[i]
        speed += gradient[i] * rate_before[i]
    if speed == 0.0:
        return False
    _write_identity(jump)
    if met:
        jump[0, 0] = jump[1, 1] = 0.0
        rate_before[0] = rate_before[1] = 0.0
    for i in range(n):
        for j in range(n):
            jump[i, j] += (rate_after[i] - rate_before[i]) * gradient[j] / speed
    return True


class _Space(NamedTuple):
    """Arrays that the maps are worked out in."""

    state: FloatArray
    areas: FloatArray
    last: FloatArray
    before: FloatArray
    found: Tangent
    one: FloatArray
    two: FloatArray
    work: FloatArray
    exponent: FloatArray


@compiled
def _new_space(n: int, n_paths: int) -> _Space:
    found = Tangent(np.empty((n, n)), np.empty((n, N_INPUTS)), np.empty(n), np.zeros(n), np.zeros(n))
    one, two, work, exponent = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    areas, before = np.empty((2, n_paths)), np.empty((2, n_paths))
    return _Space(np.empty(n), areas, np.empty(n), before, found, one, two, work, exponent)


@compiled
def _write_tangent(along: _Solution, interval: int, time: float, space: _Space, matrix: FloatArray) -> None:
    """Write the full tangent at a time since the start of an interval in scaled states, (n, n)."""
    log = along.log
    state, areas, scales = space.state, space.areas, along.scales
    _state_at(along, interval, time, state)
    _areas_at(along, interval, time, areas)
    tangent_at(state, areas, int(log[interval, MODE]), along.machine, NEAREST_SOURCE, space.found)
    for i in range(scales.size):
        for j in range(scales.size):
            matrix[i, j] = space.found.A[i, j] * scales[j] / scales[i]


@compiled
def _rough_map(along: _Solution, first: int, last: int, space: _Space, factor: FloatArray) -> float:
    """Write the map over intervals without an event, of second order; return their length [s]."""
    log = along.log
    start = log[first, START]
    h = log[last, START] + log[last, SPAN] - start
    middle = first
    while middle < last and log[middle, START] + log[middle, SPAN] < start + 0.5 * h:
        middle += 1
    _write_tangent(along, middle, start + 0.5 * h - log[middle, START], space, space.one)
    for i in range(along.scales.size):
        for j in range(along.scales.size):
            space.exponent[i, j] = h * space.one[i, j]
    rough_exponential(space.exponent, factor)
    return h


@compiled
def _fine_map(along: _Solution, interval: int, part: int, h: float, space: _Space, factor: FloatArray) -> None:
    """Write the map over one part, of length h, of an interval, of fourth order."""
    one, two, exponent, work = space.one, space.two, space.exponent, space.work
    _write_tangent(along, interval, (part + 0.5 - _GAUSS) * h, space, one)
    _write_tangent(along, interval, (part + 0.5 + _GAUSS) * h, space, two)
    multiply(two, one, exponent)
    multiply(one, two, work)
    for i in range(along.scales.size):
        for j in range(along.scales.size):
            turning = 0.5 * _GAUSS * h * h * (exponent[i, j] - work[i, j])
            exponent[i, j] = 0.5 * h * (one[i, j] + two[i, j]) + turning
    exponential(exponent, 1.0, factor, work)


@compiled
def _last_joined(along: _Solution, first: int, most: int) -> int:
    """Return the last of up to that many intervals from the first on without an event between them."""
    log = along.log
    last = first
    while last + 1 < min(log.shape[0], first + most):
        after = last + 1
        if log[after, MODE] != log[first, MODE] or log[after, PIECE_NUMBER] != log[first, PIECE_NUMBER]:
            break
        last = after
    return last


@compiled
def _jump_before(along: _Solution, interval: int, space: _Space, jump: FloatArray) -> bool:
    """Write the jump of a disturbance between an interval and the one before; False where there is none."""
    log = along.log
    after, last = interval % log.shape[0], interval - 1
    _state_at(along, after, 0.0, space.state)
    _state_at(along, last, log[last, SPAN], space.last)
    _areas_at(along, last, log[last, SPAN], space.before)
    arriving = _Place(space.last, space.before, int(log[last, MODE]))
    leaving = _Place(space.state, space.before, int(log[after, MODE]))
    return _saltation(arriving, leaving, along.machine, along.scales, jump)


@compiled
def turn_maps(
    log: FloatArray, machine: MachineRecord, pieces: Pieces, scales: FloatArray, parts: int, closes: bool
) -> TurnMaps:
    """Return the maps of a disturbance along a solution.

    Parameters
    ----------
    log : ndarray, shape (n_intervals, columns)
        As `advance` writes it; over several periods, pieces and times are counted on.
    machine : MachineRecord
    pieces : Pieces
    scales : ndarray, shape (n,)
    parts : int
        That each interval is taken in; zero for second order, of several intervals at once where there are many.
    closes : bool
        Whether the solution is a cycle, so that an event may lie between its end and its start.
    """
    n, count, along = scales.size, log.shape[0], _Solution(log, machine, pieces, scales)
    most = count * (max(parts, 1) + 2) + 1
    factors, durations, firsts = np.empty((most, n, n)), np.zeros(most), np.empty(count, dtype=np.int64)
    space, stride = _new_space(n, machine.n_paths), 1 + count // ROUGH_INTERVALS
    made, interval, pressed = 0, 0, False
    while interval < count:
        mode = int(log[interval, MODE])
        firsts[interval] = made
        if interval > 0:
            made += int(_jump_before(along, interval, space, factors[made]))
        elif mode == STUCK:
            # A small velocity is braked at once, having moved the piston by its square only.
            _write_identity(factors[made])
            factors[made, 1, 1] = 0.0
            made += 1
        _state_at(along, interval, 0.0, space.state)
        pressed = pressed and mode == STUCK
        if mode == STUCK and not pressed and is_pressed(space.state, machine):
            pressed = True
            _areas_at(along, interval, 0.0, space.areas)
            _back_on_stop(space.state, space.areas, along, space.found, factors[made])
            made += 1
        if parts == 0:
            last = _last_joined(along, interval, stride)
            durations[made] = _rough_map(along, interval, last, space, factors[made])
            firsts[interval : last + 1] = firsts[interval]
            made, interval = made + 1, last
        for part in range(parts):
            durations[made] = log[interval, SPAN] / parts
            _fine_map(along, interval, part, durations[made], space, factors[made])
            made += 1
        interval += 1
    if closes:
        made += int(_jump_before(along, count, space, factors[made]))
    return TurnMaps(factors[:made], durations[:made], firsts)


@compiled
def product_of(factors: FloatArray) -> FloatArray:
    """Return the product of maps, the first one first, (n, n)."""
    n = factors.shape[1]
    whole, work = np.eye(n), np.empty((n, n))
    for number in range(factors.shape[0]):
        multiply(factors[number], whole, work)
        whole, work = work, whole
    return whole
