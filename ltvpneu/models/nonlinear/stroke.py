"""One stroke of the piston from stop to stop: how long, how hard, with how much air."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import STUCK, external_force
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.quasi_static import settle_volumes
from ltvpneu.models.nonlinear.integrator import OK, Record
from ltvpneu.models.nonlinear.mass_drawn import mass_drawn
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.polynomial import trajectory_of
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.systems import bridge
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import ProportionalValve

if TYPE_CHECKING:
    import control

Direction = Literal["out", "in"]
FIRST_SPAN, LONGEST_SPAN = 1.0, 256.0
"""How long a stroke is followed at first, and at most [s]."""
FILLED = 1e-6
"""Distance from its last pressure at which a chamber counts as filled, over the supply pressure [-]."""
RTOL = 1e-10
"""Tolerance of the integration [-]."""
POINTS = 500
"""Times of a stroke's response."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Stroke(Value):
    """A stroke, counted from the moment at which the valve has switched.

    At first the piston rests on one stop, the chambers as a valve leaves them that has long been in its other position.
    """

    machine: Machine
    """With its valve in the position that makes the stroke."""
    direction: Direction
    delay: float
    """Of the valve, from the command until it switches, half its travel included: not part of `time` [s]."""
    first_motion: float
    """When the piston leaves its rest [s]; infinite where it does not."""
    time: float
    """When it meets the other stop [s]; infinite where it does not."""
    end_velocity: float
    """Speed with which it meets the stop [m/s]; zero where it does not."""
    impact_energy: float
    """m v^2 / 2 of the moving mass there [J]."""
    greatest_force: float
    """Largest push of the pressures in the stroke's direction, the filled chamber on the stop included [N]."""
    air_mass: float
    """Drawn from the supply until the chambers are filled [kg]."""
    work: float
    """Of the pressures, the ambient air's included, on the piston [J]."""
    start_position: float
    """[m]"""
    end_position: float
    """Where the piston rests in the end [m]."""
    times: FloatArray
    """From the switching on, a little past the stop [s], shape (n_times,)."""
    states: FloatArray
    """The machine's at these times, shape (n_states, n_times)."""

    @cached_property
    def response(self) -> "control.TimeResponseData":
        """All states over time, by name."""
        named = self.machine.states, self.states
        return bridge.time_response(self.times, named, named, self.machine.name)

    @property
    def arrives(self) -> bool:
        """Whether the piston meets the other stop."""
        return math.isfinite(self.time)

    def __repr__(self) -> str:
        if not self.arrives:
            return f"<Stroke {self.direction} of {self.machine.name}: {self.remark}>"
        return (
            f"<Stroke {self.direction} of {self.machine.name}: {1e3 * self.time:.4g} ms after a delay of "
            f"{1e3 * self.delay:.4g} ms, {self.end_velocity:.4g} m/s and {self.impact_energy:.3g} J at the stop>"
        )

    @property
    def remark(self) -> str:
        """Why the stroke does not arrive, in a sentence; empty where it does."""
        if self.arrives:
            return ""
        place = f"{1e3 * self.end_position:.4g} mm"
        if math.isinf(self.first_motion):
            return (
                f"the piston stays at {place}: its greatest push of {self.greatest_force:.4g} N does not overcome "
                "load and stiction; raise the supply pressure or the bore"
            )
        return f"the piston comes to rest at {place}, short of the stop; raise the supply pressure or the bore"


def stroke(machine: Machine, direction: Direction = "out") -> Stroke:
    """Return a stroke of the piston, out (to higher positions) or in.

    Parameters
    ----------
    machine : Machine
        With both end stops, and a valve that switches. Of two coils, one is on and the other off.
    direction : {"out", "in"}

    Raises
    ------
    ValueError
        No end stops, a proportional valve, another direction.
    IntegrationError
        The equations could not be integrated on.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("double_acting_5_2")
    >>> found = lp.stroke(machine, "out")
    >>> found.arrives, found.end_position
    (True, 0.05)
    """
    expect_machine(machine)
    if direction not in ("out", "in"):
        raise ValueError(f'direction: found {direction!r}, expected "out" or "in"')
    low, high = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    if machine.cylinder.is_absent:
        raise ValueError("machine: found one without a cylinder, expected one with a piston; use lp.simulate")
    if math.isinf(low) or math.isinf(high):
        raise ValueError(
            "machine: found a cylinder without both end stops, expected cylinder.lower_stop and cylinder.upper_stop, "
            "which a cylinder by bore and stroke has"
        )
    if isinstance(machine.valve, ProportionalValve):
        raise ValueError("machine: found a proportional valve, expected one that switches; use lp.simulate")
    start = start_of_stroke(machine, direction)
    ahead = _positions(machine)[direction == "in"]
    return _measured(ahead, direction, start, _followed(ahead, start))


def start_of_stroke(machine: Machine, direction: Direction) -> FloatArray:
    """Return the state in which a stroke begins, (n_states,): the valve has long been in its other position."""
    behind = _positions(machine)[direction == "out"]
    start = np.array(machine.rest_state)
    start[0] = machine.cylinder.lower_stop if direction == "out" else machine.cylinder.upper_stop
    settle_volumes(_areas(behind), behind.record, start)
    # A spring may keep the piston from the stop.
    return _followed(behind, start).last


def _positions(machine: Machine) -> tuple[Machine, Machine]:
    """Return the machine with its valve where it sends the piston out, and where it brings it back."""
    on, off = (
        replace(
            machine,
            valve=machine.valve.with_duty(duty),
            more_valves=tuple(valve.with_duty(1.0 - duty) for valve in machine.more_valves),
            switching_frequency=1.0,
        )
        for duty in (1.0, 0.0)
    )
    middle = (machine.cylinder.lower_stop + machine.cylinder.upper_stop) / 2
    forces: list[float] = []
    for present in (on, off):
        state = np.array(machine.rest_state)
        state[0] = middle
        settle_volumes(_areas(present), present.record, state)
        forces.append(external_force(state, present.record))
    return (on, off) if forces[0] >= forces[1] else (off, on)


def _areas(machine: Machine) -> FloatArray:
    """Return the effective areas of a valve that stands still, (2, n_paths)."""
    return np.ascontiguousarray(machine.openings.areas[0, (0, 2)])


class _Way(NamedTuple):
    """What a machine did whose valve stood still, and where it came to rest."""

    record: Record
    last: FloatArray
    span: float
    """[s]"""


def _followed(machine: Machine, start: FloatArray) -> _Way:
    """Follow a machine whose valve stands still until its piston rests and its chambers are filled."""
    settings, span = integration_settings(machine, RTOL), FIRST_SPAN
    # Without the floor under pressures near a source's that orbits have: it would be missing from the air drawn.
    settings = settings._replace(atol=RTOL * machine.state_scales)
    while True:
        outcome = integrate_period(start, new_run(machine.record, settings, pieces_of(machine.openings, span)))
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, outcome.time, outcome.state)
        settled = outcome.state.copy()
        settle_volumes(_areas(machine), machine.record, settled)
        away = np.abs(settled - outcome.state)[2 : 2 + machine.n_volumes].max()
        at_rest = outcome.record.modes[-1] == STUCK or abs(outcome.state[1]) < FILLED * machine.state_scales[1]
        if (at_rest and away <= FILLED * machine.supply_pressure) or span >= LONGEST_SPAN:
            return _Way(outcome.record, outcome.state, span)
        span *= 4


def _measured(machine: Machine, direction: Direction, start: FloatArray, way: _Way) -> Stroke:
    record, sign = way.record, 1 if direction == "out" else -1
    goal = machine.cylinder.upper_stop if sign > 0 else machine.cylinder.lower_stop
    moving = np.flatnonzero(record.modes != STUCK)
    arrived = np.flatnonzero((record.modes == STUCK) & (record.coefficients[:, 0, 0] == goal))
    arrived = arrived[arrived > (moving[0] if moving.size else -1)]
    time, speed = math.inf, 0.0
    if arrived.size and moving.size:
        time = float(record.starts[arrived[0]])
        last = arrived[0] - 1
        speed = abs(float(record.spans[last] ** np.arange(5) @ record.coefficients[last, :, 1]))
    states, weights = _along(record)
    pushes = np.array([_push(state, machine) for state in states])
    shown = 1.4 * time if math.isfinite(time) else way.span
    times = np.linspace(0.0, min(shown, way.span), POINTS)
    values = trajectory_of(record).at(times)
    return Stroke(
        machine=machine,
        direction=direction,
        delay=_delay(machine),
        first_motion=float(record.starts[moving[0]]) if moving.size else math.inf,
        time=time,
        end_velocity=speed,
        impact_energy=machine.load.mass * speed**2 / 2,
        greatest_force=max(float((sign * pushes).max()), sign * _push(way.last, machine)),
        air_mass=mass_drawn(record, machine, 1 / way.span),
        work=float(weights @ (pushes * states[:, 1])),
        start_position=float(start[0]),
        end_position=float(way.last[0]),
        times=read_only(times),
        states=read_only(values),
    )


def _along(record: Record) -> tuple[FloatArray, FloatArray]:
    """Return states along a record, and the weights that integrate over its time: (n, n_states), (n,)."""
    local = 0.5 * (_NODES + 1) * record.spans[:, None]
    states = np.einsum("itk,ikn->itn", local[:, :, None] ** np.arange(5), record.coefficients)
    return states.reshape(-1, states.shape[2]), (0.5 * _WEIGHTS * record.spans[:, None]).ravel()


def _push(state: FloatArray, machine: Machine) -> float:
    """Return the force of all pressures on the piston, the ambient air's included [N]."""
    push = machine.cylinder.ambient_push_area * machine.ambient_pressure
    return push + sum(volume.push_area * float(state[2 + k]) for k, volume in enumerate(machine.volume_fields))


def _delay(machine: Machine) -> float:
    """Return how long after the command the valves are across their middles, on their way to where they are [s].

    Of two coils, one of which goes on as the other goes off, the later counts.
    """
    delays = [0.0]
    for valve in (machine.valve, *machine.more_valves):
        if isinstance(valve, OnOffValve) and valve.duty > 0:
            delays.append(valve.opening_delay + valve.opening_time / 2)
        elif isinstance(valve, OnOffValve):
            delays.append(valve.closing_delay + valve.closing_time / 2)
    return max(delays)
