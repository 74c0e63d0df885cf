r"""Derivatives of a cycle over duty, frequency and machine parameters, through the operating points.

A cycle starts at a fixed point z = P(z, theta) of the map over its period, and has figures Q(z, theta): least and
greatest values, means. So

.. math:: \frac{dQ}{d\theta} = Q_\theta + Q_z (I - P_z)^{-1} P_\theta

P is the nonlinear model's period, or the march of an LTV model whose every step finds its operating point anew: then
the derivative goes through the operating points. With those frozen, d(amplitude)/d(duty) of Table 1 at 15 Hz even has
the wrong sign. The partial derivatives are central differences of one period; nothing is solved for again.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray, positive, read_only
from ltvpneu._values import Value
from ltvpneu.errors import NonUniqueOrbitError, NotConvergedError
from ltvpneu.models.events import at_stop
from ltvpneu.models.integrator import OK, Record, integrate_period
from ltvpneu.models.linearize import LtvModel
from ltvpneu.models.machine import Machine
from ltvpneu.models.march import Steps, march_period
from ltvpneu.models.nonlinear import (
    DormandPrince,
    integration_settings,
    joined,
    nonlinear_orbit,
    schedule_of,
    trajectory_of,
)
from ltvpneu.models.own_cycle import MAX_PERIODS, Found, Question, new_steps, retabled, trajectory_of_steps
from ltvpneu.models.repeat import repeat_march
from ltvpneu.models.runge_kutta import Run
from ltvpneu.models.stopped import raise_stopped
from ltvpneu.periodic.orbit import Orbit, Trajectory, signal_index
from ltvpneu.physics.proportional import Command
from ltvpneu.physics.window import Pulses

PARAMETERS = ("duty", "frequency", "supply_pressure", "exhaust_pressure")
"""What derivatives are taken over by default."""
STEP = 1e-4
"""Relative step of the difference quotients over parameters; duty and angles: absolute [-]."""
STATE_STEP = 1e-5
"""Step over the scaled states of the cycle's start [-]."""
TOLERANCE = 1e-10
"""Of the integrations that are differenced [-]."""

Period = Callable[[FloatArray, Machine, float], tuple[FloatArray, Trajectory]]
"""From a start, a machine and a frequency to the end of the cycle and the way there."""
TurnFigures = Callable[[FloatArray, Machine, float], FloatArray]
"""Likewise, to figures of it."""


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


class Jacobians(NamedTuple):
    """Of figures of a turn; by default its end, minima, maxima and means, in this order, (4, n)."""

    by_state: FloatArray
    """Over the start, (4, n, n)."""
    by_parameter: FloatArray
    """With the start kept, (4, n, n_parameters)."""


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

    plan, steps = found.question.plan(found.cells, TOLERANCE), new_steps(found.question, found.cells)
    start = np.append(model.orbit.initial_state / scales, 1.0)
    tight = repeat_march(start, plan, steps, 10 * TOLERANCE, MAX_PERIODS)
    if tight.n_periods == 0:
        raise NotConvergedError(
            f"the cycle at {model.frequency:g} Hz closes to {tight.residual:.1e} only, too little to take differences",
            residual=tight.residual,
            iterations=tight.n_marched,
        )
    at = machine, model.frequency, tight.start[:-1] * scales
    return _along_the_cycle(
        slopes_along_turn(_figures_of(period), at, parameters), machine, model.frequency, parameters
    )


def march_beside(
    start: FloatArray, question: Question, cells: FloatArray, n_periods: int
) -> tuple[FloatArray, list[Steps]]:
    """March a fitted or self-consistent model over some periods, tightly; return the end and each period's steps.

    Raises
    ------
    NotConvergedError
        The march did not come through.
    """
    plan, steps = question.plan(cells, TOLERANCE), new_steps(question, cells)
    scales = question.machine.state_scales
    state, parts = np.append(start / scales, 1.0), list[Steps]()
    for _ in range(n_periods):
        marched = march_period(state, plan, steps)
        if marched.status != OK:
            raise NotConvergedError(
                f"the march next to the {question.mode} model's cycle at {question.frequency:g} Hz did not come "
                "through, so it has no derivative here; take it elsewhere, or of the nonlinear model",
                residual=marched.defect,
                iterations=1,
            )
        parts.append(Steps(*(part[: marched.n_steps].copy() for part in steps)))
        state = marched.state
    return state[:-1] * scales, parts


def nonlinear_sensitivity(
    machine: Machine, frequency: float, parameters: Sequence[str] = PARAMETERS
) -> ParameterSensitivity:
    """Return the derivatives of the nonlinear model's orbit; parameters and errors as of `parameter_sensitivity`."""
    orbit = nonlinear_orbit(machine, frequency, method=DormandPrince(rtol=TOLERANCE))
    return _along_the_cycle(nonlinear_jacobians(machine, frequency, orbit, parameters), machine, frequency, parameters)


def nonlinear_jacobians(machine: Machine, frequency: float, orbit: Orbit, parameters: Sequence[str]) -> Jacobians:
    """Return how one turn of the nonlinear machine's orbit depends on its start and on parameters."""
    _expect_names(parameters)
    _expect_unique(orbit)

    def period(start: FloatArray, machine: Machine, frequency: float) -> tuple[FloatArray, Trajectory]:
        state, record = nonlinear_turn(start, machine, frequency, orbit.n_periods)
        return state, trajectory_of(record)

    return slopes_along_turn(_figures_of(period), (machine, float(frequency), orbit.initial_state.copy()), parameters)


def nonlinear_turn(start: FloatArray, machine: Machine, frequency: float, n_periods: int) -> tuple[FloatArray, Record]:
    """Integrate the nonlinear model over some periods, tightly; return where it gets to and the way there."""
    run = Run(schedule_of(machine, 1 / frequency), machine.arrays, integration_settings(machine, TOLERANCE))
    state, records = start, list[Record]()
    for number in range(n_periods):
        outcome = integrate_period(state, run, True)
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, number / frequency + outcome.time, outcome.state)
        records.append(outcome.record)
        state = outcome.state
    return state, joined(records, 1 / frequency)


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


def _figures_of(period: Period) -> TurnFigures:
    def figures(start: FloatArray, machine: Machine, frequency: float) -> FloatArray:
        end, trajectory = period(start, machine, frequency)
        n = end.size
        extremes = np.array([trajectory.extremes(i) for i in range(n)])
        return np.array([end, extremes[:, 0], extremes[:, 1], trajectory.means()[:n]])

    return figures


def slopes_along_turn(
    figures: TurnFigures, at: tuple[Machine, float, FloatArray], parameters: Sequence[str]
) -> Jacobians:
    """Return how figures of a turn, of any shape, depend on its start and on parameters: one more axis, the last."""
    machine, frequency, start = at
    scales, n = machine.state_scales, len(machine.states)
    by_state: list[FloatArray] = []
    away = -at_stop(float(start[0]), machine.arrays)
    for j in range(n):
        move = np.zeros(n)
        move[j] = STATE_STEP * scales[j]
        if away and j < 2:
            # Beyond a stop there is no motion: the derivative is that into the stroke, of second order too.
            move *= away
            here, near, far = (figures(start + steps * move, machine, frequency) for steps in (0, 1, 2))
            by_state.append((4 * near - far - 3 * here) / (2 * move[j]))
            continue
        up, down = figures(start + move, machine, frequency), figures(start - move, machine, frequency)
        by_state.append((up - down) / (2 * move[j]))
    by_parameter: list[FloatArray] = []
    for name in parameters:
        (up, down), width = _moved(machine, frequency, name)
        by_parameter.append((figures(start, *up) - figures(start, *down)) / width)
    empty = np.empty((*by_state[0].shape, 0))
    return Jacobians(np.stack(by_state, axis=-1), np.stack(by_parameter, axis=-1) if by_parameter else empty)


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


def present_value(machine: Machine, frequency: float, name: str) -> float:
    """Return a parameter's value.

    Raises
    ------
    ValueError
        The machine has no number of that name.
    """
    if name == "frequency":
        return positive("frequency", frequency, "Hz")
    if name == "duty":
        return machine.duty
    if name == "offset_angle":
        angle = float(getattr(machine.valve, "offset_angle", math.nan))
        if math.isnan(angle):
            raise ValueError("parameters: found 'offset_angle' of an on-off valve, expected 'duty'")
        return angle
    edge = pulse_edge(name)
    if edge is not None:
        edges = pulse_edges(machine)
        if edge >= len(edges):
            follows = "" if edges else ": it is proportional and follows its command, as 'valve.command.angles.0'"
            raise ValueError(f"parameters: found {name!r}, but the valve has {len(edges) // 2} pulses{follows}")
        return edges[edge]
    return _value(machine, name.split("."), name)


def with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return the machine with parameters at other values; a "frequency" among them is no part of it."""
    edges = list(pulse_edges(machine)) if any(pulse_edge(name) is not None for name in values) else []
    for name, value in values.items():
        edge = pulse_edge(name)
        if edge is not None:
            edges[edge] = value
        elif name == "duty":
            machine = machine.with_duty(value)
        elif name == "offset_angle":
            machine = machine.with_offset(value)
        elif name != "frequency":
            machine = _replaced(machine, name.split("."), value)
    return machine.with_pulses(list(zip(edges[::2], edges[1::2], strict=True))) if edges else machine


def pulse_edge(name: str) -> int | None:
    """Return which edge of the pulses a parameter is, from 0, if it is one: "on_1" is 0, "off_1" 1, and so on."""
    found = re.fullmatch(r"(on|off)_([1-9][0-9]*)", name)
    return None if found is None else 2 * (int(found[2]) - 1) + (found[1] == "off")


def pulse_edges(machine: Machine) -> tuple[float, ...]:
    """Return the angles at which the valve goes on and off in turn [rad]; a proportional one has none."""
    on = machine.valve.on_window()
    if isinstance(on, Command):
        return ()
    return on.edges if isinstance(on, Pulses) else (on.start, on.start + on.width)


def _moved(machine: Machine, frequency: float, name: str) -> tuple[tuple[tuple[Machine, float], ...], float]:
    """Return machine and frequency with a parameter a little above and below, and the difference."""
    value = present_value(machine, frequency, name)
    if name == "frequency":
        step = STEP * value
        return ((machine, frequency + step), (machine, frequency - step)), 2 * step
    high, low = around(name, value)
    return tuple((with_values(machine, {name: moved}), frequency) for moved in (high, low)), high - low


def around(name: str, value: float) -> tuple[float, float]:
    """Return values of a parameter a little above and below, on one side only where it can go no further."""
    step = STEP * (abs(value) if value and not is_angle(name) else 1.0)
    high, low = value + step, value - step
    if name == "duty":
        return min(high, 1.0), max(low, 0.0)
    if re.fullmatch(r".*command\.openings\.[0-9]+", name):
        return min(high, 1.0), max(low, -1.0)
    return high, low


def is_angle(name: str) -> bool:
    """Whether a parameter is an angle of the valve [rad], or its duty [-]: of the size of one, whatever its value."""
    last = name.rpartition(".")[2]
    return last in ("duty", "offset_angle", "start", "width") or pulse_edge(name) is not None


def _value(part: Any, path: Sequence[str], name: str) -> float:
    for key in path:
        if isinstance(part, tuple) and key.isdigit() and int(key) < len(part):
            part = part[int(key)]
            continue
        known = [field.name for field in fields(part)] if is_dataclass(part) else []
        if key not in known:
            raise ValueError(
                f"parameters: found {name!r}, but there is no {key!r} there; expected one of "
                f"{', '.join(known) or 'nothing further'}, or duty, frequency, offset_angle"
            )
        part = getattr(part, key)
    if isinstance(part, bool) or not isinstance(part, float | int) or not math.isfinite(part):
        raise ValueError(f"parameters: found {name!r}, which is {part!r}; expected the name of a finite number")
    return float(part)


def _replaced(part: Any, path: Sequence[str], value: float) -> Any:
    key, rest = path[0], path[1:]
    if isinstance(part, tuple):
        inner = _replaced(part[int(key)], rest, value) if rest else value
        return (*part[: int(key)], inner, *part[int(key) + 1 :])
    return replace(part, **{key: _replaced(getattr(part, key), rest, value) if rest else value})
