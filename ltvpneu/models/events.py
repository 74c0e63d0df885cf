"""Events of the piston, compiled: it stops, breaks away, meets an end stop, or a chamber beside it comes to rest.

All are looked for on the interpolant of a step, so that their instants are as accurate as the step.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.dynamics import STUCK, external_force
from ltvpneu.models.machine_arrays import MachineArrays, temperature_place
from ltvpneu.models.quasi_static import only_source
from ltvpneu.models.runge_kutta import Run, Workspace
from ltvpneu.physics.friction import holding_force, slip_direction
from ltvpneu.physics.properties import LIQUID

STOP_ROUNDING = 1e-15
"""Relative distance from a stop that is rounding [-]."""


@inlined
def _value(coefficients: FloatArray, component: int, share: float) -> float:
    """Interpolant of one state at a share of its step; coefficients (5, n_states) in powers of the share."""
    value = coefficients[4, component]
    for power in range(3, -1, -1):
        value = value * share + coefficients[power, component]
    return value


@compiled
def at_stop(position: float, machine: MachineArrays) -> int:
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


@compiled
def _holds(position: float, machine: MachineArrays) -> tuple[float, float]:
    """Return the forces that a resting piston withstands towards lower and higher positions [N]."""
    hold = holding_force(machine.load.dry_friction, machine.load.stiction)
    side = at_stop(position, machine)
    return (math.inf if side < 0 else hold), (math.inf if side > 0 else hold)


@compiled
def is_pressed(state: FloatArray, machine: MachineArrays) -> bool:
    """Whether a piston at rest at a stop is pressed on it by more than stiction would hold beside it.

    Then a move off the stop does not last: the force brings the piston back.
    """
    side = at_stop(state[0], machine)
    hold = holding_force(machine.load.dry_friction, machine.load.stiction)
    return side != 0 and side * external_force(state, machine) > hold


@compiled
def mode_of(state: FloatArray, machine: MachineArrays) -> int:
    """Mode of the piston: the direction of its velocity; at rest, `STUCK` or the direction in which it breaks away."""
    if state[1] > 0.0:
        return 1
    if state[1] < 0.0:
        return -1
    down, up = _holds(state[0], machine)
    direction = slip_direction(external_force(state, machine), down, up)
    return STUCK if direction == 0 else direction


@inlined
def _margin(
    share: float, kind: int, mode: int, coefficients: FloatArray, machine: MachineArrays, state: FloatArray
) -> float:
    """Return what an event waits for to fall below zero.

    Kinds: 0 velocity reverses, 1 lower, 2 upper stop, 3 break-away.
    """
    if kind == 0:
        return mode * _value(coefficients, 1, share)
    if kind == 1:
        return _value(coefficients, 0, share) - machine.load.lower_stop
    if kind == 2:
        return machine.load.upper_stop - _value(coefficients, 0, share)
    state[0] = coefficients[0, 0]
    for k in range(2, state.size):
        state[k] = _value(coefficients, k, share)
    return _hold_left(state, machine)


@inlined
def _hold_left(state: FloatArray, machine: MachineArrays) -> float:
    """Return how much more force a resting piston withstands [N]; below zero it breaks away."""
    force = external_force(state, machine)
    down, up = _holds(state[0], machine)
    return min(up - force, force + down)


@compiled
def margin_at(state: FloatArray, kind: int, mode: int, machine: MachineArrays) -> float:
    """Return what an event waits for to fall below zero, at a state; kinds as of `first_event`."""
    if kind == 0:
        return mode * state[1]
    if kind == 1:
        return state[0] - machine.load.lower_stop
    if kind == 2:
        return machine.load.upper_stop - state[0]
    return _hold_left(state, machine)


@compiled
def _event_share(kind: int, mode: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray) -> float:
    """Return the share of the step at which an event of a kind happens, 2.0 if it does not.

    Looked for at every quarter of the step, so that a short excursion is not passed over.
    """
    low, high = 0.0, 2.0
    for quarter in range(1, 5):
        if _margin(0.25 * quarter, kind, mode, coefficients, machine, work) < 0.0:
            low, high = 0.25 * (quarter - 1), 0.25 * quarter
            break
    if high <= 1.0:
        for _ in range(26):
            middle = 0.5 * (low + high)
            if _margin(middle, kind, mode, coefficients, machine, work) < 0.0:
                high = middle
            else:
                low = middle
        # On so short a bracket the margin is a straight line to rounding.
        before = _margin(low, kind, mode, coefficients, machine, work)
        after = _margin(high, kind, mode, coefficients, machine, work)
        root = low + (high - low) * (before / (before - after) + 1e-6) if before > 0.0 else low
        if low < root < high and _margin(root, kind, mode, coefficients, machine, work) < 0.0:
            high = root
    # The far side of the bracket: the event has happened there, so it does not happen again.
    return high


@compiled
def _stop_before(share: float, kind: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray) -> float:
    """Return the share at which a stop was met before a reversal beyond it, 2.0 if the reversal is not beyond it.

    So short an excursion lies between the quarters of the step that are looked at.
    """
    low, high = 0.0, 2.0
    if _margin(share, kind, 1, coefficients, machine, work) < 0.0:
        high = share
        for _ in range(50):
            middle = 0.5 * (low + high)
            if _margin(middle, kind, 1, coefficients, machine, work) < 0.0:
                high = middle
            else:
                low = middle
    return high


@inlined
def first_event(mode: int, coefficients: FloatArray, machine: MachineArrays, work: FloatArray) -> tuple[float, int]:
    """Return the share of the step at which the first event happens, and its kind; 2.0 and -1 where none does.

    Kinds: 0 velocity reverses, 1 lower, 2 upper stop, 3 break-away.
    """
    first, found = 2.0, -1
    if mode == STUCK:
        first, found = _event_share(3, mode, coefficients, machine, work), 3
    else:
        # Looked at here, without a call: in slip this is asked at every step.
        slowed = False
        for quarter in range(1, 5):
            slowed = slowed or mode * _value(coefficients, 1, 0.25 * quarter) < 0.0
        if slowed and holding_force(machine.load.dry_friction, machine.load.stiction) > 0.0:
            first, found = _event_share(0, mode, coefficients, machine, work), 0
        for stop in range(1, 3):
            exists = machine.load.lower_stop > -math.inf if stop == 1 else machine.load.upper_stop < math.inf
            if exists:
                share = _event_share(stop, mode, coefficients, machine, work)
                if share > first:
                    share = _stop_before(first, stop, coefficients, machine, work)
                if share < first:
                    first, found = share, stop
    return first, found if first <= 1.0 else -1


@compiled
def land(kind: int, share: float, run: Run, space: Workspace) -> None:
    """Bring the piston to rest at an event: at the stop that it met, without rebound, or where its velocity is zero."""
    for i in range(space.state.size):
        space.state[i] = _value(space.coefficients, i, share)
    space.state[1] = 0.0
    if kind == 1:
        space.state[0] = run.machine.load.lower_stop
    elif kind == 2:
        space.state[0] = run.machine.load.upper_stop


@compiled
def rest_at_source(run: Run, space: Workspace) -> bool:
    """Let a chamber of a resting piston come to rest at the pressure of the one source it is open to.

    The flow is like the root of the pressure difference d, so d reaches zero in the finite time 2 d / |d'| and stays.
    Left alone, an explicit method would go on in tiny steps beside that pressure, where the slope is infinite. Returns
    whether a pressure was set.
    """
    state, before, changed = space.state, space.coefficients[0], False
    # A liquid comes to rest exponentially, a volume with an energy balance goes on as long as its temperature does.
    for k in range(run.machine.chambers.shape[0] if run.machine.medium.kind != LIQUID else 0):
        low = only_source(k, space.areas, run.machine)
        if not math.isnan(low) and temperature_place(k, run.machine) < 0:
            difference = before[2 + k] - low
            # The interpolant's first power is the rate at the start of the step, times its length.
            change = space.coefficients[1, 2 + k]
            if difference * (state[2 + k] - low) <= 0.0 or abs(change) >= 2.0 * abs(difference):
                set_to_rest = state[2 + k] != low
                state[2 + k] = low
                changed = changed or set_to_rest
    return changed


@compiled
def after_event(kind: int, state: FloatArray, scales: FloatArray, machine: MachineArrays) -> int:
    """Bring a scaled state to rest at an event that it has reached, and return the mode it goes on in."""
    state[1] = 0.0
    if kind == 1:
        state[0] = machine.load.lower_stop / scales[0]
    elif kind == 2:
        state[0] = machine.load.upper_stop / scales[0]
    z = np.empty(scales.size)
    for i in range(scales.size):
        z[i] = state[i] * scales[i]
    mode = mode_of(z, machine)
    if kind == 3 and mode == STUCK:
        # Rounding must not hold what has just broken away.
        mode = 1 if external_force(z, machine) > 0.0 else -1
    return mode
