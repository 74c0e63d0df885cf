"""Patterns of slots on the nonlinear machine: whether it keeps the goals, and better patterns next to one.

The linear model's operating points are two, one on and one off, so its best pattern may break a goal on the machine, or
be far from the best there.
"""

from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import BoolArray
from ltvpneu.design.air_use import air_use
from ltvpneu.design.pattern.pattern_problem import Asked, Goal, turned_first
from ltvpneu.design.pattern.slots import count_pulses, with_pattern
from ltvpneu.design.progress import Progress
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.periodic.orbits.orbit import Orbit

MOST_MOVES = 100
"""Changes of a pattern of more slots, one after the other."""
MOST_PERIODS = 1000
"""Valve periods after which a pattern counts as one without a cycle: chaos."""
KEPT_WITHIN = 1e-6
"""By how much a goal may be missed and still counts as kept, of the state's size [-]."""


class Tried(NamedTuple):
    """A pattern on the nonlinear machine."""

    pattern: BoolArray
    orbit: Orbit | str
    """Its cycle, or why it has none."""
    value: float
    """Of the objective; infinite where there is no cycle, or it is not decided by the switching."""
    figures: dict[str, float]
    """Of each goal; nan likewise."""
    missed: dict[str, float]
    """By how much each goal is, in its own unit: 0 where it is kept, infinite where there is no cycle."""
    distance: float
    """The sum of these, each over its state's size."""

    @property
    def kept(self) -> bool:
        """Whether all goals are."""
        return self.distance == 0

    @property
    def rank(self) -> tuple[float, float]:
        """What is less is better: goals first, then the objective."""
        return self.distance, self.value


@final
class PatternsOnMachine:
    """Patterns of slots tried on the nonlinear machine, each once."""

    def __init__(self, machine: Machine, frequency: float, ask: Asked) -> None:
        self.machine, self.frequency, self.ask = machine, frequency, ask
        self._known: dict[bytes, Tried] = {}

    @property
    def n_tried(self) -> int:
        """How many patterns were."""
        return len(self._known)

    def tried(self, pattern: BoolArray) -> Tried:
        """Return what a pattern is on the machine."""
        turned = turned_first(pattern)
        key = turned.tobytes()
        if key not in self._known:
            self._known[key] = self._try(turned)
        return self._known[key]

    def best_of_all(self, patterns: BoolArray, progress: Progress | None) -> Tried | None:
        """Return the best of patterns, each tried; None of none."""
        found: list[Tried] = []
        for number, pattern in enumerate(patterns):
            if progress is not None:
                progress("trying patterns on the machine", number / len(patterns))
            found.append(self.tried(pattern))
        return min(found, default=None, key=_rank)

    def best_from(self, pattern: BoolArray) -> Tried:
        """Return the pattern to which small changes lead, each the best of all that are next to it."""
        best = self.tried(pattern)
        for _ in range(MOST_MOVES):
            beside = [self.tried(one) for one in _beside(best.pattern) if allowed(one, self.ask)]
            better = min(beside, default=best, key=_rank)
            if not better.rank < best.rank:
                break
            best = better
        return best

    def _try(self, pattern: BoolArray) -> Tried:
        machine, goals = with_pattern(self.machine, pattern), self.ask.goals
        try:
            orbit = nonlinear_orbit(machine, self.frequency, max_periods=MOST_PERIODS)
        except LtvpneuError as error:
            return self._without_cycle(pattern, str(error))
        if not orbit.is_isolated:
            # Where stiction holds it, its place is no figure of the pattern.
            return self._without_cycle(pattern, orbit)
        figures = {goal.name: getattr(orbit, goal.kind)(goal.state) for goal in goals}
        missed = {goal.name: self._missed_by(goal, figures[goal.name]) for goal in goals}
        distance = sum(missed[goal.name] / self.ask.scales[goal.state] for goal in goals)
        return Tried(pattern, orbit, self._value(pattern, machine, orbit), figures, missed, distance)

    def _missed_by(self, goal: Goal, figure: float) -> float:
        by = goal.missed_by(figure)
        return by if by > KEPT_WITHIN * self.ask.scales[goal.state] else 0.0

    def _without_cycle(self, pattern: BoolArray, orbit: Orbit | str) -> Tried:
        names = [goal.name for goal in self.ask.goals]
        return Tried(pattern, orbit, np.inf, dict.fromkeys(names, np.nan), dict.fromkeys(names, np.inf), np.inf)

    def _value(self, pattern: BoolArray, machine: Machine, orbit: Orbit) -> float:
        if self.ask.minimize == "amplitude":
            return orbit.amplitude("position")
        if self.ask.minimize == "air_use":
            return air_use(machine, orbit)
        if self.ask.minimize == "mean_error":
            return sum(
                goal.missed_by(orbit.mean(goal.state)) / self.ask.scales[goal.state] for goal in self.ask.wanted_means
            )
        return float(count_pulses(pattern))


def _rank(one: Tried) -> tuple[float, float]:
    return one.rank


def allowed(pattern: BoolArray, ask: Asked) -> bool:
    """Whether a pattern keeps the rules of its slots: pulses, and how long they and the pauses last."""
    if ask.n_pulses is not None and count_pulses(pattern) > ask.n_pulses:
        return False
    if pattern.all() or not pattern.any():
        return True
    shortest_off, shortest_on = ask.shortest
    first = int(np.flatnonzero(pattern & ~np.roll(pattern, 1))[0])
    runs = np.split(turned := np.roll(pattern, -first), np.flatnonzero(np.diff(turned)) + 1)
    return all(run.size >= (shortest_on if run[0] else shortest_off) for run in runs)


def _beside(pattern: BoolArray) -> list[BoolArray]:
    """Return the patterns with one slot changed, or two neighbours exchanged."""
    N, found = pattern.size, list[BoolArray]()
    for slot in range(N):
        flipped = pattern.copy()
        flipped[slot] = not flipped[slot]
        found.append(flipped)
        after = (slot + 1) % N
        if pattern[slot] != pattern[after]:
            moved = pattern.copy()
            moved[[slot, after]] = pattern[[after, slot]]
            found.append(moved)
    return found
