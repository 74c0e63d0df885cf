"""Machines from TOML files with units, and the bundled ones."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

from ltvpneu.errors import MachineFileError
from ltvpneu.face.machine_keys import (
    BORE_CYLINDER,
    CYLINDER,
    GAS,
    LIQUID,
    LOAD,
    MACHINE,
    PROCESS,
    REAL_GAS,
    SCHEMA,
    TUBE,
)
from ltvpneu.face.machine_table import File, ambient_of, build, read_pair, read_table
from ltvpneu.face.machine_text import machine_text, parsed
from ltvpneu.face.units import Dimension, cut
from ltvpneu.face.valve_tables import energy_balances, read_more_valves, read_path, read_rigid_volume, read_valve
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.catalog import catalog_cylinder
from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.load import Load
from ltvpneu.physics.medium import Medium
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.tube import Tube

_BORE_ALONE, _AREAS_ALONE = set(BORE_CYLINDER) - set(CYLINDER), set(CYLINDER) - set(BORE_CYLINDER)
MOUNTINGS = {"horizontal": 0.0, "up": math.pi / 2, "down": -math.pi / 2}
"""Angle of the way to higher positions above the horizontal [rad]."""


def load_machine(source: str | Path) -> Machine:
    """Return a machine: a bundled one by its name, or one from a TOML file by its path.

    Parameters
    ----------
    source : str or Path
        Such as "kunt_singh_1990" or "rig.toml".

    Raises
    ------
    MachineFileError
        No such file or bundled machine; unreadable; an unknown, missing or impossible entry. The message names the
        file, the key, what was found and what was expected.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> lp.load_machine("kunt_singh_1990").supply_pressure
    410000.0
    """
    return parse_machine(*machine_text(source))


def parse_machine(text: str, name: str) -> Machine:
    """Return the machine that a TOML text describes; `name` is what errors call it."""
    data = parsed(text, name)
    file = File(name, ambient_of(data, name))
    top = read_table(data, MACHINE, file, "")
    top.pop("source", None)
    if (version := top.pop("schema", SCHEMA)) != SCHEMA:
        raise MachineFileError(
            f"{file}: schema: found {cut(version)}, expected {SCHEMA}; this file is for another version of ltvpneu"
        )
    medium = _medium(top, file)
    tanks = tuple(read_rigid_volume(entry, file, f"volumes[{i}]") for i, entry in enumerate(top.pop("volumes", [])))
    if tanks and "cylinder" not in top and "load" not in top:
        fitted, load = _Fitted(Cylinder.absent(), (None, None), {}), Load.absent()
    else:
        _expect_both(top, file)
        fitted = _cylinder(top.pop("cylinder"), file)
        if isinstance(medium, Liquid) and any(fitted.tubes):
            raise MachineFileError(
                f"{file}: cylinder.tube_1, tube_2: found a tube in a machine of a liquid, expected its volume as part "
                "of dead_volume_1, dead_volume_2: a tube's law of flow is that of a gas"
            )
        load = _load(top.pop("load"), fitted, file)
    places = (*fitted.cylinder.chambers, *(tank.name for tank in tanks))
    found = read_valve(top.pop("valve"), places, fitted.tubes, medium, file)
    more = read_more_valves(top.pop("more_valves", []), file)
    paths = [read_path(entry, medium, file, f"flow_paths[{i}]") for i, entry in enumerate(top.pop("flow_paths", []))]
    parts = {
        "gas": medium,
        "cylinder": fitted.cylinder,
        "load": load,
        "rigid_volumes": tanks,
        "valve": found.valve,
        "more_valves": (*found.more_valves, *more),
        "flow_paths": (*found.paths, *paths),
    }
    return build(Machine, {**top, **parts}, file, "")


def _expect_both(top: dict[str, Any], file: File) -> None:
    """Raise unless there are a cylinder and a load."""
    for key in ("cylinder", "load"):
        if key not in top:
            raise MachineFileError(f"{file}: {key}: missing, expected a table")


class _Fitted(NamedTuple):
    """A cylinder as it is fitted: what else its table says."""

    cylinder: Cylinder
    tubes: tuple[Tube | None, Tube | None]
    load: dict[str, float]
    """What it adds to the load: mounting and return spring."""


def _cylinder(data: Any, file: File) -> _Fitted:
    by_bore = isinstance(data, dict) and not _BORE_ALONE.isdisjoint(cast(dict[str, Any], data))
    if by_bore and (others := [key for key in data if key in _AREAS_ALONE]):
        raise MachineFileError(
            f"{file}: cylinder.{others[0]}: found it beside {next(key for key in data if key in _BORE_ALONE)}, "
            "expected bore, rod and stroke, or piston areas, dead volumes at position zero and stops"
        )
    found = read_table(data, BORE_CYLINDER if by_bore else CYLINDER, file, "cylinder")
    load: dict[str, float] = {}
    if (mounting := found.pop("mounting", None)) is not None:
        load["mounting"] = MOUNTINGS[mounting] if isinstance(mounting, str) else mounting
    if not by_bore:
        energy_balances(found, ("energy_balance_1", "energy_balance_2"), file, "cylinder")
        cylinder = build(Cylinder, {"dead_volume_1": None, **found}, file, "cylinder")
        return _Fitted(cylinder, (None, None), load)
    process = {key: found.pop(key) for key in PROCESS if key in found}
    energy_balances(process, ("energy_balance_1", "energy_balance_2"), file, "cylinder")
    if found.pop("rodless", False) and found.get("rod"):
        raise MachineFileError(f"{file}: cylinder.rodless: found it beside a rod, expected one of them")
    if "return_spring" in found:
        load |= _return_spring(found.pop("return_spring"), found["stroke"], file)
    for key in ("tube_1", "tube_2"):
        if key in found:
            found[key] = build(Tube, read_table(found[key], TUBE, file, f"cylinder.{key}"), file, f"cylinder.{key}")
    plain = build(catalog_cylinder, found, file, "cylinder")
    cylinder = build(partial(replace, plain), process, file, "cylinder")
    return _Fitted(cylinder, (found.get("tube_1"), found.get("tube_2")), load)


def _return_spring(entry: Any, stroke: float, file: File) -> dict[str, float]:
    """Return preload and rate of a spring by its two forces."""
    retracted, extended = read_pair(entry, ("force", "force"), file, "cylinder.return_spring")
    if extended < retracted:
        raise MachineFileError(
            f"{file}: cylinder.return_spring: found {retracted:g} N with the rod in and {extended:g} N with it out, "
            "expected a force that grows as the rod moves out (of a spring that pushes it out, both negative)"
        )
    return {"spring_preload": retracted, "spring_stiffness": (extended - retracted) / stroke}


def _load(data: Any, fitted: _Fitted, file: File) -> Load:
    found = read_table(data, LOAD, file, "load")
    for key in fitted.load:
        if key in found:
            raise MachineFileError(f"{file}: load.{key}: found it beside cylinder.return_spring, expected one of them")
    return build(Load, {**found, **fitted.load}, file, "load")


def _medium(top: dict[str, Any], file: File) -> Medium:
    """Take the tables of the medium out of the file's."""
    gas, liquid = top.pop("gas", None), top.pop("liquid", None)
    if gas is not None and liquid is not None:
        raise MachineFileError(f"{file}: gas, liquid: found both tables, expected one: what flows")
    if liquid is not None:
        return build(Liquid, read_table(liquid, LIQUID, file, "liquid"), file, "liquid")
    if gas is None or "fluid" not in gas:
        return build(Gas, read_table(gas or {}, GAS, file, "gas"), file, "gas")
    found = read_table(gas, REAL_GAS, file, "gas")
    ranges: dict[str, Dimension] = {"pressure_range": "pressure", "temperature_range": "temperature"}
    for key, dimension in ranges.items():
        if key in found:
            found[key] = read_pair(found[key], (dimension, dimension), file, f"gas.{key}")
    return build(RealGas, found, file, "gas")
