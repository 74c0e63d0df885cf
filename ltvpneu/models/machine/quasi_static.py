"""What the volumes come to when the valve stands still (16), and which pressures they lie between. Compiled."""

import math

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu._compiled import by_field, compiled
from ltvpneu.models.machine.dynamics import flow_into, gas_at_source, gas_in_volume
from ltvpneu.models.machine.records import SUPPLY, GeneralRecord, MachineRecord, source_state, temperature_place

MAX_SWEEPS = 500
"""Passes over volumes whose balances depend on each other's, or on a temperature; each closes in by a factor."""
SETTLED = 1e-14
"""Relative change in a pass at which all are at rest [-]."""


@compiled
def is_open(path: int, areas: FloatArray) -> bool:
    """Whether anything can flow through a path."""
    return areas[0, path] > 0.0 and areas[1, path] > 0.0


@compiled
def source_range(k: int, areas: FloatArray, machine: MachineRecord) -> tuple[float, float]:
    """Lowest and highest of the supply and exhaust pressure that volume k is open to [Pa]; (inf, -inf) for neither."""
    low, high = math.inf, -math.inf
    for path in range(machine.n_paths):
        if machine.paths[path].volume == k and machine.paths[path].source < 0 and is_open(path, areas):
            pressure = source_state(machine.paths[path].source, machine).pressure
            low, high = min(low, pressure), max(high, pressure)
    return low, high


@compiled
def only_source(k: int, areas: FloatArray, machine: MachineRecord) -> float:
    """Pressure of the one source that volume k is open to [Pa]; nan where there is none, or more to be open to."""
    low, high = source_range(k, areas, machine)
    for path in range(machine.n_paths):
        joins = machine.paths[path].source >= 0 and (machine.paths[path].volume == k or machine.paths[path].source == k)
        if joins and is_open(path, areas):
            return math.nan
    return low if low == high else math.nan


@compiled
def nearest_source(k: int, state: FloatArray, areas: FloatArray, machine: MachineRecord) -> tuple[float, int]:
    """Return the pressure nearest to that of volume k among all that it is open to [Pa], and whose it is.

    A column of the state, `SUPPLY` or `EXHAUST`; infinity where the volume is shut.
    """
    nearest, column = math.inf, SUPPLY
    for path in range(machine.n_paths):
        into, other = machine.paths[path].volume, machine.paths[path].source
        if not is_open(path, areas) or (into != k and other != k):
            continue
        if other >= 0:
            place = 2 + (into if other == k else other)
            pressure = float(state[place])
        else:
            place = other
            pressure = source_state(other, machine).pressure
        if abs(state[2 + k] - pressure) < abs(state[2 + k] - nearest):
            nearest, column = pressure, place
    return nearest, column


@compiled
def net_flow(k: int, state: FloatArray, areas: FloatArray, machine: MachineRecord) -> float:
    """Mass flow into volume k [kg/s]."""
    total = 0.0
    for path in range(machine.n_paths):
        into, other = machine.paths[path].volume, machine.paths[path].source
        if (into == k or other == k) and is_open(path, areas):
            source, inside = gas_at_source(path, state, machine), gas_in_volume(into, state, machine)
            flow = flow_into(path, areas, source, inside, machine)
            total += flow if into == k else -flow
    return total


@compiled
def settle_volumes(areas: FloatArray, machine: MachineRecord, state: FloatArray) -> None:
    """Bring the volumes' pressures and temperatures in `state` to rest, eq. (16) with erratum E10.

    At rest no mass may gather in a volume: the sum of its flows, which falls as its pressure rises, is zero. Volumes
    with no way to a source share what they hold among themselves; one that is shut keeps its pressure.
    """
    _settle(areas, machine, state)


def _settle_plain(areas: FloatArray, machine: MachineRecord, state: FloatArray) -> None:
    """Volumes that do not feed each other have no part in each other's balance."""
    for k in range(machine.n_volumes):
        if source_range(k, areas, machine)[1] > 0.0:
            _balance_volume(k, areas, machine, state)


def _settle_general(areas: FloatArray, machine: GeneralRecord, state: FloatArray) -> None:
    n_volumes = machine.n_volumes
    group, anchored = _groups(areas, machine)
    _share(group, anchored, machine, state)
    for _ in range(MAX_SWEEPS):
        moved = 0.0
        for k in range(n_volumes):
            place = temperature_place(k, machine)
            if anchored[group[k]]:
                pressure = state[2 + k]
                _balance_volume(k, areas, machine, state)
                moved = max(moved, abs(state[2 + k] - pressure) / pressure)
            if place >= 0:
                temperature = state[place]
                _settle_temperature(k, areas, machine, state)
                moved = max(moved, abs(state[place] - temperature) / temperature)
        if moved < SETTLED:
            break


_settle = by_field("medium", "machine", _settle_general, _settle_plain)


@compiled
def _groups(areas: FloatArray, machine: GeneralRecord) -> tuple[IntArray, BoolArray]:
    """Return which volumes open paths join, as the least number of each group, and which groups have a source."""
    n_volumes = machine.n_volumes
    group, anchored = np.arange(n_volumes), np.zeros(n_volumes, dtype=np.bool_)
    for _ in range(n_volumes):
        for path in range(machine.n_paths):
            into, other = machine.paths[path].volume, machine.paths[path].source
            if other >= 0 and is_open(path, areas):
                least = min(group[into], group[other])
                group[into], group[other] = least, least
    for path in range(machine.n_paths):
        if machine.paths[path].source < 0 and is_open(path, areas):
            anchored[group[machine.paths[path].volume]] = True
    return group, anchored


@compiled
def _share(group: IntArray, anchored: BoolArray, machine: GeneralRecord, state: FloatArray) -> None:
    """Give volumes that are joined, but shut off from every source, their common pressure, by their dead volumes."""
    for first in range(group.size):
        if group[first] != first or anchored[first]:
            continue
        whole, held = 0.0, 0.0
        for k in range(group.size):
            if group[k] == first:
                whole += machine.volumes[k].size
                held += machine.volumes[k].size * state[2 + k]
        for k in range(group.size):
            if group[k] == first:
                state[2 + k] = held / whole


@compiled
def _balance_volume(k: int, areas: FloatArray, machine: MachineRecord, state: FloatArray) -> None:
    """Set the pressure of volume k, all others given, to where nothing gathers in it."""
    low, high = source_range(k, areas, machine)
    for path in range(machine.n_paths):
        into, other = machine.paths[path].volume, machine.paths[path].source
        if other >= 0 and is_open(path, areas) and (into == k or other == k):
            pressure = float(state[2 + (other if into == k else into)])
            low, high = min(low, pressure), max(high, pressure)
    # Bisection to the last bit: the slope is infinite where pressures meet, and some 50 halvings are cheap.
    middle = 0.5 * (low + high)
    while low < middle < high:
        state[2 + k] = middle
        if net_flow(k, state, areas, machine) > 0.0:
            low = middle
        else:
            high = middle
        middle = 0.5 * (low + high)
    state[2 + k] = middle


@compiled
def _settle_temperature(k: int, areas: FloatArray, machine: GeneralRecord, state: FloatArray) -> None:
    """Set the temperature of a volume with an energy balance to that of inflow and wall, by their weights.

    Where neither is there, any temperature is at rest, and that of the surroundings is taken.
    """
    gas = machine.gas
    heat = gas.heat_capacity_ratio / (gas.heat_capacity_ratio - 1.0) * gas.specific_gas_constant
    weight, sum_ = (
        machine.volumes[k].conductance,
        machine.volumes[k].conductance * machine.volumes[k].wall_temperature,
    )
    for path in range(machine.n_paths):
        into, other = machine.paths[path].volume, machine.paths[path].source
        if (into == k or other == k) and is_open(path, areas):
            source, inside = gas_at_source(path, state, machine), gas_in_volume(into, state, machine)
            flow = flow_into(path, areas, source, inside, machine)
            coming = flow if into == k else -flow
            if coming > 0.0:
                weight += heat * coming
                sum_ += heat * coming * (source.temperature if into == k else inside.temperature)
    state[temperature_place(k, machine)] = sum_ / weight if weight > 0.0 else machine.exhaust.temperature


@compiled
def settled_states(areas: FloatArray, machine: MachineRecord, start: FloatArray) -> FloatArray:
    """Return states with the quasi-static pressures and temperatures of every step of a turn, shape (n_steps, n).

    Twice round: a volume shut at the start of the turn keeps what the last step left. The piston stays.
    """
    n_steps = areas.shape[0]
    found = np.empty((n_steps, start.size))
    present = start.copy()
    for step in range(2 * n_steps):
        settle_volumes(areas[step % n_steps], machine, present)
        for i in range(start.size):
            found[step % n_steps, i] = present[i]
    return found


@compiled
def source_ranges(areas: FloatArray, machine: MachineRecord) -> FloatArray:
    """Return `source_range` of every step and volume, shape (n_steps, n_volumes, 2)."""
    n_steps, n_volumes = areas.shape[0], machine.n_volumes
    found = np.empty((n_steps, n_volumes, 2))
    for step in range(n_steps):
        for k in range(n_volumes):
            found[step, k, 0], found[step, k, 1] = source_range(k, areas[step], machine)
    return found
