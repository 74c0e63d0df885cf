"""The map of the nonlinear machine over its valve periods: where a state gets to, through which events, and how.

This is what orbits, moves and fits are built on: one turn from a state, its sequence of events, and its derivatives
over the state it starts from and over the machine's parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, positive, read_only, whole
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.parameters import moved
from ltvpneu.models.machine.piston import at_stop
from ltvpneu.models.nonlinear.integrator import OK, Record, joined, log_of
from ltvpneu.models.nonlinear.method import DormandPrince, Method, settings_of
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory, trajectory_of
from ltvpneu.models.nonlinear.runge_kutta import Run, new_run
from ltvpneu.models.nonlinear.simulation import check_state
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.models.nonlinear.variation import product_of, turn_maps

PARTS = 4
"""Parts that each interval of the integrator is taken in for a derivative."""
JUMP = 1e-9
"""Scaled velocity with which a stop is met, at least [-]."""


@final
@dataclass(frozen=True, kw_only=True)
class Event(Value):
    """A change of what the machine does."""

    time: float
    """Since the start of the turn [s]."""
    kind: str
    """"switches", "stops", "breaks away", "reverses", "meets the lower stop", "meets the upper stop"."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Turn(Value):
    """One or more valve periods from a state."""

    start: FloatArray
    """(n_states,) [m, m/s, Pa, K]"""
    end: FloatArray
    """(n_states,)"""
    machine: Machine
    record: Record

    def __repr__(self) -> str:
        return f"<Turn of {len(self.events)} events, position {self.start[0]:.6g} to {self.end[0]:.6g} m>"

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What happens on the way, in the order of time."""
        return _events(self.record, self.machine)

    @property
    def sequence(self) -> tuple[str, ...]:
        """Kinds of its events in the order of time: where two turns agree in it, the map is smooth between them."""
        return tuple(event.kind for event in self.events)

    @cached_property
    def trajectory(self) -> PolynomialTrajectory:
        """The way from start to end."""
        return trajectory_of(self.record)


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PeriodMap(Value):
    """The map of a machine over its valve periods, with derivatives.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    n_periods : int
        Valve periods of a turn.
    method : DormandPrince or RungeKutta4
        As of `nonlinear_orbit`. Derivatives are those of the equations, and agree with differences to a few 1e-5.

    Raises
    ------
    ValueError
        Frequency or number of periods out of range.

    Examples
    --------
    >>> import numpy as np
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> period = lp.PeriodMap(machine=machine, frequency=8.0)
    >>> turn = period.turn(lp.nonlinear_orbit(machine, 8.0).initial_state)
    >>> print(turn.sequence)
    ('reverses', 'switches', 'reverses')
    >>> derivative = period.derivative(turn)
    >>> print(f"{np.abs(np.linalg.eigvals(derivative)).max():.3f}")
    0.224
    """

    machine: Machine
    frequency: float
    n_periods: int = 1
    method: Method = field(default_factory=DormandPrince)

    def __post_init__(self) -> None:
        positive("frequency", self.frequency, "Hz")
        whole("n_periods", self.n_periods)

    def __repr__(self) -> str:
        periods = f", {self.n_periods} valve periods" if self.n_periods > 1 else ""
        return f"<PeriodMap of {self.machine.name} at {self.frequency:g} Hz{periods}>"

    @cached_property
    def _bound(self) -> Machine:
        return self.machine.at(self.frequency)

    @cached_property
    def _run(self) -> Run:
        period = 1 / self.frequency
        settings = settings_of(self._bound, period, self.method)
        return new_run(self._bound.record, settings, pieces_of(self._bound.openings, period))

    def turn(self, start: ArrayLike) -> Turn:
        """Return the turn from a state, shape (n_states,).

        Raises
        ------
        ValueError
            The machine's equations do not hold at the start.
        ChamberVolumeError, IntegrationError
            The equations could not be integrated on.
        """
        machine = self._bound
        first = finite_array("start", start, (len(machine.states),)).copy()
        check_state(machine, first, "start")
        state, records = first, list[Record]()
        for number in range(self.n_periods):
            outcome = integrate_period(state, self._run)
            if outcome.status != OK:
                raise_stopped(machine, outcome.status, number / self.frequency + outcome.time, outcome.state)
            state = outcome.state
            records.append(outcome.record)
        record = joined(records, 1 / self.frequency)
        return Turn(start=read_only(first), end=read_only(state), machine=machine, record=record)

    def derivative(self, turn: Turn) -> FloatArray:
        """Return the derivative of a turn's end over its start, shape (n_states, n_states), in SI units.

        By the variational equation, with saltation where the piston stops, reverses, breaks away or meets an end stop.
        A piston held by stiction stays where it is put; one that is pressed on a stop goes back to it.
        """
        machine, scales = self._bound, np.array(self._bound.state_scales)
        maps = turn_maps(log_of(turn.record), machine.record, self._run.pieces, scales, PARTS, False)
        return product_of(maps.factors) * scales[:, None] / scales

    def parameter_derivative(self, turn: Turn, parameters: Sequence[str]) -> FloatArray:
        """Return the derivative of a turn's end over parameters, its start kept, (n_states, n_parameters), in SI units.

        By central differences of turns. Parameters are named as for `parameter_sensitivity`.

        Raises
        ------
        ValueError
            A parameter is unknown.
        """
        columns: list[FloatArray] = []
        for name in parameters:
            (up, down), width = moved(self.machine, self.frequency, name)
            ends = [
                PeriodMap(machine=one, frequency=frequency, n_periods=self.n_periods, method=self.method)
                .turn(turn.start)
                .end
                for one, frequency in (up, down)
            ]
            columns.append((ends[0] - ends[1]) / width)
        return np.stack(columns, axis=-1) if columns else np.empty((turn.start.size, 0))


def _events(record: Record, machine: Machine) -> tuple[Event, ...]:
    """Return the events of a turn."""
    found: list[Event] = []
    speed = float(machine.state_scales[1])
    for interval in range(1, record.starts.size):
        before, after = int(record.modes[interval - 1]), int(record.modes[interval])
        time = float(record.starts[interval])
        if record.pieces[interval] != record.pieces[interval - 1]:
            found.append(Event(time=time, kind="switches"))
        arriving = float(record.spans[interval - 1] ** np.arange(5) @ record.coefficients[interval - 1, :, 1])
        side = at_stop(float(record.coefficients[interval, 0, 0]), machine.record)
        if before == STUCK and after != STUCK:
            found.append(Event(time=time, kind="breaks away"))
        elif before != STUCK and side and abs(arriving) > JUMP * speed and record.coefficients[interval, 0, 1] == 0.0:
            found.append(Event(time=time, kind=f"meets the {'upper' if side > 0 else 'lower'} stop"))
        elif before != STUCK and after == STUCK:
            found.append(Event(time=time, kind="stops"))
        elif before != after and machine.has_dry_friction:
            found.append(Event(time=time, kind="reverses"))
    return tuple(found)
