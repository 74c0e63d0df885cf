"""The nonlinear machine under a controller, which acts once a period.

It sees the position at the period's start and its mean over the last one, as the sensor has them, and sets what the
valves do in the next. Loads, pressures and other numbers of the machine may change from period to period.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, finite_array, positive, read_only
from ltvpneu._values import Value
from ltvpneu.design.control.laws import Controller, Measurement, Sensor, law_of, own_duties
from ltvpneu.design.progress import Progress
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.parameters import present_value, with_values
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory, trajectory_of
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.systems import bridge

if TYPE_CHECKING:
    import control

SIMULATION_TOLERANCE = 1e-7
POINTS_PER_PERIOD = 50
WINDOW = 200
"""Positions from which the mean of a delayed period is taken."""

Signal = float | Sequence[float] | FloatArray | Callable[[float], float]
"""A number, one for each period, or a function of the time [s] at the period's start."""


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
    """As they were [m]."""
    commands: FloatArray
    """Duties that the controller asked for, (n_periods,); of several valves (n_periods, n_valves)."""
    duties: FloatArray
    """Shares of the period that the valve was open: late by the delay, within the shortest pulses, its own lag off;
    likewise."""
    n_held_back: int
    """Commands that a valve could not make as they were asked for."""
    response: "control.TimeResponseData"
    """States over time."""
    measured_positions: FloatArray
    """At the periods' starts, as the sensor has them [m]."""
    states: FloatArray
    """At the periods' starts, as they were, (n_periods, n_states)."""

    def __repr__(self) -> str:
        held = f", {self.n_held_back} commands held back" if self.n_held_back else ""
        return (
            f"<ClosedLoop of {self.machine.name}: {self.references.size} periods of {1 / self.frequency:.4g} s{held}>"
        )

    @property
    def errors(self) -> FloatArray:
        """Reference less mean position, period by period [m]."""
        return self.references - self.mean_positions

    @property
    def rms_error(self) -> float:
        """Of the errors [m]."""
        return float(np.sqrt(np.mean(self.errors**2)))

    @property
    def itae(self) -> float:
        """Integral of time, since the reference last changed, times absolute error [m s^2]."""
        period = 1 / self.frequency
        return sum(
            float(np.sum((np.arange(end - start) + 0.5) * period * np.abs(self.errors[start:end])) * period)
            for start, end in self._stretches()
        )

    @property
    def switchings_per_second(self) -> float:
        """How often valves go on, in all [1/s]."""
        duties = self.duties.reshape(self.references.size, -1)
        before = np.vstack([np.zeros(duties.shape[1]), duties[:-1]])
        return float(np.sum((duties > 0) & (before < 1))) * self.frequency / self.references.size

    def settling_periods(self, tolerance: float) -> list[int | None]:
        """Return, for each stretch of constant reference, after how many periods the mean stays within a tolerance [m].

        None where it does not come to stay.
        """
        positive("tolerance", tolerance, "m")
        found: list[int | None] = []
        for start, end in self._stretches():
            outside = np.flatnonzero(np.abs(self.errors[start:end]) > tolerance)
            after = int(outside[-1]) + 1 if outside.size else 0
            found.append(after if start + after < end else None)
        return found

    def overshoots(self) -> list[float]:
        """Return by how much the mean goes beyond the reference after each of its steps [m]; zero where it does not."""
        found: list[float] = []
        for start, end in self._stretches():
            before = self.mean_positions[start - 1] if start else self.states[0, 0]
            way = np.sign(self.references[start] - before)
            found.append(float(np.max(-way * self.errors[start:end], initial=0.0)))
        return found

    def steady_errors(self, n_periods: int = 10) -> list[float]:
        """Return the largest absolute error over the last periods of each stretch of constant reference [m]."""
        return [
            float(np.max(np.abs(self.errors[max(start, end - n_periods) : end]))) for start, end in self._stretches()
        ]

    def rise_times(self, share: float = 0.9) -> list[float | None]:
        """Return how long each step of the reference takes until the mean has gone a share of it [s]; None if never."""
        found: list[float | None] = []
        for start, end in self._stretches():
            before = self.mean_positions[start - 1] if start else self.states[0, 0]
            gone = (self.mean_positions[start:end] - before) * np.sign(self.references[start] - before)
            there = np.flatnonzero(gone >= share * abs(self.references[start] - before))
            found.append((int(there[0]) + 1) / self.frequency if there.size else None)
        return found

    def _stretches(self) -> list[tuple[int, int]]:
        """Return first and last but one period of each stretch of constant reference."""
        changes = (np.flatnonzero(np.diff(self.references)) + 1).tolist()
        return list(pairwise([0, *changes, self.references.size]))


def simulate_closed_loop(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    controller: "Controller | control.StateSpace | control.TransferFunction",
    reference: Signal,
    frequency: float,
    *,
    n_periods: int | None = None,
    signals: Mapping[str, Signal] | None = None,
    sensor: Sensor | None = None,
    generator: np.random.Generator | None = None,
    valve: ValveLimits | None = None,
    initial_state: Sequence[float] | FloatArray | None = None,
    progress: Progress | None = None,
) -> ClosedLoop:
    """Simulate the nonlinear machine, every switch hit, under a controller that sets its valves each period.

    Parameters
    ----------
    machine : Machine
        Its own duty is that of the periods before the controller's first command arrives.
    controller : callable, control.StateSpace or control.TransferFunction
        From a `Measurement` to a duty; with several valves to all duties, by name ("valve", "valve_2", ...) or in
        order, True for always on. Or a discrete-time system, whose dt must be the period. Its inputs are named "error"
        (reference less mean position; that of a single input), "reference", "mean_position", "measured_position" or as
        states; its outputs, one or one for each valve, are added to the machine's duties.
    reference : float, array_like of shape (n_periods,), or callable
        Wanted mean position of each period [m]; or a function of the time.
    frequency : float
        [Hz]
    n_periods : int, optional
        Needed where the reference does not say.
    signals : mapping of str to float, array_like of shape (n_periods,), or callable, optional
        Numbers of the machine that change from period to period, as "load.force" [N] or "supply_pressure" [Pa].
    sensor : Sensor, optional
        Of the position; by default it is seen as it is.
    generator : numpy.random.Generator, optional
        Of the sensor's noise; by default one that always makes the same.
    valve : ValveLimits, optional
        Shortest on- and off-times, and periods that a command is late.
    initial_state : array_like, shape (n_states,), optional
        At rest with the mean quasi-static pressures by default.
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Raises
    ------
    ValueError
        A command that is not a finite number, too few or too many of them, a controller of another dt, unknown signals,
        arguments out of range.
    """
    expect_machine(machine)
    period = 1 / positive("frequency", frequency, "Hz")
    wanted = _wanted(reference, n_periods, period)
    n = wanted.size
    plant = _Plant(machine, frequency, _varied(machine, frequency, signals or {}, n, period))
    valve = ValveLimits() if valve is None else valve
    sensor = Sensor() if sensor is None else sensor
    generator = np.random.default_rng(0) if generator is None else generator
    least, most = valve.duties(frequency)
    law, own = law_of(controller, machine, period), own_duties(machine)
    given = machine.rest_state if initial_state is None else initial_state
    state = finite_array("initial_state", given, (len(machine.states),)).copy()
    before = np.array([valve.open_share(min(max(duty, least), most), frequency) for duty in own.tolist()])
    # A controller that sees means has none yet: a position between the ends of its swing would mislead it.
    past = _Past(period, plant.turn(state.copy(), before, 0)[1], float(state[0]))
    means, positions, begins = np.empty(n), np.empty(n), np.empty((n, state.size))
    commands, duties = np.empty((n, own.size)), np.empty((n, own.size))
    n_held = 0
    for number in range(n):
        if progress is not None and number % 10 == 0:
            progress("periods", number / n)
        begins[number] = state
        positions[number] = sensor.seen(past.position(sensor.delay), generator)
        measured = Measurement(
            number=number, time=number * period, reference=float(wanted[number]),
            mean_position=sensor.seen(past.mean(sensor.delay), generator), state=read_only(state.copy()),
            duty=float(duties[number - 1, 0]) if number else float(before[0]), position=float(positions[number]),
        )  # fmt: skip
        commands[number] = law(measured)
        asked = commands[number - valve.delay] if number >= valve.delay else own
        made = np.clip(asked, least, most)
        n_held += int(np.sum(made != asked))
        duties[number] = [valve.open_share(duty, frequency) for duty in made.tolist()]
        state, trajectory = plant.turn(state, duties[number], number, keep=True)
        past.add(trajectory, float(state[0]))
        means[number] = float(trajectory.means()[0])
    single = own.size == 1
    return ClosedLoop(
        machine=machine,
        frequency=float(frequency),
        references=wanted,
        mean_positions=read_only(means),
        commands=read_only(commands[:, 0].copy() if single else commands),
        duties=read_only(duties[:, 0].copy() if single else duties),
        n_held_back=n_held,
        response=plant.response(n * period, state),
        measured_positions=read_only(positions),
        states=read_only(begins),
    )


class _Plant:
    """The machine, period by period, and what it did."""

    def __init__(self, machine: Machine, frequency: float, varied: list[dict[str, float]]) -> None:
        self.machine, self.frequency, self.varied = machine, frequency, varied
        self.settings = integration_settings(machine, SIMULATION_TOLERANCE)
        self._times: list[FloatArray] = []
        self._states: list[FloatArray] = []

    def turn(
        self, start: FloatArray, duties: FloatArray, number: int, *, keep: bool = False
    ) -> tuple[FloatArray, PolynomialTrajectory]:
        """Return the state after a period, and the period itself."""
        period = 1 / self.frequency
        varied = with_values(self.machine, self.varied[number]) if self.varied else self.machine
        present = _told(varied, duties)
        pieces = pieces_of(present.at(self.frequency).openings, period)
        outcome = integrate_period(start, new_run(present.record, self.settings, pieces))
        if outcome.status != OK:
            raise_stopped(self.machine, outcome.status, number * period + outcome.time, outcome.state)
        trajectory = trajectory_of(outcome.record)
        if keep:
            local = np.union1d(np.linspace(0.0, period, POINTS_PER_PERIOD + 1), pieces["begin"])[:-1]
            self._times.append(number * period + local)
            self._states.append(trajectory.at(local).T)
        return outcome.state, trajectory

    def response(self, end: float, last: FloatArray) -> "control.TimeResponseData":
        """Return the states over time, by name."""
        times = np.concatenate([*self._times, [end]])
        named = self.machine.states, np.concatenate([*self._states, last[None]]).T
        return bridge.time_response(times, named, named, self.machine.name)


class _Past:
    """The position until now, as far back as a sensor may look."""

    def __init__(self, period: float, first: PolynomialTrajectory, start: float) -> None:
        # Before the start, periods as the machine's own duty makes them: what a mean is of at first.
        self._period, self._first, self._last = period, first, start
        self._periods: list[PolynomialTrajectory] = []

    def add(self, trajectory: PolynomialTrajectory, last: float) -> None:
        """Take a period to the past."""
        self._periods.append(trajectory)
        self._last = last

    def position(self, delay: float) -> float:
        """Return the position that long ago; at rest before the start [m]."""
        if delay == 0.0:
            return self._last
        return float(self._at(np.array([delay]), resting=True)[0])

    def mean(self, delay: float) -> float:
        """Return the mean over the period that ended that long ago [m]."""
        if delay == 0.0:
            return float((self._periods[-1] if self._periods else self._first).means()[0])
        ages = delay + (np.arange(WINDOW) + 0.5) / WINDOW * self._period
        return float(np.mean(self._at(ages, resting=False)))

    def _at(self, ages: FloatArray, *, resting: bool) -> FloatArray:
        times = len(self._periods) * self._period - ages
        found = np.empty(times.size)
        for i, time in enumerate(times.tolist()):
            number = int(np.floor(time / self._period))
            if number >= 0:
                found[i] = self._periods[number].at(np.array([time - number * self._period]))[0, 0]
            elif resting:
                found[i] = self._first.at(np.zeros(1))[0, 0]
            else:
                found[i] = self._first.at(np.array([time - number * self._period]))[0, 0]
        return found


def _wanted(reference: Any, n_periods: int | None, period: float) -> FloatArray:
    if n_periods is None:
        if callable(reference):
            raise ValueError("n_periods: found none beside a reference that is a function, expected how many periods")
        wanted = finite_array("reference", np.atleast_1d(np.asarray(reference, dtype=np.float64)), (None,))
        if wanted.size == 0:
            raise ValueError("reference: found none, expected one for each period")
        return wanted
    if n_periods < 1:
        raise ValueError(f"n_periods: found {n_periods}, expected 1 or more")
    return read_only(_sampled("reference", reference, n_periods, period))


def _sampled(name: str, signal: Signal, n: int, period: float) -> FloatArray:
    """Return a signal's values period by period, (n,)."""
    if callable(signal):
        return np.array([finite(f"{name} at {k * period:g} s", float(signal(k * period))) for k in range(n)])
    values = np.asarray(signal, dtype=np.float64)
    return finite_array(name, np.full(n, float(values)) if values.ndim == 0 else values, (n,)).copy()


def _varied(
    machine: Machine, frequency: float, signals: Mapping[str, Signal], n: int, period: float
) -> list[dict[str, float]]:
    """Return the numbers of the machine that are changed, period by period; nothing where there are none."""
    if not signals:
        return []
    values: dict[str, FloatArray] = {}
    for name, signal in signals.items():
        present_value(machine, frequency, name)
        values[name] = _sampled(f"signals[{name!r}]", signal, n, period)
    return [{name: float(one[k]) for name, one in values.items()} for k in range(n)]


def _told(machine: Machine, duties: FloatArray) -> Machine:
    """Return the machine with its valves told to be on for shares of the period."""
    changed = machine.with_duty(float(duties[0]))
    if duties.size == 1:
        return changed
    others = tuple(
        valve.with_duty(float(duty)) for valve, duty in zip(machine.more_valves, duties[1:].tolist(), strict=True)
    )
    return replace(changed, more_valves=others)
