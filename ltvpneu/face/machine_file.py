"""Machines from TOML files with units, and the bundled ones."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast, final

from ltvpneu.errors import MachineFileError
from ltvpneu.face.machine_text import machine_text, nearest, parsed
from ltvpneu.face.units import Dimension, parse
from ltvpneu.models.machine.connections import FlowPath
from ltvpneu.models.machine.machine import Machine, Valve
from ltvpneu.physics.cylinder import ATMOSPHERE, Cylinder
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.load import Load
from ltvpneu.physics.medium import Medium
from ltvpneu.physics.proportional import Command, ProportionalValve
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.thermal import EnergyBalance
from ltvpneu.physics.valve import OnOffValve, Port, RotaryValve
from ltvpneu.physics.window import Pulses, Window, check_pulses

Kind = Dimension | type
T = TypeVar("T")


class Key(NamedTuple):
    """What a key of a table holds: a dimension, `str`, `bool`, `dict` or `list`; and whether it may be left out."""

    kind: Kind
    required: bool = False


@final
@dataclass(frozen=True)
class _File:
    """A machine file: the name that its errors begin with, and what its gauge pressures are counted from [Pa]."""

    name: str
    ambient: float

    def __str__(self) -> str:
        return self.name


_MACHINE = {
    "name": Key(str, True), "source": Key(str), "supply_pressure": Key("pressure", True),
    "exhaust_pressure": Key("pressure", True), "collapse": Key(str), "gas": Key(dict), "liquid": Key(dict),
    "cylinder": Key(dict, True), "load": Key(dict, True), "valve": Key(dict, True), "flow_paths": Key(list),
    "more_valves": Key(list), "ambient_pressure": Key("pressure"),
}  # fmt: skip
_GAS = {
    "heat_capacity_ratio": Key("number"), "specific_gas_constant": Key("gas constant"),
    "temperature": Key("temperature"),
}  # fmt: skip
_REAL_GAS = {
    "fluid": Key(str, True), "temperature": Key("temperature"), "pressure_range": Key(list),
    "temperature_range": Key(list),
}  # fmt: skip
_LIQUID = {
    "density": Key("density"), "bulk_modulus": Key("pressure"), "bulk_modulus_slope": Key("number"),
    "entrained_gas": Key("number"), "gas_exponent": Key("number"), "viscosity": Key("viscosity"),
    "critical_reynolds_number": Key("number"), "vapor_pressure": Key("pressure"),
    "reference_pressure": Key("pressure"), "temperature": Key("temperature"),
}  # fmt: skip
_ENERGY_BALANCE = {
    "heat_transfer_coefficient": Key("heat transfer coefficient"), "wall_area": Key("area"),
    "wall_temperature": Key("temperature"),
}  # fmt: skip
_INNER_VOLUME = {
    "name": Key(str), "volume": Key("volume", True), "polytropic_exponent": Key("number"),
    "energy_balance": Key(dict),
}  # fmt: skip
_PROPORTIONAL = {"type": Key(str, True), "command": Key(list, True)}
_CYLINDER = {
    "piston_area_1": Key("area", True), "piston_area_2": Key("area", True), "dead_volume_1": Key("volume"),
    "dead_volume_2": Key("volume"), "seal_friction_area": Key("area"), "polytropic_exponent_1": Key("number"),
    "polytropic_exponent_2": Key("number"), "energy_balance_1": Key(dict), "energy_balance_2": Key(dict),
    "lower_stop": Key("length"), "upper_stop": Key("length"), "rod_area_1": Key("area"), "rod_area_2": Key("area"),
}  # fmt: skip
_LOAD = {
    "mass": Key("mass", True), "spring_stiffness": Key("stiffness"), "viscous_damping": Key("damping"),
    "dry_friction": Key("force"), "stiction": Key("force"), "force": Key("force"),
}  # fmt: skip
_ROTARY = {
    "type": Key(str, True),
    "offset_angle": Key("angle"),
    "duty": Key("number"),
    "pulses": Key(list),
    "ports": Key(list, True),
    "inner_volumes": Key(list),
}
_ON_OFF = {
    "type": Key(str, True), "duty": Key("number"), "ramp": Key("angle"), "start": Key("angle"), "pulses": Key(list),
}  # fmt: skip
_PORT = {
    "way": Key(str, True), "area": Key("area", True), "discharge_coefficient": Key("number", True),
    "opens_at": Key("angle", True), "open_for": Key("angle", True), "ramp": Key("angle"), "volume": Key(str),
    "turns_with_offset": Key(bool), "phase": Key(str),
}  # fmt: skip
_FLOW_PATH = {
    "source": Key(str, True), "chamber": Key(str, True), "area": Key("area", True),
    "discharge_coefficient": Key("number"), "opening": Key(str), "opens_at": Key("angle"), "open_for": Key("angle"),
    "ramp": Key("angle"), "valve": Key(int),
}  # fmt: skip


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
    file = _File(name, _ambient(data, name))
    top = _table(data, _MACHINE, file, "")
    top.pop("source", None)
    gas = _medium(top, file)
    found = _table(top.pop("cylinder"), _CYLINDER, file, "cylinder")
    _energy_balances(found, ("energy_balance_1", "energy_balance_2"), file, "cylinder")
    cylinder = _build(Cylinder, {"dead_volume_1": None, **found}, file, "cylinder")
    load = _build(Load, _table(top.pop("load"), _LOAD, file, "load"), file, "load")
    valve = _valve(top.pop("valve"), file)
    more = tuple(_plain_valve(entry, file, f"more_valves[{i}]") for i, entry in enumerate(top.pop("more_valves", [])))
    paths = tuple(_flow_path(entry, file, f"flow_paths[{i}]") for i, entry in enumerate(top.pop("flow_paths", [])))
    return _build(
        Machine,
        {
            **top,
            "gas": gas,
            "cylinder": cylinder,
            "load": load,
            "valve": valve,
            "more_valves": more,
            "flow_paths": paths,
        },
        file,
        "",
    )


def _medium(top: dict[str, Any], file: _File) -> Medium:
    """Take the tables of the medium out of the file's."""
    gas, liquid = top.pop("gas", None), top.pop("liquid", None)
    if gas is not None and liquid is not None:
        raise MachineFileError(f"{file}: gas, liquid: found both tables, expected one: what flows")
    if liquid is not None:
        return _build(Liquid, _table(liquid, _LIQUID, file, "liquid"), file, "liquid")
    if gas is None or "fluid" not in gas:
        return _build(Gas, _table(gas or {}, _GAS, file, "gas"), file, "gas")
    found = _table(gas, _REAL_GAS, file, "gas")
    ranges: dict[str, Dimension] = {"pressure_range": "pressure", "temperature_range": "temperature"}
    for key, dimension in ranges.items():
        if key in found:
            found[key] = _pair(found[key], (dimension, dimension), file, f"gas.{key}")
    return _build(RealGas, found, file, "gas")


def _pair(entry: Any, kinds: tuple[Dimension, Dimension], file: _File, where: str) -> tuple[Any, Any]:
    """Return two quantities that stand in one array."""
    if not isinstance(entry, list) or len(pair := cast(list[Any], entry)) != 2:
        raise MachineFileError(f"{file}: {where}: found {entry!r}, expected two: {kinds[0]}, {kinds[1]}")
    return _entry(pair[0], kinds[0], file, where), _entry(pair[1], kinds[1], file, where)


def _energy_balances(found: dict[str, Any], keys: tuple[str, ...], file: _File, where: str) -> None:
    for key in keys:
        if key in found:
            table = _table(found[key], _ENERGY_BALANCE, file, f"{where}.{key}")
            found[key] = _build(EnergyBalance, table, file, f"{where}.{key}")


def _inner_volume(data: object, file: _File, where: str) -> InnerVolume:
    found = _table(data, _INNER_VOLUME, file, where)
    _energy_balances(found, ("energy_balance",), file, where)
    return _build(InnerVolume, found, file, where)


def _plain_valve(data: object, file: _File, where: str) -> OnOffValve | ProportionalValve:
    """Return a valve that is no more than its openings."""
    if not isinstance(data, dict) or cast(dict[str, Any], data).get("type") != "proportional":
        return _on_off(data, file, where)
    found = _table(cast(dict[str, Any], data), _PROPORTIONAL, file, where)
    points = [
        _pair(entry, ("angle", "number"), file, f"{where}.command[{i}]") for i, entry in enumerate(found["command"])
    ]
    values = {"angles": tuple(angle for angle, _ in points), "openings": tuple(value for _, value in points)}
    command = _build(Command, values, file, f"{where}.command")
    return ProportionalValve(command=command)


def _valve(data: dict[str, Any], file: _File) -> Valve:
    kind = data.get("type")
    if kind in ("on_off", "proportional"):
        return _plain_valve(data, file, "valve")
    if kind != "rotary":
        raise MachineFileError(f'{file}: valve.type: found {kind!r}, expected "rotary", "on_off" or "proportional"')
    found = _table(data, _ROTARY, file, "valve")
    del found["type"]
    found["ports"] = tuple(_port(entry, file, f"valve.ports[{i}]") for i, entry in enumerate(found["ports"]))
    inner = enumerate(found.get("inner_volumes", []))
    found["inner_volumes"] = tuple(_inner_volume(entry, file, f"valve.inner_volumes[{i}]") for i, entry in inner)
    if "pulses" in found:
        found["pulses"] = _pulses(found["pulses"], 0.0, file, "valve")
    return _build(RotaryValve, found, file, "valve")


def _on_off(data: object, file: _File, where: str) -> OnOffValve:
    found = _table(data, _ON_OFF, file, where)
    kind = found.pop("type")
    if kind != "on_off":
        raise MachineFileError(f'{file}: {where}.type: found {kind!r}, expected "on_off" or "proportional"')
    if "pulses" in found:
        for key in ("duty", "start"):
            if key in found:
                raise MachineFileError(f"{file}: {where}.{key}: found it beside pulses, expected one or the other")
        found["pulses"] = _pulses(found["pulses"], found.get("ramp", 0.0), file, where)
    return _build(OnOffValve, found, file, where)


def _pulses(entries: list[Any], ramp: float, file: _File, where: str) -> Pulses:
    pairs: list[tuple[float, float]] = []
    for i, entry in enumerate(entries):
        at = f"{where}.pulses[{i}]"
        if not isinstance(entry, list) or len(pair := cast(list[Any], entry)) != 2:
            raise MachineFileError(f'{file}: {at}: found {entry!r}, expected two angles, as ["0 deg", "60 deg"]')
        pairs.append((_entry(pair[0], "angle", file, at), _entry(pair[1], "angle", file, at)))
    return _build(lambda pulses: check_pulses(pulses, ramp), {"pulses": pairs}, file, where)


def _port(data: object, file: _File, where: str) -> Port:
    found = _table(data, _PORT, file, where)
    found["window"] = _window(found, file, where)
    return _build(Port, found, file, where)


def _flow_path(data: object, file: _File, where: str) -> FlowPath:
    found = _table(data, _FLOW_PATH, file, where)
    if "opens_at" in found or "open_for" in found:
        for key in ("opens_at", "open_for"):
            if key not in found:
                raise MachineFileError(
                    f"{file}: {where}.{key}: missing, expected an angle beside the other of the window"
                )
        if "opening" in found:
            raise MachineFileError(
                f"{file}: {where}.opening: found it beside opens_at and open_for, expected one or the other"
            )
        found["opening"] = _window(found, file, where)
    elif "ramp" in found:
        raise MachineFileError(f"{file}: {where}.ramp: found it without opens_at and open_for, expected all three")
    return _build(FlowPath, found, file, where)


def _window(found: dict[str, Any], file: _File, where: str) -> Window:
    """Take the three keys of a window out of a table."""
    names = {"opens_at": "start", "open_for": "width", "ramp": "ramp"}
    values = {name: found.pop(key) for key, name in names.items() if key in found}
    return _build(Window, values, file, where, {name: key for key, name in names.items()})


def _table(data: object, keys: Mapping[str, Key], file: _File, where: str) -> dict[str, Any]:
    """Return a table's entries in SI units, after checking that all are known, complete and of the right kind."""
    prefix = f"{where}." if where else ""
    if not isinstance(data, dict):
        raise MachineFileError(f"{file}: {where}: found {data!r}, expected a table")
    for key in data:
        if key not in keys:
            raise MachineFileError(
                f"{file}: {prefix}{key}: unknown key{nearest(key, tuple(keys))}; expected {', '.join(keys)}"
            )
    for key, spec in keys.items():
        if spec.required and key not in data:
            close = nearest(key, tuple(k for k in data if k not in keys))
            raise MachineFileError(f"{file}: {prefix}{key}: missing{close}, expected {_kind_name(spec.kind)}")
    return {key: _entry(value, keys[key].kind, file, f"{prefix}{key}") for key, value in data.items()}


def _entry(value: object, kind: Kind, file: _File, where: str) -> Any:
    if isinstance(kind, type):
        if not isinstance(value, kind):
            raise MachineFileError(f"{file}: {where}: found {value!r}, expected {_kind_name(kind)}")
        return value
    try:
        return parse(value, kind, file.ambient)
    except ValueError as error:
        raise MachineFileError(f"{file}: {where}: {error}") from None


def _ambient(data: dict[str, Any], file: str) -> float:
    """Return the pressure that gauge pressures are counted from; a gauge pressure itself cannot say."""
    if "ambient_pressure" not in data:
        return ATMOSPHERE
    found = data["ambient_pressure"]
    try:
        if parse(found, "pressure", 0.0) == parse(found, "pressure", 1.0):
            return parse(found, "pressure")
    except ValueError as error:
        raise MachineFileError(f"{file}: ambient_pressure: {error}") from None
    raise MachineFileError(
        f"{file}: ambient_pressure: found {found!r}, a gauge pressure, which is counted from the ambient pressure; "
        "expected an absolute one, such as '1.013 bar'"
    )


def _build(
    make: Callable[..., T],
    values: dict[str, Any],
    file: _File,
    where: str,
    keys: Mapping[str, str] | None = None,
) -> T:
    """Build a checked value; its complaint, which begins with the field, gets the file and the table before it."""
    try:
        return make(**values)
    except (ValueError, TypeError) as error:
        message = str(error)
        field, colon, rest = message.partition(":")
        if keys and field in keys:
            message = keys[field] + colon + rest
        raise MachineFileError(f"{file}: {where + '.' if where else ''}{message}") from error


def _kind_name(kind: Kind) -> str:
    names: dict[Kind, str] = {
        str: "a string",
        int: "a whole number",
        bool: "true or false",
        dict: "a table",
        list: "an array of tables",
    }
    return names.get(kind, f"a quantity: {kind}")
