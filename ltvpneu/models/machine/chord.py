"""Tangent of the equations in one mode of the piston, and the chord near a source's pressure. Compiled.

In slip in one direction, and at rest, the mechanics are linear as they stand: dry friction is a constant force, its
operating point the sign of the velocity, and a resting piston has x' = 0. What is left to linearize are the chambers'
pressure rates p' = n (R T m - p A v) / V. The matrices are augmented, [[A, f], [0, 0]], in scaled states
y = z / scales.

Where a pressure nears that of a source the flow's slope grows without bound, and a tangent there overshoots the source
by as much as it was away. There the slope goes over to the chord's, whose equilibrium is the source. The rate at the
state itself stays exact, so in a step about its own mean that costs no order of accuracy.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import by_field, compiled
from ltvpneu.models.machine.dynamics import STUCK, state_rate
from ltvpneu.models.machine.quasi_static import nearest_source
from ltvpneu.models.machine.records import AMBIENT, N_INPUTS, GeneralRecord, MachineRecord, is_liquid
from ltvpneu.models.machine.tangent import state_tangent

DECAY_AT_REST = 40.0
"""Exponent by which what does not last decays over a step of rest: the velocity of a resting piston, and the distance
from a stop of one that is pressed on it. What is left is below rounding."""
LEAST_SEPARATION = 1e-5
"""Relative distance from a source's pressure within which the flow counts as a straight line through zero [-]."""


class Tangent(NamedTuple):
    """Where a tangent is written to, in physical units."""

    A: FloatArray
    """(n, n)"""
    B: FloatArray
    """Over the inputs, (n, 4)."""
    rate: FloatArray
    """(n,)"""
    held: FloatArray
    """Share of the chord in each pressure's slope, from 0 to 1, (n,)."""
    sweeps: FloatArray
    """At rest, how the rates of pressures and temperatures would follow a velocity, (n,)."""


@compiled
def tangent_at(
    state: FloatArray, areas: FloatArray, mode: int, machine: MachineRecord, distance: float, found: Tangent
) -> bool:
    """Write the rate at a state and its tangent in one mode of motion; False outside the equations' domain.

    Parameters
    ----------
    state : ndarray, shape (n,)
    areas : ndarray, shape (2, n_paths)
    mode : int
    machine : MachineRecord
    distance : float
        Relative distance from a source's pressure within which the slope goes over to that of the chord to it.
    found : Tangent
        Result.
    """
    n, A, held = state.size, found.A, found.held
    inside = state_rate(state, areas, mode, machine, found.rate)
    if inside:
        state_tangent(state, areas, machine, True, A, found.B)
        if mode != STUCK:
            _add_seals(mode, machine, found)
        for k in range(2, n):
            held[k] = 0.0
        # A liquid's flow is laminar where pressures meet, and its slope finite.
        for k in range(2, 2 + (machine.n_volumes if not is_liquid(machine) else 0)):
            source, column = nearest_source(k - 2, state, areas, machine)
            apart = state[k] - source
            if math.isfinite(source) and abs(apart) < distance * source:
                held[k] = 1.0 - abs(apart) / (distance * source)
                _chord(state, (k, source, held[k], column), areas, mode, machine, found)
        if mode == STUCK:
            for k in range(2, n):
                found.sweeps[k] = A[k, 1]
            A[0, 1] = 0.0
            for j in range(n):
                A[1, j] = 0.0
            for j in range(N_INPUTS):
                found.B[1, j] = 0.0
            for k in range(2, n):
                A[k, 1] = 0.0
    return inside


def _pressed_seals(mode: int, machine: GeneralRecord, found: Tangent) -> None:
    for k in range(machine.n_volumes):
        slope = mode * machine.volumes[k].friction_area / machine.load.mass
        found.A[1, 2 + k] -= slope
        found.B[1, AMBIENT] += slope


def _constant_seals(mode: int, machine: MachineRecord, found: Tangent) -> None:
    pass


_add_seals = by_field("medium", "machine", _pressed_seals, _constant_seals)
"""Add the slopes of the friction that grows with the pressures, in motion."""


@compiled
def _chord(
    state: FloatArray, near: tuple[int, float, float, int], areas: FloatArray, mode: int, machine: MachineRecord,
    found: Tangent,
) -> None:  # fmt: skip
    """Blend the chord from a pressure to a near source's into its slope, and the difference into the source's column.

    The flow depends on the difference of the two, nearly. Within `LEAST_SEPARATION` the rate is on the chord too.
    `near` holds the state's number, the source's pressure, the chord's share, and whose pressure the source's is: a
    column of the state, or -1 for the supply, -2 for the exhaust.
    """
    k, source, share, column = near
    n = state.size
    least = LEAST_SEPARATION * source
    apart = state[k] - source
    reached = apart if abs(apart) > least else math.copysign(least, apart)
    point, at_source, away = state.copy(), np.empty(n), np.empty(n)
    others, inputs = np.empty((n, n)), np.empty((n, N_INPUTS))
    point[k] = source
    state_rate(point, areas, mode, machine, at_source)
    point[k] = source + reached
    state_rate(point, areas, mode, machine, away)
    state_tangent(point, areas, machine, True, others, inputs)
    chord = (away[k] - at_source[k]) / reached
    if abs(apart) < least:
        found.rate[k] = at_source[k] + chord * apart
    found.A[k, k] = share * chord + (1.0 - share) * others[k, k]
    for j in range(N_INPUTS):
        found.B[k, j] = inputs[k, j]
    if column >= 0:
        found.A[k, column] = others[k, column] + others[k, k] - found.A[k, k]
    else:
        found.B[k, -1 - column] += others[k, k] - found.A[k, k]


@compiled
def come_to_rest(duration: float, sweeps: FloatArray, pressed: bool, A: FloatArray) -> None:
    """Let what does not last in a step of rest decay over it: x' = 0 is its motion, and not that of a disturbance.

    A velocity is braked at once. A piston pressed on a stop and set beside it goes back, and its pressures follow:
    `sweeps` is how their rates follow the velocity in motion, (n,).
    """
    A[1, 1] = -DECAY_AT_REST / duration
    if pressed:
        A[0, 0] = -DECAY_AT_REST / duration
        for k in range(2, A.shape[0]):
            A[k, 0] += sweeps[k] * A[0, 0]


@compiled
def augmented(A: FloatArray, state: FloatArray, rate: FloatArray, scales: FloatArray, matrix: FloatArray) -> None:
    """Write the scaled augmented matrix of z' = rate + A (z - state), shape (n + 1, n + 1)."""
    n = state.size
    for i in range(n):
        constant = rate[i]
        for j in range(n):
            constant -= A[i, j] * state[j]
            matrix[i, j] = A[i, j] * scales[j] / scales[i]
        matrix[i, n] = constant / scales[i]
    for j in range(n + 1):
        matrix[n, j] = 0.0
