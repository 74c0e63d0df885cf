"""Stick, slip and end stops of the piston, compiled: its mode, what holds it, what follows an event."""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import by_field, compiled, inlined
from ltvpneu.models.machine.dynamics import STUCK, external_force, seal_friction
from ltvpneu.models.machine.records import GeneralRecord, MachineRecord
from ltvpneu.physics.friction import holding_force, slip_direction

REVERSES, LOWER_STOP, UPPER_STOP, BREAKS_AWAY = range(4)
"""Kinds of events: the velocity reverses, the piston meets a stop, or leaves its rest."""
STOP_ROUNDING = 1e-15
"""Relative distance from a stop that is rounding [-]."""


@compiled
def at_stop(position: float, machine: MachineRecord) -> int:
    """Return the stop that a position is at: -1 the lower, 1 the upper, 0 neither.

    States that were scaled and back are off by rounding.
    """
    lower, upper = machine.load.lower_stop, machine.load.upper_stop
    # False where there is no stop: infinity less infinity is no number.
    if position <= lower + STOP_ROUNDING * abs(lower):
        return -1
    if position >= upper - STOP_ROUNDING * abs(upper):
        return 1
    return 0


def _seals_may_hold(machine: GeneralRecord) -> bool:
    found = False
    for k in range(machine.n_volumes):
        found = found or machine.volumes[k].friction_area > 0.0
    return found


def _seals_do_not(machine: MachineRecord) -> bool:
    return False


_do_seals_hold = by_field("medium", "machine", _seals_may_hold, _seals_do_not)


@inlined
def can_stick(machine: MachineRecord) -> bool:
    """Whether friction can hold the piston at all."""
    return holding_force(machine.load.dry_friction, machine.load.stiction) > 0.0 or _do_seals_hold(machine)


@compiled
def hold_of(state: FloatArray, machine: MachineRecord) -> float:
    """Return the largest force that leaves a piston at rest beside the stops, at the pressures of a state [N]."""
    return holding_force(machine.load.dry_friction, machine.load.stiction) + seal_friction(state, machine)


@inlined
def _holds(state: FloatArray, machine: MachineRecord) -> tuple[float, float]:
    """Return the forces that a resting piston withstands towards lower and higher positions [N]."""
    hold = hold_of(state, machine)
    side = at_stop(state[0], machine)
    return (math.inf if side < 0 else hold), (math.inf if side > 0 else hold)


@compiled
def is_pressed(state: FloatArray, machine: MachineRecord) -> bool:
    """Whether a piston at rest at a stop is pressed on it by more than stiction would hold beside it.

    Then a move off the stop does not last: the force brings the piston back.
    """
    side = at_stop(state[0], machine)
    return side != 0 and side * external_force(state, machine) > hold_of(state, machine)


@compiled
def mode_of(state: FloatArray, machine: MachineRecord) -> int:
    """Mode of the piston: the direction of its velocity; at rest, `STUCK` or the direction in which it breaks away."""
    if state[1] > 0.0:
        return 1
    if state[1] < 0.0:
        return -1
    down, up = _holds(state, machine)
    direction = slip_direction(external_force(state, machine), down, up)
    return STUCK if direction == 0 else direction


@inlined
def hold_left(state: FloatArray, machine: MachineRecord) -> float:
    """Return how much more force a resting piston withstands [N]; below zero it breaks away."""
    force = external_force(state, machine)
    down, up = _holds(state, machine)
    return min(up - force, force + down)


@inlined
def is_possible(kind: int, mode: int, machine: MachineRecord) -> bool:
    """Whether an event of a kind can happen in a mode of motion at all."""
    if mode == STUCK or kind == BREAKS_AWAY:
        return mode == STUCK and kind == BREAKS_AWAY
    if kind == LOWER_STOP:
        return machine.load.lower_stop > -math.inf
    if kind == UPPER_STOP:
        return machine.load.upper_stop < math.inf
    # Without dry friction nothing holds the piston where its velocity reverses.
    return can_stick(machine)


@inlined
def margin_at(state: FloatArray, kind: int, mode: int, machine: MachineRecord) -> float:
    """Return what an event of a kind waits for to fall below zero, at a state."""
    if kind == REVERSES:
        return mode * state[1]
    if kind == LOWER_STOP:
        return state[0] - machine.load.lower_stop
    if kind == UPPER_STOP:
        return machine.load.upper_stop - state[0]
    return hold_left(state, machine)


@compiled
def after_event(kind: int, state: FloatArray, scales: FloatArray, machine: MachineRecord) -> int:
    """Bring a scaled state to rest at an event that it has reached, and return the mode it goes on in."""
    state[1] = 0.0
    if kind == LOWER_STOP:
        state[0] = machine.load.lower_stop / scales[0]
    elif kind == UPPER_STOP:
        state[0] = machine.load.upper_stop / scales[0]
    z = np.empty(scales.size)
    for i in range(scales.size):
        z[i] = state[i] * scales[i]
    mode = mode_of(z, machine)
    if kind == BREAKS_AWAY and mode == STUCK:
        # Rounding must not hold what has just broken away.
        mode = 1 if external_force(z, machine) > 0.0 else -1
    return mode
