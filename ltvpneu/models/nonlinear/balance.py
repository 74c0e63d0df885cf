r"""Balances of mass and energy of every volume over an orbit of the nonlinear model.

Per volume, over the orbit's period, the mass that flowed in less what flowed out is what is stored more, and by the
first law

.. math:: \Delta (\rho u V) = \int (H + Q) \, dt - \int p \, dV

The orbit is integrated once more, tightly, and flows are integrated along it by Gauss' rule, so what is left over tells
the truth of the equations and of the integration together. In a volume whose temperature follows from its pressure, the
heat is what the process implies: the energy balance has nothing left over there by definition.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, positive, read_only
from ltvpneu._compiled import compiled
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import (
    chamber_volume,
    enthalpy_of,
    flow_into,
    gas_at_source,
    gas_in_volume,
    properties_of,
)
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import Pieces, pieces_of, write_areas
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.integrator import OK, Record
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.orbits.orbit import Orbit

NODES, WEIGHTS = (part / 2 for part in np.polynomial.legendre.leggauss(8))
MASS_IN, MASS_OUT, ENTHALPY_IN, ENTHALPY_OUT, HEAT, WORK = range(6)
CLOSES = 1e-3
"""Scaled distance from its beginning within which an orbit counts as closed [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Balance(Value):
    """What passed through each volume over one period of an orbit, arrays of shape (n_volumes,)."""

    volumes: tuple[str, ...]
    mass_in: FloatArray
    """[kg]"""
    mass_out: FloatArray
    """[kg]"""
    mass_stored: FloatArray
    """Change of the mass that is in the volume [kg]; on a closed orbit rounding."""
    enthalpy_in: FloatArray
    """[J]"""
    enthalpy_out: FloatArray
    """[J]"""
    heat: FloatArray
    """From the wall [J]."""
    work: FloatArray
    """Done on the piston, the integral of p dV [J]."""
    energy_stored: FloatArray
    """[J]"""
    turnover: FloatArray
    """Sum of the sizes of all energies that passed [J]."""

    def __repr__(self) -> str:
        return (
            f"<Balance of {', '.join(self.volumes)}: mass to {self.mass_error:.1e}, energy to {self.energy_error:.1e}>"
        )

    @property
    def mass_error(self) -> float:
        """Mass left over, relative to what flowed in, at worst [-]."""
        left = np.abs(self.mass_in - self.mass_out - self.mass_stored)
        return float(np.max(left / np.maximum(np.maximum(self.mass_in, self.mass_out), np.finfo(float).tiny)))

    @property
    def energy_error(self) -> float:
        """Energy left over, relative to the sum of all that passed, at worst [-]."""
        left = np.abs(self.enthalpy_in - self.enthalpy_out + self.heat - self.work - self.energy_stored)
        return float(np.max(left / self.turnover))


def balance(machine: Machine, orbit: Orbit, *, rtol: float = 1e-12) -> Balance:
    """Return the balances of mass and energy over an orbit of `nonlinear_orbit`.

    Parameters
    ----------
    machine : Machine
        The orbit's.
    orbit : Orbit
    rtol : float
        Relative tolerance with which the orbit is integrated once more [-].

    Raises
    ------
    ValueError
        The orbit's states are not the machine's, or the machine does not return to where the orbit begins: it is of
        another machine, or of a linear model.
    IntegrationError
        The equations could not be integrated on.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990").with_thermal("adiabatic")
    >>> found = lp.balance(machine, lp.nonlinear_orbit(machine, 10.0))
    >>> found.mass_error < 1e-9, found.energy_error < 1e-9
    (True, True)
    """
    expect_machine(machine)
    if orbit.states != machine.states:
        raise ValueError(
            f"orbit: found states {', '.join(orbit.states)}, expected the machine's: {', '.join(machine.states)}"
        )
    machine = machine.at(1 / orbit.system_period)
    pieces = pieces_of(machine.openings, orbit.system_period)
    settings = integration_settings(machine, positive("rtol", rtol))
    # Without the floor that orbits keep under pressures near a source's: what it leaves uncounted is looked for here.
    settings = settings._replace(atol=0.1 * rtol * machine.state_scales)
    run = new_run(machine.record, settings, pieces)
    state = np.array(orbit.initial_state)
    before, total = _stored(state, machine), np.zeros((machine.n_volumes, 6))
    for number in range(orbit.n_periods):
        outcome = integrate_period(state, run)
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, number * orbit.system_period + outcome.time, outcome.state)
        total += _integrals(outcome.record, pieces, machine.record)
        state = outcome.state
    gap = float(np.max(np.abs(state - orbit.initial_state) / machine.state_scales))
    if not gap < CLOSES:
        raise ValueError(
            f"orbit: found {orbit.name}, to whose beginning the machine does not return (a relative {gap:.1e} is "
            "left), expected one of lp.nonlinear_orbit(machine, ...): balances close over a cycle of the machine's own"
        )
    stored = _stored(state, machine) - before
    heat = total[:, HEAT]
    for k in range(machine.n_volumes):
        if f"temperature_{machine.states[2 + k].removeprefix('pressure_')}" not in machine.states:
            heat[k] = stored[k, 1] + total[k, WORK] - total[k, ENTHALPY_IN] + total[k, ENTHALPY_OUT]
    turnover = np.abs(total[:, [ENTHALPY_IN, ENTHALPY_OUT, WORK]]).sum(axis=1) + np.abs(heat)
    parts = (total[:, MASS_IN], total[:, MASS_OUT], stored[:, 0], total[:, ENTHALPY_IN], total[:, ENTHALPY_OUT])
    mass_in, mass_out, mass_stored, enthalpy_in, enthalpy_out = (read_only(part.copy()) for part in parts)
    return Balance(
        volumes=machine.volumes,
        mass_in=mass_in,
        mass_out=mass_out,
        mass_stored=mass_stored,
        enthalpy_in=enthalpy_in,
        enthalpy_out=enthalpy_out,
        heat=read_only(heat.copy()),
        work=read_only(total[:, WORK].copy()),
        energy_stored=read_only(stored[:, 1].copy()),
        turnover=read_only(turnover),
    )


def _stored(state: FloatArray, machine: Machine) -> FloatArray:
    """Return mass and internal energy in each volume, (n_volumes, 2)."""
    found, record = np.empty((machine.n_volumes, 2)), machine.record
    for k in range(machine.n_volumes):
        now = properties_of(gas_in_volume(k, state, record), record)
        mass = now.rho * chamber_volume(k, float(state[0]), record)
        found[k] = mass, mass * now.u
    return found


@compiled
def _integrals(record: Record, pieces: Pieces, machine: MachineRecord) -> FloatArray:
    """Return the integrals over a period of all that passes through each volume, (n_volumes, 6)."""
    n, n_paths = record.coefficients.shape[2], machine.n_paths
    total, passed = np.zeros((machine.n_volumes, 6)), np.empty((machine.n_volumes, 6))
    state, areas = np.empty(n), np.empty((2, n_paths))
    for interval in range(record.starts.size):
        p, piece = record.coefficients[interval], int(record.pieces[interval])
        for node in range(NODES.size):
            t = (0.5 + NODES[node]) * record.spans[interval]
            for i in range(n):
                state[i] = (((p[4, i] * t + p[3, i]) * t + p[2, i]) * t + p[1, i]) * t + p[0, i]
            write_areas(record.starts[interval] + t, pieces[piece], areas)
            _passing(state, areas, machine, passed)
            weight = WEIGHTS[node] * record.spans[interval]
            for k in range(total.shape[0]):
                for what in range(6):
                    total[k, what] += weight * passed[k, what]
    return total


@compiled
def _passing(state: FloatArray, areas: FloatArray, machine: MachineRecord, passed: FloatArray) -> None:
    """Write what passes through each volume at a state, (n_volumes, 6), into `passed`."""
    passed.fill(0.0)
    for k in range(machine.n_volumes):
        here = gas_in_volume(k, state, machine)
        passed[k, HEAT] = machine.volumes[k].conductance * (machine.volumes[k].wall_temperature - here.temperature)
        passed[k, WORK] = here.pressure * machine.volumes[k].slope * state[1]
    for path in range(machine.n_paths):
        first, second = areas[0, path], areas[1, path]
        if first == 0.0 or second == 0.0:
            continue
        into, other = machine.paths[path].volume, machine.paths[path].source
        source, inside = gas_at_source(path, state, machine), gas_in_volume(into, state, machine)
        flow = flow_into(path, areas, source, inside, machine)
        enthalpy = enthalpy_of(source if flow >= 0.0 else inside, machine)[0]
        size = math.fabs(flow)
        receiving, giving = (into, other) if flow >= 0.0 else (other, into)
        if receiving >= 0:
            passed[receiving, MASS_IN] += size
            passed[receiving, ENTHALPY_IN] += size * enthalpy
        if giving >= 0:
            passed[giving, MASS_OUT] += size
            passed[giving, ENTHALPY_OUT] += size * enthalpy
