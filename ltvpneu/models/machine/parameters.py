"""Any number of a machine by its name: its present value, and the machine with another."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from ltvpneu._arrays import positive
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.proportional import Command
from ltvpneu.physics.window import Pulses

STEP = 1e-4
"""Relative step of the difference quotients over parameters; duty and angles: absolute [-]."""


def present_value(machine: Machine, frequency: float, name: str) -> float:
    """Return a parameter's value.

    Raises
    ------
    ValueError
        The machine has no number of that name.
    """
    name = _long(name)
    if name == "frequency":
        return positive("frequency", frequency, "Hz")
    if name == "duty":
        return machine.duty
    if name == "offset_angle":
        angle = float(getattr(machine.valve, "offset_angle", math.nan))
        if math.isnan(angle):
            raise ValueError("parameters: found 'offset_angle' of an on-off valve, expected 'duty'")
        return angle
    edge = pulse_edge(name)
    if edge is not None:
        edges = pulse_edges(machine)
        if edge >= len(edges):
            follows = "" if edges else ": it is proportional and follows its command, as 'valve.command.angles.0'"
            raise ValueError(f"parameters: found {name!r}, but the valve has {len(edges) // 2} pulses{follows}")
        return edges[edge]
    return _value(machine, name.split("."), name)


def with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return the machine with parameters at other values; a "frequency" among them is that at which it switches."""
    edges = list(pulse_edges(machine)) if any(pulse_edge(name) is not None for name in values) else []
    for given, value in values.items():
        name = _long(given)
        edge = pulse_edge(name)
        if edge is not None:
            edges[edge] = value
        elif name == "duty":
            machine = machine.with_duty(value)
        elif name == "offset_angle":
            machine = machine.with_offset(value)
        elif name == "frequency":
            machine = machine.at(value)
        else:
            machine = _replaced(machine, name.split("."), value)
    return machine.with_pulses(list(zip(edges[::2], edges[1::2], strict=True))) if edges else machine


def _long(name: str) -> str:
    """Return the dotted name of what has a plain one: "duty_2" and "start_2" are those of the second valve."""
    found = re.fullmatch(r"(duty|start)_([2-9])", name)
    return name if found is None else f"more_valves.{int(found[2]) - 2}.{found[1]}"


def pulse_edge(name: str) -> int | None:
    """Return which edge of the pulses a parameter is, from 0, if it is one: "on_1" is 0, "off_1" 1, and so on."""
    found = re.fullmatch(r"(on|off)_([1-9][0-9]*)", name)
    return None if found is None else 2 * (int(found[2]) - 1) + (found[1] == "off")


def pulse_edges(machine: Machine) -> tuple[float, ...]:
    """Return the angles at which the valve goes on and off in turn [rad]; a proportional one has none."""
    on = machine.valve.on_window()
    if isinstance(on, Command):
        return ()
    return on.edges if isinstance(on, Pulses) else (on.start, on.start + on.width)


def around(name: str, value: float, step: float = STEP) -> tuple[float, float]:
    """Return values of a parameter a little above and below, on one side only where it can go no further."""
    step = step * (abs(value) if value and not is_angle(name) else 1.0)
    high, low = value + step, value - step
    if is_duty(name):
        return min(high, 1.0), max(low, 0.0)
    if re.fullmatch(r".*command\.openings\.[0-9]+", name):
        return min(high, 1.0), max(low, -1.0)
    return high, low


def moved(
    machine: Machine, frequency: float, name: str, step: float = STEP
) -> tuple[tuple[tuple[Machine, float], tuple[Machine, float]], float]:
    """Return machine and frequency with a parameter a little above and below, and the difference.

    Raises
    ------
    ValueError
        The machine has no number of that name.
    """
    value = present_value(machine, frequency, name)
    if name == "frequency":
        up, down = frequency * (1 + step), frequency * (1 - step)
        return ((machine.at(up), up), (machine.at(down), down)), up - down
    high, low = around(name, value, step)
    above, below = (with_values(machine, {name: beside}) for beside in (high, low))
    return ((above, frequency), (below, frequency)), high - low


def is_duty(name: str) -> bool:
    """Whether a parameter is a valve's duty [-]."""
    return _long(name).rpartition(".")[2] == "duty"


def is_angle(name: str) -> bool:
    """Whether a parameter is an angle of the valve [rad], or its duty [-]: of the size of one, whatever its value."""
    last = _long(name).rpartition(".")[2]
    return last in ("duty", "offset_angle", "start", "width") or pulse_edge(name) is not None


def _value(part: Any, path: Sequence[str], name: str) -> float:
    for key in path:
        if isinstance(part, tuple) and key.isdigit() and int(key) < len(part):
            part = part[int(key)]
            continue
        known = [field.name for field in fields(part)] if is_dataclass(part) else []
        if key not in known:
            raise ValueError(
                f"parameters: found {name!r}, but there is no {key!r} there; expected one of "
                f"{', '.join(known) or 'nothing further'}, or duty, frequency, offset_angle"
            )
        part = getattr(part, key)
    if isinstance(part, bool) or not isinstance(part, float | int) or not math.isfinite(part):
        raise ValueError(f"parameters: found {name!r}, which is {part!r}; expected the name of a finite number")
    return float(part)


def _replaced(part: Any, path: Sequence[str], value: float) -> Any:
    key, rest = path[0], path[1:]
    if isinstance(part, tuple):
        inner = _replaced(part[int(key)], rest, value) if rest else value
        return (*part[: int(key)], inner, *part[int(key) + 1 :])
    return replace(part, **{key: _replaced(getattr(part, key), rest, value) if rest else value})
