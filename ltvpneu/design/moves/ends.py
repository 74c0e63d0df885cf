"""Where a move starts and where it has to end: rest at a place, by pressures that hold it there."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, finite, finite_array
from ltvpneu.design.switching.goals import Wanted, wanted_bounds
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.piston import at_stop, hold_of
from ltvpneu.models.machine.quasi_static import settle_volumes
from ltvpneu.models.nonlinear.passage import Position
from ltvpneu.models.nonlinear.simulation import check_state

Place = float | Mapping[str, Any] | FloatArray
"""A position [m] at rest, states by name, or all of them."""
ON_A_STOP = 1e-9
"""Distance from a stop that counts as none [m]."""


class End(NamedTuple):
    """What the last state has to be."""

    bounds: dict[str, tuple[float | None, float | None]]
    """The least and the greatest value of states, equal where it is one value."""
    force: tuple[float, float] | None
    """Between which the push on the piston has to be for friction to hold it [N]; None where it need not."""


def start_state(machine: Machine, positions: Mapping[Position, Machine], start: Place) -> FloatArray:
    """Return the state that a move starts from, (n_states,).

    Raises
    ------
    ValueError
        Unknown states, or a place that no pressures hold.
    """
    given: Any = start
    if isinstance(given, Mapping):
        named: dict[str, Any] = dict(given)  # pyright: ignore[reportUnknownArgumentType]
        _check_names("start", machine, named)
        if "position" not in named:
            raise ValueError("start: found no position, expected one [m]")
        state = _at_rest(machine, positions, finite("start: position", named["position"], "m"))
        for name, value in named.items():
            state[machine.states.index(name)] = finite(f"start: {name}", value)
    elif np.ndim(given) == 0:
        state = _at_rest(machine, positions, finite("start", given, "m"))
    else:
        state = finite_array("start", given, (len(machine.states),)).copy()
    check_state(machine, state, "start")
    return state


def end_of(machine: Machine, end: Place | Mapping[str, Wanted], hold: bool | None) -> End:
    """Return what a move has to end in.

    Raises
    ------
    ValueError
        Unknown states, contradictory bounds, a place beyond the stops or one that no pressures hold.
    """
    given: Any = end
    is_place = not isinstance(given, Mapping) and np.ndim(given) == 0
    bounds: dict[str, tuple[float | None, float | None]]
    if isinstance(given, Mapping):
        named: dict[str, Any] = dict(given)  # pyright: ignore[reportUnknownArgumentType]
        _check_names("end", machine, named)
        if not named:
            raise ValueError("end: found no states, expected some, such as a position [m]")
        bounds = {name: wanted_bounds(f"end: {name}", wanted) for name, wanted in named.items()}
    elif is_place:
        value = finite("end", given, "m")
        bounds = {"position": (value, value)}
        if not at_stop(value, machine.record):
            # A stop takes the velocity.
            bounds["velocity"] = 0.0, 0.0
    else:
        values = finite_array("end", given, (len(machine.states),))
        bounds = {name: (value, value) for name, value in zip(machine.states, values.tolist(), strict=True)}
    place = bounds.get("position", (None, None))
    lower, upper = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    if any(value is not None and not lower - ON_A_STOP <= value <= upper + ON_A_STOP for value in place):
        found = next(value for value in place if value is not None)
        raise ValueError(
            f"end: found position {found:g} m, expected it between the end stops ({lower:g} to {upper:g} m)"
        )
    hold = is_place if hold is None else hold
    if not hold:
        return End(bounds, None)
    if place[0] is None or place[0] != place[1]:
        raise ValueError("hold: found an end without one position, expected one to be held at")
    return End(bounds, _holding(machine, place[0]))


def _holding(machine: Machine, position: float) -> tuple[float, float]:
    """Return between which forces the piston stays at a place [N]."""
    low, high = push_range(machine, position)
    state = machine.rest_state.copy()
    state[0] = position
    state[2 : 2 + machine.n_volumes] = machine.exhaust_pressure
    hold = hold_of(state, machine.record)
    side = at_stop(position, machine.record)
    least = -np.inf if side < 0 else -hold
    most = np.inf if side > 0 else hold
    if low > most or high < least:
        raise ValueError(
            f"end: found {1e3 * position:g} mm, where the pressures push with {low:.4g} to {high:.4g} N against spring "
            f"and load; no pressure between exhaust and supply holds the piston there. Expected another place, or "
            "hold=False"
        )
    return least, most


def push_range(machine: Machine, position: float) -> tuple[float, float]:
    """Return the least and the greatest force on the piston at a place, over all pressures of the sources [N]."""
    state = machine.rest_state.copy()
    state[0] = position
    state[2 : 2 + machine.n_volumes] = machine.exhaust_pressure
    slopes = push_slopes(machine)[2 : 2 + machine.n_volumes]
    least = external_force(state, machine.record)
    spans = slopes * (machine.supply_pressure - machine.exhaust_pressure)
    return float(least + np.minimum(spans, 0).sum()), float(least + np.maximum(spans, 0).sum())


def push_slopes(machine: Machine) -> FloatArray:
    """Return the derivative of the push on the piston, without friction, over the state, (n_states,)."""
    found = np.zeros(len(machine.states))
    found[0] = -machine.load.spring_stiffness
    for k, volume in enumerate(machine.volume_fields):
        found[2 + k] = volume.push_area
    return found


def _at_rest(machine: Machine, positions: Mapping[Position, Machine], position: float) -> FloatArray:
    """Return the state at rest at a place: on a stop as the valves leave it, else by pressures that balance."""
    state = machine.rest_state.copy()
    state[0] = position
    if at_stop(position, machine.record):
        for held in positions.values():
            settled = state.copy()
            settle_volumes(np.ascontiguousarray(held.openings.areas[0, (0, 2)]), held.record, settled)
            side = at_stop(position, machine.record)
            if side * external_force(settled, machine.record) >= 0:
                return settled
    pressures = slice(2, 2 + machine.n_volumes)
    state[pressures] = (machine.supply_pressure + machine.exhaust_pressure) / 2
    slopes = push_slopes(machine)[pressures]
    force = external_force(state, machine.record)
    hold = hold_of(state, machine.record)
    low, high = push_range(machine, position)
    if not slopes.any() or low > hold or high < -hold:
        raise ValueError(
            f"start: found {1e3 * position:g} mm, where the pressures push with {low:.4g} to {high:.4g} N against "
            "spring and load, and no pressure between exhaust and supply holds the piston; expected another place, or "
            "all states"
        )
    state[pressures] -= force * slopes / (slopes @ slopes)
    state[pressures] = np.clip(state[pressures], machine.exhaust_pressure, machine.supply_pressure)
    return state


def _check_names(what: str, machine: Machine, named: Mapping[str, Any]) -> None:
    for name in named:
        if name not in machine.states:
            raise ValueError(f"{what}: found {name!r}, expected one of {', '.join(machine.states)}")
