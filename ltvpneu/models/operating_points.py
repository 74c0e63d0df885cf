"""Operating points of the linear models: quasi-static (16), time means (15), per step from the LTI cycle (17).

Points taken from a cycle may leave the range in which a linearization means something: at low speed the LTI cycle's mean pressures
go above the supply. They are held inside the range of the quasi-static pressures, and away from pressures where the slope of the
flow is infinite; what was held back is reported.
"""

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.models.dynamics import equilibrium_pressures, external_force, source_range
from ltvpneu.models.linearize import HeldBack
from ltvpneu.models.machine import Machine
from ltvpneu.models.staircase import Staircase

LEAST_DISTANCE = 0.02
"""Default relative distance kept from the pressure of a source that a chamber is open to [-]."""


def quasi_static_states(machine: Machine, areas: FloatArray) -> FloatArray:
    """Return the states that each step would settle on if the valve stood still, (16) with erratum E10, (n_steps, n).

    Velocity is zero, friction neglected; a shut chamber keeps the pressure of the step before.

    Raises
    ------
    ValueError
        The load has no spring, so no position is balanced.
    """
    load = machine.load
    if load.spring_stiffness == 0:
        raise ValueError(
            "load.spring_stiffness: found 0, expected above zero: without a spring no position balances the pressures. Give "
            "ltv_model the operating points as an array of states, one row a step, or use the nonlinear model"
        )
    arrays, n = machine.arrays, len(machine.states)
    states = np.zeros((areas.shape[0], n))
    pressures = machine.rest_state[2:]
    # Twice round: a chamber shut at the start of the turn keeps what the last step left.
    for step in [*range(areas.shape[0]), *range(areas.shape[0])]:
        pressures = equilibrium_pressures(areas[step], arrays, pressures)
        states[step, 2:] = pressures
    for state in states:
        state[0] = external_force(state, arrays) / load.spring_stiffness
    return states


def mean_state(machine: Machine, stairs: Staircase) -> FloatArray:
    """Return zbar: the mean over the turn of the quasi-static states, (15)-(16), shape (n,)."""
    return np.diff(stairs.fractions) @ quasi_static_states(machine, stairs.areas)


def held_inside(
    machine: Machine, areas: FloatArray, asked: FloatArray, quasi_static: FloatArray, least_distance: float
) -> tuple[FloatArray, tuple[HeldBack, ...]]:
    """Return the operating points (n_steps, n) kept inside their range, and a list of those that were moved.

    Position and pressures stay within the range of the quasi-static ones; pressures at least `least_distance`, relative,
    away from those of the sources that the chamber is open to.
    """
    used = asked.copy()
    for column in (0, *range(2, asked.shape[1])):
        used[:, column] = np.clip(asked[:, column], quasi_static[:, column].min(), quasi_static[:, column].max())
    supply, exhaust = machine.supply_pressure, machine.exhaust_pressure
    for step in range(asked.shape[0]):
        for k in range(asked.shape[1] - 2):
            low, high = source_range(k, areas[step], machine.arrays)
            if low > high:
                continue
            floor = exhaust * (1 + least_distance) if low == exhaust else -np.inf
            ceiling = supply * (1 - least_distance) if high == supply else np.inf
            pressure = min(max(float(used[step, 2 + k]), floor), ceiling)
            used[step, 2 + k] = pressure if floor <= ceiling else (supply + exhaust) / 2
    moved = np.argwhere(used != asked)
    return used, tuple(
        HeldBack(
            step=int(step),
            state=machine.states[column],
            asked=float(asked[step, column]),
            used=float(used[step, column]),
        )
        for step, column in moved
    )
