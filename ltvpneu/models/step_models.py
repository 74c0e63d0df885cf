r"""One linear model for one step of the machine's motion: a tangent, or a fit over what the step visits. Compiled.

In slip in one direction, and at rest, the mechanics are linear as they stand: dry friction is a constant force, its
operating point the sign of the velocity, and a resting piston has x' = 0. What is left to linearize are the chambers'
pressure rates p' = n (R T m - p A v) / V. All here is in scaled states y = z / scales, as augmented matrices
[[A, f], [0, 0]].

*Tangent*: every derivative at one state. Where a pressure nears that of a source the flow's slope grows without bound,
and a tangent there overshoots the source by as much as it was away; the slope goes over to the chord's, whose
equilibrium is the source. The rate at the state itself stays exact, so in a step about its own mean that costs no order
of accuracy.

*Fit* (equivalent linearization): the pressure rate as a linear function of pressures, position and velocity, by least
squares over the trajectory visited. Residuals are weighted by the volume, as errors of mass flow, since what counts is
how much gas a chamber ends up with. Directions that a step hardly visits keep the tangent's slope (a ridge).
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.dynamics import STUCK, chamber_volume, state_rate
from ltvpneu.models.machine_arrays import N_INPUTS, MachineArrays, temperature_place
from ltvpneu.models.quasi_static import nearest_source
from ltvpneu.models.tangent import state_tangent
from ltvpneu.periodic.small import solve
from ltvpneu.physics.properties import LIQUID

DECAY_AT_REST = 40.0
"""Exponent by which what does not last decays over a step of rest: the velocity of a resting piston, and the distance
from a stop of one that is pressed on it. What is left is below rounding."""
RIDGE = 1e-6
"""Mean square of a scaled state's excursions below which the fit keeps the tangent's slope over it [-]."""
LEAST_SLOPE = 0.4
"""Least slope of a fitted pressure rate over its own pressure, as a share of the tangent's [-]."""
LEAST_SHARE_RIDGE = 1e-3
_SHARES = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class Visited(NamedTuple):
    """A trajectory as polynomials over intervals of time."""

    spans: FloatArray
    """[s], (n_intervals,)"""
    coefficients: FloatArray
    """Ascending powers of the time since the start of each interval, (n_intervals, 5, n)."""


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
    state: FloatArray, areas: FloatArray, mode: int, machine: MachineArrays, distance: float, found: Tangent
) -> bool:
    """Write the rate at a state and its tangent in one mode of motion; False outside the equations' domain.

    Parameters
    ----------
    state : ndarray, shape (n,)
    areas : ndarray, shape (2, n_paths)
    mode : int
    machine : MachineArrays
    distance : float
        Relative distance from a source's pressure within which the slope goes over to that of the chord to it.
    found : Tangent
        Result.
    """
    n, A, held = state.size, found.A, found.held
    inside = state_rate(state, areas, mode, machine, found.rate)
    if inside:
        state_tangent(state, areas, machine, True, A, found.B)
        for k in range(2, n):
            held[k] = 0.0
        # A liquid's flow is laminar where pressures meet, and its slope finite.
        for k in range(2, 2 + (machine.chambers.shape[0] if machine.medium.kind != LIQUID else 0)):
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


@compiled
def _chord(
    state: FloatArray, near: tuple[int, float, float, int], areas: FloatArray, mode: int, machine: MachineArrays,
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


@compiled
def mean_visited(visited: Visited) -> FloatArray:
    """Return the time means over a trajectory, shape (n,)."""
    count, _, n = visited.coefficients.shape
    means, total = np.zeros(n), 0.0
    for interval in range(count):
        span = visited.spans[interval]
        total += span
        factor = span
        for power in range(5):
            for i in range(n):
                means[i] += visited.coefficients[interval, power, i] * factor / (power + 1)
            factor *= span
    for i in range(n):
        means[i] /= total
    return means


@compiled
def volume_of_row(row: int, machine: MachineArrays) -> int:
    """Return the volume whose pressure or temperature a row of the state holds."""
    n_volumes = machine.chambers.shape[0]
    if row < 2 + n_volumes:
        return row - 2
    for k in range(n_volumes):
        if temperature_place(k, machine) == row:
            return k
    return 0


@compiled
def fit_visited(
    visited: Visited, mean: FloatArray, machine: MachineArrays, mode: int, scales: FloatArray, matrix: FloatArray
) -> None:
    """Replace the rows of pressures and temperatures of a tangent at the trajectory's mean by the fit over it.

    Parameters
    ----------
    visited : Visited
        Physical units.
    mean : ndarray, shape (n,)
    machine : MachineArrays
    mode : int
    scales : ndarray, shape (n,)
    matrix : ndarray, shape (n + 1, n + 1)
        Scaled augmented tangent at the mean; its pressure rows are replaced.
    """
    n = mean.size
    features = 1 + (n - 2 if mode == STUCK else n)
    first = 2 if mode == STUCK else 0
    moments = np.empty((n - 2, features, features))
    sums = np.empty((n - 2, features))
    moments.fill(0.0)
    sums.fill(0.0)
    total = np.zeros(n - 2)
    volumes = np.empty(n - 2, dtype=np.int64)
    for k in range(2, n):
        volumes[k - 2] = volume_of_row(k, machine)
    z, slope, c = np.empty(n), np.empty(n), np.empty(features)
    for interval in range(visited.spans.size):
        span, p = visited.spans[interval], visited.coefficients[interval]
        for node in range(3):
            t = _SHARES[node] * span
            for i in range(n):
                z[i] = (((p[4, i] * t + p[3, i]) * t + p[2, i]) * t + p[1, i]) * t + p[0, i]
                slope[i] = ((4.0 * p[4, i] * t + 3.0 * p[3, i]) * t + 2.0 * p[2, i]) * t + p[1, i]
            c[0] = 1.0
            for q in range(1, features):
                i = first + q - 1
                c[q] = (z[i] - mean[i]) / scales[i]
            for k in range(2, n):
                of = volumes[k - 2]
                volume = chamber_volume(of, z[0], machine) / machine.chambers[of, 0]
                weight = _WEIGHTS[node] * span * volume * volume
                total[k - 2] += weight
                left = slope[k] / scales[k]
                for q in range(1, features):
                    left -= matrix[k, first + q - 1] * c[q]
                for a in range(features):
                    sums[k - 2, a] += weight * c[a] * left
                    for b in range(features):
                        moments[k - 2, a, b] += weight * c[a] * c[b]
    for k in range(2, n):
        own = matrix[k, k]
        found = _ridge_fit(moments[k - 2], sums[k - 2], total[k - 2], RIDGE, 0.0)
        share = LEAST_SHARE_RIDGE
        # A flow that does not fall with the chamber's own pressure is no flow: such a slope comes of a short path along
        # which pressure, position and velocity go hand in hand. Then more of the tangent is kept.
        is_pressure = k < 2 + machine.chambers.shape[0]
        while is_pressure and own < 0.0 and matrix[k, k] + found[k - first + 1] > LEAST_SLOPE * own and share < 1e6:
            found = _ridge_fit(moments[k - 2], sums[k - 2], total[k - 2], RIDGE, share)
            share *= 10.0
        constant = found[0]
        for q in range(1, features):
            matrix[k, first + q - 1] += found[q]
        for i in range(n):
            constant -= matrix[k, i] * mean[i] / scales[i]
        matrix[k, n] = constant


@compiled
def _ridge_fit(moments: FloatArray, sums: FloatArray, total: float, ridge: float, share: float) -> FloatArray:
    """Return the coefficients of a fit that a ridge, and a share of each feature's own moment, draw towards zero."""
    matrix, found = moments.copy(), sums.copy()
    for a in range(1, sums.size):
        matrix[a, a] += ridge * total + share * moments[a, a]
    if not solve(matrix, found):
        found.fill(0.0)
    return found
