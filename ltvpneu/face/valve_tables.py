"""Tables of a machine file that tell of valves and what they let through."""

from typing import Any, NamedTuple, cast

from ltvpneu.errors import MachineFileError
from ltvpneu.face.machine_keys import (
    AREA,
    COIL,
    ENERGY_BALANCE,
    FLOW_PATH,
    INNER_VOLUME,
    LAW,
    ON_OFF,
    PORT,
    PROPORTIONAL,
    RIGID_VOLUME,
    ROTARY,
    VALVE,
)
from ltvpneu.face.machine_table import File, build, read_entry, read_pair, read_table
from ltvpneu.face.machine_text import bundled_valves, nearest
from ltvpneu.models.machine.connections import FlowPath
from ltvpneu.models.machine.directional import (
    DIRECTIONAL,
    Directional,
    directional_paths,
    has_both_outlets,
    n_coils,
    second_coil,
)
from ltvpneu.models.machine.machine import Valve
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.iso6358 import AREA_OF_KV, ISO6358, KV_OF_CV
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.medium import Medium
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import Command, ProportionalValve
from ltvpneu.physics.thermal import EnergyBalance
from ltvpneu.physics.tube import Tube
from ltvpneu.physics.valve import Port, RotaryValve
from ltvpneu.physics.window import Pulses, Window, check_pulses


def energy_balances(found: dict[str, Any], keys: tuple[str, ...], file: File, where: str) -> None:
    """Put energy balances in the place of their tables."""
    for key in keys:
        if key in found:
            table = read_table(found[key], ENERGY_BALANCE, file, f"{where}.{key}")
            found[key] = build(EnergyBalance, table, file, f"{where}.{key}")


def read_rigid_volume(data: object, file: File, where: str) -> InnerVolume:
    """Return one of a file's `volumes`."""
    found = read_table(data, RIGID_VOLUME, file, where)
    energy_balances(found, ("energy_balance",), file, where)
    return build(InnerVolume, found, file, where)


def _inner_volume(data: object, file: File, where: str) -> InnerVolume:
    found = read_table(data, INNER_VOLUME, file, where)
    energy_balances(found, ("energy_balance",), file, where)
    return build(InnerVolume, found, file, where)


def _plain_valve(data: object, file: File, where: str) -> OnOffValve | ProportionalValve:
    """Return a valve that is no more than its openings."""
    if not isinstance(data, dict) or cast(dict[str, Any], data).get("type") != "proportional":
        return _on_off(data, file, where)
    found = read_table(cast(dict[str, Any], data), PROPORTIONAL, file, where)
    points = [
        read_pair(entry, ("angle", "number"), file, f"{where}.command[{i}]") for i, entry in enumerate(found["command"])
    ]
    values = {"angles": tuple(angle for angle, _ in points), "openings": tuple(value for _, value in points)}
    command = build(Command, values, file, f"{where}.command")
    return ProportionalValve(command=command)


class ReadValve(NamedTuple):
    """What a file's `valve` table makes: the machine's valve, further ones, and flow paths."""

    valve: Valve
    more_valves: tuple[OnOffValve, ...] = ()
    paths: tuple[FlowPath, ...] = ()


def read_valve(
    data: dict[str, Any], places: tuple[str, ...], tubes: tuple[Tube | None, Tube | None], medium: Medium, file: File
) -> ReadValve:
    """Return what a file's `valve` table makes, for volumes by name, tubes and a medium."""
    if "model" in data:
        data = _of_model(data, file)
    kind = data.get("type")
    if kind in ("on_off", "proportional"):
        return ReadValve(_plain_valve(data, file, "valve"))
    if kind == "rotary":
        return ReadValve(_rotary(data, file))
    if kind in DIRECTIONAL:
        return _directional(data, places, tubes, medium, file)
    close = nearest(kind, DIRECTIONAL) if isinstance(kind, str) else ""
    words = ", ".join(f'"{word}"' for word in DIRECTIONAL)
    raise MachineFileError(
        f'{file}: valve.type: found {kind!r}{close}, expected "rotary", "on_off" or "proportional", or of a '
        f"directional valve {words}"
    )


def _of_model(data: dict[str, Any], file: File) -> dict[str, Any]:
    """Return a table with what is known of the bundled valve that it names; what the table says itself wins."""
    known, name = bundled_valves(), data["model"]
    if name not in known:
        close = nearest(name, tuple(known)) if isinstance(name, str) else ""
        raise MachineFileError(f"{file}: valve.model: found {name!r}{close}, expected one of {', '.join(known)}")
    printed = {key: value for key, value in known[name].items() if key != "source"}
    # Another way to say what it lets through takes the place of the one that is known.
    if data.keys() & {"sonic_conductance", "nominal_flow", "Kv", "Cv", "area"}:
        printed = {key: value for key, value in printed.items() if key not in LAW}
    return {**printed, **{key: value for key, value in data.items() if key != "model"}}


def read_more_valves(entries: list[Any], file: File) -> tuple[OnOffValve | ProportionalValve, ...]:
    """Return a file's `more_valves`."""
    return tuple(_plain_valve(entry, file, f"more_valves[{i}]") for i, entry in enumerate(entries))


def _rotary(data: dict[str, Any], file: File) -> RotaryValve:
    found = read_table(data, ROTARY, file, "valve")
    del found["type"]
    found["ports"] = tuple(_port(entry, file, f"valve.ports[{i}]") for i, entry in enumerate(found["ports"]))
    inner = enumerate(found.get("inner_volumes", []))
    found["inner_volumes"] = tuple(_inner_volume(entry, file, f"valve.inner_volumes[{i}]") for i, entry in inner)
    if "pulses" in found:
        found["pulses"] = _pulses(found["pulses"], 0.0, file, "valve")
    return build(RotaryValve, found, file, "valve")


def _directional(
    data: dict[str, Any], places: tuple[str, ...], tubes: tuple[Tube | None, Tube | None], medium: Medium, file: File
) -> ReadValve:
    found = read_table(data, VALVE, file, "valve")
    kind: Directional = found.pop("type")
    passage = read_law({key: found.pop(key) for key in (*LAW, *AREA) if key in found}, medium, file, "valve")
    others = {
        key: read_law(read_table(found.pop(key), LAW, file, f"valve.{key}"), medium, file, f"valve.{key}")
        for key in ("exhaust", "silencer")
        if key in found
    }
    chamber: str = found.pop("chamber", next(iter(places)))
    if chamber not in places:
        raise MachineFileError(f"{file}: valve.chamber: found {chamber!r}, expected one of {', '.join(places)}")
    if has_both_outlets(kind) and not {"chamber_1", "chamber_2"} <= set(places):
        raise MachineFileError(
            f'{file}: valve.type: found "{kind}", which feeds two chambers, on a cylinder with {chamber} alone; '
            'expected "3/2" or "2/2 nc"'
        )
    second = found.pop("second", None)
    first = _switched(found, file, "valve")
    paths = build(
        directional_paths,
        {"kind": kind, "law": passage, **others, "tubes": tubes, "chamber": chamber},
        file,
        "valve",
    )
    if n_coils(kind) == 1:
        if second is not None:
            raise MachineFileError(f'{file}: valve.second: found it of a "{kind}" valve, which has one coil')
        return ReadValve(first, paths=paths)
    given = {} if second is None else read_table(second, COIL, file, "valve.second")
    times = {key: value for key, value in found.items() if key.endswith(("_delay", "_time", "ramp"))}
    usual = second_coil(kind, first)
    if not given.keys() & {"pulses", *usual}:
        given |= usual
    return ReadValve(first, (_switched({**times, **given}, file, "valve.second"),), paths)


def read_law(found: dict[str, Any], medium: Medium, file: File, where: str) -> ISO6358 | float:
    """Return the law that keys of a table give, or an effective area [m^2]."""
    ways = [key for key in ("sonic_conductance", "nominal_flow", "Kv", "Cv", "area") if key in found]
    if len(ways) != 1:
        listed = " and ".join(ways) or "none"
        raise MachineFileError(
            f"{file}: {where}: found {listed} of sonic_conductance, nominal_flow, Kv, Cv and area, expected one of them"
        )
    way, value = ways[0], found[ways[0]]
    if way != "area" and "discharge_coefficient" in found:
        raise MachineFileError(
            f"{file}: {where}.discharge_coefficient: found it beside {way}, expected an area with it"
        )
    if way == "area":
        for key in ("critical_pressure_ratio", "subsonic_index", "laminar_ratio", "cracking_pressure"):
            if key in found:
                raise MachineFileError(f"{file}: {where}.{key}: found it beside an area, expected sonic_conductance")
        return found.get("discharge_coefficient", 1.0) * value
    coefficient = {"Kv": 1.0, "Cv": KV_OF_CV}.get(way)
    if isinstance(medium, Liquid):
        if coefficient is None:
            raise MachineFileError(f"{file}: {where}.{way}: found a gas's of a liquid, expected Kv, Cv or an area")
        return value * coefficient * AREA_OF_KV
    ratio = found.get("critical_pressure_ratio", 0.3)
    if coefficient is not None:
        value = build(ISO6358.from_kv, {"kv": coefficient * value, "critical_pressure_ratio": ratio}, file, where)
    elif way == "nominal_flow":
        keys = {"flow": value, "critical_pressure_ratio": ratio, "subsonic_index": found.get("subsonic_index", 0.5)}
        value = build(ISO6358.from_nominal_flow, keys, file, where, {"flow": "nominal_flow"})
    if isinstance(value, ISO6358):
        value = value.sonic_conductance
    shape = {key: found[key] for key in LAW if key in found and key not in ways}
    return build(ISO6358, {"sonic_conductance": value, **shape}, file, where)


def _on_off(data: object, file: File, where: str) -> OnOffValve:
    found = read_table(data, ON_OFF, file, where)
    kind = found.pop("type")
    if kind != "on_off":
        raise MachineFileError(f'{file}: {where}.type: found {kind!r}, expected "on_off" or "proportional"')
    return _switched(found, file, where)


def _switched(found: dict[str, Any], file: File, where: str) -> OnOffValve:
    """Return a valve from the keys that say how it is switched."""
    if "pulses" in found:
        for key in ("duty", "start"):
            if key in found:
                raise MachineFileError(f"{file}: {where}.{key}: found it beside pulses, expected one or the other")
        found["pulses"] = _pulses(found["pulses"], found.get("ramp", 0.0), file, where)
    return build(OnOffValve, found, file, where)


def _pulses(entries: list[Any], ramp: float, file: File, where: str) -> Pulses:
    pairs: list[tuple[float, float]] = []
    for i, entry in enumerate(entries):
        at = f"{where}.pulses[{i}]"
        if not isinstance(entry, list) or len(pair := cast(list[Any], entry)) != 2:
            raise MachineFileError(f'{file}: {at}: found {entry!r}, expected two angles, as ["0 deg", "60 deg"]')
        pairs.append((read_entry(pair[0], "angle", file, at), read_entry(pair[1], "angle", file, at)))
    return build(lambda pulses: check_pulses(pulses, ramp), {"pulses": pairs}, file, where)


def _port(data: object, file: File, where: str) -> Port:
    found = read_table(data, PORT, file, where)
    found["window"] = _window(found, file, where)
    return build(Port, found, file, where)


def read_path(data: object, medium: Medium, file: File, where: str) -> FlowPath:
    """Return one of a file's `flow_paths`."""
    found = read_table(data, FLOW_PATH, file, where)
    law = {key: found.pop(key) for key in LAW if key in found}
    if law:
        if "area" in found:
            raise MachineFileError(f"{file}: {where}.area: found it beside {next(iter(law))}, expected one of them")
        passage = read_law(law, medium, file, where)
        found |= {"law": passage} if isinstance(passage, ISO6358) else {"area": passage}
    elif "area" not in found:
        raise MachineFileError(f"{file}: {where}.area: missing, expected a quantity: area, or a sonic_conductance")
    for key, name in (("back", "law_back"), ("in_series", "in_series")):
        if key in found:
            table = read_table(found.pop(key), LAW, file, f"{where}.{key}")
            found[name] = read_law(table, medium, file, f"{where}.{key}")
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
    return build(FlowPath, found, file, where)


def _window(found: dict[str, Any], file: File, where: str) -> Window:
    """Take the three keys of a window out of a table."""
    names = {"opens_at": "start", "open_for": "width", "ramp": "ramp"}
    values = {name: found.pop(key) for key, name in names.items() if key in found}
    return build(Window, values, file, where, {name: key for key, name in names.items()})
