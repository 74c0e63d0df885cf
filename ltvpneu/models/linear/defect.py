r"""Error of a linear model's cycle from its defect in the nonlinear equations.

Where the cycle z(t) of a linear model does not satisfy z' = F(z), the nearest cycle that does differs from it, to first
order, by the periodic solution e of e' = J(t) e + F(z(t)) - z'(t): one Newton step in the space of periodic functions.
The sum z + e solves z' = F(z(t)) + J(t) (z - z(t)), a fine model of linear steps about the cycle given, and that is
what is marched here. The mechanics need no linearizing: dry friction, stiction and end stops act on the sum as they
are, so phases of rest that the model leaves out are found too. The nonlinear equations are evaluated along the model's
cycle alone and never integrated.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.chord import DECAY_AT_REST, Tangent, augmented, tangent_at
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.piston import after_event, is_possible, margin_at, mode_of
from ltvpneu.models.machine.records import N_INPUTS, MachineRecord
from ltvpneu.periodic.small import apply, exponential

PARTS_PER_SWING, MOST_PARTS = 2.0, 256
"""Parts of a step per radian of the piston's own oscillation that are searched for events, and how many at most."""


class Given(NamedTuple):
    """A fine staircase with an operating point for each cell, over one or more valve periods."""

    times: FloatArray
    """[s], (n_cells + 1,)"""
    points: FloatArray
    """(n_cells, n)"""
    areas: FloatArray
    """(n_cells, 2, n_paths)"""
    scales: FloatArray
    distance: float


class Swept(NamedTuple):
    """One pass over the staircase."""

    state: FloatArray
    """Scaled augmented state at the end."""
    lows: FloatArray
    """Least scaled values, (n,)."""
    highs: FloatArray
    sums: FloatArray
    """Integrals of the scaled states over time, (n,)."""
    means: FloatArray
    """Means over the cells, (n_cells, n)."""
    is_finite: bool


@compiled
def _first_event(  # noqa: PLR0913 - compiled, and called from one place
    matrix: FloatArray,
    start: FloatArray,
    end: FloatArray,
    duration: float,
    mode: int,
    machine: MachineRecord,
    scales: FloatArray,
) -> tuple[float, int]:
    """Return when within a linear step the first event happens, and its kind; -1 for none."""
    n = scales.size
    z, middle = np.empty(n), np.empty(n + 1)
    map_, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    # Fine enough that the piston cannot turn and turn back unseen.
    swing = math.sqrt(abs(matrix[0, 1] * matrix[1, 0])) * duration
    parts = 1 if mode == STUCK else 1 + min(int(PARTS_PER_SWING * swing), MOST_PARTS)
    share = np.empty((n + 1, n + 1))
    if parts > 1:
        exponential(matrix, duration / parts, share, mean)
    first, found = duration, -1
    for kind in range(4):
        if not is_possible(kind, mode, machine):
            continue
        low, state, crossed = 0.0, start.copy(), False
        for part in range(parts):
            if part < parts - 1:
                apply(share, state, middle)
            else:
                middle[:] = end
            for i in range(n):
                z[i] = middle[i] * scales[i]
            if margin_at(z, kind, mode, machine) < 0.0:
                crossed = True
                break
            state[:] = middle
            low += duration / parts
        if not crossed:
            continue
        # Halved by exponentials, not by series: near a source's pressure a cell may be long for its fastest rate.
        half = 0.5 * duration / parts
        for _ in range(40):
            exponential(matrix, half, map_, mean)
            apply(map_, state, middle)
            for i in range(n):
                z[i] = middle[i] * scales[i]
            if margin_at(z, kind, mode, machine) >= 0.0:
                low += half
                state[:] = middle
            half *= 0.5
        high = low + 2.0 * half
        if high < first or found < 0:
            first, found = high, kind
    return first, found


@compiled
def _note(state: FloatArray, lows: FloatArray, highs: FloatArray) -> None:
    for i in range(lows.size):
        lows[i] = min(lows[i], state[i])
        highs[i] = max(highs[i], state[i])


@compiled
def sweep(start: FloatArray, given: Given, machine: MachineRecord) -> Swept:
    """Follow the linear steps once over the staircase from a scaled augmented state, shape (n + 1,)."""
    scales = given.scales
    n = scales.size
    found = Tangent(np.empty((n, n)), np.empty((n, N_INPUTS)), np.empty(n), np.zeros(n), np.empty(n))
    matrix, result, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    state, end, means, z = start.copy(), np.empty(n + 1), np.empty(n + 1), np.empty(n)
    lows, highs, sums = np.full(n, math.inf), np.full(n, -math.inf), np.zeros(n)
    visited = np.zeros((given.points.shape[0], n))
    for i in range(n):
        z[i] = state[i] * scales[i]
    mode = mode_of(z, machine)
    for cell in range(given.points.shape[0]):
        left = width = given.times[cell + 1] - given.times[cell]
        if mode != STUCK and state[1] != 0.0:
            mode = 1 if state[1] > 0.0 else -1
        for _ in range(20):
            if not tangent_at(given.points[cell], given.areas[cell], mode, machine, given.distance, found):
                return Swept(state, lows, highs, sums, visited, False)
            if mode == STUCK:
                found.A[1, 1] = -DECAY_AT_REST / left
                # The rate is that at rest, whatever velocity the operating point has.
                found.rate[1] = -DECAY_AT_REST / left * given.points[cell, 1]
            augmented(found.A, given.points[cell], found.rate, scales, matrix)
            exponential(matrix, left, result, mean)
            apply(result, state, end)
            duration, kind = _first_event(matrix, state, end, left, mode, machine, scales)
            if kind >= 0:
                exponential(matrix, duration, result, mean)
                apply(result, state, end)
            apply(mean, state, means)
            _note(state, lows, highs)
            for i in range(n):
                sums[i] += means[i] * duration
                visited[cell, i] += means[i] * scales[i] * duration / width
                if not abs(end[i]) < 1e3:
                    return Swept(state, lows, highs, sums, visited, False)
            for i in range(n + 1):
                state[i] = end[i]
            left -= duration
            if kind >= 0:
                mode = after_event(kind, state, scales, machine)
            if kind < 0 or left <= 0.0:
                break
    _note(state, lows, highs)
    return Swept(state, lows, highs, sums, visited, True)


def corrected(
    start: FloatArray, given: Given, machine: MachineRecord, tolerance: float, max_sweeps: int
) -> tuple[Swept, float]:
    """Sweep until the state repeats; return the last sweep and the change that is left."""
    begin, change = start.copy(), math.inf
    while True:
        swept = sweep(begin, given, machine)
        last, change = change, float(np.max(np.abs(swept.state - begin)))
        max_sweeps -= 1
        # What is left to go is the change over one minus the contraction.
        if not swept.is_finite or max_sweeps <= 0 or change <= tolerance * max(1.0 - change / last, 1e-3):
            return swept, change
        begin = swept.state.copy()
