"""Mass flow out of the supply or the exhaust, and its tangents, compiled: what air use is computed from."""

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import flow_into, gas_in_volume, temperature_slope
from ltvpneu.models.machine.records import EXHAUST, N_INPUTS, SUPPLY, MachineRecord, source_state, temperature_place
from ltvpneu.models.machine.tangent import flow_slopes_into
from ltvpneu.physics.gas import GasState


@compiled
def source_flow(states: FloatArray, areas: FloatArray, from_supply: bool, machine: MachineRecord) -> FloatArray:
    """Return the mass flow out of the supply, or out of the exhaust, at a stack of states [kg/s], (n_states,).

    Shapes: states (n_states, n), areas (n_states, 2, n_paths).
    """
    found = np.zeros(states.shape[0])
    wanted = SUPPLY if from_supply else EXHAUST
    source = source_state(wanted, machine)
    for i in range(states.shape[0]):
        for path in range(machine.n_paths):
            if machine.paths[path].source == wanted:
                inside = gas_in_volume(machine.paths[path].volume, states[i], machine)
                found[i] += flow_into(path, areas[i], source, inside, machine)
    return found


@compiled
def supply_flow_tangents(
    points: FloatArray, areas: FloatArray, distance: float, machine: MachineRecord
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rows c, d and offset q of the supply's mass flow c z + d u + q [kg/s] about one state per step.

    Closer to the supply's pressure than `distance`, relative to it, the slope is that of the chord to it.
    """
    n_steps, n = points.shape
    by_state, by_input, offset = np.zeros((n_steps, n)), np.zeros((n_steps, N_INPUTS)), np.zeros(n_steps)
    source = source_state(SUPPLY, machine)
    for i in range(n_steps):
        for path in range(machine.n_paths):
            first, second = areas[i, 0, path], areas[i, 1, path]
            if machine.paths[path].source != SUPPLY or first == 0.0 or second == 0.0:
                continue
            k = machine.paths[path].volume
            inside = gas_in_volume(k, points[i], machine)
            least = distance * source.pressure
            if abs(inside.pressure - source.pressure) < least:
                pressure = source.pressure + (least if inside.pressure > source.pressure else -least)
                away = GasState(pressure, inside.temperature)
                through = flow_into(path, areas[i], source, away, machine)
                slope = through / (pressure - source.pressure)
                by_state[i, 2 + k] += slope
                by_input[i, 0] -= slope
                continue
            through, by_source, by_chamber, by_temperature = flow_slopes_into(path, areas[i], source, inside, machine)
            by_state[i, 2 + k] += by_chamber
            by_input[i, 0] += by_source
            offset[i] += through - by_chamber * inside.pressure - by_source * source.pressure
            if through < 0.0:
                place = temperature_place(k, machine)
                if place < 0:
                    place = 2 + k
                    by_temperature *= temperature_slope(k, inside, machine)
                by_state[i, place] += by_temperature
                offset[i] -= by_temperature * points[i, place]
    return by_state, by_input, offset
