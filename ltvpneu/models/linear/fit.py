r"""The chambers of one step as a linear model, fitted over what the step visits. Compiled.

*Fit* (equivalent linearization): the pressure rate as a linear function of pressures, position and velocity, by least
squares over the trajectory visited. Residuals are weighted by the volume, as errors of mass flow, since what counts is
how much gas a chamber ends up with. Directions that a step hardly visits keep the tangent's slope (a ridge).
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import STUCK, chamber_volume
from ltvpneu.models.machine.records import MachineRecord, temperature_place
from ltvpneu.models.nonlinear.integrator import POLYNOMIAL, SPAN
from ltvpneu.periodic.algebra.small import solve

RIDGE = 1e-6
"""Mean square of a scaled state's excursions below which the fit keeps the tangent's slope over it [-]."""
LEAST_SLOPE = 0.4
"""Least slope of a fitted pressure rate over its own pressure, as a share of the tangent's [-]."""
LEAST_SHARE_RIDGE = 1e-3
_SHARES = np.array([0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class Visited(NamedTuple):
    """A trajectory as polynomials over intervals of time."""

    log: FloatArray
    """The integrator's, (capacity, columns)."""
    n_intervals: int


@compiled
def mean_visited(visited: Visited) -> FloatArray:
    """Return the time means over a trajectory, shape (n,)."""
    log, n = visited.log, (visited.log.shape[1] - POLYNOMIAL) // 5
    means, total = np.zeros(n), 0.0
    for interval in range(visited.n_intervals):
        span = log[interval, SPAN]
        total += span
        factor = span
        for power in range(5):
            for i in range(n):
                means[i] += log[interval, POLYNOMIAL + power * n + i] * factor / (power + 1)
            factor *= span
    for i in range(n):
        means[i] /= total
    return means


@compiled
def volume_of_row(row: int, machine: MachineRecord) -> int:
    """Return the volume whose pressure or temperature a row of the state holds."""
    n_volumes = machine.n_volumes
    if row < 2 + n_volumes:
        return row - 2
    for k in range(n_volumes):
        if temperature_place(k, machine) == row:
            return k
    return 0


@compiled
def fit_visited(
    visited: Visited, mean: FloatArray, machine: MachineRecord, mode: int, scales: FloatArray, matrix: FloatArray
) -> None:
    """Replace the rows of pressures and temperatures of a tangent at the trajectory's mean by the fit over it.

    Parameters
    ----------
    visited : Visited
        Physical units.
    mean : ndarray, shape (n,)
    machine : MachineRecord
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
    log = visited.log
    for interval in range(visited.n_intervals):
        span = log[interval, SPAN]
        for node in range(3):
            t = _SHARES[node] * span
            for i in range(n):
                z[i], slope[i] = 0.0, 0.0
                for power in range(4, -1, -1):
                    slope[i] = slope[i] * t + z[i]
                    z[i] = z[i] * t + log[interval, POLYNOMIAL + power * n + i]
            c[0] = 1.0
            for q in range(1, features):
                i = first + q - 1
                c[q] = (z[i] - mean[i]) / scales[i]
            for k in range(2, n):
                of = volumes[k - 2]
                volume = chamber_volume(of, z[0], machine) / machine.volumes[of].size
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
        is_pressure = k < 2 + machine.n_volumes
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
