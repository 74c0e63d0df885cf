r"""The machine's equations (3)-(7), compiled; every model calls these kernels.

.. math::
    \dot x = v, \qquad M_t \dot v = F_e - C_v v - F_d \operatorname{sign} v, \qquad
    \dot p_k = \frac{n_k}{V_k} \left( R T_k \sum_i \dot m_{ik} - p_k \frac{dV_k}{dx} v \right)

with F_e = sum of push areas times pressures - K_s x + external force, (7b) with erratum E4, and the push of the ambient
air on rods and on a side that is open (`physics.cylinder`), which the paper leaves out. That is the ideal gas in a
polytropic chamber. In general a volume of density rho(p, T) has d(rho V)/dt = M, its mass flow; where T follows from p,

.. math:: \dot p = \frac{M - \rho \dot V}{V \, d\rho/dp}

with d/dp along that process, and where it is a state, this and the first law are two linear equations in p' and T':

.. math::
    V (\rho_p \dot p + \rho_T \dot T) = M - \rho \dot V, \qquad
    V \rho (u_p \dot p + u_T \dot T) = H + Q - p \dot V - u M

with the enthalpy flow H and the wall's heat Q (`physics.thermal`).
"""

from typing import NamedTuple

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import by_field, compiled, inlined
from ltvpneu.models.machine.records import GeneralRecord, MachineRecord, is_liquid, source_state, temperature_place
from ltvpneu.physics.flow import mass_flow
from ltvpneu.physics.gas import GasState, ideal_properties, polytropic_temperature
from ltvpneu.physics.medium import in_range, path_flow, properties
from ltvpneu.physics.properties import Properties

STUCK = 2
"""Mode of a piston held by stiction; in motion the mode is the direction +1 or -1, which signs the dry friction."""


@inlined
def gas_in_chamber(k: int, pressure: float, machine: MachineRecord) -> GasState:
    """Return pressure [Pa] and temperature [K] in a polytropic volume k, eq. (4) with ambient as the reference."""
    temperature = polytropic_temperature(
        pressure, machine.volumes[k].polytropic_exponent, machine.exhaust.temperature, machine.exhaust.pressure
    )
    return GasState(pressure, temperature)


@compiled
def gas_in_volume(k: int, state: FloatArray, machine: MachineRecord) -> GasState:
    """Return pressure [Pa] and temperature [K] in volume k, whatever its process."""
    place, pressure = temperature_place(k, machine), state[2 + k]
    return GasState(pressure, state[place]) if place >= 0 else gas_in_chamber(k, pressure, machine)


@compiled
def gas_at_source(path: int, state: FloatArray, machine: MachineRecord) -> GasState:
    """Return pressure [Pa] and temperature [K] of what feeds a path."""
    volume = machine.paths[path].source
    return gas_in_volume(volume, state, machine) if volume >= 0 else source_state(volume, machine)


def _general_flow(path: int, areas: FloatArray, source: GasState, inside: GasState, machine: GeneralRecord) -> float:
    return path_flow(areas[0, path], areas[1, path], source, inside, machine.laws[path], machine.medium)


def _plain_flow(path: int, areas: FloatArray, source: GasState, inside: GasState, machine: MachineRecord) -> float:
    return mass_flow(areas[0, path], areas[1, path], source, inside, machine.gas)


flow_into = by_field("medium", "machine", _general_flow, _plain_flow)
"""Mass flow from a source into a volume through a path, at areas (2, n_paths), in any medium [kg/s]."""


def _general_properties(here: GasState, machine: GeneralRecord) -> Properties:
    return properties(here.pressure, here.temperature, machine.medium)


def _plain_properties(here: GasState, machine: MachineRecord) -> Properties:
    return ideal_properties(here.pressure, here.temperature, machine.gas)


_properties = by_field("medium", "machine", _general_properties, _plain_properties)


@compiled
def properties_of(here: GasState, machine: MachineRecord) -> Properties:
    """Density and internal energy of the medium at a pressure and a temperature, with derivatives."""
    return _properties(here, machine)


def _in_general_range(here: GasState, machine: GeneralRecord) -> bool:
    return in_range(here.pressure, here.temperature, machine.medium)


def _in_plain_range(here: GasState, machine: MachineRecord) -> bool:
    return here.pressure > 0.0 and here.temperature > 0.0


_in_range = by_field("medium", "machine", _in_general_range, _in_plain_range)


@compiled
def is_in_range(here: GasState, machine: MachineRecord) -> bool:
    """Whether the medium's laws hold at a pressure and a temperature."""
    return _in_range(here, machine)


@inlined
def chamber_volume(k: int, position: float, machine: MachineRecord) -> float:
    """Return the size of volume k [m^3]."""
    return machine.volumes[k].size + machine.volumes[k].slope * position


@inlined
def external_force(state: FloatArray, machine: MachineRecord) -> float:
    """F_e, all forces on the piston but friction [N], (7b)."""
    load = machine.load
    force = load.force - load.spring_stiffness * state[0] + load.ambient_push_area * load.ambient_pressure
    for k in range(machine.n_volumes):
        force += machine.volumes[k].push_area * state[2 + k]
    return force


def _pressed_seals(state: FloatArray, machine: GeneralRecord) -> float:
    total = 0.0
    for k in range(machine.n_volumes):
        total += machine.volumes[k].friction_area * (state[2 + k] - machine.load.ambient_pressure)
    return total


def _constant_seals(state: FloatArray, machine: MachineRecord) -> float:
    return 0.0


seal_friction = by_field("medium", "machine", _pressed_seals, _constant_seals)
"""What the pressures add to dry friction and to stiction, by pressing the seals on [N]."""


@compiled
def state_rate(state: FloatArray, areas: FloatArray, mode: int, machine: MachineRecord, rate: FloatArray) -> bool:
    """Write the time derivative of the state into `rate`; False outside the equations' domain.

    Parameters
    ----------
    state : ndarray, shape (n,)
        Position [m], velocity [m/s], the volumes' pressures [Pa], temperatures [K] where they are states.
    areas : ndarray, shape (2, n_paths)
        Effective areas of the first and second restriction of each path [m^2].
    mode : int
        Direction of slip that signs the dry friction, or `STUCK`.
    machine : MachineRecord
    rate : ndarray, shape (n,)
        Result.
    """
    load = machine.load
    velocity = 0.0 if mode == STUCK else state[1]
    rate[0] = velocity
    rate[1] = 0.0
    if mode != STUCK:
        friction = load.viscous_damping * velocity + (load.dry_friction + seal_friction(state, machine)) * mode
        rate[1] = (external_force(state, machine) - friction) / load.mass
    return _volume_rates(state, areas, velocity, machine, rate)


def _plain_rates(
    state: FloatArray, areas: FloatArray, velocity: float, machine: MachineRecord, rate: FloatArray
) -> bool:
    """Write the rates of all pressures in the paper's case: the inner loop of every orbit."""
    for k in range(machine.n_volumes):
        volume = chamber_volume(k, state[0], machine)
        if not (volume > 0.0 and state[2 + k] > 0.0):
            return False
        inside = gas_in_chamber(k, state[2 + k], machine)
        flow = 0.0
        for path in range(machine.n_paths):
            if machine.paths[path].volume == k:
                source = source_state(machine.paths[path].source, machine)
                flow += mass_flow(areas[0, path], areas[1, path], source, inside, machine.gas)
        supplied = machine.gas.specific_gas_constant * inside.temperature * flow
        swept = inside.pressure * machine.volumes[k].slope * velocity
        rate[2 + k] = machine.volumes[k].polytropic_exponent / volume * (supplied - swept)
    return True


def _general_rates(
    state: FloatArray, areas: FloatArray, velocity: float, machine: GeneralRecord, rate: FloatArray
) -> bool:
    """Write the rates of all pressures and temperatures of any medium and process; False outside their domain."""
    n_volumes = machine.n_volumes
    for k in range(n_volumes):
        here = gas_in_volume(k, state, machine)
        if not (
            chamber_volume(k, state[0], machine) > 0.0 and in_range(here.pressure, here.temperature, machine.medium)
        ):
            return False
        # Mass and energy flow first gather where the rates will stand.
        rate[2 + k] = 0.0
        place = temperature_place(k, machine)
        if place >= 0:
            rate[place] = machine.volumes[k].conductance * (machine.volumes[k].wall_temperature - here.temperature)
    for path in range(machine.n_paths):
        first, second = areas[0, path], areas[1, path]
        if first == 0.0 or second == 0.0:
            continue
        k, other = machine.paths[path].volume, machine.paths[path].source
        source, inside = gas_at_source(path, state, machine), gas_in_volume(k, state, machine)
        flow = flow_into(path, areas, source, inside, machine)
        rate[2 + k] += flow
        if other >= 0:
            rate[2 + other] -= flow
        into, out = temperature_place(k, machine), temperature_place(other, machine) if other >= 0 else -1
        if into >= 0 or out >= 0:
            enthalpy = enthalpy_of(source if flow >= 0.0 else inside, machine)[0]
            if into >= 0:
                rate[into] += flow * enthalpy
            if out >= 0:
                rate[out] -= flow * enthalpy
    for k in range(n_volumes):
        volume, swept = chamber_volume(k, state[0], machine), machine.volumes[k].slope * velocity
        place, here = temperature_place(k, machine), gas_in_volume(k, state, machine)
        if place < 0:
            along = density_along(k, here, machine)
            rate[2 + k] = (rate[2 + k] - along.density * swept) / (volume * along.by_pressure)
        else:
            found = properties(here.pressure, here.temperature, machine.medium)
            mass = rate[2 + k] - found.rho * swept
            energy = rate[place] - here.pressure * swept - found.u * rate[2 + k]
            rate[2 + k], rate[place] = balanced(found, volume, mass, energy)
    return True


_volume_rates = by_field("medium", "machine", _general_rates, _plain_rates)


class Along(NamedTuple):
    """Density [kg/m^3] and its first and second derivative over the pressure, along a volume's process."""

    density: float
    by_pressure: float
    second: float


@compiled
def temperature_slope(k: int, here: GasState, machine: MachineRecord) -> float:
    """Return dT/dp [K/Pa] where the temperature follows from the pressure, by (4)."""
    exponent = machine.volumes[k].polytropic_exponent
    return (exponent - 1.0) / exponent * here.temperature / here.pressure


@compiled
def density_along(k: int, here: GasState, machine: GeneralRecord) -> Along:
    """Return the density of volume k as a function of its pressure alone, its temperature by (4)."""
    found = properties(here.pressure, here.temperature, machine.medium)
    if is_liquid(machine):
        return Along(found.rho, found.rho_p, found.rho_pp)
    exponent = machine.volumes[k].polytropic_exponent
    slope = temperature_slope(k, here, machine)
    curvature = -slope / (exponent * here.pressure)
    return Along(
        found.rho,
        found.rho_p + found.rho_T * slope,
        found.rho_pp + (2.0 * found.rho_pT + found.rho_TT * slope) * slope + found.rho_T * curvature,
    )


@compiled
def enthalpy_of(here: GasState, machine: MachineRecord) -> tuple[float, float, float]:
    """Return the specific enthalpy u + p / rho [J/kg] and its slopes over pressure and temperature."""
    found = properties_of(here, machine)
    p, rho = here.pressure, found.rho
    return (
        found.u + p / rho,
        found.u_p + 1.0 / rho - p * found.rho_p / (rho * rho),
        found.u_T - p * found.rho_T / (rho * rho),
    )


@compiled
def balanced(found: Properties, volume: float, mass: float, energy: float) -> tuple[float, float]:
    """Solve the balances of mass and energy of a volume for the rates of its pressure and temperature.

    `mass` and `energy` are their right-hand sides, [kg/s] and [W].
    """
    rho = found.rho
    determinant = volume * rho * (found.rho_p * found.u_T - found.rho_T * found.u_p)
    by_mass_p, by_mass_T = rho * found.u_T / determinant, -rho * found.u_p / determinant
    by_u_p, by_u_T = -found.rho_T / determinant, found.rho_p / determinant
    return by_mass_p * mass + by_u_p * energy, by_mass_T * mass + by_u_T * energy
