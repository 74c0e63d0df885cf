"""What a design of switching angles ended with."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np
from scipy.stats import binomtest

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu._values import Value
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import Attractors, attractors
from ltvpneu.periodic.orbits.orbit import Orbit


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DutySolution(Value):
    """What a design of switching angles ended with."""

    status: str
    """Of the model that was designed on; whether the nonlinear machine keeps the goals, `broken` says. "optimal":
    stationary, all constraints kept. "infeasible": no setting that was found keeps them; this is the nearest, by what
    each goal ranges over, those that some setting keeps by itself first, equations before bounds. "edge": better
    settings next to this one have no cycle, as where stiction locks. "stopped": out of iterations, or where the
    residual stays large."""
    values: dict[str, float]
    """Of the variables."""
    objective: float
    """Of the model that was designed on; nan where infeasible."""
    constraints: dict[str, float]
    """By how much each is broken on that model, in its own unit; 0 where it is kept."""
    nonlinear_constraints: dict[str, float]
    """The same on the nonlinear machine; nan where that has no cycle."""
    tolerances: dict[str, float]
    """By how much the nonlinear machine may break each goal and still counts as keeping it, in its own unit: a
    hundredth of the larger of its two sides there, or a thousandth of what these differ by over the settings looked at,
    if that is more."""
    nonlinear_objective: float
    """The same on the nonlinear machine; nan where it has no cycle, or where infeasible."""
    duals: dict[str, float]
    """Of the constraints: how fast the objective gets better as an inequality's bound is loosened, never below zero, or
    as the right side of an equation rises, in its own unit."""
    slopes: dict[str, float]
    """How fast the best objective changes with parameters that were asked for, the settings following; nan where the
    status is not "optimal", where the optimum lies on a kink, of which one side's derivatives do not tell, and where a
    cycle beside it cannot be followed."""
    setting_slopes: dict[str, dict[str, float]]
    """How fast the best settings change with these parameters, by parameter and variable; nan where `slopes` are, and
    where the problem beside has no optimum next to this one."""
    active: tuple[str, ...]
    """Constraints, and bounds of variables, that hold the design."""
    residual: float
    """Of the conditions of optimality, scaled [-]: the longest of the step that the convex problem with unit curvature
    still takes, the constraints' violation, and their duals times what is left to their bounds."""
    at_kink: bool
    """Whether the optimum lies on a kink of the model, as where the piston begins to rest within its cycle: then the
    residual is that of the slopes on both sides, mixed."""
    merits: tuple[tuple[float, float], ...]
    """Objective plus penalties before and after every step taken, each pair with the same penalty."""
    n_cycles: int
    """Cycles computed, those that were only looked at included."""
    n_failed: int
    """Settings tried where the model had no cycle."""
    spectral_radius: float
    """Of the cycle, the refit included: below one it is stable."""
    machine: Machine
    """As designed."""
    frequency: float
    """[Hz]"""
    commands: tuple[tuple[float, float], ...]
    """When to tell the valve to go on and off, each pulse, delays counted in [s]; below zero, in the period before."""
    model: LtvModel | None
    """The linear model designed on, if it was one."""
    scenario_machines: dict[str, Machine]
    """As designed, in every scenario."""
    nonlinear: dict[str, Orbit | str]
    """Cycle of the nonlinear machine in every scenario, or why it has none."""
    lower_bound: float = math.nan
    """Where the search was global: no setting makes the objective better, as far as the estimated curvature between the
    settings looked at holds; see `global_search`."""
    corrected: "DutySolution | None" = None
    """The same problem solved from here on the nonlinear machine, where that was asked for."""
    not_corrected: str = ""
    """Why it was not, where that was asked for."""
    ranges: "GoalCheck | None" = None
    """Where it was designed for ranges: what was checked of the nonlinear machine over them."""
    choice: dict[str, str | float] = field(default_factory=dict[str, str | float])
    """Where there were lists to choose from: the entry of each."""
    choices: "tuple[Chosen, ...]" = ()
    """The design with every combination of the lists' entries, best first."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value:.6g}" for name, value in self.values.items())
        broken = f"; the machine breaks {', '.join(self.broken)}" if self.broken else ""
        figures = f"objective {self.objective:.6g}, {shown}, residual {self.residual:.1e}"
        return f"<DutySolution: {self.status}, {figures}{broken}>"

    @cached_property
    def attractors(self) -> Attractors:
        """What the nonlinear machine, as designed, settles on from different starts."""
        return attractors(self.machine, self.frequency)

    @property
    def broken(self) -> tuple[str, ...]:
        """Goals that the nonlinear machine breaks by more than `tolerances`, or has no cycle to keep them with.

        Those that it breaks somewhere in the ranges come last, as "amplitude position, in the ranges".
        """
        missed = self.nonlinear_constraints
        found = [name for name, by in missed.items() if not by <= self.tolerances[name]]
        return (*found, *(() if self.ranges is None else (f"{name}, in the ranges" for name in self.ranges.broken)))


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Chosen(Value):
    """A design with one entry of each list."""

    choice: dict[str, str | float]
    """The entry of each list; valves and cylinders by their names."""
    solution: DutySolution | None
    """What it came to; None where there is none."""
    failure: str
    """Why not; else empty."""

    def __repr__(self) -> str:
        named = ", ".join(f"{name} {label}" for name, label in self.choice.items())
        return f"<Chosen: {named}: {self.failure or repr(self.solution)}>"

    @property
    def final(self) -> DutySolution | None:
        """The solution, or the corrected one where there is one."""
        return None if self.solution is None else self.solution.corrected or self.solution

    @property
    def keeps_goals(self) -> bool:
        """Whether the nonlinear machine keeps all goals."""
        found = self.final
        return found is not None and found.status != "infeasible" and not found.broken


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GoalCheck(Value):
    """How the nonlinear machine keeps goals while numbers of it vary."""

    names: tuple[str, ...]
    """Of what varies."""
    points: FloatArray
    """Its values, SI units, (n_points, n_names): corners first, then those inside."""
    n_inside: int
    missed: dict[str, FloatArray]
    """By how much each goal is missed, in its own unit, (n_points,); nan where the machine has no cycle."""
    tolerances: dict[str, float]
    """By how much a goal may be missed and still counts as kept: a hundredth of its bound."""
    objectives: FloatArray
    """What is minimized, (n_points,)."""
    failures: dict[int, str]
    """Why the machine has no cycle, by the point's number."""

    def __repr__(self) -> str:
        low, high = self.interval
        inside = (
            f"{self.share:.3g} of those inside ({low:.2g} to {high:.2g} by 95 %)" if self.n_inside else "none inside"
        )
        return f"<GoalCheck: {int(self.kept.sum())} of {len(self.points)} points keep all goals; {inside}>"

    @property
    def kept(self) -> BoolArray:
        """Whether the machine keeps all goals, to within their tolerances, (n_points,)."""
        found = np.ones(len(self.points), dtype=np.bool_)
        found[list(self.failures)] = False
        for name, by in self.missed.items():
            found &= by <= self.tolerances[name]
        return found

    @property
    def broken(self) -> tuple[str, ...]:
        """Goals that are missed by more than their tolerances somewhere; "a cycle" where there is none."""
        found = [name for name, by in self.missed.items() if np.nanmax(by, initial=0.0) > self.tolerances[name]]
        return (*found, *(["a cycle"] if self.failures else []))

    @property
    def share(self) -> float:
        """How many of the points inside keep all goals [-]: with random points, the probability; nan without any."""
        return float(np.mean(self.kept[len(self.points) - self.n_inside :])) if self.n_inside else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Where the probability lies by 95 %, of as many random points (Wilson); nan without any."""
        if not self.n_inside:
            return math.nan, math.nan
        count = int(self.kept[len(self.points) - self.n_inside :].sum())
        found = binomtest(count, self.n_inside).proportion_ci(0.95, "wilson")
        return float(found.low), float(found.high)

    def worst(self, goal: str) -> float:
        """Return the most by which a goal is missed, in its own unit.

        Raises
        ------
        ValueError
            There is no such goal.
        """
        if goal not in self.missed:
            raise ValueError(f"goal: found {goal!r}, expected one of {', '.join(self.missed) or 'none'}")
        return float(np.nanmax(self.missed[goal], initial=0.0))

    def point(self, number: int) -> dict[str, float]:
        """Return what varies, at a point."""
        return dict(zip(self.names, self.points[number].tolist(), strict=True))
