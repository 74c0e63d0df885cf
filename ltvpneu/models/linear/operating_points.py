"""Operating points of the linear models: quasi-static (16), time means (15), per step from the LTI cycle (17).

Points taken from a cycle may leave the range in which a linearization means something: at low speed the LTI cycle's
mean pressures go above the supply. They are held inside the range of the quasi-static pressures, and away from
pressures where the slope of the flow is infinite; what was held back is reported.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.models.linear.model import HeldBack
from ltvpneu.models.linear.staircase import Staircase, fine_staircase, staircase
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.quasi_static import nearest_source, settled_states, source_ranges

LEAST_DISTANCE = 0.02
"""Default relative distance kept from the pressure of a source that a chamber is open to [-]."""
LEAST_TEMPERATURE, MOST_TEMPERATURE = 0.5, 2.0
"""Range that temperatures of operating points are held in, over that of the surroundings [-]."""


class Turn(NamedTuple):
    """What the linear models know of a turn of the valve before they know its speed."""

    stairs: Staircase
    quasi_static: FloatArray
    """State that each step would settle on, (16), shape (n_steps, n)."""
    mean: FloatArray
    """zbar, the mean over the turn of the quasi-static states, (15)-(16), shape (n,)."""
    mean_balance: float
    """Mean over the turn of the positions that the spring alone would balance, stops or not [m]."""


def quasi_static_turn(machine: Machine, n_steps: int | None) -> Turn:
    """Return the staircase of a turn and its quasi-static states; by default one step for each linear piece.

    Raises
    ------
    ValueError
        The load has no spring, so no position is balanced; fewer steps than valve positions.
    """
    stairs = staircase(machine, machine.openings.fractions.size - 1 if n_steps is None else n_steps)
    fine = fine_staircase(machine)
    states = quasi_static_states(machine, stairs.areas)
    finely = states if fine.fractions.size == stairs.fractions.size else quasi_static_states(machine, fine.areas)
    widths = np.diff(fine.fractions)
    return Turn(stairs, states, widths @ finely, float(widths @ _balanced(machine, finely)))


def quasi_static_states(machine: Machine, areas: FloatArray) -> FloatArray:
    """Return the states that each step would settle on if the valve stood still, (16) with erratum E10, (n_steps, n).

    Velocity is zero, friction neglected; a shut chamber keeps the pressure of the step before.
    """
    load = machine.load
    if load.spring_stiffness == 0:
        raise ValueError(
            "load.spring_stiffness: found none, expected one above zero: without a spring no position balances the "
            "pressures (in Python, ltv_model takes the operating points as an array of states)"
        )
    states = settled_states(np.array(areas, order="C"), machine.record, np.array(machine.rest_state))
    # What the spring does not bear, an end stop does.
    states[:, 0] = np.clip(_balanced(machine, states), machine.cylinder.lower_stop, machine.cylinder.upper_stop)
    return states


def _balanced(machine: Machine, states: FloatArray) -> FloatArray:
    """Return the positions at which the spring balances the states' pressures [m], (n_steps,)."""
    load, pushes = machine.load, np.array([volume.push_area for volume in machine.volume_fields])
    force = load.constant_force + machine.cylinder.ambient_push_area * machine.ambient_pressure
    return (states[:, 2 : 2 + machine.n_volumes] @ pushes + force) / load.spring_stiffness


def held_inside(
    machine: Machine, turn: Turn, asked: FloatArray, least_distance: float
) -> tuple[FloatArray, tuple[HeldBack, ...]]:
    """Return the operating points (n_steps, n) kept inside their range, and a list of those that were moved.

    Position and pressures stay within the range of the quasi-static ones; pressures at least `least_distance`,
    relative, away from those of the sources that the chamber is open to. Temperatures stay within half to twice that of
    the surroundings.
    """
    low, high = turn.quasi_static.min(axis=0), turn.quasi_static.max(axis=0)
    # The velocity has no quasi-static range; a temperature has one, the surroundings', which it leaves at any speed.
    low[1], high[1] = -np.inf, np.inf
    temperatures = slice(2 + machine.n_volumes, None)
    low[temperatures] = LEAST_TEMPERATURE * machine.gas.temperature
    high[temperatures] = MOST_TEMPERATURE * machine.gas.temperature
    used = np.minimum(np.maximum(asked, low), high)
    if machine.has_infinite_slopes:
        supply, exhaust = machine.supply_pressure, machine.exhaust_pressure
        sources = source_ranges(np.array(turn.stairs.areas, order="C"), machine.record)
        floor = np.where(sources[:, :, 0] == exhaust, exhaust * (1 + least_distance), -np.inf)
        ceiling = np.where(sources[:, :, 1] == supply, supply * (1 - least_distance), np.inf)
        pressures = used[:, 2 : temperatures.start]
        held = np.minimum(np.maximum(pressures, floor), ceiling)
        # Between sources too near each other there is no room, so the point is taken beyond both.
        pressures[:] = np.where(floor <= ceiling, held, supply * (1 + least_distance))
        if not machine.is_plain:
            _part(machine, turn, used, least_distance)
    # Rounding is not holding back.
    moved = np.abs(used - asked) > 1e-9 * machine.state_scales
    if not moved.any():
        return used, ()
    return used, tuple(
        HeldBack(
            step=int(step),
            state=machine.states[column],
            asked=float(asked[step, column]),
            used=float(used[step, column]),
        )
        for step, column in np.argwhere(moved)
    )


def _part(machine: Machine, turn: Turn, points: FloatArray, least_distance: float) -> None:
    """Move pressures of volumes that feed each other apart by the least distance, the inner one of a valve first."""
    for step, areas in enumerate(np.array(turn.stairs.areas, order="C")):
        for k in reversed(range(machine.n_volumes)):
            pressure, column = nearest_source(k, points[step], areas, machine.record)
            apart = points[step, 2 + k] - pressure
            if column >= 0 and abs(apart) < least_distance * pressure:
                points[step, 2 + k] = pressure * (1 + (least_distance if apart >= 0 else -least_distance))
