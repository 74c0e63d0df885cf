"""Search for events, compiled: the piston stops, breaks away, meets an end stop, or a chamber beside it comes to rest.

All are looked for on the interpolant of a step, so that their instants are as accurate as the step.
"""

import math

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.machine.piston import LOWER_STOP, REVERSES, UPPER_STOP, is_possible, margin_at
from ltvpneu.models.machine.quasi_static import nearest_source, only_source
from ltvpneu.models.machine.records import MachineRecord, is_liquid, temperature_place
from ltvpneu.models.nonlinear.runge_kutta import Workspace

HOVERS = 1e-4
"""Relative distance from a source's pressure within which a pressure is about to reach it anyway [-]."""


@inlined
def _value(coefficients: FloatArray, component: int, share: float) -> float:
    """Interpolant of one state at a share of its step; coefficients (5, n_states) in powers of the share."""
    value = coefficients[4, component]
    for power in range(3, -1, -1):
        value = value * share + coefficients[power, component]
    return value


@inlined
def _margin(
    share: float, kind: int, mode: int, coefficients: FloatArray, machine: MachineRecord, state: FloatArray
) -> float:
    """Return `margin_at` the state at a share of the step, which is written into `state`."""
    for i in range(state.size):
        state[i] = _value(coefficients, i, share)
    return margin_at(state, kind, mode, machine)


@compiled
def _event_share(kind: int, mode: int, coefficients: FloatArray, machine: MachineRecord, work: FloatArray) -> float:
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
def _stop_before(share: float, kind: int, coefficients: FloatArray, machine: MachineRecord, work: FloatArray) -> float:
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
def _may_happen(kind: int, mode: int, coefficients: FloatArray, machine: MachineRecord) -> bool:
    """Whether an event of a kind can happen in a step, by a quick look at the velocity for a reversal."""
    happens = is_possible(kind, mode, machine)
    if happens and kind == REVERSES:
        happens = False
        for quarter in range(1, 5):
            happens = happens or mode * _value(coefficients, 1, 0.25 * quarter) < 0.0
    return happens


@compiled
def first_event(mode: int, coefficients: FloatArray, machine: MachineRecord, work: FloatArray) -> tuple[float, int]:
    """Return the share of the step at which the first event happens, and its kind; 2.0 and -1 where none does."""
    first, found = 2.0, -1
    for kind in range(4):
        if _may_happen(kind, mode, coefficients, machine):
            share = _event_share(kind, mode, coefficients, machine, work)
            if found == REVERSES and share > first:
                share = _stop_before(first, kind, coefficients, machine, work)
            if share < first:
                first, found = share, kind
    return first, found


@compiled
def first_reversal(coefficients: FloatArray, areas: FloatArray, machine: MachineRecord, work: FloatArray) -> float:
    """Return the share of the step at which a flow reverses first, 2.0 if none does.

    There its slope is infinite, and the error of a step across is not what its estimate says.
    """
    first = 2.0
    for k in range(machine.n_volumes):
        for i in range(work.size):
            work[i] = coefficients[0, i]
        source, column = nearest_source(k, work, areas, machine)
        before, low, high = work[2 + k] - source, 0.0, 2.0
        # A pressure that hovers about a source's is not looked at over and over.
        if not math.isfinite(source) or abs(before) < HOVERS * source:
            continue
        for quarter in range(1, 5):
            if before * _apart(coefficients, 2 + k, column, source, 0.25 * quarter) < 0.0:
                low, high = 0.25 * (quarter - 1), 0.25 * quarter
                break
        if high <= 1.0:
            for _ in range(26):
                middle = 0.5 * (low + high)
                if before * _apart(coefficients, 2 + k, column, source, middle) < 0.0:
                    high = middle
                else:
                    low = middle
        first = min(first, high)
    return first


@inlined
def _apart(coefficients: FloatArray, row: int, column: int, source: float, share: float) -> float:
    """Return a pressure less a source's, which is another pressure where `column` names one, at a share of the step."""
    other = _value(coefficients, column, share) if column >= 0 else source
    return _value(coefficients, row, share) - other


@compiled
def land(kind: int, share: float, machine: MachineRecord, space: Workspace) -> None:
    """Bring the piston to rest at an event: at the stop that it met, without rebound, or where its velocity is zero."""
    for i in range(space.state.size):
        space.state[i] = _value(space.coefficients, i, share)
    space.state[1] = 0.0
    if kind == LOWER_STOP:
        space.state[0] = machine.load.lower_stop
    elif kind == UPPER_STOP:
        space.state[0] = machine.load.upper_stop


@compiled
def rest_at_source(machine: MachineRecord, space: Workspace) -> bool:
    """Let a chamber of a resting piston come to rest at the pressure of the one source it is open to.

    The flow is like the root of the pressure difference d, so d reaches zero in the finite time 2 d / |d'| and stays.
    Left alone, an explicit method would go on in tiny steps beside that pressure, where the slope is infinite. Returns
    whether a pressure was set.
    """
    state, before, changed = space.state, space.coefficients, False
    # A liquid comes to rest exponentially, a volume with an energy balance goes on as long as its temperature does.
    for k in range(0 if is_liquid(machine) else machine.n_volumes):
        low = only_source(k, space.areas, machine)
        if not math.isnan(low) and temperature_place(k, machine) < 0:
            difference = before[0, 2 + k] - low
            # The interpolant's first power is the rate at the start of the step, times its length.
            change = before[1, 2 + k]
            if difference * (state[2 + k] - low) <= 0.0 or abs(change) >= 2.0 * abs(difference):
                set_to_rest = state[2 + k] != low
                state[2 + k] = low
                changed = changed or set_to_rest
    return changed
