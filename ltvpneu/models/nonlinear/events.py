"""Search for events, compiled: the piston stops, breaks away, meets an end stop, or a chamber beside it comes to rest.

All are looked for on the interpolant of a step, so that their instants are as accurate as the step.
"""

import math

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.machine.arrays import MachineArrays, temperature_place
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.piston import (
    hold_left,
)
from ltvpneu.models.machine.quasi_static import only_source
from ltvpneu.models.nonlinear.runge_kutta import Run, Workspace
from ltvpneu.physics.friction import holding_force
from ltvpneu.physics.properties import LIQUID


@inlined
def _value(coefficients: FloatArray, component: int, share: float) -> float:
    """Interpolant of one state at a share of its step; coefficients (5, n_states) in powers of the share."""
    value = coefficients[4, component]
    for power in range(3, -1, -1):
        value = value * share + coefficients[power, component]
    return value


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
    return hold_left(state, machine)


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
