"""`ltvpneu move`: a move in the words of a drive engineer, and when its valves switch as tables and as JSON."""

import argparse
import math
import re
from typing import TYPE_CHECKING, Any

from ltvpneu.face.request import quantity
from ltvpneu.face.tables import heading, table
from ltvpneu.face.units import parse, pressure_shown
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.liquid import Liquid

if TYPE_CHECKING:
    from ltvpneu.design import MoveSolution

LEAST = {"time": "in the least time", "air": "with the least air", "impact": "with the least impact"}


def move_request(machine: Machine, options: argparse.Namespace) -> dict[str, Any]:
    """Return what a command line asks for, as `design.optimize_move` takes it."""
    maximum, named = _upper_bounds(machine, options.max)
    return {
        "start": _place(machine, "--from", options.start),
        "end": _place(machine, "--to", options.end),
        "switches": options.switches,
        "minimize": options.minimize,
        "maximum": maximum,
        **named,
        "hold": False if options.no_hold else None,
        "max_time": None if options.longest is None else _time("--longest", options.longest),
    }


def _place(machine: Machine, option: str, text: str) -> float:
    """Return a position [m]; "retracted" and "extended" are the stops."""
    for word, stop in (("retracted", machine.cylinder.lower_stop), ("extended", machine.cylinder.upper_stop)):
        if text == word:
            if math.isinf(stop):
                raise ValueError(f"{option}: found {text!r}, but the cylinder has no stop there; expected a position")
            return stop
    return quantity(option, "position", text)


def _time(option: str, text: str) -> float:
    try:
        return parse(text, "time")
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


def _upper_bounds(machine: Machine, given: list[str]) -> tuple[dict[str, float], dict[str, float]]:
    """Return bounds of states, and those of speed [m/s] and impact [J]."""
    states: dict[str, float] = {}
    named: dict[str, float] = {}
    for text in given:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise ValueError(f"--max: found {text!r}, expected a name and a value, such as speed=0.5m/s")
        if name in states or name in named:
            raise ValueError(f"--max: found {name!r} twice, expected it once")
        if name == "speed":
            named["speed"] = quantity("--max", "velocity", value)
        elif name == "impact_energy":
            number = re.fullmatch(r"([\d.]+(?:[eE][+-]?\d+)?)\s*(m?)J", value)
            if number is None:
                raise ValueError(f"--max: impact_energy: found {value!r}, expected an energy, such as 0.1J or 50mJ")
            named["impact_energy"] = float(number[1]) * (1e-3 if number[2] else 1.0)
        elif name in machine.states:
            states[name] = quantity("--max", name, value, machine.ambient_pressure)
        else:
            raise ValueError(
                f"--max: found {name!r}, expected speed, impact_energy or one of {', '.join(machine.states)}"
            )
    return states, named


def move_text(found: "MoveSolution", minimize: str) -> str:
    """Return what was found as tables."""
    machine, way = found.machine, found.way
    said = {
        "optimal": "optimal: no small change of the switching times does better",
        "stopped": "stopped: the end is kept, and no step does better, as on a kink",
        "infeasible": "infeasible: no move was found that keeps everything; this one comes nearest",
    }
    shown = f"{1e3 * way.start[0]:.4g} mm to {1e3 * way.end[0]:.4g} mm"
    parts = [
        heading("Move").lstrip("\n"),
        f"{machine.name}: {shown} {LEAST[minimize]}: {1e3 * found.time:.4g} ms, {found.n_switches} switches",
        f"{said[found.status]} (residual {found.residual:.1e})",
    ]
    parts += [f"  missed: {name} by {by:.3g}" for name, by in found.missed.items() if by]
    ends = found.durations.cumsum()
    rows = [
        [f"{1e3 * (end - lasts):.4f}", f"{1e3 * lasts:.4f}", *("on" if on else "off" for on in position)]
        for end, lasts, position in zip(ends.tolist(), found.durations.tolist(), found.order, strict=True)
    ]
    valves = ["valve"] if len(found.delays) == 1 else [f"valve {i + 1}" for i in range(len(found.delays))]
    parts += ["", table(["from [ms]", "for [ms]", *valves], rows)]
    if any(delay for pair in found.delays for delay in pair):
        parts += ["", "commands, the valves' delays taken off:"]
        for valve, told in zip(valves, found.commands, strict=True):
            parts.append(f"  {valve}: " + ", ".join(f"{'on' if on else 'off'} at {1e3 * at:.3f} ms" for at, on in told))
    parts += ["", table(["figure", "value"], _figures(found))]
    return "\n".join(parts)


def _figures(found: "MoveSolution") -> list[list[str]]:
    machine, figures = found.machine, found.figures
    air = figures["air_mass"]
    normal = "" if isinstance(machine.gas, Liquid) else f" = {1e3 * air / ANR_DENSITY:.4g} Nl"
    rows = [["greatest speed", f"{figures['speed']:.4g} m/s"]]
    rows.append(["drawn from the supply", f"{1e3 * air:.4g} g{normal}"])
    if math.isfinite(max(-machine.cylinder.lower_stop, machine.cylinder.upper_stop)):
        rows.append(["impact at a stop", f"{round(figures['impact_energy'], 9) + 0.0:.3g} J"])
    rows += [
        [f"last {name.replace('_', ' ')}", pressure_shown(figures[f"end {name}"], machine.ambient_pressure)]
        for name in machine.states
        if name.startswith("pressure")
    ]
    return rows


def move_json(found: "MoveSolution") -> dict[str, Any]:
    """Return what was found, in SI units."""
    return {
        "status": found.status,
        "time": found.time,
        "durations": found.durations.tolist(),
        "valves": [list(position) for position in found.order],
        "commands": [[{"time": time, "on": on} for time, on in told] for told in found.commands],
        "figures": found.figures,
        "missed": found.missed,
        "duals": found.duals,
        "residual": found.residual,
        "start": found.way.start.tolist(),
        "end": found.end_state.tolist(),
        "states": list(found.machine.states),
    }
