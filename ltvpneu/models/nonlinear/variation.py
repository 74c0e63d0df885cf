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
from ltvpneu.periodic.small import exponential, multiply

NEAREST_SOURCE = 1e-5
"""Relative distance from a source's pressure within which the chord to it replaces an ever steeper slope [-]."""
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


class _Place(NamedTuple):
    """A place along a solution: state, areas, and the mode of motion there."""

    state: FloatArray
    areas: FloatArray
    mode: int


@compiled
def _state_at(log: FloatArray, interval: int, time: float, state: FloatArray) -> None:
    """Write the state at a time since the start of an interval."""
    n = state.size
    for i in range(n):
        value = log[interval, POLYNOMIAL + 4 * n + i]
        for power in range(3, -1, -1):
            value = value * time + log[interval, POLYNOMIAL + power * n + i]
        state[i] = value


@compiled
def _areas_at(log: FloatArray, interval: int, time: float, pieces: Pieces, areas: FloatArray) -> None:
    """Write the areas at a time since the start of an interval."""
    number = int(log[interval, PIECE_NUMBER])
    turn, piece = number // pieces.size, number % pieces.size
    write_areas(log[interval, START] + time - turn * pieces[pieces.size - 1].end, pieces[piece], areas)


@compiled
def _scaled_tangent(
    place: _Place, machine: MachineRecord, scales: FloatArray, found: Tangent, matrix: FloatArray
) -> None:
    """Write the full tangent at a place in scaled states, (n, n)."""
    tangent_at(place.state, place.areas, place.mode, machine, NEAREST_SOURCE, found)
    for i in range(scales.size):
        for j in range(scales.size):
            matrix[i, j] = found.A[i, j] * scales[j] / scales[i]


@compiled
def _back_on_stop(place: _Place, machine: MachineRecord, scales: FloatArray, found: Tangent, jump: FloatArray) -> None:
    """Write what becomes of a disturbance where the piston is pressed on a stop.

    Set beside it the piston goes back at once, and sweeps the chambers' volumes on the way.
    """
    tangent_at(place.state, place.areas, STUCK, machine, NEAREST_SOURCE, found)
    _write_identity(jump)
    jump[0, 0] = jump[1, 1] = 0.0
    for k in range(2, scales.size):
        jump[k, 0] = -found.sweeps[k] * scales[0] / scales[k]


@compiled
def _write_identity(matrix: FloatArray) -> None:
    matrix.fill(0.0)
    for i in range(matrix.shape[0]):
        matrix[i, i] = 1.0


@compiled
def _saltation(
    arriving: _Place, leaving: _Place, machine: MachineRecord, scales: FloatArray, jump: FloatArray
) -> bool:
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
    along = 0.0
    for i in range(n):
        rate_before[i] /= scales[i]
        rate_after[i] /= scales[i]
        along += gradient[i] * rate_before[i]
    if along == 0.0:
        return False
    _write_identity(jump)
    if met:
        jump[0, 0] = jump[1, 1] = 0.0
        rate_before[0] = rate_before[1] = 0.0
    for i in range(n):
        for j in range(n):
            jump[i, j] += (rate_after[i] - rate_before[i]) * gradient[j] / along
    return True


@compiled
def turn_maps(  # noqa: PLR0913 - compiled
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
        That each interval is taken in; zero for one of second order.
    closes : bool
        Whether the solution is a cycle, so that an event may lie between its end and its start.
    """
    n, count, each = scales.size, log.shape[0], max(parts, 1)
    factors = np.empty((count * (each + 2) + 1, n, n))
    durations, firsts = np.zeros(count * (each + 2) + 1), np.empty(count, dtype=np.int64)
    found = Tangent(np.empty((n, n)), np.empty((n, N_INPUTS)), np.empty(n), np.zeros(n), np.zeros(n))
    one, two, work, exponent = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    state, areas = np.empty(n), np.empty((2, machine.n_paths))
    last, before = np.empty(n), np.empty((2, machine.n_paths))
    made, pressed = 0, False
    for interval in range(count + 1 if closes else count):
        # The start, once more, for an event that lies between the end and the start of a cycle.
        here = interval % count
        mode = int(log[here, MODE])
        _state_at(log, here, 0.0, state)
        if interval < count:
            firsts[interval] = made
        if interval > 0:
            span = log[interval - 1, SPAN]
            _state_at(log, interval - 1, span, last)
            _areas_at(log, interval - 1, span, pieces, before)
            arriving = _Place(last, before, int(log[interval - 1, MODE]))
            if _saltation(arriving, _Place(state, before, mode), machine, scales, factors[made]):
                made += 1
        if interval == count:
            break
        _areas_at(log, interval, 0.0, pieces, areas)
        if interval == 0 and mode == STUCK:
            # A small velocity is braked at once, having moved the piston by its square only.
            _write_identity(factors[made])
            factors[made, 1, 1] = 0.0
            made += 1
        pressed = pressed and mode == STUCK
        if mode == STUCK and not pressed and is_pressed(state, machine):
            pressed = True
            _back_on_stop(_Place(state, areas, mode), machine, scales, found, factors[made])
            made += 1
        h = log[interval, SPAN] / each
        for part in range(each):
            for side in range(2 if parts > 0 else 1):
                share = 0.5 if parts == 0 else 0.5 + (2 * side - 1) * _GAUSS
                time = (part + share) * h
                _state_at(log, interval, time, state)
                _areas_at(log, interval, time, pieces, areas)
                _scaled_tangent(_Place(state, areas, mode), machine, scales, found, one if side == 0 else two)
            if parts == 0:
                for i in range(n):
                    for j in range(n):
                        exponent[i, j] = h * one[i, j]
            else:
                multiply(two, one, exponent)
                multiply(one, two, work)
                for i in range(n):
                    for j in range(n):
                        turning = 0.5 * _GAUSS * h * h * (exponent[i, j] - work[i, j])
                        exponent[i, j] = 0.5 * h * (one[i, j] + two[i, j]) + turning
            exponential(exponent, 1.0, factors[made], work)
            durations[made] = h
            made += 1
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
