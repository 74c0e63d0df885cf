"""Variables of a design of switching: which there are, their bounds, and how short pulses and pauses may get."""

import math
import re
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, cast

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import finite
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.models.machine.machine import Machine, Valve
from ltvpneu.models.machine.parameters import is_angle, is_duty, present_value, pulse_edge, pulse_edges, with_values
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import Command
from ltvpneu.physics.valve import RotaryValve

Bounds = tuple[float, float]
LEAST_WIDTH = 2e-3
"""Least share of the turn for a pulse, or between pulses, whatever is asked for: none of them vanishes [-]."""


def least_shares(machine: Machine) -> tuple[float, float]:
    """Return the least shares of the turn for a pulse, and for a pause, at which the valve opens and shuts fully.

    Below, its ramps meet: it opens in part, and figures have no slopes in the way that the linear models find them.
    """
    valve = machine.valve
    if isinstance(valve, RotaryValve):
        ramps = [(port.phase, port.window.ramp) for port in valve.ports]
    else:
        own = getattr(valve, "ramp", 0.0)
        ramps = [(path.opening, own) for path in machine.flow_paths if path.valve == 0]
    ramps_on, ramps_off = (max([ramp for way, ramp in ramps if way == phase], default=0.0) for phase in ("on", "off"))
    shortest_on, shortest_off = shortest_commands(valve)
    speed = machine.switching_frequency or 0.0
    # A ramp up and one down, and between them as much as any pulse has to last.
    least_on, least_off = (
        max(ramp / math.pi, time * speed) + LEAST_WIDTH
        for ramp, time in ((ramps_on, shortest_on), (ramps_off, shortest_off))
    )
    return least_on, least_off


def shortest_commands(valve: Valve) -> tuple[float, float]:
    """Return the shortest command on, and off, that a valve allows, opens fully by, and shuts by [s]."""
    if not isinstance(valve, OnOffValve):
        return 0.0, 0.0
    lag = valve.opening_delay - valve.closing_delay
    on, off = (lag + valve.opening_time, valve.closing_time - lag) if valve.has_times else (0.0, 0.0)
    return max(on, valve.opening_delay, valve.shortest_on), max(off, valve.closing_delay, valve.shortest_off)


def drawn_in(machine: Machine, pair: Bounds) -> Bounds:
    """Return the bounds of the duty, no wider than where the valve opens and shuts fully.

    Raises
    ------
    ValueError
        It does so at none of these duties.
    """
    least_on, least_off = least_shares(machine)
    if max(least_on, least_off) <= LEAST_WIDTH:
        return pair
    low, high = max(pair[0], least_on), min(pair[1], 1 - least_off)
    if low >= high:
        raise ValueError(
            f"variables: found bounds {pair[0]:g} to {pair[1]:g} of 'duty', at which the valve's ramps meet: it does "
            f"not open and shut fully; expected some of {least_on:.4g} to {1 - least_off:.4g}"
        )
    return low, high


def default_variables(machine: Machine) -> dict[str, Bounds]:
    """Return the duty as the variable or, of several pulses, all edges but the first, with their bounds."""
    edges = pulse_edges(machine)
    if not edges:
        raise ValueError(
            "variables: found none, and a proportional valve with neither duty nor pulses; expected points of its "
            "command, as 'valve.command.openings.0', or other numbers of the machine"
        )
    if len(edges) == 2:
        least_on, least_off = least_shares(machine)
        return {"duty": (max(0.02, least_on), min(0.98, 1 - least_off))}
    first = float(edges[0])
    names = [f"{'off' if i % 2 else 'on'}_{i // 2 + 1}" for i in range(1, len(edges))]
    return dict.fromkeys(names, (first, first + 2 * math.pi))


def expect_one_way_to_switch(machine: Machine, bounds: Mapping[str, Bounds]) -> None:
    """Raise where two variables would set the same switching."""
    edges = [name for name in bounds if pulse_edge(name) is not None]
    ways = [name for name in ("duty", "offset_angle") if name in bounds] + edges[:1]
    if len(ways) > 1:
        raise ValueError(
            f"variables: found {' and '.join(map(repr, ways))}, which set the same switching; expected one of them"
        )
    n_pulses = len(pulse_edges(machine)) // 2
    if ways and n_pulses == 0:
        raise ValueError(
            f"variables: found {ways[0]!r} of a proportional valve, expected points of its command, as "
            "'valve.command.openings.0'"
        )
    if "duty" in bounds and n_pulses > 1:
        raise ValueError(f"variables: found 'duty' of a valve with {n_pulses} pulses, expected their edges, as 'off_1'")


def check_pair(name: str, pair: Any) -> None:
    """Raise unless these are the least and the greatest value of a variable."""
    if not isinstance(pair, Sequence) or isinstance(pair, str) or len(cast(Sequence[Any], pair)) != 2:
        raise ValueError(f"variables: found {pair!r} for {name!r}, expected its least and its greatest value")
    low, high = (finite(name, value) for value in cast(Sequence[float], pair))
    if low >= high:
        raise ValueError(f"variables: found bounds {low:g} to {high:g} of {name!r}, expected the lower one first")


def check_bounds(machine: Machine, frequency: float, name: str, pair: Bounds) -> None:
    """Raise unless the machine has such a number, and may be built with its least and its greatest value."""
    check_pair(name, pair)
    low, high = pair
    try:
        present_value(machine, frequency, name)
    except ValueError as error:
        known = ["duty", "frequency", "offset_angle", "on_1", "off_1", "supply_pressure", "exhaust_pressure"]
        near = get_close_matches(name, known, 1, 0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"variables: found {name!r}, which is no number of the machine ({error}){hint}") from None
    if is_duty(name) and not (low >= 0 and high <= 1):
        raise ValueError(f"variables: found bounds {low:g} to {high:g} of {name!r}, expected 0 to 1")
    if re.fullmatch(r"valve\.command\.angles\.[0-9]+", name):
        # The points' order is a constraint: others may move too.
        if not (low >= 0 and high < 2 * math.pi):
            raise ValueError(f"variables: found bounds {low:g} to {high:g} rad of {name!r}, expected 0 to below 2 pi")
    elif not is_angle(name) and name != "frequency":
        for value in (low, high):
            try:
                with_values(machine, {name: value})
            except ValueError as error:
                raise ValueError(f"variables: found {value:g} for {name!r}: {error}") from None


def pulse_limits(
    machine: Machine, slowest: float, variables: Mapping[str, cp.Expression], valve: ValveLimits
) -> dict[str, cp.Constraint]:
    """Return constraints that keep commanded pulses and pauses long enough, and the edges in order.

    `slowest` is the frequency, or the least it may become where it is a variable [Hz].
    """
    frequency: Any = variables.get("frequency", cp.Constant(slowest))
    # A command shorter than the valve's delay does not reach it.
    own_on, own_off = shortest_commands(machine.valve)
    shortest_on = max(valve.shortest_on, valve.opening_delay, own_on)
    shortest_off = max(valve.shortest_off, valve.closing_delay, own_off)
    if (shortest_on + shortest_off) * slowest > 1:
        raise ValueError(
            f"valve: found shortest times of {shortest_on:g} s on and {shortest_off:g} s off, delays counted in, more "
            f"than a period of {1 / slowest:g} s; expected shorter ones, or a lower frequency"
        )
    # Open times, less by the lag than what is commanded.
    least_on, least_off = (
        cp.maximum(time * frequency, LEAST_WIDTH) for time in (shortest_on - valve.lag, shortest_off + valve.lag)
    )
    # What moves also keeps its ramps apart.
    fully_on, fully_off = least_shares(machine)
    others = _limits_of_others(machine, frequency, variables)
    if "duty" in variables:
        return others | {
            "shortest pulse": variables["duty"] >= cp.maximum(least_on, fully_on),
            "shortest pause": 1 - variables["duty"] >= cp.maximum(least_off, fully_off),
        }
    edges: list[Any] = [
        variables.get(f"{'off' if i % 2 else 'on'}_{i // 2 + 1}", cp.Constant(float(edge)))
        for i, edge in enumerate(pulse_edges(machine))
    ]
    if "offset_angle" in variables:
        # On while both windows are open: for half a turn less the offset, whichever way.
        edges = [cp.Constant(0.0), math.pi - cp.abs(variables["offset_angle"])]
    found = others | _command_in_order(machine, variables)
    for i, (before, after) in enumerate(
        zip(edges, [*edges[1:], *(edge + 2 * math.pi for edge in edges[:1])], strict=True)
    ):
        if i % 2 and "offset_angle" in variables:
            # The pause is half a turn at least.
            break
        width, least = after - before, (least_off if i % 2 else least_on) * (2 * math.pi)
        name = f"shortest {'pause' if i % 2 else 'pulse'} {i // 2 + 1}"
        if width.variables():
            found[name] = width >= cp.maximum(least, (fully_off if i % 2 else fully_on) * (2 * math.pi))
            continue
        if least.variables():
            found[name] = width >= least
            continue
        open_for, asked = float(np.asarray(width.value)), float(np.asarray(least.value))
        if 0 < open_for < min(2 * math.pi, asked - 1e-9):
            raise ValueError(
                f"valve: the machine's {name[9:]} lasts {open_for / (2 * math.pi * slowest):g} s, which is shorter "
                "than the valve can be told to; expected it longer, or among the variables"
            )
    return found


def _limits_of_others(
    machine: Machine, frequency: Any, variables: Mapping[str, cp.Expression]
) -> dict[str, cp.Constraint]:
    """Return constraints that keep pulses and pauses of the other valves, whose duties are variables, long enough."""
    found: dict[str, cp.Constraint] = {}
    for number, valve in enumerate(machine.more_valves, start=2):
        for name in (f"duty_{number}", f"more_valves.{number - 2}.duty"):
            if name not in variables:
                continue
            shares = variables[name], 1 - variables[name]
            for what, time, share in zip(("pulse", "pause"), shortest_commands(valve), shares, strict=True):
                if time:
                    found[f"shortest {what} of valve {number}"] = share >= time * frequency
    return found


def _command_in_order(machine: Machine, variables: Mapping[str, cp.Expression]) -> dict[str, cp.Constraint]:
    """Return constraints that the points of a proportional valve's command keep their order."""
    command = machine.valve.on_window()
    if not isinstance(command, Command):
        return {}
    names = [f"valve.command.angles.{i}" for i in range(len(command.angles))]
    angles: list[Any] = [
        variables.get(name, cp.Constant(angle)) for name, angle in zip(names, command.angles, strict=True)
    ]
    return {
        f"order of {before} and {after}": last - first >= 2 * math.pi * LEAST_WIDTH
        for (before, first), (after, last) in pairwise(zip(names, angles, strict=True))
        if before in variables or after in variables
    }
