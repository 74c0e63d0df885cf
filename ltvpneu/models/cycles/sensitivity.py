r"""Derivatives of a cycle over duty, frequency and machine parameters, through the operating points.

A cycle starts at a fixed point z = P(z, theta) of the map over its period, and has figures Q(z, theta): least and
greatest values, means. So

.. math:: \frac{dQ}{d\theta} = Q_\theta + Q_z (I - P_z)^{-1} P_\theta

P is the nonlinear model's period, or the march of an LTV model whose every step finds its operating point anew: then
the derivative goes through the operating points. With those frozen, d(amplitude)/d(duty) of Table 1 at 15 Hz even has
the wrong sign. The partial derivatives are central differences of one period; nothing is solved for again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.errors import NonUniqueOrbitError, NotConvergedError
from ltvpneu.models.cycles.turns import (
    TOLERANCE,
    Jacobians,
    figures_of,
    march_beside,
    nonlinear_turn,
    slopes_along_turn,
)
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.own_cycle import MAX_PERIODS, Found, retabled, trajectory_of_steps
from ltvpneu.models.linear.plan import new_steps
from ltvpneu.models.linear.repeat import repeat_march
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.parameters import present_value
from ltvpneu.models.nonlinear.method import DormandPrince
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.polynomial import trajectory_of
from ltvpneu.periodic.orbits.orbit import Orbit, Trajectory
from ltvpneu.periodic.systems.signals import signal_index

PARAMETERS = ("duty", "frequency", "supply_pressure", "exhaust_pressure")
"""What derivatives are taken over by default."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ParameterSensitivity(Value):
    """Derivatives of a cycle's figures, one column a parameter, in SI units."""

    parameters: tuple[str, ...]
    values: FloatArray
    """Of the parameters, where the derivatives are taken, (n_parameters,)."""
    states: tuple[str, ...]
    minima: FloatArray
    """(n_states, n_parameters)"""
    maxima: FloatArray
    means: FloatArray
    initial_state: FloatArray
    """Of the state at the start of the period, (n_states, n_parameters)."""

    def __repr__(self) -> str:
        return f"<ParameterSensitivity of {', '.join(self.states)} over {', '.join(self.parameters)}>"

    def amplitude(self, state: str | int, parameter: str) -> float:
        """Return d(amplitude)/d(parameter)."""
        row, column = self._place(state, parameter)
        return float(self.maxima[row, column] - self.minima[row, column]) / 2

    def mean(self, state: str | int, parameter: str) -> float:
        """Return d(mean)/d(parameter)."""
        return float(self.means[self._place(state, parameter)])

    def minimum(self, state: str | int, parameter: str) -> float:
        """Return d(least value)/d(parameter)."""
        return float(self.minima[self._place(state, parameter)])

    def maximum(self, state: str | int, parameter: str) -> float:
        """Return d(greatest value)/d(parameter)."""
        return float(self.maxima[self._place(state, parameter)])

    def _place(self, state: str | int, parameter: str) -> tuple[int, int]:
        if parameter not in self.parameters:
            raise ValueError(f"parameter: found {parameter!r}, expected one of {', '.join(self.parameters)}")
        return signal_index(self.states, state), self.parameters.index(parameter)


def parameter_sensitivity(model: LtvModel, parameters: Sequence[str] = PARAMETERS) -> ParameterSensitivity:
    """Return the derivatives of a fitted or self-consistent model's cycle, through its operating points.

    Parameters
    ----------
    model : LtvModel
        Of `ltv_model` with operating points "fitted" or "self-consistent".
    parameters : sequence of str
        "duty", "frequency" [Hz], "offset_angle" [rad], where the valve's pulses open and close, "on_1", "off_1",
        "on_2", ... [rad], or the way to any number of the machine: "supply_pressure", "load.mass",
        "cylinder.dead_volume_1", "flow_paths.0.area", "more_valves.0.start", ...

    Raises
    ------
    ValueError
        The model's operating points are not those of its own cycle, or a parameter is unknown.
    NonUniqueOrbitError
        The piston rests in a stiction band: where, is not decided by the parameters.
    NotConvergedError
        The cycle was not found to the accuracy that differences ask for.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), 4.0, operating_points="fitted")
    >>> found = lp.parameter_sensitivity(model, ["load.spring_stiffness"])
    >>> print(f"{1e6 * found.mean('position', 'load.spring_stiffness'):.0f} um m/N")
    -25 um m/N
    """
    _expect_names(parameters)
    found = model.found
    if not isinstance(found, Found):
        raise ValueError(
            f'model: found operating points {model.mode!r}, expected "fitted" or "self-consistent": others do not '
            "follow the cycle. With operating points frozen, lp.sensitivity(model.system) has the derivatives"
        )
    machine, scales = model.machine, model.machine.state_scales
    _expect_unique(model.orbit)
    n_periods = found.repeated.n_periods

    def period(start: FloatArray, machine: Machine, frequency: float) -> tuple[FloatArray, Trajectory]:
        question = replace(found.question, machine=machine, frequency=frequency)
        cells = retabled(found.cells, model.machine.openings, machine.openings)
        end, parts = march_beside(start, question, cells, n_periods)
        return end, trajectory_of_steps(machine, parts)

    plan = found.question.plan(found.cells, TOLERANCE)
    steps = new_steps(plan)
    start = np.append(model.orbit.initial_state / scales, 1.0)
    tight = repeat_march(start, plan, steps, 10 * TOLERANCE, MAX_PERIODS)
    if tight.n_periods == 0:
        raise NotConvergedError(
            f"the cycle at {model.frequency:g} Hz closes to {tight.residual:.1e} only, too little to take differences",
            residual=tight.residual,
            iterations=tight.n_marched,
        )
    at = machine, model.frequency, tight.start[:-1] * scales
    return _along_the_cycle(slopes_along_turn(figures_of(period), at, parameters), machine, model.frequency, parameters)


def nonlinear_sensitivity(
    machine: Machine, frequency: float, parameters: Sequence[str] = PARAMETERS
) -> ParameterSensitivity:
    """Return the derivatives of the nonlinear model's orbit; parameters and errors as of `parameter_sensitivity`."""
    expect_machine(machine)
    machine = machine.at(frequency)
    orbit = nonlinear_orbit(machine, frequency, method=DormandPrince(rtol=TOLERANCE))
    return _along_the_cycle(nonlinear_jacobians(machine, frequency, orbit, parameters), machine, frequency, parameters)


def nonlinear_jacobians(machine: Machine, frequency: float, orbit: Orbit, parameters: Sequence[str]) -> Jacobians:
    """Return how one turn of the nonlinear machine's orbit depends on its start and on parameters."""
    _expect_names(parameters)
    _expect_unique(orbit)
    machine = machine.at(frequency)

    def period(start: FloatArray, machine: Machine, frequency: float) -> tuple[FloatArray, Trajectory]:
        state, record = nonlinear_turn(start, machine, frequency, orbit.n_periods)
        return state, trajectory_of(record)

    return slopes_along_turn(figures_of(period), (machine, float(frequency), orbit.initial_state.copy()), parameters)


def _expect_names(parameters: Sequence[str]) -> None:
    if isinstance(parameters, str):
        raise TypeError(f"parameters: found {parameters!r}, expected a list of names, such as [{parameters!r}]")
    names: list[Any] = list(parameters)
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"parameters: found {name!r} of type {type(name).__name__}, expected names")


def _expect_unique(orbit: Orbit) -> None:
    if not orbit.is_isolated:
        direction = np.zeros((len(orbit.states), 1))
        direction[0] = 1.0
        raise NonUniqueOrbitError(
            "the piston rests in a stiction band, so where it rests is not decided by the parameters: see "
            "lp.stiction_band",
            least_norm=orbit.initial_state,
            free_directions=direction,
        )


def _along_the_cycle(
    jacobians: Jacobians, machine: Machine, frequency: float, parameters: Sequence[str]
) -> ParameterSensitivity:
    by_state, by_parameter = jacobians
    scales, n = machine.state_scales, len(machine.states)
    # Scaled, for the states span seven decades.
    left = np.eye(n) - by_state[0] * scales / scales[:, None]
    by_start = scales[:, None] * np.linalg.solve(left, by_parameter[0] / scales[:, None])
    total = by_parameter + by_state @ by_start
    return ParameterSensitivity(
        parameters=tuple(parameters),
        values=read_only(np.array([present_value(machine, frequency, name) for name in parameters])),
        states=machine.states,
        minima=read_only(total[1]),
        maxima=read_only(total[2]),
        means=read_only(total[3]),
        initial_state=read_only(by_start),
    )
