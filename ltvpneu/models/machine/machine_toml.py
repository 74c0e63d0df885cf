"""A machine as the text of a machine file, in SI units, which reads back as the same machine.

Cylinders are written by areas and volumes, valves by their flow paths, whatever words they came from.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from ltvpneu.models.machine.connections import FlowPath
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.iso6358 import ISO6358
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import ProportionalValve
from ltvpneu.physics.valve import Port, RotaryValve
from ltvpneu.physics.window import Pulses, Window

if TYPE_CHECKING:
    from ltvpneu.models.machine.machine import Machine

Table = dict[str, Any]


def machine_toml(machine: "Machine") -> str:
    """Return a machine as the text of a machine file.

    Raises
    ------
    ValueError
        A port's window closes over another angle than it opens: files have one ramp.
    """
    top: Table = {
        "schema": 1,
        "name": machine.name,
        "supply_pressure": machine.supply_pressure,
        "exhaust_pressure": machine.exhaust_pressure,
        "ambient_pressure": machine.ambient_pressure,
        "collapse": machine.collapse,
    }
    gas = machine.gas
    tables: dict[str, Table] = {"liquid" if isinstance(gas, Liquid) else "gas": _plain(gas)}
    if not machine.cylinder.is_absent:
        tables["cylinder"] = {**_plain(machine.cylinder, "is_absent"), "mounting": machine.load.mounting}
        tables["load"] = _plain(machine.load, "mounting")
    tables["valve"] = _valve(machine.valve)
    lists: dict[str, list[Table]] = {
        "volumes": [_plain(tank) for tank in machine.rigid_volumes],
        "more_valves": [_valve(valve) for valve in machine.more_valves],
        "flow_paths": [_path(path) for path in machine.flow_paths],
    }
    parts = [_lines(top), *(f"\n[{name}]\n{_lines(table)}" for name, table in tables.items())]
    parts += [f"\n[[{name}]]\n{_lines(entry)}" for name, entries in lists.items() for entry in entries]
    return "\n".join(parts) + "\n"


def _plain(value: Any, *without: str) -> Table:
    """Return the fields of a value, those left out that say nothing: None, and infinite stops."""
    found = {field.name: getattr(value, field.name) for field in fields(value) if field.name not in without}
    return {name: _entry(entry) for name, entry in found.items() if entry is not None and entry not in _NO_STOPS}


_NO_STOPS = (math.inf, -math.inf)


def _entry(entry: Any) -> Any:
    """Return a field as TOML has it: nested values as tables."""
    return _plain(entry) if hasattr(entry, "__dataclass_fields__") else entry


def _valve(valve: RotaryValve | OnOffValve | ProportionalValve) -> Table:
    if isinstance(valve, ProportionalValve):
        pairs = zip(valve.command.angles, valve.command.openings, strict=True)
        return {"type": "proportional", "command": [list(pair) for pair in pairs]}
    if isinstance(valve, OnOffValve):
        found = {"type": "on_off", **_plain(valve, "pulses")}
        if valve.pulses is not None:
            del found["duty"], found["start"]
        return {**found, **_pulses(valve.pulses)}
    found = {"type": "rotary", "offset_angle": valve.offset_angle, **_pulses(valve.pulses)}
    if valve.duty is not None:
        found["duty"] = valve.duty
    found["ports"] = [_port(port) for port in valve.ports]
    if valve.inner_volumes:
        found["inner_volumes"] = [_inner(inner) for inner in valve.inner_volumes]
    return found


def _inner(inner: InnerVolume) -> Table:
    return _plain(inner)


def _pulses(pulses: Pulses | None) -> Table:
    if pulses is None:
        return {}
    return {"pulses": [list(pair) for pair in zip(pulses.edges[::2], pulses.edges[1::2], strict=True)]}


def _port(port: Port) -> Table:
    return {**_plain(port, "window"), **_window(port.window)}


def _window(window: Window) -> Table:
    if window.closing_ramp not in (None, window.ramp):
        raise ValueError(
            f"window: found a closing ramp of {window.closing_ramp:g} rad beside {window.ramp:g} rad, expected one for "
            "both: a machine file has one"
        )
    return {"opens_at": window.start, "open_for": window.width, "ramp": window.ramp}


def _path(path: FlowPath) -> Table:
    found: Table = {"source": path.source, "chamber": path.chamber}
    if path.law is None:
        found |= {"area": path.area, "discharge_coefficient": path.discharge_coefficient}
    else:
        found |= _law(path.law)
    for name, law in (("back", path.law_back), ("in_series", path.in_series)):
        if law is not None:
            found[name] = _law(law)
    found |= _window(path.opening) if isinstance(path.opening, Window) else {"opening": path.opening}
    return {**found, "valve": path.valve}


def _law(law: ISO6358) -> Table:
    return _plain(law)


def _lines(table: Mapping[str, Any]) -> str:
    return "\n".join(f"{name} = {_toml(value)}" for name, value in table.items())


def _toml(value: Any) -> str:
    """Return a value as TOML: tables and arrays in line, numbers to their last digit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(entry)}" for name, entry in value.items()) + " }" if value else "{}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    # Strings of JSON are strings of TOML.
    return json.dumps(str(value), ensure_ascii=False)
