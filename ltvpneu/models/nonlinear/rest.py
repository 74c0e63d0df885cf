"""A piston at rest through whole valve periods: held by stiction, one of a band of places, or pressed on a stop."""

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu.models.machine.dynamics import STUCK, external_force
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.piston import at_stop, hold_of, is_pressed
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.models.nonlinear.runge_kutta import Run
from ltvpneu.models.nonlinear.settle import settle
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.physics.friction import holding_force

STILL = 10.0
"""Travel below which a piston that also rests may be creeping to the edge of a band, over the orbit's tolerance [-]."""
BESIDE = 1e3
"""How far beside such a piston a place of rest is looked for, likewise [-]."""
BY_STICTION, AT_EDGE = "held by stiction", "at the edge of a stiction band"


def rests_in_a_band(machine: Machine, states: FloatArray, modes: IntArray) -> bool:
    """Whether the piston rests throughout, held by stiction alone, so that it could rest beside just as well.

    `states`, (n_steps, n), are those at the starts of the steps, `modes`, (n_steps,), their modes.
    """
    if not machine.has_dry_friction or not (modes == STUCK).all():
        return False
    if at_stop(float(states[0, 0]), machine.record) == 0:
        return True
    # Pressed against an end stop by more than stiction holds, it has nowhere else to rest.
    return all(
        abs(external_force(state, machine.record)) <= hold_of(state, machine.record) * (1 + 1e-9) for state in states
    )


def what_holds(machine: Machine, states: FloatArray, modes: IntArray) -> str:
    """Return what holds a piston that rests throughout, for readers; nothing of one that moves."""
    if not (modes == STUCK).all() or machine.cylinder.is_absent:
        return ""
    if rests_in_a_band(machine, states, modes):
        return BY_STICTION
    side = at_stop(float(states[0, 0]), machine.record)
    if side == 0 or not any(is_pressed(state, machine.record) for state in states):
        return ""
    return f"rests on the {'upper' if side > 0 else 'lower'} stop, {1e3 * float(states[0, 0]):.4g} mm"


def is_at_edge_of_band(machine: Machine, run: Run, orbit: Orbit, tolerance: float) -> bool:
    """Whether an orbit with next to no travel is no more than a creep to the edge of a stiction band.

    It is if the piston rests for good just beside.
    """
    length, positions = float(machine.state_scales[0]), orbit.step_states[:, 0]
    # Its steps' starts are there; extremes cost more, and few orbits are that still.
    if not machine.has_dry_friction or np.ptp(positions) > STILL * tolerance * length:
        return False
    low, high = orbit.minimum(0), orbit.maximum(0)
    if high - low > STILL * tolerance * length:
        return False
    for side in (-1, 1):
        beside = orbit.initial_state.copy()
        beside[0] = (low if side < 0 else high) + side * BESIDE * tolerance * length
        beside[1] = 0.0
        if not machine.cylinder.lower_stop <= beside[0] <= machine.cylinder.upper_stop:
            continue
        found = settle(beside, run, machine.state_scales, tolerance, 1000)
        stays = found.last.status == OK and found.n_periods > 0 and found.last.state[0] == beside[0]
        if stays and bool(np.all(found.last.record.modes == STUCK)):
            return True
    return False


def positions_of_rest(machine: Machine) -> tuple[float, float]:
    """Return positions beyond which no pressure between the sources' holds the piston [m].

    Within stops and volumes; infinite where nothing bounds them: no spring, stop or chamber on that side.
    """
    load = machine.load
    lower, upper = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    for volume, slope, *_ in machine.volume_fields[: len(machine.cylinder.chambers)]:
        edge = -volume / slope
        if slope > 0:
            lower = max(lower, 0.999 * edge)
        else:
            upper = min(upper, 0.999 * edge)
    if load.spring_stiffness > 0:
        highest = max(machine.supply_pressure, machine.exhaust_pressure) - machine.ambient_pressure
        seals = sum(volume.friction_area for volume in machine.volume_fields) * highest
        hold = holding_force(load.dry_friction, load.stiction) + max(seals, 0.0)
        rest = load.constant_force + machine.cylinder.ambient_push_area * machine.ambient_pressure
        ends = np.outer(
            [volume.push_area for volume in machine.volume_fields], [machine.exhaust_pressure, machine.supply_pressure]
        )
        lower = max(lower, (rest + float(ends.min(axis=1).sum()) - hold) / load.spring_stiffness)
        upper = min(upper, (rest + float(ends.max(axis=1).sum()) + hold) / load.spring_stiffness)
    # Where all of them lie beyond a stop, the piston lies on it.
    low, high = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    return min(max(lower, low), high), min(max(upper, low), high)
