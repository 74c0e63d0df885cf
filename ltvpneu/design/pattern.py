"""Which of N equal slots of the period the valve is on in: solved for (`pattern_problem`), refitted, solved again.

Operating points are refitted to the pattern's own cycle until the pattern stays.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from ltvpneu._arrays import BoolArray, positive, whole
from ltvpneu._values import Value
from ltvpneu.design.duty_cycle import Wanted
from ltvpneu.design.pattern_problem import Asked, Solved, solved_pattern
from ltvpneu.design.slots import first_points, pattern_system, points_of, slots_of, two_positions
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.linearize import linearize_steps
from ltvpneu.models.machine import Machine
from ltvpneu.models.nonlinear import nonlinear_orbit
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.system import PeriodicSystem

MOST_ROUNDS = 8


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PatternSolution(Value):
    """A pattern of slots. Where the status is not "optimal", the figures are nan and there is no pattern."""

    status: str
    """"optimal" or "infeasible"."""
    pattern: BoolArray
    """Whether the valve is on, slot by slot, (n_slots,)."""
    value: float
    """Of the objective, on the linear model."""
    relaxation: float
    """The least that the objective could be if slots could be on in part: a lower bound."""
    n_rounds: int
    """How often the operating points were fitted to the pattern's cycle."""
    settled: bool
    """Whether the pattern is best for operating points of its own cycle."""
    system: PeriodicSystem | None
    """The linear model of the pattern, one step a slot."""
    machine: Machine | None
    """With the pattern's pulses."""
    frequency: float
    """[Hz]"""
    nonlinear: Orbit | str
    """Cycle of the nonlinear machine, or why it has none."""

    def __repr__(self) -> str:
        shown = "".join("1" if on else "0" for on in self.pattern)
        return f"<PatternSolution: {self.status}, {shown or 'none'}, objective {self.value:.6g}, gap {self.gap:.3g}>"

    @property
    def gap(self) -> float:
        """What deciding between on and off costs: the objective less that of the relaxation."""
        return self.value - self.relaxation

    @property
    def n_pulses(self) -> int:
        """How often the valve goes on in a period."""
        return int(np.sum(self.pattern & ~np.roll(self.pattern, 1)))


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
        Half the span of the positions at the slots' starts [m]; the distance of the means from those wanted, each over
        its size, summed [-]; mean mass flow from the supply [kg/s]; pulses a period [-].
    mean : mapping of str to float or (float or None, float or None), optional
        States' time means, or their bounds.
    amplitude : mapping of str to float, optional
        Largest half span of states at the slots' starts.
    n_pulses : int, optional
        Most pulses a period.
    shortest_on, shortest_off : int
        Least slots in a pulse, and in a pause.
    refit : bool
        Fit the operating points to the pattern's own cycle and solve again, until the pattern stays.

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
    >>> found = design.optimize_pattern(machine, 4.0, 12, mean={"position": (0.04, 0.05)})
    >>> print(found.status, f"{1e3 * found.value:.1f} mm, {found.n_pulses} pulses")
    optimal 8.9 mm, 5 pulses
    """
    positive("frequency", frequency, "Hz")
    N = whole("n_slots", n_slots, 2)
    ask = Asked(machine, minimize, dict(mean or {}), dict(amplitude or {}), n_pulses, (shortest_on, shortest_off), N)
    areas = two_positions(machine)
    point = first_points(machine, frequency)
    solved, rounds, settled, before = Solved("infeasible", np.zeros(0, dtype=np.bool_), np.nan, np.nan), 0, False, ""
    seen: set[str] = set()
    linearization = linearize_steps(machine, point, areas, "paper")
    while rounds < MOST_ROUNDS:
        rounds += 1
        linearization = linearize_steps(machine, point, areas, "paper")
        slots = slots_of(machine, linearization, point, areas, 1 / (frequency * N))
        solved = solved_pattern(ask, slots)
        text = "".join(map(str, solved.pattern.astype(int)))
        settled = text == before or not refit
        if solved.status != "optimal" or settled or text in seen:
            break
        seen.add(text)
        before = text
        point = points_of(
            machine, pattern_system(machine, linearization, solved.pattern, frequency), solved.pattern, point
        )
    if solved.status != "optimal":
        return PatternSolution(
            status=solved.status, pattern=solved.pattern, value=np.nan, relaxation=np.nan, n_rounds=rounds,
            settled=False, system=None, machine=None, frequency=float(frequency), nonlinear="no pattern was found",
        )  # fmt: skip
    found = with_pattern(machine, solved.pattern)
    try:
        orbit: Orbit | str = nonlinear_orbit(found, frequency)
    except LtvpneuError as error:
        orbit = str(error)
    return PatternSolution(
        status="optimal",
        pattern=solved.pattern,
        value=solved.value,
        relaxation=solved.relaxation,
        n_rounds=rounds,
        settled=settled,
        system=pattern_system(machine, linearization, solved.pattern, frequency),
        machine=found,
        frequency=float(frequency),
        nonlinear=orbit,
    )


def with_pattern(machine: Machine, pattern: BoolArray) -> Machine:
    """Return the machine with its valve on in those slots of the turn."""
    N = pattern.size
    if pattern.all() or not pattern.any():
        return machine.with_duty(float(pattern.all()))
    starts = np.flatnonzero(pattern & ~np.roll(pattern, 1))
    ends = np.flatnonzero(~pattern & np.roll(pattern, 1))
    pulses: list[tuple[float, float]] = []
    for start in starts.tolist():
        after = ends[ends > start]
        end = int(after[0]) if after.size else int(ends[0]) + N
        pulses.append((start * 2 * np.pi / N, end * 2 * np.pi / N))
    return machine.with_pulses(pulses)
