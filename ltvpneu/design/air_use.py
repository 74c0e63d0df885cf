"""Air use: the mass flow from the supply, as an output of a linear model and as a figure of any orbit."""

from dataclasses import replace

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import step_means
from ltvpneu.models.machine.supply_flow import source_flow, supply_flow_tangents
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.system import PeriodicSystem

AIR_USE = "air_use"
"""Name of the output: mass flow out of the supply [kg/s]."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
PARTS = 2048
"""Parts of a period, cut at the switches too, over each of which the flow of an orbit is integrated."""
LEAST_DISTANCE = 1e-3
"""Relative distance from the supply's pressure within which the flow's slope is that of a chord [-]."""


def with_air_use(model: LtvModel) -> PeriodicSystem:
    """Return the model's system with one more output, "air_use": the mass flow out of the supply [kg/s].

    The flow of each step is linearized at its operating point, as the chambers' equations are.

    Parameters
    ----------
    model : LtvModel

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> system = design.with_air_use(lp.ltv_model(lp.load_machine("kunt_singh_1990"), 10.0, operating_points="fitted"))
    >>> print(f"{1e3 * lp.steady_state(system).mean('air_use'):.2f} g/s")
    2.49 g/s
    """
    system, machine = model.system, model.machine
    slopes, inputs, offsets = supply_flow_tangents(
        model.operating_points, _step_areas(model), LEAST_DISTANCE, machine.record
    )
    return replace(
        system,
        C=np.concatenate([system.C, slopes[:, None]], axis=1),
        D=np.concatenate([system.D, inputs[:, None]], axis=1),
        q=np.column_stack([system.q, offsets]),
        outputs=(*system.outputs, AIR_USE),
    )


def air_use(machine: Machine, orbit: Orbit) -> float:
    """Return the mean mass flow that an orbit of any model takes from the supply, by the nonlinear law [kg/s].

    Parameters
    ----------
    machine : Machine
        The orbit's.
    orbit : Orbit

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> print(f"{1e3 * design.air_use(machine, lp.nonlinear_orbit(machine, 10.0)):.2f} g/s")
    2.39 g/s
    """
    return mean_flow(machine, orbit, from_supply=True)


def mean_flow(machine: Machine, orbit: Orbit, *, from_supply: bool) -> float:
    """Return the mean mass flow out of the supply, or out of the exhaust, over an orbit [kg/s]."""
    period = orbit.system_period
    machine = machine.at(1 / period)
    own = np.mod(orbit.step_times / period, 1.0)
    cells, table = np.unique(np.round(np.concatenate([np.linspace(0.0, 1.0, PARTS + 1), own]), 12)), machine.openings
    cuts = np.union1d(cells, table.fractions)
    starts, spans = cuts[:-1], np.diff(cuts)
    within = 0.5 * (NODES + 1)
    times = (starts[:, None] + within * spans[:, None]).ravel()
    areas = table.areas_at(times, table.pieces_at(times))
    weights = (0.5 * WEIGHTS * spans[:, None]).ravel()
    total = 0.0
    for number in range(orbit.n_periods):
        states = np.ascontiguousarray(orbit.at((times + number) * period)[: len(machine.states)].T)
        total += float(weights @ source_flow(states, areas, from_supply, machine.record))
    return total / orbit.n_periods


def _step_areas(model: LtvModel) -> FloatArray:
    """Return the mean effective areas of every step, (n_steps, 2, n_paths), over one or more valve periods."""
    shares = model.system.switching_times * model.frequency
    found: list[FloatArray] = []
    for number in range(max(1, round(float(shares[-1])))):
        cells = shares[(shares > number - 1e-9) & (shares < number + 1 + 1e-9)] - number
        cells[0], cells[-1] = 0.0, 1.0
        found.append(step_means(model.machine.openings, cells))
    return np.concatenate(found)
