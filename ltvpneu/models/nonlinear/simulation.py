"""The nonlinear model (3)-(7): transient simulation and periodic orbits.

An orbit is what the machine settles on from its initial state, by default at rest at exhaust pressure. With stiction
it may be one of a band of resting positions, or repeat only after several valve periods; both are found and
reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, positive, read_only, whole
from ltvpneu._values import Value
from ltvpneu.errors import NotSettledError
from ltvpneu.models.machine.dynamics import STUCK, chamber_volume, gas_in_volume, is_in_range
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.integrator import OK, Outcome, Record
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory
from ltvpneu.models.nonlinear.rest import AT_EDGE, is_at_edge_of_band, rests_in_a_band, what_holds
from ltvpneu.models.nonlinear.runge_kutta import AdaptiveSettings, FixedSettings, Run, Settings, new_run
from ltvpneu.models.nonlinear.settle import integrate_period, settle
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic import bridge
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.physics.valve import check_duty

if TYPE_CHECKING:
    import control


@final
@dataclass(frozen=True, kw_only=True)
class DormandPrince(Value):
    """The adaptive method: step control, stick and slip located as events.

    Parameters
    ----------
    rtol : float
        Relative error tolerated in a step [-].
    """

    rtol: float = 1e-8

    def __post_init__(self) -> None:
        if not 1e-13 <= positive("rtol", self.rtol) < 1:
            raise ValueError(f"rtol: found {self.rtol:g}, expected 1e-13 to 1")


@final
@dataclass(frozen=True, kw_only=True)
class RungeKutta4(Value):
    """The paper's method: fourth order with a fixed step, stick and slip as they are at the end of a step.

    Parameters
    ----------
    steps_per_period : int
        Least number of steps in a valve period; each interval between switching instants has a whole number of them.
    """

    steps_per_period: int = 1000

    def __post_init__(self) -> None:
        whole("steps_per_period", self.steps_per_period)


Method = DormandPrince | RungeKutta4


# Where pressures meet the slope of the flow is infinite, and steps that resolve small differences multiply: of an orbit
# pressures need not be right to less than 1e-7 of the supply; what is differenced is asked for more tightly.
LEAST_PRESSURE_TOLERANCE, TIGHTER = 1e-7, 100.0
REPEATS = 1e3
"""How well an orbit of several periods repeats once more at least, over the tolerance [-]."""
MAX_STEPS = 5_000_000
"""Steps that a period may take before the integration is given up."""


def nonlinear_orbit(
    machine: Machine,
    frequency: float,
    initial_state: ArrayLike | None = None,
    *,
    method: Method = DormandPrince(),
    max_periods: int = 5000,
    tolerance: float = 1e-7,
) -> Orbit:
    """Return the periodic orbit that the machine settles on.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency Omega_p [Hz].
    initial_state : array_like, shape (n_states,), optional
        Start [m, m/s, Pa]; by default at rest at zero, all chambers at exhaust pressure.
    method : DormandPrince or RungeKutta4
        Adaptive with located events, or the paper's fixed step.
    max_periods : int
        Valve periods to simulate before giving up.
    tolerance : float
        Estimated distance from the orbit, relative to the machine's state scales [-], at which the state counts as
        periodic. The estimate divides the closure by one minus the observed contraction.

    Returns
    -------
    Orbit
        Over `n_periods` valve periods, the least number after which it repeats. `is_isolated` is false where the piston
        rests within a stiction band, or creeps to its edge by less than the tolerance; `rest` says what holds it.
        `residual` is the scaled closure of the period map. Other starts may lead to other orbits: see `attractors`.

    Raises
    ------
    NotSettledError
        The state did not repeat; the error carries the residual.
    ChamberVolumeError
        The piston swept a chamber's volume down to zero.
    ValueError
        Frequency or initial state out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990").with_duty(0.86)
    >>> lp.nonlinear_orbit(machine, frequency=5.4).n_periods
    2
    """
    period = 1 / positive("frequency", frequency, "Hz")
    machine, settings = machine.at(frequency), _settings(machine, period, method)
    start = _initial_state(machine, initial_state)
    run = new_run(machine.record, settings, pieces_of(machine.openings, period))
    scales = machine.state_scales
    max_periods, n_simulated = whole("max_periods", max_periods), 0
    while True:
        found = settle(start, run, scales, positive("tolerance", tolerance), max_periods - n_simulated)
        n_simulated += found.n_simulated
        if found.last.status != OK:
            elapsed = (n_simulated - 1) * period + found.last.time
            raise_stopped(machine, found.last.status, elapsed, found.last.state)
        if found.n_periods == 1:
            orbit = _orbit(machine, period, [found.last.record], (n_simulated, found.residual))
            if orbit.is_isolated and is_at_edge_of_band(machine, run, orbit, float(tolerance)):
                return replace(orbit, is_isolated=False, rest=AT_EDGE)
            return orbit
        residual, start = found.residual, found.last.state
        if found.n_periods > 1:
            records, start = _go_round(start, run, found.n_periods)
            residual = float(np.max(np.abs(start - found.last.state) / scales))
            # What is chaotic comes near an earlier state by chance, and does not once more.
            if residual <= REPEATS * tolerance:
                return _orbit(machine, period, records, (n_simulated, residual))
            n_simulated += found.n_periods
        if n_simulated >= max_periods:
            raise NotSettledError(
                f"no periodic orbit after {n_simulated} valve periods: the scaled state still changes by "
                f"{residual:.1e} (tolerance {tolerance:.1e}). {_why_not_settled(machine, found.last)}",
                residual=residual,
                n_simulated=n_simulated,
                last_state=start,
            )


def _go_round(state: FloatArray, run: Run, n_periods: int) -> tuple[list[Record], FloatArray]:
    """Return what the next valve periods are, and the state after them."""
    records: list[Record] = []
    for _ in range(n_periods):
        outcome = integrate_period(state, run)
        state = outcome.state
        records.append(outcome.record)
    return records, state


def _why_not_settled(machine: Machine, last: Outcome) -> str:
    """Return the likely cause and what to do."""
    free = np.isinf([machine.cylinder.lower_stop, machine.cylinder.upper_stop]).any()
    if machine.load.spring_stiffness == 0:
        moved = float(last.state[0] - last.record.coefficients[0, 0, 0])
        without = " and without both end stops" if free else ""
        remedy = "Give it a spring or end stops." if free else "Raise max_periods until it reaches an end stop."
        return (
            f"There is a piston without a spring (load.spring_stiffness is 0){without}: in the last period its "
            f"position moved by {moved:+.3g} m. {remedy}"
        )
    return "It may decay slowly (raise max_periods) or be chaotic (look at lp.simulate)."


def simulate(  # noqa: PLR0913 - one call for one transient
    machine: Machine,
    frequency: float,
    n_periods: int = 10,
    initial_state: ArrayLike | None = None,
    duty_by_period: Sequence[float] | None = None,
    *,
    points_per_period: int = 200,
    method: Method = DormandPrince(),
) -> "control.TimeResponseData":
    """Return the transient of the nonlinear model over a number of valve periods.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    n_periods : int
    initial_state : array_like, shape (n_states,), optional
        As for `nonlinear_orbit`.
    duty_by_period : sequence of float, shape (n_periods,), optional
        Duty cycle of each period; by default the machine's own throughout.
    points_per_period : int
        Evenly spaced times returned per period; the switching instants are added.
    method : DormandPrince or RungeKutta4
        As for `nonlinear_orbit`.

    Returns
    -------
    control.TimeResponseData
        States as outputs, by name.

    Raises
    ------
    ChamberVolumeError, IntegrationError
        The equations could not be integrated on.
    ValueError
        Arguments out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> response = lp.simulate(lp.load_machine("kunt_singh_1990"), frequency=4.0, n_periods=2)
    >>> print(f"{float(response.time[-1])} s")
    0.5 s
    """
    period = 1 / positive("frequency", frequency, "Hz")
    n_periods, machine = whole("n_periods", n_periods), machine.at(frequency)
    settings = _settings(machine, period, method)
    state = _initial_state(machine, initial_state)
    machines = [machine] * n_periods
    if duty_by_period is not None:
        if len(duty_by_period) != n_periods:
            raise ValueError(f"duty_by_period: found {len(duty_by_period)} values, expected n_periods = {n_periods}")
        duties = [check_duty(duty, f"duty_by_period[{i}]") for i, duty in enumerate(duty_by_period)]
        by_duty = {duty: machine.with_duty(duty) for duty in set(duties)}
        machines = [by_duty[duty] for duty in duties]
    even = np.linspace(0.0, period, whole("points_per_period", points_per_period) + 1)
    times, states = [], []
    for number, present in enumerate(machines):
        pieces = pieces_of(present.openings, period)
        outcome = integrate_period(state, new_run(present.record, settings, pieces))
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, number * period + outcome.time, outcome.state)
        local = np.union1d(even, pieces["begin"])[:-1]
        times.append(number * period + local)
        states.append(trajectory_of(outcome.record).at(local).T)
        state = outcome.state
    times.append(np.array([n_periods * period]))
    states.append(state[None])
    values = np.concatenate(states).T
    return bridge.time_response(np.concatenate(times), (machine.states, values), (machine.states, values), machine.name)


def _settings(machine: Machine, period: float, method: Method) -> Settings:
    if isinstance(method, RungeKutta4):
        return FixedSettings(period / method.steps_per_period, MAX_STEPS)
    return integration_settings(machine, method.rtol)


def integration_settings(machine: Machine, rtol: float) -> AdaptiveSettings:
    """Return the adaptive method's settings for a relative tolerance."""
    scales = machine.state_scales
    atol = rtol * scales
    pressures = slice(2, 2 + machine.n_volumes)
    atol[pressures] = max(rtol, min(LEAST_PRESSURE_TOLERANCE, TIGHTER * rtol)) * scales[pressures]
    return AdaptiveSettings(float(rtol), MAX_STEPS, atol)


def _initial_state(machine: Machine, initial_state: ArrayLike | None) -> FloatArray:
    if initial_state is None:
        return machine.rest_state.copy()
    state = finite_array("initial_state", initial_state, (len(machine.states),)).copy()
    check_state(machine, state, "initial_state")
    return state


def check_state(machine: Machine, state: FloatArray, name: str) -> None:
    """Raise unless the machine's equations hold at a state, (n,); `name` is what the caller calls it."""
    cylinder = machine.cylinder
    if not cylinder.lower_stop <= state[0] <= cylinder.upper_stop:
        raise ValueError(
            f"{name}: found position {state[0]:g} m, expected it between the end stops "
            f"({cylinder.lower_stop:g} to {cylinder.upper_stop:g} m)"
        )
    count, record = machine.n_volumes, machine.record
    for i, label in enumerate(machine.states[2:]):
        positive(f"{name}: {label}", state[2 + i], "Pa" if i < count else "K")
    for k, chamber in enumerate(machine.volumes):
        volume = chamber_volume(k, float(state[0]), record)
        positive(f"{name}: volume of {chamber} at position {state[0]:g} m", volume, "m^3")
        here = gas_in_volume(k, state, record)
        if not is_in_range(here, record):
            raise ValueError(
                f"{name}: found {chamber} at {here.pressure:g} Pa and {here.temperature:g} K, expected it where "
                f"the laws of the medium hold: {machine.gas.limits}"
            )


def joined(records: Sequence[Record], period: float) -> Record:
    """Return the records of consecutive periods as one."""
    if len(records) == 1:
        return records[0]
    return Record(
        starts=np.concatenate([number * period + record.starts for number, record in enumerate(records)]),
        spans=np.concatenate([record.spans for record in records]),
        modes=np.concatenate([record.modes for record in records]),
        # Numbered on through all periods: with one piece a turn, a new period is the only sign of it.
        pieces=np.concatenate(
            [number * (record.pieces[-1] + 1) + record.pieces for number, record in enumerate(records)]
        ),
        coefficients=np.concatenate([record.coefficients for record in records]),
    )


def trajectory_of(record: Record) -> PolynomialTrajectory:
    """Return what a record holds as a trajectory."""
    return PolynomialTrajectory(starts=record.starts, spans=record.spans, coefficients=record.coefficients)


def _orbit(machine: Machine, period: float, records: list[Record], reached: tuple[int, float]) -> Orbit:
    record = joined(records, period)
    modes, pieces = record.modes, record.pieces
    first = np.ones(modes.size, dtype=np.bool_)
    first[1:] = (modes[1:] != modes[:-1]) | (pieces[1:] != pieces[:-1])
    begins = first.nonzero()[0]
    step_times = np.empty(begins.size + 1)
    step_times[:-1], step_times[-1] = record.starts[begins], len(records) * period
    trajectory = trajectory_of(record)
    n_simulated, residual = reached
    states = trajectory.coefficients[:, 0].copy()
    return Orbit(
        system_period=period,
        n_periods=len(records),
        step_times=read_only(step_times),
        step_states=read_only(record.coefficients[begins, 0]),
        step_labels=tuple(step_label(machine, mode) for mode in modes[begins].tolist()),
        trajectory=trajectory,
        states=machine.states,
        outputs=machine.states,
        is_isolated=not rests_in_a_band(machine, states, modes),
        residual=float(residual),
        n_simulated=n_simulated,
        name=machine.name,
        rest=what_holds(machine, states, modes),
    )


def step_label(machine: Machine, mode: int) -> str:
    """Return what a step of an orbit is, for readers."""
    if mode == STUCK:
        return "stuck"
    if not machine.has_dry_friction:
        return "free"
    return "moves up" if mode > 0 else "moves down"


def mode_labelled(label: str) -> int:
    """Return the mode of motion that `step_label` names; without dry friction either direction serves."""
    return {"stuck": STUCK, "moves down": -1}.get(label, 1)
