"""Feedback through the duty cycle: the sampled small-signal model, and the nonlinear machine under a controller.

A controller acts once a period: it sees the state at the period's start and the means of the last one, and sets the
duty of the next. The small-signal model is the derivative of the nonlinear machine's map over one period about its
orbit, stick and slip included, by central differences of integrations at a tolerance of 1e-10.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, cast, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, finite_array, positive, read_only
from ltvpneu._values import Value
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.models.cycles.sensitivity import nonlinear_jacobians
from ltvpneu.models.cycles.turns import TOLERANCE
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import DormandPrince, integration_settings
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory, trajectory_of
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.systems import bridge

if TYPE_CHECKING:
    import control

INPUTS = {"duty": "duty", "supply_pressure": "supply_pressure", "load_force": "load.force"}
"""Inputs of the small-signal model, and the machine's parameters that they are."""
SIMULATION_TOLERANCE = 1e-7
POINTS_PER_PERIOD = 50


def duty_model(
    machine: Machine,
    frequency: float,
    duty: float | None = None,
    *,
    inputs: Sequence[str] = ("duty", "supply_pressure", "load_force"),
) -> "control.StateSpace":
    """Return how the machine answers to small changes from period to period, about its orbit.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz]; the model's dt is the period.
    duty : float, optional
        Operating point; the machine's own by default.
    inputs : sequence of str
        Of "duty", "supply_pressure" [Pa] and "load_force" [N], constant through each period.

    Returns
    -------
    control.StateSpace
        States: the machine's, at the start of each period. Outputs: "position" there [m], "mean_position" over the
        period [m], and "force", the mean push of the pressures on the piston [N]. All are deviations from the orbit.

    Raises
    ------
    NonUniqueOrbitError
        Stiction holds the piston: small changes do not move it.
    ValueError
        Unknown inputs, or an orbit that repeats only after several periods.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> model = design.duty_model(lp.load_machine("kunt_singh_1990"), 15.0, 0.5, inputs=["duty"])
    >>> print(f"{1e3 * model.dcgain()[1, 0]:.0f} mm per unit of duty")
    108 mm per unit of duty
    """
    expect_machine(machine)
    if duty is not None:
        machine = machine.with_duty(duty)
    for name in inputs:
        if name not in INPUTS:
            raise ValueError(f"inputs: found {name!r}, expected some of {', '.join(INPUTS)}")
    if not inputs:
        raise ValueError(f"inputs: found none, expected some of {', '.join(INPUTS)}")
    orbit = nonlinear_orbit(machine, frequency, method=DormandPrince(rtol=TOLERANCE))
    if orbit.n_periods > 1:
        raise ValueError(
            f"frequency: found an orbit that repeats every {orbit.n_periods} periods at {frequency:g} Hz and duty "
            f"{machine.duty:g}, about which there is no model of one period; choose another duty or frequency"
        )
    by_state, by_input = nonlinear_jacobians(machine, frequency, orbit, [INPUTS[name] for name in inputs])
    n = len(machine.states)
    pushes = np.zeros(n)
    pushes[2 : 2 + machine.n_volumes] = [volume.push_area for volume in machine.volume_fields]
    C = np.array([np.eye(n)[0], by_state[3][0], pushes @ by_state[3]])
    D = np.array([np.zeros(len(inputs)), by_input[3][0], pushes @ by_input[3]])
    names = machine.states, tuple(inputs), ("position", "mean_position", "force")
    name = f"{machine.identifier}_sampled"
    return bridge.state_space((by_state[0], by_input[0], C, D), names, name, 1 / frequency)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Measurement(Value):
    """What a controller sees at the start of a period."""

    number: int
    """Of the period, from 0."""
    time: float
    """[s]"""
    reference: float
    """Wanted mean position [m]."""
    mean_position: float
    """Over the last period [m]; at first, over one that the machine's own duty makes from the initial state."""
    state: FloatArray
    """(n_states,), now."""
    duty: float = math.nan
    """Share of the last period that the valve was open; at first, the machine's own; nan where it is not known."""


Controller = Callable[[Measurement], float]
"""From a measurement to the duty of the next period."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ClosedLoop(Value):
    """The nonlinear machine under a controller; one entry a period."""

    machine: Machine
    frequency: float
    """[Hz]"""
    references: FloatArray
    """Wanted mean positions [m]."""
    mean_positions: FloatArray
    """[m]"""
    commands: FloatArray
    """Duties that the controller asked for."""
    duties: FloatArray
    """Shares of the period that the valve was open: late by the delay, within the shortest pulses, its own lag off."""
    n_held_back: int
    """Periods in which the valve could not make what was asked for."""
    response: "control.TimeResponseData"
    """States over time."""

    def __repr__(self) -> str:
        return f"<ClosedLoop of {self.machine.name}: {self.references.size} periods of {1 / self.frequency:.4g} s>"

    def settling_periods(self, tolerance: float) -> list[int | None]:
        """Return, for each stretch of constant reference, after how many periods the mean stays within a tolerance [m].

        None where it does not come to stay.
        """
        positive("tolerance", tolerance, "m")
        starts = [0, *(np.flatnonzero(np.diff(self.references)) + 1).tolist(), self.references.size]
        found: list[int | None] = []
        for start, end in pairwise(starts):
            outside = np.flatnonzero(np.abs(self.mean_positions[start:end] - self.references[start:end]) > tolerance)
            after = int(outside[-1]) + 1 if outside.size else 0
            found.append(after if start + after < end else None)
        return found


def simulate_closed_loop(
    machine: Machine,
    controller: "Controller | control.StateSpace | control.TransferFunction",
    reference: float | Sequence[float] | FloatArray,
    frequency: float,
    *,
    valve: ValveLimits | None = None,
    initial_state: Sequence[float] | FloatArray | None = None,
) -> ClosedLoop:
    """Simulate the nonlinear machine, every switch hit, under a controller that sets the duty each period.

    Parameters
    ----------
    machine : Machine
        Its own duty is that of the periods before the controller's first command arrives.
    controller : callable, control.StateSpace or control.TransferFunction
        From a `Measurement` to a duty; or a discrete-time system of one input, the error of the mean position [m], and
        one output, which is added to the machine's duty. Its dt must be the period.
    reference : array_like, shape (n_periods,)
        Wanted mean position of each period [m].
    frequency : float
        [Hz]
    valve : ValveLimits, optional
        Shortest on- and off-times, and periods that a command is late.
    initial_state : array_like, shape (n_states,), optional
        At rest with the mean quasi-static pressures by default.

    Raises
    ------
    ValueError
        A command that is not a finite number, a controller of another dt, arguments out of range.
    """
    expect_machine(machine)
    period = 1 / positive("frequency", frequency, "Hz")
    wanted = finite_array("reference", np.atleast_1d(np.asarray(reference, dtype=np.float64)), (None,))
    if wanted.size == 0:
        raise ValueError("reference: found none, expected one for each period")
    valve = ValveLimits() if valve is None else valve
    least, most = valve.duties(frequency)
    law = controller if callable(controller) and not _is_system(controller) else _law(controller, machine.duty, period)
    settings = integration_settings(machine, SIMULATION_TOLERANCE)
    given = machine.rest_state if initial_state is None else initial_state
    state = finite_array("initial_state", given, (len(machine.states),)).copy()
    n, before = wanted.size, valve.open_share(min(max(machine.duty, least), most), frequency)

    def turn(start: FloatArray, duty: float, number: int) -> tuple[FloatArray, PolynomialTrajectory, FloatArray]:
        """Return the state after a period, the period itself, and the instants of its switches."""
        present = machine.with_duty(duty)
        pieces = pieces_of(present.at(frequency).openings, period)
        outcome = integrate_period(start, new_run(present.record, settings, pieces))
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, number * period + outcome.time, outcome.state)
        return outcome.state, trajectory_of(outcome.record), pieces["begin"]

    # A controller that sees means has none yet: a position between the ends of its swing would mislead it.
    mean = float(turn(state.copy(), before, 0)[1].means()[0])
    means, commands, duties = np.empty(n), np.empty(n), np.empty(n)
    times, states, n_held = [], [], 0
    for number in range(n):
        now = state.copy()
        measured = Measurement(
            number=number, time=number * period, reference=float(wanted[number]), mean_position=mean,
            state=read_only(now), duty=float(duties[number - 1]) if number else before,
        )  # fmt: skip
        commands[number] = finite(f"controller: at {number * period:g} s", float(cast(Controller, law)(measured)))
        late = number - valve.delay
        asked = float(commands[late]) if late >= 0 else machine.duty
        made = min(max(asked, least), most)
        n_held += made != asked
        duties[number] = valve.open_share(made, frequency)
        state, trajectory, begins = turn(state, float(duties[number]), number)
        mean = means[number] = float(trajectory.means()[0])
        local = np.union1d(np.linspace(0.0, period, POINTS_PER_PERIOD + 1), begins)[:-1]
        times.append(number * period + local)
        states.append(trajectory.at(local).T)
    times.append(np.array([n * period]))
    states.append(state[None])
    values = np.concatenate(states).T
    names = (machine.states, values)
    return ClosedLoop(
        machine=machine,
        frequency=float(frequency),
        references=wanted,
        mean_positions=read_only(means),
        commands=read_only(commands),
        duties=read_only(duties),
        n_held_back=int(n_held),
        response=bridge.time_response(np.concatenate(times), names, names, machine.name),
    )


def _is_system(controller: object) -> bool:
    return hasattr(controller, "dt") and (hasattr(controller, "A") or hasattr(controller, "num"))


def _law(system: Any, duty: float, period: float) -> Controller:
    if not _is_system(system):
        raise TypeError(
            f"controller: found {type(system).__name__}, expected a function of a Measurement, a control.StateSpace or "
            "a control.TransferFunction"
        )
    if system.dt is True or system.dt is None or not np.isclose(float(system.dt), period, rtol=1e-9):
        raise ValueError(f"controller: found dt = {system.dt}, expected the period, {period:g} s")
    system = bridge.as_state_space(system)
    A, B, C, D = (np.asarray(matrix, dtype=np.float64) for matrix in (system.A, system.B, system.C, system.D))
    if D.shape != (1, 1):
        raise ValueError(f"controller: found {D.shape[1]} inputs and {D.shape[0]} outputs, expected one of each")
    state = np.zeros(len(A))

    def law(measured: Measurement) -> float:
        nonlocal state
        error = measured.reference - measured.mean_position
        command = float((C @ state)[0] + D[0, 0] * error) if state.size else float(D[0, 0] * error)
        state = A @ state + B[:, 0] * error
        return duty + command

    return law
