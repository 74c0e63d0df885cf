"""Derivatives of the machine's equations over its state and its inputs, compiled.

The mass and energy flows of every volume are differentiated path by path; each volume's own balances then turn their
derivatives into those of its pressure and temperature.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import by_field, compiled
from ltvpneu.models.machine.dynamics import (
    balanced,
    chamber_volume,
    density_along,
    enthalpy_of,
    gas_at_source,
    gas_in_chamber,
    gas_in_volume,
    temperature_slope,
)
from ltvpneu.models.machine.records import (
    AMBIENT,
    LOAD_FORCE,
    N_INPUTS,
    GeneralRecord,
    MachineRecord,
    is_liquid,
    source_state,
    temperature_place,
)
from ltvpneu.physics.flow import mass_flow, mass_flow_slopes
from ltvpneu.physics.gas import GasState
from ltvpneu.physics.medium import path_flow_slopes, properties


@compiled
def state_tangent(
    state: FloatArray, areas: FloatArray, machine: MachineRecord, full: bool, A: FloatArray, B: FloatArray
) -> None:
    """Write the derivatives of the state's rate over the state and over the inputs into `A` and `B`.

    Parameters
    ----------
    state, areas, machine
        As for `state_rate`; dry friction, constant on either side of rest, has no part in the tangent.
    full : bool
        Whether to take all derivatives. If not, the paper's choice (8b): in the rows of pressures and temperatures,
        none over the position, and the others as at rest, a liquid's bulk modulus held.
    A : ndarray, shape (n, n)
    B : ndarray, shape (n, 4)
        Over the machine's `INPUTS`.
    """
    load, n_volumes = machine.load, machine.n_volumes
    A.fill(0.0)
    B.fill(0.0)
    A[0, 1] = 1.0
    A[1, 0] = -load.spring_stiffness / load.mass
    A[1, 1] = -load.viscous_damping / load.mass
    B[1, AMBIENT] = load.ambient_push_area / load.mass
    B[1, LOAD_FORCE] = 1.0 / load.mass
    for k in range(n_volumes):
        A[1, 2 + k] = machine.volumes[k].push_area / load.mass
    _volume_rows(state, areas, machine, full, A, B)


def _general_rows(
    state: FloatArray, areas: FloatArray, machine: GeneralRecord, full: bool, A: FloatArray, B: FloatArray
) -> None:
    """Write the rows of all pressures and temperatures, of any medium and process."""
    n_volumes = machine.n_volumes
    sums = _Sums(np.zeros((n_volumes, 2)), A, B)
    for path in range(machine.n_paths):
        if areas[0, path] != 0.0 and areas[1, path] != 0.0:
            _add_path(path, state, areas, machine, sums)
    velocity = state[1] if full else 0.0
    for k in range(n_volumes):
        if temperature_place(k, machine) < 0:
            _pressure_row(k, state, velocity, full, machine, sums)
        else:
            _energy_rows(k, state, velocity, full, machine, sums)


def _plain_rows(
    state: FloatArray, areas: FloatArray, machine: MachineRecord, full: bool, A: FloatArray, B: FloatArray
) -> None:
    """Write the rows of all pressures in the paper's case, as `state_rate` has it."""
    for k in range(machine.n_volumes):
        inside = gas_in_chamber(k, state[2 + k], machine)
        exponent, slope = machine.volumes[k].polytropic_exponent, machine.volumes[k].slope
        flow, by_chamber = 0.0, 0.0
        for path in range(machine.n_paths):
            first, second = areas[0, path], areas[1, path]
            if machine.paths[path].volume != k or first == 0.0 or second == 0.0:
                continue
            source = source_state(machine.paths[path].source, machine)
            slopes = mass_flow_slopes(first, second, source, inside, machine.gas)
            through = mass_flow(first, second, source, inside, machine.gas)
            flow += through
            B[2 + k, -1 - machine.paths[path].source] += slopes[0]
            by_chamber += slopes[1]
            if through < 0.0:
                # An outflow carries the chamber's temperature, M_f ~ T^(-1/2), and T follows the pressure by (4).
                by_chamber -= 0.5 * through * (exponent - 1.0) / (exponent * inside.pressure)
        volume = chamber_volume(k, state[0], machine)
        factor = exponent / volume
        supplied = machine.gas.specific_gas_constant * inside.temperature
        by_temperature = (exponent - 1.0) / (exponent * inside.pressure) * flow
        A[2 + k, 1] = -factor * inside.pressure * slope
        A[2 + k, 2 + k] = factor * supplied * (by_chamber + by_temperature)
        B[2 + k, 0] *= factor * supplied
        B[2 + k, 1] *= factor * supplied
        if full:
            swept = inside.pressure * slope * state[1]
            A[2 + k, 2 + k] -= factor * slope * state[1]
            A[2 + k, 0] = -factor * (supplied * flow - swept) * slope / volume


_volume_rows = by_field("medium", "machine", _general_rows, _plain_rows)


def _general_slopes(
    path: int, areas: FloatArray, source: GasState, inside: GasState, machine: GeneralRecord
) -> tuple[float, float, float, float]:
    return path_flow_slopes(areas[0, path], areas[1, path], source, inside, machine.laws[path], machine.medium)


def _plain_slopes(
    path: int, areas: FloatArray, source: GasState, inside: GasState, machine: MachineRecord
) -> tuple[float, float, float, float]:
    first, second = areas[0, path], areas[1, path]
    flow = mass_flow(first, second, source, inside, machine.gas)
    by_source, by_chamber = mass_flow_slopes(first, second, source, inside, machine.gas)
    # M_f ~ T^(-1/2) of the side upstream, (5).
    upstream = source.temperature if flow >= 0.0 else inside.temperature
    return flow, by_source, by_chamber, -0.5 * flow / upstream


flow_slopes_into = by_field("medium", "machine", _general_slopes, _plain_slopes)
"""Mass flow from a source into a volume [kg/s] and its slopes, as of `path_flow_slopes`, in any medium."""


class _Sums(NamedTuple):
    """What gathers over the paths."""

    totals: FloatArray
    """Flow of mass [kg/s] and of energy [W] into each volume, (n_volumes, 2)."""
    A: FloatArray
    """The derivatives of these, in the rows where those of the rates will stand, (n, n)."""
    B: FloatArray


class _Slopes(NamedTuple):
    """Flow through a path as a function of the two pressures and the temperature of the side that it comes from."""

    source: int
    """Column of the source's pressure in A, or `SUPPLY` or `EXHAUST` for one in B."""
    chamber: int
    upstream: int
    """Column of the pressure of the side that it comes from, likewise."""
    temperature: int
    """Column that the temperature there depends on; -3 where it is given."""
    flow: float
    by_source: float
    by_chamber: float
    by_temperature: float


@compiled
def _add(column: int, value: float, row_A: FloatArray, row_B: FloatArray) -> None:
    if column >= 0:
        row_A[column] += value
    else:
        row_B[-1 - column] += value


@compiled
def _slopes(path: int, state: FloatArray, areas: FloatArray, machine: GeneralRecord) -> _Slopes:
    k, other = machine.paths[path].volume, machine.paths[path].source
    source, inside = gas_at_source(path, state, machine), gas_in_volume(k, state, machine)
    flow, by_source, by_chamber, by_temperature = flow_slopes_into(path, areas, source, inside, machine)
    column = 2 + other if other >= 0 else other
    volume = k if flow < 0.0 else other
    upstream = 2 + k if flow < 0.0 else column
    temperature = -3
    if volume >= 0:
        temperature = temperature_place(volume, machine)
        if temperature < 0:
            temperature = 2 + volume
            by_temperature *= temperature_slope(volume, inside if flow < 0.0 else source, machine)
    return _Slopes(column, 2 + k, upstream, temperature, flow, by_source, by_chamber, by_temperature)


@compiled
def _add_path(path: int, state: FloatArray, areas: FloatArray, machine: GeneralRecord, sums: _Sums) -> None:
    """Add a path's flows to the volumes at its ends, and their derivatives to the rows of these."""
    totals, A, B = sums.totals, sums.A, sums.B
    k, other = machine.paths[path].volume, machine.paths[path].source
    found = _slopes(path, state, areas, machine)
    for end in range(2):
        volume, sign = (k, 1.0) if end == 0 else (other, -1.0)
        if volume < 0:
            continue
        totals[volume, 0] += sign * found.flow
        _add_flow(sign, found, A[2 + volume], B[2 + volume])
        row = temperature_place(volume, machine)
        if row >= 0:
            upstream = gas_in_volume(k, state, machine) if found.flow < 0.0 else gas_at_source(path, state, machine)
            h, h_p, h_T = enthalpy_of(upstream, machine)
            totals[volume, 1] += sign * found.flow * h
            _add_flow(sign * h, found, A[row], B[row])
            _add(found.upstream, sign * found.flow * h_p, A[row], B[row])
            feeding = k if found.flow < 0.0 else other
            if feeding >= 0:
                slope = 1.0
                if temperature_place(feeding, machine) < 0:
                    slope = temperature_slope(feeding, upstream, machine)
                A[row, found.temperature] += sign * found.flow * h_T * slope


@compiled
def _add_flow(factor: float, found: _Slopes, row_A: FloatArray, row_B: FloatArray) -> None:
    _add(found.source, factor * found.by_source, row_A, row_B)
    _add(found.chamber, factor * found.by_chamber, row_A, row_B)
    if found.temperature >= 0:
        row_A[found.temperature] += factor * found.by_temperature


@compiled
def _pressure_row(k: int, state: FloatArray, velocity: float, full: bool, machine: GeneralRecord, sums: _Sums) -> None:
    """Turn the derivatives of a volume's mass flow into those of its pressure's rate (M - rho V') / (V d rho/dp)."""
    mass, A, B = sums.totals[k, 0], sums.A, sums.B
    volume, slope = chamber_volume(k, state[0], machine), machine.volumes[k].slope
    along = density_along(k, gas_in_volume(k, state, machine), machine)
    factor = 1.0 / (volume * along.by_pressure)
    for j in range(state.size):
        A[2 + k, j] *= factor
    for j in range(N_INPUTS):
        B[2 + k, j] *= factor
    rate = (mass - along.density * slope * velocity) * factor
    A[2 + k, 2 + k] -= slope * velocity / volume
    # At rest, with nothing swept, the rate is the whole flow's: times the change of a liquid's bulk modulus it would
    # make a feedback that the machine does not have. The paper's choice is a constant bulk modulus there.
    if full or not is_liquid(machine):
        A[2 + k, 2 + k] -= rate * along.second / along.by_pressure
    A[2 + k, 1] -= along.density * slope * factor
    if full:
        A[2 + k, 0] -= rate * slope / volume


@compiled
def _energy_rows(k: int, state: FloatArray, velocity: float, full: bool, machine: GeneralRecord, sums: _Sums) -> None:
    """Turn the derivatives of a volume's mass and energy flow into those of the rates of pressure and temperature.

    Of M(y) y' = b(y) the derivative is M^-1 (b_y - M_y y').
    """
    A, B = sums.A, sums.B
    p, row, place = 2 + k, 2 + k, temperature_place(k, machine)
    volume, slope, here = (
        chamber_volume(k, state[0], machine),
        machine.volumes[k].slope,
        gas_in_volume(k, state, machine),
    )
    found = properties(here.pressure, here.temperature, machine.medium)
    conductance, swept = machine.volumes[k].conductance, slope * velocity
    rho, u = found.rho, found.u
    mass, energy = sums.totals[k, 0], sums.totals[k, 1]
    energy += conductance * (machine.volumes[k].wall_temperature - here.temperature)
    rates = balanced(found, volume, mass - rho * swept, energy - here.pressure * swept - u * mass)
    for j in range(state.size):
        A[row, j], A[place, j] = balanced(found, volume, A[row, j], A[place, j] - u * A[row, j])
    for j in range(N_INPUTS):
        B[row, j], B[place, j] = balanced(found, volume, B[row, j], B[place, j] - u * B[row, j])
    dp, dT = rates
    by_p = balanced(
        found,
        volume,
        -found.rho_p * swept - volume * (found.rho_pp * dp + found.rho_pT * dT),
        -swept
        - found.u_p * mass
        - volume * (found.rho_p * found.u_p + rho * found.u_pp) * dp
        - volume * (found.rho_p * found.u_T + rho * found.u_pT) * dT,
    )
    by_T = balanced(
        found,
        volume,
        -found.rho_T * swept - volume * (found.rho_pT * dp + found.rho_TT * dT),
        -conductance
        - found.u_T * mass
        - volume * (found.rho_T * found.u_p + rho * found.u_pT) * dp
        - volume * (found.rho_T * found.u_T + rho * found.u_TT) * dT,
    )
    by_v = balanced(found, volume, -rho * slope, -here.pressure * slope)
    for i in range(2):
        target = row if i == 0 else place
        A[target, p] += by_p[i]
        A[target, place] += by_T[i]
        A[target, 1] += by_v[i]
        if full:
            A[target, 0] -= rates[i] * slope / volume


@compiled
def tangents(
    states: FloatArray, areas: FloatArray, machine: MachineRecord, full: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the tangents at one state per step: (n_steps, n, n) over the state, (n_steps, n, 4) over the inputs."""
    n_steps, n = states.shape
    A, B = np.empty((n_steps, n, n)), np.empty((n_steps, n, N_INPUTS))
    for step in range(n_steps):
        state_tangent(states[step], areas[step], machine, full, A[step], B[step])
    return A, B
