"""All patterns of up to `MOST_LISTED` slots, and their cycles on the linear model, many at a time.

A pattern is written as a binary number, its first slot the highest digit. Turned round it is the same pattern, so of
all its turns the greatest number stands for it: 700,000 of 24 slots.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu.design.pattern.pattern_problem import Asked, Solved, relaxation
from ltvpneu.design.pattern.slots import Slots, count_pulses, pattern_states

MOST_LISTED = 24
"""Slots up to which all patterns are listed."""
NUMBERS_AT_ONCE = 1 << 20
CYCLES_AT_ONCE = 1 << 16
LEAST_GAP = 1e-9
"""By how much a goal may be missed on the linear model, of the state's size [-]; HiGHS allows 1e-6."""

Numbers = NDArray[np.uint32]


class LinearFigures(NamedTuple):
    """Figures of patterns' cycles on the linear model, SI units; nan where a pattern has no cycle."""

    means: FloatArray
    """(n_patterns, n_states)"""
    amplitudes: FloatArray
    """Half spans at the slots' starts, (n_patterns, n_states)."""
    flows: FloatArray
    """Mean flow from the supply [kg/s], (n_patterns,)."""


def all_patterns(ask: Asked) -> BoolArray:
    """Return every pattern that the rules of the slots allow, once, (n_patterns, n_slots)."""
    N = ask.n_slots
    found = [_kept_of(np.arange(first, min(first + NUMBERS_AT_ONCE, 1 << N), dtype=np.uint32), ask)
             for first in range(0, 1 << N, NUMBERS_AT_ONCE)]  # fmt: skip
    digits = np.arange(N - 1, -1, -1, dtype=np.uint32)
    return ((np.concatenate(found)[:, None] >> digits) & 1).astype(np.bool_)


def _kept_of(numbers: Numbers, ask: Asked) -> Numbers:
    """Return those of the numbers that are allowed, and the greatest of their turns."""
    N = ask.n_slots
    turned = numbers.copy()
    for _ in range(N - 1):
        turned = _turned(turned, 1, N)
        greatest = turned <= numbers
        numbers, turned = numbers[greatest], turned[greatest]
    everything = np.uint32((1 << N) - 1)
    goes_on = numbers & ~_turned(numbers, N - 1, N)
    goes_off = ~numbers & _turned(numbers, N - 1, N) & everything
    allowed = np.ones(numbers.size, dtype=np.bool_)
    if ask.n_pulses is not None:
        allowed &= np.bitwise_count(goes_on) <= ask.n_pulses
    shortest_off, shortest_on = ask.shortest
    for ahead in range(1, shortest_on):
        allowed &= (goes_on & ~_turned(numbers, ahead, N)) == 0
    for ahead in range(1, shortest_off):
        allowed &= (goes_off & _turned(numbers, ahead, N)) == 0
    return numbers[allowed]


def _turned(numbers: Numbers, by: int, n_slots: int) -> Numbers:
    """Return patterns turned so that the slot `by` later comes first."""
    everything = np.uint32((1 << n_slots) - 1)
    return ((numbers << np.uint32(by)) & everything) | (numbers >> np.uint32(n_slots - by))


def linear_figures(slots: Slots, patterns: BoolArray) -> LinearFigures:
    """Return the figures of patterns' cycles on the linear model."""
    parts = [
        _figures(slots, patterns[first : first + CYCLES_AT_ONCE]) for first in range(0, len(patterns), CYCLES_AT_ONCE)
    ]
    return LinearFigures(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _figures(slots: Slots, patterns: BoolArray) -> LinearFigures:
    n, N = slots.scales.size, patterns.shape[1]
    # From the state at a slot's start to that at its end, its mean and the mean flow, in one matrix, off and on.
    flow_rows = np.einsum("bi,bij->bj", slots.flow_rows, slots.mean_maps)
    flow_offsets = np.einsum("bi,bi->b", slots.flow_rows, slots.mean_moves) + slots.flow_offsets
    matrices = np.concatenate([slots.maps, slots.mean_maps, flow_rows[:, None]], axis=1).transpose(0, 2, 1)
    offsets = np.hstack([slots.moves, slots.mean_moves, flow_offsets[:, None]])
    state = _starts(slots, patterns)
    low, high, total = state.copy(), state.copy(), np.zeros((len(patterns), n + 1))
    for on in patterns.T[:, :, None]:
        following = np.where(on, state @ matrices[1] + offsets[1], state @ matrices[0] + offsets[0])
        state = following[:, :n]
        total += following[:, n:]
        low, high = np.minimum(low, state), np.maximum(high, state)
    return LinearFigures(total[:, :n] / N * slots.scales, (high - low) / 2 * slots.scales, total[:, n] / N)


def _starts(slots: Slots, patterns: BoolArray) -> FloatArray:
    """Return the scaled states at the cycles' starts, (n_patterns, n)."""
    n, N = slots.scales.size, patterns.shape[1]
    half = N // 2
    digits = 1 << np.arange(N)[::-1]
    first, second = (
        _products(slots, part.shape[1])[part @ digits[N - part.shape[1] :]]
        for part in (patterns[:, :half], patterns[:, half:])
    )
    whole_maps = second @ first
    always = patterns.all(axis=1) | ~patterns.any(axis=1)
    # Always on or always off, a volume may stay shut, and any pressure in it is a cycle.
    whole_maps[always, :n, :n] = 0.0
    found: FloatArray = np.linalg.solve(np.eye(n) - whole_maps[:, :n, :n], whole_maps[:, :n, n:])[..., 0].astype(
        np.float64
    )
    for i in np.flatnonzero(always):
        try:
            found[i] = pattern_states(slots, patterns[i].astype(int))[0]
        except np.linalg.LinAlgError:
            found[i] = np.nan
    return found


def _products(slots: Slots, n_slots: int) -> FloatArray:
    """Return the maps, with a last row and column for what is added, through every pattern of some slots, by number."""
    n = slots.scales.size
    one = np.zeros((2, n + 1, n + 1))
    one[:, :n, :n], one[:, :n, n], one[:, n, n] = slots.maps, slots.moves, 1.0
    found = np.eye(n + 1)[None]
    for _ in range(n_slots):
        found = (one[None] @ found[:, None]).reshape(-1, n + 1, n + 1)
    return found


def solved_by_listing(ask: Asked, slots: Slots, patterns: BoolArray) -> tuple[Solved, LinearFigures]:
    """Return the linear model's best of all patterns, and the figures of all."""
    figures = linear_figures(slots, patterns)
    missed, value = np.zeros(len(patterns)), np.zeros(len(patterns))
    for goal in ask.goals:
        i = ask.states.index(goal.state)
        of = figures.means if goal.kind == "mean" else figures.amplitudes
        missed = np.maximum(missed, goal.beyond(of[:, i]) / slots.scales[i])
    if ask.minimize == "amplitude":
        value = figures.amplitudes[:, 0]
    elif ask.minimize == "air_use":
        value = figures.flows
    elif ask.minimize == "mean_error":
        for goal in ask.wanted_means:
            i = ask.states.index(goal.state)
            value = value + goal.beyond(figures.means[:, i]) / slots.scales[i]
    else:
        value = count_pulses(patterns)
    kept = (missed <= LEAST_GAP) & np.isfinite(value)
    if not kept.any():
        return Solved("infeasible", np.zeros(0, dtype=np.bool_), np.nan, np.nan), figures
    best = int(np.argmin(np.where(kept, value, np.inf)))
    return Solved("optimal", patterns[best], float(value[best]), relaxation(ask, slots)), figures
