"""LTV models whose operating points belong to the model's own cycle: "fitted" and "self-consistent".

The cycle is found by marching through the steps until the state repeats (`march`, `repeat`), from rest as the nonlinear
orbit is; where the piston sticks it is one of a band, and it may repeat only after several valve periods. Dry friction
acts through the operating point of the velocity, its sign, as the paper's conclusion suggests: steps are cut where the
piston stops, reverses or breaks away, and at rest x' = 0.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, final

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._clock import UNWATCHED, Watch
from ltvpneu._values import Value
from ltvpneu.errors import NotConvergedError
from ltvpneu.models.linear.cuts import cuts_by_error, even_cuts
from ltvpneu.models.linear.linearize import Linearization
from ltvpneu.models.linear.march import MAX_EVENTS, NOT_CONVERGED, TOO_MANY_EVENTS, Marched, march_period
from ltvpneu.models.linear.march import MOST_STEPS as MOST_STEPS_IN_PERIOD
from ltvpneu.models.linear.model import HeldBack, LtvModel, assemble
from ltvpneu.models.linear.plan import Plan, Steps, new_plan, new_steps, together
from ltvpneu.models.linear.repeat import Repeated, repeat_march
from ltvpneu.models.linear.staircase import default_steps, staircase
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import OpeningTable, cut_pieces
from ltvpneu.models.machine.quasi_static import nearest_source
from ltvpneu.models.nonlinear.integrator import OK, PAUSED
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.orbits import step_label
from ltvpneu.models.nonlinear.rest import AT_EDGE, rests_in_a_band, what_holds
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbits.orbit import Orbit

OwnCycle = Literal["fitted", "self-consistent"]


Spacing = Literal["adaptive", "even"]
LOOSEST_REFERENCE, TIGHTEST_REFERENCE = 1e-5, 1e-7
"""Relative tolerances of the integration over each step, to which it is fitted or from which its search starts [-]."""
POINT_TOLERANCE = 1e-10
CYCLE_TOLERANCE = 0.1
"""Scaled distance from the cycle at which the state counts as periodic, over the reference's tolerance [-]."""
MAX_PERIODS = 5000
LEAST_TRAVEL = 1e-4
"""Scaled travel below which a piston that also rests counts as resting [-]."""
MAX_ITERATIONS = 40
MOST_STEPS = 2048
GROWTH = 4
"""Factor by which the number of steps grows from one round of placing them to the next."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Question(Value):
    """What is asked for, but for the steps."""

    machine: Machine
    frequency: float
    mode: OwnCycle
    distance: float

    def plan(self, cells: FloatArray, rtol: float | None = None) -> Plan:
        """Return what the march needs, for cell boundaries given as shares of the turn, (n_cells + 1,)."""
        pieces, first_pieces, areas = cut_pieces(self.machine.openings, cells, 1 / self.frequency)
        # In step with the error of the steps themselves, which falls with the square of their number.
        if rtol is None:
            rtol = min(max(LOOSEST_REFERENCE * (2 / (cells.size - 1)) ** 2, TIGHTEST_REFERENCE), LOOSEST_REFERENCE)
        return new_plan(
            new_run(self.machine.record, integration_settings(self.machine, rtol), pieces),
            first_pieces,
            areas,
            self.machine.state_scales,
            fitted=self.mode == "fitted",
            distance=float(self.distance),
            tolerance=POINT_TOLERANCE,
            max_iterations=MAX_ITERATIONS,
        )


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Found(Value):
    """A cycle of linear steps, over one or more valve periods."""

    question: Question
    cells: FloatArray
    plan: Plan
    repeated: Repeated
    periods: tuple[Steps, ...]
    """The steps of each valve period, cut to size."""
    iterations: int
    """Valve periods marched, in all rounds."""

    @cached_property
    def steps(self) -> Steps:
        """The steps of all valve periods as one."""
        return together(self.periods)

    @property
    def sticks(self) -> bool:
        """Whether the piston rests anywhere."""
        return bool((self.steps.modes == STUCK).any())


def own_cycle_model(question: Question, n_steps: int, spacing: Spacing, watch: Watch = UNWATCHED) -> LtvModel:
    """Return the model with that many steps of the openings; cuts at stick and slip come on top.

    Raises
    ------
    NotConvergedError
        An operating point was not found, or the cycle does not repeat.
    """
    return as_model(find_cycle(question, n_steps, spacing, watch=watch))


def model_to_tolerance(question: Question, rtol: float, spacing: Spacing, watch: Watch = UNWATCHED) -> LtvModel:
    """Return the model with as few steps, by factors of two, as its own error estimate asks for.

    Raises
    ------
    NotConvergedError
        The estimate stays above `rtol` with `MOST_STEPS` steps, or a cycle was not found.
    """
    n_steps, found = default_steps(question.machine), None
    while True:
        found = find_cycle(question, n_steps, spacing, found, watch)
        model = as_model(found)
        estimate = model.error_estimate
        # Of a piston at rest, the error is that of its pressures.
        scales = question.machine.state_scales
        errors = [
            abs(estimate.relative_amplitude(i)) for i in (0, 2) if model.orbit.amplitude(i) > LEAST_TRAVEL * scales[i]
        ]
        if estimate.is_reliable and (not errors or errors[0] <= rtol):
            return model
        if n_steps >= MOST_STEPS:
            worst = errors[0] if errors else math.inf
            raise NotConvergedError(
                f"rtol: found {rtol:g}, but with {n_steps} steps the amplitude of the position is still estimated to "
                f"be {worst:.1e} off. Ask for less, or look at lp.nonlinear_orbit",
                residual=worst,
                iterations=found.iterations,
            )
        n_steps = max(2 * n_steps, found.cells.size)


def find_cycle(
    question: Question, n_steps: int, spacing: Spacing, found: Found | None = None, watch: Watch = UNWATCHED
) -> Found:
    """Return the cycle with `n_steps` cells; `found`, one with fewer, saves the first rounds."""
    machine = question.machine
    base = staircase(machine, min(n_steps, machine.openings.fractions.size - 1)).fractions
    least = base.size - 1
    n_steps = max(n_steps, least)
    if spacing == "even" or n_steps == least:
        return _repeated(question, even_cuts(base, n_steps), None, watch)
    if found is None:
        found = _repeated(question, base, None, watch)
    while True:
        n_cells = min(n_steps, GROWTH * (found.cells.size - 1))
        steps = found.steps
        # The cuts serve all valve periods of a subharmonic: each place's worst.
        starts = np.concatenate([[0.0], np.cumsum(steps.durations)]) * question.frequency
        one = int(np.searchsorted(starts, 1 - 1e-9)) + 1 if found.repeated.n_periods > 1 else starts.size
        boundaries = np.append(starts[: one - 1], 1.0)
        found = _repeated(question, cuts_by_error(base, boundaries, steps.errors[: one - 1], n_cells), found, watch)
        if n_cells >= n_steps:
            return found


def _repeated(question: Question, cells: FloatArray, before: Found | None, watch: Watch) -> Found:
    machine, plan = question.machine, question.plan(cells)
    steps = new_steps(plan)
    # Where the piston rests depends on how it came there, so a cycle with rest is marched to from the machine's rest.
    if before is None or before.sticks or before.repeated.n_periods > 1:
        start = np.append(machine.rest_state / plan.scales, 1.0)
    else:
        start = before.repeated.start
    tolerance = CYCLE_TOLERANCE * float(plan.records["run"]["settings"]["rtol"][0])
    repeated = repeat_march(start, plan, steps, tolerance, MAX_PERIODS, watch)
    iterations = repeated.n_marched + (0 if before is None else before.iterations)
    if repeated.n_periods == 0:
        _raise_not_found(question, repeated, iterations, cells.size - 1)
    periods = [steps.cut_to(repeated.last.n_steps)]
    state = repeated.last.state
    for _ in range(repeated.n_periods - 1):
        marched = march_period(state, plan.copy(), steps)
        periods.append(steps.cut_to(marched.n_steps))
        state = marched.state
    return Found(
        question=question,
        cells=cells,
        plan=plan,
        repeated=repeated,
        periods=tuple(periods),
        iterations=iterations,
    )


def retabled(cells: FloatArray, before: OpeningTable, after: OpeningTable) -> FloatArray:
    """Return cell boundaries moved along with the openings' own, as a machine is varied a little."""
    if before.fractions.size != after.fractions.size:
        raise ValueError(
            f"parameters: found openings of {after.fractions.size - 1} pieces next to the machine's "
            f"{before.fractions.size - 1}; at such a corner there is no derivative"
        )
    return np.interp(cells, before.fractions, after.fractions)


def _raise_not_found(question: Question, repeated: Repeated, iterations: int, n_cells: int) -> None:
    marched: Marched = repeated.last
    name = f'operating points "{question.mode}" at {question.frequency:g} Hz with {n_cells} steps'
    if marched.status == OK:
        raise NotConvergedError(
            f"{name}: after {iterations} valve periods the model's cycle does not repeat; its scaled state still "
            f"changes by {repeated.residual:.1e} over any number of periods up to 64. The machine itself may do the "
            "same: see lp.nonlinear_orbit and lp.simulate",
            residual=repeated.residual,
            iterations=iterations,
        )
    reasons = {
        TOO_MANY_EVENTS: f"the piston chatters: it stops and breaks away more than {MAX_EVENTS} times within a step. "
        "Ask for more steps, or look at lp.simulate",
        PAUSED: f"the march was given up after {MOST_STEPS_IN_PERIOD} steps of integration within one valve period: a "
        "small volume beside a large opening makes them that short. Make the volume larger, or collapse it (collapse)",
        NOT_CONVERGED: "no operating point was found, however short the step; the scaled difference from the step's "
        f"own mean is {marched.defect:.1e}. Ask for more steps",
    }
    if marched.status in reasons:
        raise NotConvergedError(
            f"{name}: at {marched.time:.6g} s {reasons[marched.status]}",
            residual=marched.defect,
            iterations=iterations,
        )
    state = marched.state[:-1] * question.machine.state_scales
    raise_stopped(question.machine, marched.status, marched.time, state)


def trajectory_of_steps(machine: Machine, periods: Sequence[Steps]) -> ExponentialTrajectory:
    """Return the linear system that steps make, and the way they went through it."""
    scales, n, steps = machine.state_scales, len(machine.states), together(periods)
    A = steps.matrices[:, :n, :n] * (scales[:, None] / scales)
    f = steps.matrices[:, :n, n] * scales
    linearization = Linearization(A=A, B=steps.inputs, r=f - steps.inputs @ machine.levels, f=f)
    system = assemble(machine, steps.durations, linearization, f"{machine.identifier}_ltv")
    return ExponentialTrajectory(system=system, step_states=steps.starts[:, :n] * scales)


def as_model(found: Found) -> LtvModel:
    """Return a cycle found as an LTV model."""
    question, machine = found.question, found.question.machine
    trajectory, steps = trajectory_of_steps(machine, found.periods), found.steps
    system, states = trajectory.system, trajectory.step_states
    modes = steps.modes
    creeps = _creeps(machine, states, modes)
    orbit = Orbit(
        system_period=1 / question.frequency,
        n_periods=found.repeated.n_periods,
        step_times=system.switching_times,
        step_states=states,
        step_labels=tuple(step_label(machine, mode) for mode in modes.tolist()),
        trajectory=trajectory,
        states=machine.states,
        outputs=machine.states,
        is_isolated=not (rests_in_a_band(machine, states, modes) or creeps),
        residual=found.repeated.residual,
        n_simulated=found.repeated.n_marched,
        name=system.name,
        rest=what_holds(machine, states, modes) or (AT_EDGE if creeps else ""),
    )
    return LtvModel(
        system=system,
        machine=machine,
        frequency=question.frequency,
        operating_points=steps.points,
        mode=question.mode,
        held_back=_held_back(found, steps),
        least_distance=question.distance,
        iterations=found.iterations,
        own_cycle=orbit,
        found=found,
    )


def _creeps(machine: Machine, states: FloatArray, modes: IntArray) -> bool:
    """Whether the piston rests but for moves too small to matter, on its way to the edge of a stiction band."""
    cylinder, position = machine.cylinder, float(states[0, 0])
    reach = LEAST_TRAVEL * machine.state_scales[0]
    if not cylinder.lower_stop + reach < position < cylinder.upper_stop - reach:
        # Against a stop it has nowhere to go.
        return False
    return bool((modes == STUCK).any()) and float(np.ptp(states[:, 0])) < LEAST_TRAVEL * machine.state_scales[0]


def _held_back(found: Found, steps: Steps) -> tuple[HeldBack, ...]:
    machine = found.question.machine
    if found.question.mode == "fitted":
        # A fit's slope is that over what its step visits; the chord only stands in for what it does not visit.
        return ()
    held: list[HeldBack] = []
    for step, column in np.argwhere(steps.held > 0):
        asked = float(steps.points[step, column])
        openings = found.plan.areas[int(steps.cells[step])]
        used = float(nearest_source(int(column) - 2, steps.points[step], openings, machine.record)[0])
        held.append(HeldBack(step=int(step), state=machine.states[column], asked=asked, used=used))
    return tuple(held)
