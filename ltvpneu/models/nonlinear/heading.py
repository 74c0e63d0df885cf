r"""Where a state is heading, by the derivative of the map over a period. Compiled.

Over N more periods an affine map with derivative \Phi carries a state on by

.. math:: s_N = \sum_{i=1}^{N} \Phi^i r

with r its change over the last one. By doubling, :math:`s_{2N} = s_N + \Phi^N s_N`, that is cheap for any N. Where the
map contracts the sum ends at the fixed point, :math:`(I - \Phi)^{-1} \Phi r` (Newton's method); where it does not, it
leaves an unstable orbit as the machine does.
"""

import math
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.openings import Pieces
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.integrator import MODE, POLYNOMIAL
from ltvpneu.models.nonlinear.variation import product_of, turn_maps
from ltvpneu.periodic.algebra.small import apply, multiply

MOST_DOUBLINGS = 60
CONVERGED = 1e-13
"""Relative change of the sum by a doubling at which it has reached its end [-]."""
FURTHEST = 1e3
"""Scaled sum at which doubling ends [-]."""
LONGEST = 0.25
"""Length of a move, scaled, at most [-]."""
ONE_WAY = 0.5
"""Net move over the travel in a period from which on a piston creeps [-]."""
LEAST_SHARE, MOST_SHARE = 0.5, 2.0
"""Shares of a pressure or temperature that a move leaves at least, or leads to at most [-]."""


class Heading(NamedTuple):
    """The way ahead of a state, in scaled states."""

    powers: FloatArray
    """The derivative to the powers 1, 2, 4, ..., (n_moves, n, n)."""
    moves: FloatArray
    """Moves over 1, 2, 4, ... periods, (n_moves, n)."""
    ends: bool
    """Whether the last move ends at a fixed point."""
    radius: float
    """Spectral radius of the derivative."""
    left: float
    """Distance to the fixed point; infinite where the map leads to none."""


@compiled
def largest(values: FloatArray) -> float:
    """Return the largest size of some values; nan if one is."""
    worst = 0.0
    for value in values:
        if not abs(value) <= worst:
            worst = abs(value)
    return worst


@compiled
def heading_of(derivative: FloatArray, change: FloatArray) -> Heading:
    """Return the way ahead of a state that has changed by that much over the last period, both scaled."""
    n = change.size
    powers, moves = np.empty((MOST_DOUBLINGS, n, n)), np.empty((MOST_DOUBLINGS, n))
    power, square, move, added = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n)
    apply(derivative, change, move)
    count, ends, radius, periods, left = 0, False, math.inf, 1.0, math.inf
    # Entry by entry: numba takes seconds to compile what checks the shapes of slices.
    for i in range(n):
        for j in range(n):
            square[i, j] = derivative[i, j]
    while count < MOST_DOUBLINGS:
        norm, size, step = 0.0, 0.0, 0.0
        for i in range(n):
            if count > 0:
                move[i] += added[i]
            moves[count, i] = move[i]
            size, step = max(size, abs(move[i])), max(step, abs(added[i]))
            for j in range(n):
                power[i, j] = powers[count, i, j] = square[i, j]
                norm += abs(square[i, j])
        # By Gelfand's formula the norm of a high power tells the spectral radius.
        radius = norm ** (1.0 / periods)
        count += 1
        if count > 1 and norm < 1e-3 and step <= CONVERGED * size:
            ends, left = True, size
            break
        if not (size < FURTHEST and norm < 1e100):
            count = max(count - 1, 1)
            break
        apply(power, move, added)
        multiply(power, power, square)
        periods *= 2.0
    return Heading(powers[:count], moves[:count], ends, radius, left)


@compiled
def is_held(log: FloatArray) -> bool:
    """Whether the piston rests through a whole period."""
    resting = 0
    for row in range(log.shape[0]):
        resting += int(log[row, MODE]) == STUCK
    return resting == log.shape[0]


@compiled
def creeps(log: FloatArray, change: float) -> bool:
    """Whether the piston rests now and then in a period, and moves one way only, by `change` [m]."""
    rests, low, high = False, math.inf, -math.inf
    for row in range(log.shape[0]):
        rests = rests or int(log[row, MODE]) == STUCK
        low, high = min(low, log[row, POLYNOMIAL]), max(high, log[row, POLYNOMIAL])
    return rests and abs(change) > ONE_WAY * (high - low)


@compiled
def look_ahead(
    log: FloatArray, machine: MachineRecord, pieces: Pieces, scales: FloatArray, change: FloatArray, parts: int
) -> Heading:
    """Return the way ahead after a period; `log` and `parts` are as of `turn_maps`."""
    derivative = product_of(turn_maps(log, machine, pieces, scales, parts, False).factors)
    if is_held(log):
        # The piston stays where it is put, and that counts as no disturbance.
        for i in range(scales.size):
            for j in range(2):
                derivative[i, j] = derivative[j, i] = 0.0
    return heading_of(derivative, change)


@compiled
def furthest(ahead: Heading, state: FloatArray, scales: FloatArray, machine: MachineRecord) -> int:
    """Return the number of the longest move that stays where it can be trusted, below zero for none."""
    for number in range(ahead.moves.shape[0] - 1, -1, -1):
        move = ahead.moves[number]
        place = state[0] + move[0] * scales[0]
        trusted = move[0] == 0.0 or machine.load.lower_stop < place < machine.load.upper_stop
        trusted = trusted and largest(move) <= LONGEST
        for i in range(2, scales.size):
            share = 1.0 + move[i] * scales[i] / state[i]
            trusted = trusted and LEAST_SHARE <= share <= MOST_SHARE
        if trusted:
            return number
    return -1


@compiled
def surprise(ahead: Heading, number: int, change: FloatArray) -> float:
    """Return what a move errs by, from the change over the period after it, carried on as far."""
    n = change.size
    total, added = change.copy(), np.empty(n)
    if not (ahead.ends and number == ahead.moves.shape[0] - 1):
        # The first move is the change over the next period.
        apply(ahead.powers[number], ahead.moves[0], added)
        for i in range(n):
            total[i] -= added[i]
    for power in range(number):
        apply(ahead.powers[power], total, added)
        for i in range(n):
            total[i] += added[i]
    return largest(total)
