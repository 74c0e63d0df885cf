r"""Which of N equal slots of the period the valve is on in: a mixed-integer problem on the exact step maps.

With the operating points frozen, a slot takes the state through its exact map, z_{j+1} = Phi_on z_j + g_on or that of
"off". The choice b_j is written with the state in two parts, of which one is zero (the convex hull of both),

.. math:: z_j = z_j^{on} + z_j^{off}, \quad b_j \underline z \le z_j^{on} \le b_j \overline z, \quad
          (1 - b_j) \underline z \le z_j^{off} \le (1 - b_j) \overline z

so means over a slot and the flow from the supply are linear, and HiGHS solves for the pattern, not for a rounding of
it. Operating points are then refitted to the pattern's own cycle, and it is solved again until the pattern stays.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, cast, final

import cvxpy as cp
import numpy as np
from cvxpy.error import SolverError as CvxpySolverError

from ltvpneu._arrays import BoolArray, FloatArray, finite, positive, whole
from ltvpneu.design.duty_cycle import Wanted, wanted_bounds
from ltvpneu.errors import LtvpneuError, SolverError
from ltvpneu.models.linearize import Linearization, assemble, linearize_steps
from ltvpneu.models.lti import lti_model
from ltvpneu.models.machine import Machine
from ltvpneu.models.nonlinear import nonlinear_orbit
from ltvpneu.models.operating_points import LEAST_DISTANCE
from ltvpneu.models.supply_flow import supply_flow_tangents
from ltvpneu.periodic.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.propagate import exponentials
from ltvpneu.periodic.steady import periodic_states, steady_state
from ltvpneu.periodic.system import PeriodicSystem

OBJECTIVES = ("amplitude", "mean_error", "air_use", "switching")
MOST_ROUNDS = 8
SAMPLES = 200
"""Random patterns from which the states' bounds are taken."""
RELATIVE_GAP = 1e-9
"""Asked of HiGHS."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PatternSolution:
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


class Slots(NamedTuple):
    """Exact maps of a slot, off and on, in scaled states; second axis for what is mapped to."""

    maps: FloatArray
    """(2, n, n)"""
    moves: FloatArray
    """(2, n)"""
    mean_maps: FloatArray
    """To the means over the slot, (2, n, n)."""
    mean_moves: FloatArray
    """(2, n)"""
    flow_rows: FloatArray
    """From those to the mean flow from the supply [kg/s], (2, n)."""
    flow_offsets: FloatArray
    """(2,)"""
    scales: FloatArray
    """(n,)"""


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
    ask = _Asked(machine, minimize, dict(mean or {}), dict(amplitude or {}), n_pulses, (shortest_on, shortest_off), N)
    areas = _two_positions(machine)
    point = _first_points(machine, frequency)
    solved, rounds, settled, before = _Solved("infeasible", np.zeros(0, dtype=np.bool_), np.nan, np.nan), 0, False, ""
    seen: set[str] = set()
    linearization = _linearization(machine, point, areas)
    while rounds < MOST_ROUNDS:
        rounds += 1
        linearization = _linearization(machine, point, areas)
        slots = _slots(machine, linearization, point, areas, 1 / (frequency * N))
        solved = _solve(ask, slots)
        text = "".join(map(str, solved.pattern.astype(int)))
        settled = text == before or not refit
        if solved.status != "optimal" or settled or text in seen:
            break
        seen.add(text)
        before = text
        point = _points_of(machine, _system(machine, linearization, solved.pattern, frequency), solved.pattern, point)
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
        system=_system(machine, linearization, solved.pattern, frequency),
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


class _Asked:
    """The goals, checked."""

    def __init__(  # noqa: PLR0913 - what the caller gave
        self,
        machine: Machine,
        minimize: str,
        mean: dict[str, Wanted],
        amplitude: dict[str, float],
        n_pulses: int | None,
        shortest: tuple[int, int],
        n_slots: int,
    ) -> None:
        if minimize not in OBJECTIVES:
            raise ValueError(f"minimize: found {minimize!r}, expected one of {', '.join(OBJECTIVES)}")
        if minimize == "mean_error" and not mean:
            raise ValueError('minimize: found "mean_error" without wanted means; give mean={"position": ...}')
        for name in (*mean, *amplitude):
            if name not in machine.states:
                raise ValueError(f"mean, amplitude: found {name!r}, expected one of {', '.join(machine.states)}")
        self.minimize, self.n_slots = minimize, n_slots
        self.states = machine.states
        self.mean = {name: wanted_bounds(f"mean[{name!r}]", wanted) for name, wanted in mean.items()}
        self.amplitude = {name: finite(f"amplitude[{name!r}]", most) for name, most in amplitude.items()}
        self.n_pulses = None if n_pulses is None else whole("n_pulses", n_pulses)
        self.shortest = whole("shortest_off", shortest[1]), whole("shortest_on", shortest[0])
        if sum(self.shortest) > n_slots:
            raise ValueError(
                f"shortest_on, shortest_off: found {shortest[0]} and {shortest[1]} slots, more than n_slots = {n_slots}"
            )


class _Solved(NamedTuple):
    status: str
    pattern: BoolArray
    value: float
    relaxation: float


def _two_positions(machine: Machine) -> FloatArray:
    """Return the areas with the valve off and on, (2, 2, n_paths)."""
    tables = [machine.with_duty(duty).openings for duty in (0.0, 1.0)]
    for table in tables:
        if table.fractions.size != 2 or table.ramped.any():
            raise ValueError("machine: found a valve with other positions than on and off; expected those two alone")
    if machine.with_duty(0.5).openings.ramped.any():
        raise ValueError("machine: found openings that ramp, expected a valve that is on or off (valve.ramp = 0)")
    return np.array([table.areas[0, (0, 2)] for table in tables])


def _first_points(machine: Machine, frequency: float) -> FloatArray:
    """Return a first operating point for both positions, (2, n): the means of the averaged model's cycle."""
    model = lti_model(machine, frequency)
    means = (
        np.diff(model.system.switching_times)
        @ ExponentialTrajectory(system=model.system, step_states=periodic_states(model.system)).step_state_means()
    )
    point = means / model.system.period
    return _held(machine, np.tile(point, (2, 1)))


def _held(machine: Machine, points: FloatArray) -> FloatArray:
    """Return the points with pressures kept inside the sources', and the position where the chambers are."""
    low, high = machine.exhaust_pressure, machine.supply_pressure
    points = points.copy()
    points[:, 1] = 0.0
    pressures = points[:, 2 : 2 + machine.n_volumes]
    np.clip(pressures, low * (1 + LEAST_DISTANCE), high * (1 - LEAST_DISTANCE), out=pressures)
    return points


def _linearization(machine: Machine, points: FloatArray, areas: FloatArray) -> Linearization:
    return linearize_steps(machine, points, areas, "paper")


def _slots(
    machine: Machine, linearization: Linearization, points: FloatArray, areas: FloatArray, duration: float
) -> Slots:
    n, scales = len(machine.states), machine.state_scales
    matrices = np.zeros((2, 2 * (n + 1), 2 * (n + 1)))
    inner = np.zeros((2, n + 1, n + 1))
    inner[:, :n, :n] = linearization.A * scales / scales[:, None]
    inner[:, :n, n] = linearization.f / scales
    matrices[:, : n + 1, : n + 1] = inner * duration
    matrices[:, : n + 1, n + 1 :] = np.eye(n + 1)
    whole_maps = exponentials(matrices)
    maps, means = whole_maps[:, : n + 1, : n + 1], whole_maps[:, : n + 1, n + 1 :]
    rows, inputs, offsets = supply_flow_tangents(points, areas, 1e-3, machine.arrays)
    return Slots(
        maps=maps[:, :n, :n],
        moves=maps[:, :n, n],
        mean_maps=means[:, :n, :n],
        mean_moves=means[:, :n, n],
        flow_rows=rows * scales,
        flow_offsets=inputs @ machine.levels + offsets,
        scales=scales,
    )


def _bounds_of(slots: Slots, n_slots: int) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the scaled states over all patterns: of many patterns' cycles, widened by their own span."""
    random = np.random.default_rng(0)
    n = slots.scales.size
    patterns = random.random((SAMPLES, n_slots)) < random.random((SAMPLES, 1))
    patterns[0], patterns[1] = False, True
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    for pattern in patterns.astype(int):
        states = pattern_states(slots, pattern)
        low, high = np.minimum(low, states.min(axis=0)), np.maximum(high, states.max(axis=0))
    span = np.maximum(high - low, 1e-6)
    return low - span, high + span


def pattern_states(slots: Slots, pattern: Any) -> FloatArray:
    """Return the scaled states at the starts of the slots on a pattern's cycle, (n_slots, n)."""
    n = slots.scales.size
    whole_map, move = np.eye(n), np.zeros(n)
    for on in pattern:
        whole_map, move = slots.maps[on] @ whole_map, slots.maps[on] @ move + slots.moves[on]
    state: FloatArray = np.linalg.solve(np.eye(n) - whole_map, move).astype(np.float64)
    found: list[FloatArray] = []
    for on in pattern:
        found.append(state)
        state = slots.maps[on] @ state + slots.moves[on]
    return np.array(found)


def _solve(ask: _Asked, slots: Slots) -> _Solved:
    """Solve for the pattern, and with parts of slots on for the bound that this gives."""
    best: tuple[float, BoolArray] | None = None
    written = _problem(ask, slots, boolean=True)
    on, N = written.on, ask.n_slots
    # A pattern and the same turned round are one: those that go on in the first slot stand for all but two.
    for ends in ([on[0] == 1, on[N - 1] == 0], [on == 0], [on == 1]):
        problem = cp.Problem(written.problem.objective, [*written.problem.constraints, *ends])
        if _run(problem) == "optimal":
            value = float(cast(float, problem.value))
            if best is None or value < best[0]:
                best = value, np.asarray(on.value, dtype=np.float64) > 0.5
    if best is None:
        return _Solved("infeasible", np.zeros(0, dtype=np.bool_), np.nan, np.nan)
    relaxed = _problem(ask, slots, boolean=False)
    _run(relaxed.problem)
    bound = float(cast(float, relaxed.problem.value))
    return _Solved("optimal", turned_first(best[1]), best[0] * written.unit, bound * written.unit)


def turned_first(pattern: BoolArray) -> BoolArray:
    """Return the pattern turned round so that, of all its turns, its slots on come first."""
    turns = [np.roll(pattern, -i) for i in range(pattern.size)]
    return max(turns, key=lambda turn: tuple(turn.tolist()))


class _Written(NamedTuple):
    problem: cp.Problem
    on: cp.Variable
    unit: float
    """Of the objective."""


def _problem(ask: _Asked, slots: Slots, *, boolean: bool) -> _Written:
    N, n = ask.n_slots, slots.scales.size
    low, high = _bounds_of(slots, N)
    on = cp.Variable(N, boolean=True) if boolean else cp.Variable(N)
    states, with_on = cp.Variable((N, n)), cp.Variable((N, n))
    with_off = states - with_on
    column = cp.reshape(on, (N, 1), order="C")
    following = (
        with_on @ slots.maps[1].T + column @ slots.moves[1][None]
        + with_off @ slots.maps[0].T + (1 - column) @ slots.moves[0][None]
    )  # fmt: skip
    every: list[Any] = [
        on >= 0, on <= 1,
        with_on >= column @ low[None], with_on <= column @ high[None],
        with_off >= (1 - column) @ low[None], with_off <= (1 - column) @ high[None],
        states[1:] == following[:-1], states[0] == following[-1],
    ]  # fmt: skip
    mean_on = with_on @ slots.mean_maps[1].T + column @ slots.mean_moves[1][None]
    mean_off = with_off @ slots.mean_maps[0].T + (1 - column) @ slots.mean_moves[0][None]
    means: Any = cp.sum(mean_on + mean_off, axis=0) / N
    flow = (
        cp.sum(mean_on @ slots.flow_rows[1] + on * slots.flow_offsets[1])
        + cp.sum(mean_off @ slots.flow_rows[0] + (1 - on) * slots.flow_offsets[0])
    ) / N  # fmt: skip

    def span(i: int) -> Any:
        return (cp.max(states[:, i]) - cp.min(states[:, i])) / 2

    for name, (least, most) in ask.mean.items():
        i = ask.states.index(name)
        if ask.minimize != "mean_error":
            every += [] if least is None else [means[i] >= least / slots.scales[i]]
            every += [] if most is None else [means[i] <= most / slots.scales[i]]
    for name, most in ask.amplitude.items():
        i = ask.states.index(name)
        every.append(span(i) <= most / slots.scales[i])
    rises = cp.Variable(N, nonneg=True)
    before = cp.hstack([on[N - 1 :], on[: N - 1]])
    every.append(rises >= on - before)
    if ask.n_pulses is not None:
        every.append(cp.sum(rises) <= ask.n_pulses)
    every += _long_enough(on, before, ask.shortest)
    unit, goal = 1.0, cast(Any, cp.sum(rises))
    if ask.minimize == "amplitude":
        unit, goal = float(slots.scales[0]), span(0)
    elif ask.minimize == "mean_error":
        off_by = cp.Variable(len(ask.mean), nonneg=True)
        for row, (name, (least, most)) in enumerate(ask.mean.items()):
            i = ask.states.index(name)
            every += [] if most is None else [off_by[row] >= means[i] - most / slots.scales[i]]
            every += [] if least is None else [off_by[row] >= least / slots.scales[i] - means[i]]
        goal = cp.sum(off_by)
    elif ask.minimize == "air_use":
        unit = float(np.max(np.abs(slots.flow_offsets), initial=0.0)) or 1.0
        goal = flow / unit
    return _Written(cp.Problem(cp.Minimize(goal), every), on, unit)


def _long_enough(on: cp.Variable, before: Any, shortest: tuple[int, int]) -> list[Any]:
    """Return constraints that a change of the valve lasts for some slots; first those after going off."""
    N, found = on.size, list[Any]()
    for ahead in range(1, max(shortest)):
        later = cp.hstack([on[ahead:], on[:ahead]]) if ahead < N else on
        if ahead < shortest[1]:
            found.append(later >= on - before)
        if ahead < shortest[0]:
            found.append(1 - later >= before - on)
    return found


def _run(problem: cp.Problem) -> str:
    try:
        problem.solve(solver=cp.HIGHS, mip_rel_gap=RELATIVE_GAP, output_flag=False)
    except CvxpySolverError as error:
        raise SolverError(f"HiGHS failed: {error}", status="solver_error") from None
    status = str(problem.status)
    if status not in ("optimal", "infeasible"):
        raise SolverError(f"HiGHS ended with status {status!r}: no pattern to trust", status=status)
    return status


def _system(machine: Machine, linearization: Linearization, pattern: BoolArray, frequency: float) -> PeriodicSystem:
    """Return the linear model of a pattern, one step a slot."""
    chosen = pattern.astype(int)
    one = Linearization(
        A=linearization.A[chosen], B=linearization.B[chosen], r=linearization.r[chosen], f=linearization.f[chosen]
    )
    durations = np.full(pattern.size, 1 / (frequency * pattern.size))
    return assemble(machine, durations, one, f"{machine.identifier}_pattern")


def _points_of(machine: Machine, system: PeriodicSystem, pattern: BoolArray, before: FloatArray) -> FloatArray:
    """Return a pattern's means over all its slots off, and over all on; as before where it has none."""
    trajectory = ExponentialTrajectory(system=system, step_states=steady_state(system).step_states)
    means = trajectory.step_state_means()
    points = before.copy()
    for row, chosen in enumerate((~pattern, pattern)):
        if chosen.any():
            points[row] = means[chosen].mean(axis=0)
    points[:, 0] = means[:, 0].mean()
    return _held(machine, points)
