"""The nonlinear model (3)-(7): transient simulation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, positive, whole
from ltvpneu._clock import deadline
from ltvpneu.models.machine.dynamics import chamber_volume, gas_in_volume, is_in_range
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import DEFAULT, Method, settings_of
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import trajectory_of
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.systems import bridge
from ltvpneu.physics.valve import check_duty

if TYPE_CHECKING:
    import control


def simulate(  # noqa: PLR0913 - one call for one transient
    machine: Machine,
    frequency: float,
    n_periods: int = 10,
    initial_state: ArrayLike | None = None,
    duty_by_period: Sequence[float] | None = None,
    *,
    points_per_period: int = 200,
    method: Method = DEFAULT,
    max_seconds: float | None = None,
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
    max_seconds : float, optional
        As for `nonlinear_orbit`.

    Returns
    -------
    control.TimeResponseData
        States as outputs, by name.

    Raises
    ------
    ChamberVolumeError, IntegrationError
        The equations could not be integrated on.
    TimeLimitError
        `max_seconds` are over.
    ValueError
        Arguments out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> response = lp.simulate(lp.load_machine("kunt_singh_1990"), frequency=4.0, n_periods=2)
    >>> print(f"{float(response.time[-1])} s")
    0.5 s
    """
    expect_machine(machine)
    period, end = 1 / positive("frequency", frequency, "Hz"), deadline(max_seconds)
    n_periods, machine = whole("n_periods", n_periods), machine.at(frequency)
    settings = settings_of(machine, period, method)
    state = initial_state_of(machine, initial_state)
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
        outcome = integrate_period(state, new_run(present.record, settings, pieces), end)
        if end is not None:
            end.check(f"{number + 1} of {n_periods} valve periods simulated")
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


def initial_state_of(machine: Machine, initial_state: ArrayLike | None) -> FloatArray:
    """Return where a simulation starts: the state given, checked, or rest at exhaust pressure."""
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
