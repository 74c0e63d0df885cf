"""Which of N equal slots of the period the valve is on in.

The linear model's best is found among all patterns (`enumeration`), of very many slots by mixed-integer programming
(`pattern_problem`). Its operating points are refitted to that pattern's own cycle until the pattern stays. Whether the
goals are kept is what the nonlinear machine says (`pattern_machine`), and the best pattern is looked for there in the
end (`pattern_search`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, positive, whole
from ltvpneu._values import Value
from ltvpneu.design.pattern.enumeration import MOST_LISTED, LinearFigures, all_patterns, solved_by_listing
from ltvpneu.design.pattern.pattern_machine import PatternsOnMachine
from ltvpneu.design.pattern.pattern_problem import Asked, Solved, solved_pattern
from ltvpneu.design.pattern.pattern_search import Searched, search_patterns
from ltvpneu.design.pattern.slots import (
    count_pulses,
    first_points,
    pattern_system,
    points_of,
    slots_of,
    two_positions,
    with_pattern,
)
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.goals import Wanted
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.linear.linearize import linearize_steps
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.system import PeriodicSystem

MOST_ROUNDS = 8
MOST_ENUMERATED = 500
"""Patterns that are all tried on the nonlinear machine."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PatternSolution(Value):
    """A pattern of slots, and what it is on the nonlinear machine. Figures that there are none of are nan."""

    status: str
    """"optimal": the machine keeps all goals, and no pattern is better there: all were tried, where `is_best_of_all`,
    or those that could be better than `bound`. Of more than 24 slots, and where nothing was looked for on the machine,
    none is better on the linear model. "improved": the machine keeps all goals, and no pattern next to this one is
    better there. "broken on the machine": the best that was found breaks the goals in `broken` there. "infeasible": no
    pattern keeps the goals, of all on the machine where `is_best_of_all`, else of those on the linear model and of
    those tried."""
    pattern: BoolArray
    """Whether the valve is on, slot by slot, (n_slots,)."""
    value: float
    """Of the objective, of `linear_pattern` on the linear model."""
    relaxation: float
    """The least that the objective could be there if slots could be on in part: a lower bound."""
    linear_pattern: BoolArray
    """The linear model's best pattern, (n_slots,); none where it has no pattern that keeps the goals."""
    n_rounds: int
    """How often the operating points were fitted to the pattern's cycle."""
    settled: bool
    """Whether `linear_pattern` is best for operating points of its own cycle; never without `refit`."""
    system: PeriodicSystem | None
    """The linear model of the pattern, one step a slot."""
    machine: Machine | None
    """With the pattern's pulses."""
    frequency: float
    """[Hz]"""
    nonlinear: Orbit | str
    """Cycle of the nonlinear machine, or why it has none."""
    nonlinear_value: float
    """Of the objective on the nonlinear machine; its amplitude is that of the whole cycle, not of the slots' starts."""
    figures: dict[str, float]
    """Of each goal on the nonlinear machine, as "mean position"; nan where it has no cycle, or stiction holds it."""
    missed: dict[str, float]
    """By how much the nonlinear machine misses each goal, in its own unit; 0 where it keeps it within a millionth of
    the state's size, infinite where there is no figure."""
    bound: float
    """Of the objective on the nonlinear machine, from below: the value of the best where all patterns were tried; else
    what no pattern is predicted to go below, were its prediction four standard errors off in its favour. It holds as
    far as the errors seen of the patterns tried do. Of more than 24 slots nan."""
    n_allowed: int | None
    """Patterns that the slots' rules allow, a pattern turned round counting once; of more than 24 slots not counted."""
    n_tried: int
    """Patterns tried on the nonlinear machine."""
    is_best_of_all: bool
    """Whether those were all that the slots' rules allow."""

    def __repr__(self) -> str:
        shown = "".join("1" if on else "0" for on in self.pattern)
        broken = f", broken: {', '.join(self.broken)}" if self.broken else ""
        return f"<PatternSolution: {self.status}, {shown or 'none'}, objective {self.nonlinear_value:.6g}{broken}>"

    @property
    def broken(self) -> tuple[str, ...]:
        """Goals that the nonlinear machine does not keep with this pattern."""
        return tuple(name for name, by in self.missed.items() if by > 0)

    @property
    def gap(self) -> float:
        """What deciding between on and off costs on the linear model: `value` less `relaxation`."""
        return self.value - self.relaxation

    @property
    def n_pulses(self) -> int:
        """How often the valve goes on in a period."""
        return int(count_pulses(self.pattern))


def optimize_pattern(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float,
    n_slots: int,
    *,
    minimize: str = "amplitude",
    mean: Mapping[str, Wanted] | None = None,
    amplitude: Mapping[str, float] | None = None,
    n_pulses: int | None = None,
    shortest_on: int = 1,
    shortest_off: int = 1,
    refit: bool = True,
    correct: bool | None = None,
    progress: Progress | None = None,
) -> PatternSolution:
    """Return in which slots of the period the valve is best on.

    Parameters
    ----------
    machine : Machine
        Whose valve is either on or off, without ramps.
    frequency : float
        Of the whole pattern [Hz].
    n_slots : int
        Into which the period is divided.
    minimize : {"amplitude", "mean_error", "air_use", "switching"}
        Half the span of the positions, on the linear model those at the slots' starts [m]; the distance of the means
        from those wanted, each over its size, summed [-]; mean mass flow from the supply [kg/s]; pulses a period [-].
    mean : mapping of str to float or (float or None, float or None), optional
        States' time means, or their bounds.
    amplitude : mapping of str to float, optional
        Largest half span of states, on the linear model at the slots' starts.
    n_pulses : int, optional
        Most pulses a period.
    shortest_on, shortest_off : int
        Least slots in a pulse, and in a pause.
    refit : bool
        Fit the operating points to the pattern's own cycle and solve again, until the pattern stays.
    correct : bool, optional
        Look for the best pattern on the nonlinear machine: among all, of up to 500; of more, and up to 24 slots, among
        those predicted to be better; of more slots, next to the linear model's best and on from there. By default where
        `refit` is. Without, the linear model's best comes back.
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Returns
    -------
    PatternSolution

    Raises
    ------
    ValueError
        Arguments out of range, contradictory bounds, a valve with other positions than on and off.
    SolverError
        HiGHS ended without an answer.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> found = design.optimize_pattern(machine, 4.0, 8, mean={"position": (0.04, 0.05)})
    >>> print(found.status, f"{1e3 * found.nonlinear_value:.1f} mm about {1e3 * found.figures['mean position']:.1f} mm")
    optimal 18.2 mm about 48.3 mm

    The linear model's own best breaks the goal on the machine, and says so:

    >>> linear = design.optimize_pattern(machine, 4.0, 8, mean={"position": (0.04, 0.05)}, correct=False)
    >>> print(linear.status, linear.broken, f"{1e3 * linear.figures['mean position']:.1f} mm")
    broken on the machine ('mean position',) 36.3 mm
    """
    expect_machine(machine)
    positive("frequency", frequency, "Hz")
    N = whole("n_slots", n_slots, 2)
    ask = Asked(machine, minimize, dict(mean or {}), dict(amplitude or {}), n_pulses, (shortest_on, shortest_off), N)
    patterns = all_patterns(ask) if N <= MOST_LISTED else None
    linear = _on_the_linear_model(machine, frequency, ask, refit, patterns)
    trials = PatternsOnMachine(machine, frequency, ask)
    correct = refit if correct is None else correct
    every = correct and patterns is not None and len(patterns) <= MOST_ENUMERATED
    searched = _on_the_machine(trials, linear, patterns, correct, progress)
    if searched is None or not (searched.best.kept or (linear.solved.status == "optimal" and not every)):
        return _nothing(linear, trials, patterns, every)
    best = searched.best
    own = linear.solved.status == "optimal" and np.array_equal(best.pattern, linear.solved.pattern)
    status = "optimal" if searched.ended or (own and (patterns is None or not correct)) else "improved"
    return PatternSolution(
        status=status if best.kept else "broken on the machine",
        pattern=best.pattern,
        value=linear.solved.value,
        relaxation=linear.solved.relaxation,
        linear_pattern=linear.solved.pattern,
        n_rounds=linear.n_rounds,
        settled=linear.settled,
        system=linear.system_of(best.pattern, own),
        machine=with_pattern(machine, best.pattern),
        frequency=float(frequency),
        nonlinear=best.orbit,
        nonlinear_value=best.value,
        figures=best.figures,
        missed=best.missed,
        bound=searched.bound,
        n_allowed=None if patterns is None else len(patterns),
        n_tried=trials.n_tried,
        is_best_of_all=every,
    )


class _Linear(NamedTuple):
    """What the linear model says, and its operating points in the end."""

    machine: Machine
    frequency: float
    areas: FloatArray
    point: FloatArray
    solved: Solved
    figures: LinearFigures | None
    """Of all patterns, where they were listed."""
    n_rounds: int
    settled: bool

    def system_of(self, pattern: BoolArray, own: bool) -> PeriodicSystem | None:
        """Return the linear model of a pattern: its own operating points, or those that it was found with."""
        linearization = linearize_steps(self.machine, self.point, self.areas, "paper")
        system = pattern_system(self.machine, linearization, pattern, self.frequency)
        if own:
            return system
        try:
            point = points_of(self.machine, system, pattern, self.point)
        except LtvpneuError:
            return system
        return pattern_system(
            self.machine, linearize_steps(self.machine, point, self.areas, "paper"), pattern, self.frequency
        )


def _on_the_linear_model(
    machine: Machine, frequency: float, ask: Asked, refit: bool, patterns: BoolArray | None
) -> _Linear:
    """Solve for the pattern, fit the operating points to its cycle, and again until it stays."""
    areas = two_positions(machine)
    point = first_points(machine, frequency)
    rounds, before, seen = 0, "", set[str]()
    while True:
        rounds += 1
        linearization = linearize_steps(machine, point, areas, "paper")
        slots = slots_of(machine, linearization, point, areas, 1 / (frequency * ask.n_slots))
        if patterns is None:
            solved, figures = solved_pattern(ask, slots), None
        else:
            solved, figures = solved_by_listing(ask, slots, patterns)
        text = "".join(map(str, solved.pattern.astype(int)))
        settled = solved.status == "optimal" and text == before
        if solved.status != "optimal" or not refit or text in seen or rounds == MOST_ROUNDS:
            return _Linear(machine, frequency, areas, point, solved, figures, rounds, settled)
        seen.add(text)
        before = text
        system = pattern_system(machine, linearization, solved.pattern, frequency)
        point = points_of(machine, system, solved.pattern, point)


def _on_the_machine(
    trials: PatternsOnMachine,
    linear: _Linear,
    patterns: BoolArray | None,
    correct: bool,
    progress: Progress | None,
) -> Searched | None:
    """Return the best pattern on the nonlinear machine, or what the linear model's is there; None without a pattern."""
    if not correct:
        own = linear.solved.status == "optimal"
        return Searched(trials.tried(linear.solved.pattern), np.nan, False) if own else None
    if patterns is None or linear.figures is None:
        own = linear.solved.status == "optimal"
        return Searched(trials.best_from(linear.solved.pattern), np.nan, False) if own else None
    if len(patterns) <= MOST_ENUMERATED:
        best = trials.best_of_all(patterns, progress)
        return None if best is None else Searched(best, best.value if best.kept else np.nan, True)
    return search_patterns(trials, patterns, linear.figures, progress)


def _nothing(linear: _Linear, trials: PatternsOnMachine, patterns: BoolArray | None, every: bool) -> PatternSolution:
    return PatternSolution(
        status="infeasible", pattern=np.zeros(0, dtype=np.bool_), value=np.nan, relaxation=np.nan,
        linear_pattern=linear.solved.pattern, n_rounds=linear.n_rounds, settled=False, system=None, machine=None,
        frequency=float(linear.frequency), nonlinear="no pattern was found", nonlinear_value=np.nan, figures={},
        missed={}, bound=np.nan, n_allowed=None if patterns is None else len(patterns), n_tried=trials.n_tried,
        is_best_of_all=every,
    )  # fmt: skip
