r"""The machine's equations (3)-(7) and their tangent, compiled; every model calls these kernels.

.. math::
    \dot x = v, \qquad M_t \dot v = F_e - C_v v - F_d \operatorname{sign} v, \qquad
    \dot p_k = \frac{n_k}{V_k} \left( R T_k \sum_i \dot m_{ik} - p_k \frac{dV_k}{dx} v \right)

with F_e = sum of push areas times pressures - K_s x + external force, (7b) with erratum E4.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.machine import MachineArrays
from ltvpneu.physics.flow import mass_flow, mass_flow_slopes
from ltvpneu.physics.gas import GasState, polytropic_temperature

STUCK = 2
"""Mode of a piston held by stiction; in motion the mode is the direction +1 or -1, which signs the dry friction."""


@inlined
def gas_in_chamber(k: int, pressure: float, machine: MachineArrays) -> GasState:
    """Return pressure [Pa] and temperature [K] in chamber k, eq. (4) with ambient as the reference."""
    temperature = polytropic_temperature(
        pressure, machine.chambers[k, 2], machine.exhaust.temperature, machine.exhaust.pressure
    )
    return GasState(pressure, temperature)


@inlined
def chamber_volume(k: int, position: float, machine: MachineArrays) -> float:
    """Return the volume of chamber k [m^3]."""
    return machine.chambers[k, 0] + machine.chambers[k, 1] * position


@inlined
def external_force(state: FloatArray, machine: MachineArrays) -> float:
    """F_e, all forces on the piston but friction [N], (7b)."""
    load = machine.load
    force = load.force - load.spring_stiffness * state[0] + load.open_push_area * machine.exhaust.pressure
    for k in range(machine.chambers.shape[0]):
        force += machine.chambers[k, 3] * state[2 + k]
    return force


@inlined
def state_rate(state: FloatArray, areas: FloatArray, mode: int, machine: MachineArrays, rate: FloatArray) -> bool:
    """Write the time derivative of the state into `rate`; False where a volume or pressure is not above zero.

    Parameters
    ----------
    state : ndarray, shape (2 + n_c,)
        Position [m], velocity [m/s], chamber pressures [Pa].
    areas : ndarray, shape (2, n_paths)
        Effective areas of the first and second restriction of each path [m^2].
    mode : int
        Direction of slip that signs the dry friction, or `STUCK`.
    machine : MachineArrays
    rate : ndarray, shape (2 + n_c,)
        Result.
    """
    load = machine.load
    velocity = 0.0 if mode == STUCK else state[1]
    rate[0] = velocity
    rate[1] = 0.0
    if mode != STUCK:
        friction = load.viscous_damping * velocity + load.dry_friction * mode
        rate[1] = (external_force(state, machine) - friction) / load.mass
    for k in range(machine.chambers.shape[0]):
        volume = chamber_volume(k, state[0], machine)
        if not (volume > 0.0 and state[2 + k] > 0.0):
            return False
        inside = gas_in_chamber(k, state[2 + k], machine)
        flow = 0.0
        for path in range(machine.path_chamber.size):
            if machine.path_chamber[path] == k:
                source = machine.supply if machine.path_from_supply[path] else machine.exhaust
                flow += mass_flow(areas[0, path], areas[1, path], source, inside, machine.gas)
        supplied = machine.gas.specific_gas_constant * inside.temperature * flow
        swept = inside.pressure * machine.chambers[k, 1] * velocity
        rate[2 + k] = machine.chambers[k, 2] / volume * (supplied - swept)
    return True


@compiled
def state_tangent(
    state: FloatArray, areas: FloatArray, machine: MachineArrays, full: bool, A: FloatArray, B: FloatArray
) -> None:
    """Write the derivatives of the state's rate over the state and over the inputs into `A` and `B`.

    Parameters
    ----------
    state, areas, machine
        As for `state_rate`; dry friction, constant on either side of rest, has no part in the tangent.
    full : bool
        Whether to take all derivatives. If not, the paper's choice (8b): in the pressure rows, none over the
        position, and the others as at rest.
    A : ndarray, shape (2 + n_c, 2 + n_c)
    B : ndarray, shape (2 + n_c, 3)
        Over supply pressure, exhaust pressure and external force.
    """
    load = machine.load
    A.fill(0.0)
    B.fill(0.0)
    A[0, 1] = 1.0
    A[1, 0] = -load.spring_stiffness / load.mass
    A[1, 1] = -load.viscous_damping / load.mass
    B[1, 1] = load.open_push_area / load.mass
    B[1, 2] = 1.0 / load.mass
    for k in range(machine.chambers.shape[0]):
        inside = gas_in_chamber(k, state[2 + k], machine)
        exponent, slope = machine.chambers[k, 2], machine.chambers[k, 1]
        flow, by_chamber = 0.0, 0.0
        for path in range(machine.path_chamber.size):
            first, second = areas[0, path], areas[1, path]
            if machine.path_chamber[path] != k or first == 0.0 or second == 0.0:
                continue
            from_supply = machine.path_from_supply[path]
            source = machine.supply if from_supply else machine.exhaust
            slopes = mass_flow_slopes(first, second, source, inside, machine.gas)
            through = mass_flow(first, second, source, inside, machine.gas)
            flow += through
            B[2 + k, 0 if from_supply else 1] += slopes[0]
            by_chamber += slopes[1]
            if through < 0.0:
                # An outflow carries the chamber's temperature, M_f ~ T^(-1/2), and T follows the pressure by (4).
                by_chamber -= 0.5 * through * (exponent - 1.0) / (exponent * inside.pressure)
        volume = chamber_volume(k, state[0], machine)
        factor = exponent / volume
        supplied = machine.gas.specific_gas_constant * inside.temperature
        by_temperature = (exponent - 1.0) / (exponent * inside.pressure) * flow
        A[1, 2 + k] = machine.chambers[k, 3] / load.mass
        A[2 + k, 1] = -factor * inside.pressure * slope
        A[2 + k, 2 + k] = factor * supplied * (by_chamber + by_temperature)
        B[2 + k, 0] *= factor * supplied
        B[2 + k, 1] *= factor * supplied
        if full:
            swept = inside.pressure * slope * state[1]
            A[2 + k, 2 + k] -= factor * slope * state[1]
            A[2 + k, 0] = -factor * (supplied * flow - swept) * slope / volume


@compiled
def equilibrium_pressures(areas: FloatArray, machine: MachineArrays, start: FloatArray) -> FloatArray:
    """Return the chambers' quasi-static pressures [Pa], eq. (16) with erratum E10, shape (n_c,).

    At rest no mass may gather in a chamber: the sum of its flows, which falls as its pressure rises, is zero. A
    chamber with every path shut keeps its pressure `start`.
    """
    pressures = start.copy()
    for k in range(pressures.size):
        low, high = source_range(k, areas, machine)
        if low > high:
            continue
        # Bisection to the last bit: the slope is infinite where pressures meet, and some 50 halvings are cheap.
        middle = 0.5 * (low + high)
        while low < middle < high:
            if _net_flow(k, middle, areas, machine) > 0.0:
                low = middle
            else:
                high = middle
            middle = 0.5 * (low + high)
        pressures[k] = middle
    return pressures


@compiled
def source_range(k: int, areas: FloatArray, machine: MachineArrays) -> tuple[float, float]:
    """Lowest and highest pressure of the sources that chamber k is open to [Pa]; (inf, -inf) where it is shut."""
    low, high = math.inf, -math.inf
    for path in range(machine.path_chamber.size):
        if machine.path_chamber[path] == k and areas[0, path] > 0.0 and areas[1, path] > 0.0:
            pressure = machine.supply.pressure if machine.path_from_supply[path] else machine.exhaust.pressure
            low, high = min(low, pressure), max(high, pressure)
    return low, high


@compiled
def _net_flow(k: int, pressure: float, areas: FloatArray, machine: MachineArrays) -> float:
    inside = gas_in_chamber(k, pressure, machine)
    total = 0.0
    for path in range(machine.path_chamber.size):
        if machine.path_chamber[path] == k:
            source = machine.supply if machine.path_from_supply[path] else machine.exhaust
            total += mass_flow(areas[0, path], areas[1, path], source, inside, machine.gas)
    return total


@compiled
def tangents(
    states: FloatArray, areas: FloatArray, machine: MachineArrays, full: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the tangents at one state per step: (n_steps, n, n) over the state, (n_steps, n, 3) over the inputs."""
    n_steps, n = states.shape
    A, B = np.empty((n_steps, n, n)), np.empty((n_steps, n, 3))
    for step in range(n_steps):
        state_tangent(states[step], areas[step], machine, full, A[step], B[step])
    return A, B


@compiled
def settled_pressures(areas: FloatArray, machine: MachineArrays, start: FloatArray) -> FloatArray:
    """Return the quasi-static pressures of every step of a turn, shape (n_steps, n_c).

    Twice round: a chamber shut at the start of the turn keeps what the last step left.
    """
    n_steps = areas.shape[0]
    found = np.empty((n_steps, start.size))
    present = start
    for step in range(2 * n_steps):
        present = equilibrium_pressures(areas[step % n_steps], machine, present)
        for k in range(start.size):
            found[step % n_steps, k] = present[k]
    return found


@compiled
def source_ranges(areas: FloatArray, machine: MachineArrays) -> FloatArray:
    """Return `source_range` of every step and chamber, shape (n_steps, n_c, 2)."""
    n_steps, n_chambers = areas.shape[0], machine.chambers.shape[0]
    found = np.empty((n_steps, n_chambers, 2))
    for step in range(n_steps):
        for k in range(n_chambers):
            found[step, k, 0], found[step, k, 1] = source_range(k, areas[step], machine)
    return found


@compiled
def source_flow(states: FloatArray, areas: FloatArray, from_supply: bool, machine: MachineArrays) -> FloatArray:
    """Return the mass flow out of the supply, or out of the exhaust, at a stack of states [kg/s], (n_states,).

    Shapes: states (n_states, n), areas (n_states, 2, n_paths).
    """
    found = np.zeros(states.shape[0])
    source = machine.supply if from_supply else machine.exhaust
    for i in range(states.shape[0]):
        for path in range(machine.path_chamber.size):
            if machine.path_from_supply[path] == from_supply:
                k = machine.path_chamber[path]
                inside = gas_in_chamber(k, states[i, 2 + k], machine)
                found[i] += mass_flow(areas[i, 0, path], areas[i, 1, path], source, inside, machine.gas)
    return found


@compiled
def supply_flow_tangents(
    points: FloatArray, areas: FloatArray, distance: float, machine: MachineArrays
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rows c, d and offset q of the supply's mass flow c z + d u + q [kg/s] about one state per step.

    Closer to the supply's pressure than `distance`, relative to it, the slope is that of the chord to it.
    """
    n_steps, n = points.shape
    by_state, by_input, offset = np.zeros((n_steps, n)), np.zeros((n_steps, 3)), np.zeros(n_steps)
    source = machine.supply
    for i in range(n_steps):
        for path in range(machine.path_chamber.size):
            first, second = areas[i, 0, path], areas[i, 1, path]
            if not machine.path_from_supply[path] or first == 0.0 or second == 0.0:
                continue
            k = machine.path_chamber[path]
            pressure = points[i, 2 + k]
            least = distance * source.pressure
            if abs(pressure - source.pressure) < least:
                pressure = source.pressure + (least if pressure > source.pressure else -least)
                inside = gas_in_chamber(k, pressure, machine)
                slope = mass_flow(first, second, source, inside, machine.gas) / (pressure - source.pressure)
                by_state[i, 2 + k] += slope
                by_input[i, 0] -= slope
                continue
            inside = gas_in_chamber(k, pressure, machine)
            slopes = mass_flow_slopes(first, second, source, inside, machine.gas)
            through = mass_flow(first, second, source, inside, machine.gas)
            by_chamber = slopes[1]
            if through < 0.0:
                exponent = machine.chambers[k, 2]
                by_chamber -= 0.5 * through * (exponent - 1.0) / (exponent * pressure)
            by_state[i, 2 + k] += by_chamber
            by_input[i, 0] += slopes[0]
            offset[i] += through - by_chamber * pressure - slopes[0] * source.pressure
    return by_state, by_input, offset
