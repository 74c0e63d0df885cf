r"""A position controller for pistons that no spring holds, on valves that are set anew each period.

Such a piston stays wherever friction lets it, and its chambers' pressures are integrals of what the valves let in: a
duty sets how fast the push on the piston changes, not where the piston is. Three parts follow.

*Force.* A critically damped second-order way to the reference, of bandwidth w, asks for the push

.. math:: F = m \, (w^2 e + 2 w (\dot r - v)) + F_{friction}, \quad e = r - x

with dry friction in the direction of motion, or enough to break away where the piston rests off its goal. The push
changes along the period, so a share of what it is short of now is asked for on top.

*Duties.* With a valve on or off the pressures' rates are known from the machine's own equations, and over a short
period those of a duty lie between. The duties are those that bring the push to what is asked for within the period;
two valves bring the mean pressure to the middle of the sources' too.

*Near the goal* stick and slip decide where the piston comes to rest. There a few pushes are tried on the machine's
equations, each followed for some periods with the law above, and the one that ends best is taken: feedback by
roll-outs [Bertsekas2020]_.

.. [Bertsekas2020] D. P. Bertsekas, "Rollout, Policy Iteration, and Distributed Reinforcement Learning", Athena
   Scientific, 2020, chapter 2.
"""

import math
from dataclasses import replace
from typing import final

import numpy as np
from scipy.optimize import lsq_linear

from ltvpneu._arrays import FloatArray, not_negative, positive, whole
from ltvpneu.design.control.laws import Measurement, own_duties
from ltvpneu.models.machine.dynamics import external_force, state_rate
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.piston import hold_of
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.passage import positions_of, without_delays
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.physics.proportional import ProportionalValve

PUSHES = (-2.0, -1.5, -1.2, -1.05, -0.85, -0.6, -0.3, 0.0, 0.3, 0.6, 0.85, 1.05, 1.2, 1.5, 2.0)
"""Pushes that are tried near the goal, over what friction holds [-]."""
BREAKS = 1.05
"""Push that breaks away, over what friction holds [-]."""
AHEAD = 0.5
"""Share of what the push is short of that is asked for on top [-]."""
AT_REST = 1e-3
"""Speed below which a piston counts as at rest [m/s]."""
SPEED_WEIGHT = 4e-3
"""Of a speed beside an error, where ways near the goal are compared [s]."""
LAST_ERROR, LAST_SPEED = 3.0, 10.0
"""How much the last of a way counts more [-]."""
WAITS = 4
"""Periods at rest off the goal after which the push that breaks away is taken without trial."""
LEVEL_WEIGHT, LEVEL_PERIODS = 0.05, 3.0
"""Of the mean pressure beside the push [-], and periods in which it is brought to the middle."""
ROUGH = 1e-5
"""Tolerance of a trial [-]."""


@final
class SlideController:
    """Holds and moves a piston without a spring, by the push of its chambers; the law is the module's docstring.

    It sees the position as the sensor has it, and velocity and pressures as they are. A call takes about a millisecond
    on the way, and some tens of them near the goal, where it tries pushes.

    Parameters
    ----------
    machine : Machine
        As it is known, with one valve (5/2) or two (5/3, two 3/2), each on or off.
    frequency : float
        At which the valves are set [Hz].
    bandwidth : float, optional
        w of the way to the reference [rad/s]; by default one over the period.
    zone : float
        Error within which a piston that comes to rest is left alone, until it is off by twice that [m].
    near : float
        Error within which pushes are tried [m].
    horizon : int
        Periods for which a trial is followed.
    delay : float
        Of the sensor, by which the position is brought forward [s].

    Raises
    ------
    ValueError
        A machine with a spring or without a cylinder, a proportional valve, arguments out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> law = lp.ISO6358(sonic_conductance=0.4e-8, critical_pressure_ratio=0.3)
    >>> machine = lp.Machine(
    ...     name="slide", supply_pressure=7.01e5, exhaust_pressure=1.01e5,
    ...     cylinder=lp.catalog_cylinder(bore=0.025, stroke=0.15, rod=0.01, through_rod=True, clearance=0.1),
    ...     load=lp.Load(mass=1.0, dry_friction=20.0, stiction=30.0), valve=lp.OnOffValve(duty=0.5),
    ...     more_valves=(lp.OnOffValve(duty=0.5),), flow_paths=lp.directional_paths("2 x 3/2", law))
    >>> controller = design.SlideController(machine, 100.0)
    >>> start = [0.05, 0.0, 4e5, 4e5]
    >>> done = design.simulate_closed_loop(machine, controller, [0.05] * 5 + [0.06] * 35, 100.0, initial_state=start)
    >>> bool(done.steady_errors()[-1] < 2e-4)
    True
    """

    def __init__(  # noqa: PLR0913 - keyword-only, each with its default
        self,
        machine: Machine,
        frequency: float,
        *,
        bandwidth: float | None = None,
        zone: float = 1e-4,
        near: float = 3e-3,
        horizon: int = 6,
        delay: float = 0.0,
    ) -> None:
        expect_machine(machine)
        if machine.cylinder.is_absent or machine.load.spring_stiffness > 0:
            found = "one without a cylinder" if machine.cylinder.is_absent else "one with a spring"
            raise ValueError(f"machine: found {found}, expected a springless cylinder; use design.PositionController")
        self.frequency = positive("frequency", frequency, "Hz")
        self.bandwidth = self.frequency if bandwidth is None else positive("bandwidth", bandwidth, "rad/s")
        self.zone, self.near = not_negative("zone", zone, "m"), not_negative("near", near, "m")
        self.horizon, self.delay = whole("horizon", horizon), not_negative("delay", delay, "s")
        if isinstance(machine.valve, ProportionalValve):
            raise ValueError("machine: found a proportional valve, expected valves that switch")
        own_duties(machine)
        self.machine = machine
        self._prompt = without_delays(machine)
        n = 1 + len(machine.more_valves)
        held = positions_of(self._prompt)
        alone = [tuple(i == k for i in range(n)) for k in range(n)]
        self._off = _areas(held[(False,) * n])
        self._on = [_areas(held[one]) for one in alone if one in held]
        if len(self._on) < n:
            raise ValueError(
                "machine: found valves that open the same as others, expected each to open paths of its own"
            )
        self._slopes = np.array([volume.push_area for volume in machine.volume_fields])
        self._settings = integration_settings(self._prompt, ROUGH)
        self._waited, self._resting = 0, False
        self._before: tuple[float, float] | None = None
        """The last reference, and its change to it [m]."""

    def __repr__(self) -> str:
        return f"<SlideController of {self.machine.name}: {self.bandwidth:g} rad/s at {self.frequency:g} Hz>"

    def __call__(self, measured: Measurement) -> tuple[float, ...]:
        """Return the duties of the valves for the next period."""
        if measured.number == 0:
            self._waited, self._resting, self._before = 0, False, None
        state, reference = measured.state.copy(), measured.reference
        stops = self.machine.cylinder.lower_stop, self.machine.cylinder.upper_stop
        seen = measured.position if math.isfinite(measured.position) else float(state[0])
        state[0] = min(max(seen + self.delay * float(state[1]), stops[0]), stops[1])
        goal = reference, self._slope(reference)
        error, rests = reference - float(state[0]), abs(float(state[1])) < AT_REST
        usual = self._push(state, goal)
        self._waited = self._waited + 1 if rests and abs(error) > self.zone else 0
        # Once at rest near the goal it is left alone up to twice the zone: the last digits of a sensor start no hunt.
        zone = (2 if self._resting else 1) * self.zone
        self._resting = rests and abs(error) <= zone and goal[1] == 0.0
        if self._resting:
            return tuple(self._duties(state, 0.0).tolist())
        if abs(error) > self.near or self._waited > WAITS:
            return tuple(self._duties(state, usual).tolist())
        hold = hold_of(state, self.machine.record)
        trials = [self._duties(state, push) for push in (usual, *(share * hold for share in PUSHES))]
        return tuple(min(trials, key=lambda duties: self._cost(state, goal, duties)).tolist())

    def _slope(self, reference: float) -> float:
        """Return how fast the reference moves [m/s]: by the smaller of its last two changes, a step being none."""
        last, change = self._before if self._before is not None else (reference, 0.0)
        new = reference - last
        self._before = reference, new
        if new != 0.0:
            self._resting = False
        return self.frequency * (min(new, change, key=abs) if new * change > 0 else 0.0)

    def _push(self, state: FloatArray, goal: tuple[float, float]) -> float:
        """Return the push that is asked for at the period's end [N]."""
        record, load, w = self.machine.record, self.machine.load, self.bandwidth
        error, speed = goal[0] - float(state[0]), float(state[1])
        wanted = load.mass * (w**2 * error + 2 * w * (goal[1] - speed))
        if abs(speed) < AT_REST:
            if abs(error) <= self.zone:
                return 0.0
            return math.copysign(max(abs(load.mass * w**2 * error), BREAKS * hold_of(state, record)), error)
        wanted += math.copysign(load.dry_friction, speed) + load.viscous_damping * speed
        return wanted + AHEAD * (wanted - external_force(state, record))

    def _duties(self, state: FloatArray, push: float) -> FloatArray:
        """Return the duties that bring the push to what is asked for within a period, (n_valves,)."""
        off = self._rates(state, self._off)
        by_valve = np.array([self._rates(state, on) - off for on in self._on]).T
        short = (push - external_force(state, self.machine.record)) * self.frequency - float(self._slopes @ off)
        along = self._slopes @ by_valve
        if along.size == 1:
            return np.clip([short / along[0]], 0.0, 1.0)
        middle = (self.machine.supply_pressure + self.machine.exhaust_pressure) / 2
        n = self._slopes.size
        level = (middle - float(state[2 : 2 + n].mean())) * self.frequency / LEVEL_PERIODS - float(off.mean())
        weight = LEVEL_WEIGHT * float(np.abs(self._slopes).mean())
        matrix = np.vstack([along, weight * by_valve.mean(axis=0)])
        size = float(np.abs(matrix).max())
        return np.asarray(lsq_linear(matrix / size, np.array([short, weight * level]) / size, bounds=(0.0, 1.0)).x)

    def _rates(self, state: FloatArray, areas: FloatArray) -> FloatArray:
        """Return how fast the volumes' pressures change with the valves held [Pa/s]."""
        rate = np.empty(state.size)
        state_rate(state, areas, 1 if state[1] >= 0 else -1, self._prompt.record, rate)
        return rate[2 : 2 + self._slopes.size]

    def _cost(self, state: FloatArray, goal: tuple[float, float], duties: FloatArray) -> float:
        """Return what a way that begins with some duties, and goes on by the law, is worth: the less, the better."""
        total, off = 0.0, (0.0, 0.0)
        reference, slope = goal
        for period in range(self.horizon):
            after = self._after(state, duties)
            if after is None:
                return math.inf
            state, reference = after, reference + slope / self.frequency
            off = (reference - float(state[0])) ** 2, (SPEED_WEIGHT * (float(state[1]) - slope)) ** 2
            total += sum(off)
            if period < self.horizon - 1:
                duties = self._duties(state, self._push(state, (reference, slope)))
        return total + LAST_ERROR * off[0] + LAST_SPEED * off[1]

    def _after(self, state: FloatArray, duties: FloatArray) -> FloatArray | None:
        """Return the state after a period; None where the equations end."""
        present = self._prompt.with_duty(float(duties[0]))
        if duties.size > 1:
            pairs = zip(self._prompt.more_valves, duties[1:].tolist(), strict=True)
            present = replace(present, more_valves=tuple(valve.with_duty(duty) for valve, duty in pairs))
        run = new_run(present.record, self._settings, pieces_of(present.openings, 1 / self.frequency))
        outcome = integrate_period(state, run)
        return outcome.state if outcome.status == OK else None


def _areas(held: Machine) -> FloatArray:
    return np.ascontiguousarray(held.openings.areas[0, (0, 2)])
