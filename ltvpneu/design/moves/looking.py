"""Where to start: all orders of the valves' positions, on a coarse grid of switching times.

The last part is followed to its end, and the move ends where it is nearest to what is wanted; so a grid over k
switching times costs as many integrations as it has points, whatever the time of the whole move.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.design.moves.ends import End, push_slopes
from ltvpneu.design.progress import Progress
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.passage import Position, passage

MOST_LOOKED_AT = 2400
"""Integrations of a grid."""
ROUGH = 1e-6
"""Their tolerance [-]."""
INSTANTS = 240
"""At which the last part is looked at."""
WEIGHT = 20.0
"""Of the scaled distance from the end that is wanted, beside the share of the longest time that a move takes [-]."""
MOST_OF_ONE_ORDER = 3
"""Starts with the same order of positions."""


class Candidate(NamedTuple):
    """A move that was looked at."""

    rank: float
    """The less, the better."""
    order: tuple[Position, ...]
    durations: FloatArray
    """[s], (n_parts,)"""


@dataclass(kw_only=True)
class Look:
    """A look at moves on a grid of switching times."""

    positions: Mapping[Position, Machine]
    start: FloatArray
    end: End
    bounds: tuple[FloatArray, FloatArray]
    """The least and the greatest values of the states on the way, (n_states,), infinite where there is no bound."""
    max_time: float
    shortest: float
    """[s]"""
    n_simulations: int = 0
    found: list[Candidate] = field(default_factory=list[Candidate])

    def __post_init__(self) -> None:
        self.machine = next(iter(self.positions.values()))
        self._slopes = push_slopes(self.machine)
        self._force = external_force(self.start, self.machine.record) - float(self._slopes @ self.start)
        self._scales = self.machine.state_scales

    def at_moves(self, n_switches: int, n_starts: int, progress: Progress | None) -> list[Candidate]:
        """Return the best of moves of so many switches, not too many of one order of positions."""
        self.found = []
        modes = len(self.positions)
        orders = modes * max(modes - 1, 1) ** n_switches
        points = int((MOST_LOOKED_AT / orders) ** (1 / max(n_switches, 1)))
        self._follow((), np.zeros(0), (self.start, 0.0), (n_switches, min(max(points, 3), 80)), progress)
        best: list[Candidate] = []
        for one in sorted(self.found, key=lambda one: one.rank):
            if sum(one.order == other.order for other in best) < MOST_OF_ONE_ORDER:
                best.append(one)
            if len(best) == n_starts:
                break
        return best

    def _follow(
        self,
        order: tuple[Position, ...],
        durations: FloatArray,
        begin: tuple[FloatArray, float],
        left: tuple[int, int],
        progress: Progress | None,
    ) -> None:
        """Follow a move on from a state that broke the bounds on the way there by some sum."""
        (state, broken), (n_left, points) = begin, left
        longest = self.max_time - float(durations.sum())
        for number, (position, held) in enumerate(self.positions.items()):
            if (order and order[-1] == position) or longest <= 2 * self.shortest:
                continue
            if progress is not None and len(order) < 2:
                progress("looking at moves", number / len(self.positions))
            self.n_simulations += 1
            try:
                way = passage([held], np.array([longest]), state, ROUGH)
            except LtvpneuError:
                continue
            if n_left == 0:
                times = np.linspace(self.shortest, longest, INSTANTS)
                states = way.at(times)
                missed = self.missed(states) + np.maximum(self._broken(states), broken)
                rank = WEIGHT * missed + (durations.sum() + times) / self.max_time
                for best in _least(rank):
                    last = np.append(durations, times[best])
                    self.found.append(Candidate(float(rank[best]), (*order, position), last))
                continue
            # Closer together at first: parts of a quick move are short.
            shares = ((np.arange(points) + 0.5) / points) ** 1.5
            times = self.shortest + shares * (longest - 2 * self.shortest)
            states = way.at(times)
            there = zip(times.tolist(), states.T, np.maximum(self._broken(states), broken).tolist(), strict=True)
            for time, after, by in there:
                self._follow((*order, position), np.append(durations, time), (after, by), (n_left - 1, points), None)

    def _broken(self, states: FloatArray) -> FloatArray:
        """Return by how much bounds are broken until each of the states, over their sizes, summed, (n,)."""
        low, high = (bound[:, None] for bound in self.bounds)
        over = np.maximum(np.maximum(low - states, states - high), 0.0) / self._scales[:, None]
        return np.maximum.accumulate(over, axis=1).sum(axis=0)

    def missed(self, states: FloatArray) -> FloatArray:
        """Return by how much states, (n_states, n), miss what is wanted, each over its size, summed, (n,)."""
        total = np.zeros(states.shape[1])
        for name, (low, high) in self.end.bounds.items():
            row = self.machine.states.index(name)
            if low is not None:
                total += np.maximum(low - states[row], 0.0) / self._scales[row]
            if high is not None:
                total += np.maximum(states[row] - high, 0.0) / self._scales[row]
        if self.end.force is not None:
            force = self._force + self._slopes @ states
            over = np.maximum(np.maximum(self.end.force[0] - force, force - self.end.force[1]), 0.0)
            total += over / float(np.max(np.abs(self._slopes * self._scales)))
        return total


def _least(rank: FloatArray) -> list[int]:
    """Return where ranks are least, and where the next to least of their minima is."""
    beside = np.concatenate([[np.inf], rank, [np.inf]])
    minima = np.flatnonzero((rank <= beside[:-2]) & (rank < beside[2:]))
    return minima[np.argsort(rank[minima])][:2].tolist()
