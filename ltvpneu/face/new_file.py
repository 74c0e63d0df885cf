"""`ltvpneu new`: a commented machine file to start from, bare or filled in."""

from collections.abc import Mapping

from ltvpneu.face.machine_keys import BORE_CYLINDER, LOAD, MACHINE, SCHEMA, VALVE, Key
from ltvpneu.face.units import example_of

SCHEMA_FILE = "ltvpneu.schema.json"
"""Where editors look for the schema that `ltvpneu schema` prints."""
_HEAD = f"""#:schema ./{SCHEMA_FILE}
# A machine file of ltvpneu. Lines that begin with # say what else may be given; take the # away and set the value.
# Plain numbers are SI; "6 bar(g)" is gauge, "7 bar" absolute. `ltvpneu schema > {SCHEMA_FILE}` lets editors help.
"""
_TABLES: dict[str, tuple[Mapping[str, Key], str]] = {
    "cylinder": (BORE_CYLINDER, "position 0 is the rod in, chamber 1 pushes it out"),
    "load": (LOAD, "what the piston moves"),
    "valve": (VALVE, "give C and b, or nominal_flow, Kv or Cv"),
}
_USUAL = {
    "": {"schema": str(SCHEMA), "exhaust_pressure": '"0 bar(g)"'},
    "cylinder": {"rod": '"12 mm"', "clearance": '"10 %"'},
    "load": {"dry_friction": '"20 N"', "stiction": '"35 N"'},
    "valve": {"sonic_conductance": '"0.7 dm^3/(s bar)"', "critical_pressure_ratio": "0.3"},
}
"""What a file says where nothing is asked for, beside the keys that it must have."""


def new_file(given: Mapping[str, Mapping[str, str]]) -> str:
    """Return the text of a machine file.

    Parameters
    ----------
    given : mapping
        By table ("" for the top) and key: values as TOML.
    """
    top = {name: key for name, key in MACHINE.items() if key.kind not in (dict, list)}
    parts = [_HEAD, *_lines(top, {**_USUAL[""], **given.get("", {})})]
    for name, (keys, says) in _TABLES.items():
        values = {**_usual(name, given.get(name, {})), **given.get(name, {})}
        parts += [f"\n[{name}]    # {says}", *_lines(keys, values)]
    return "\n".join(parts) + "\n"


def _usual(table: str, given: Mapping[str, str]) -> dict[str, str]:
    """Return what a table says by default, without what is given in another way."""
    usual = dict(_USUAL[table])
    if given.keys() & {"nominal_flow", "Kv", "Cv", "model"}:
        usual.pop("sonic_conductance", None)
    if "model" in given:
        usual.pop("critical_pressure_ratio", None)
    if given.keys() & {"rodless"}:
        usual.pop("rod", None)
    if given.keys() & {"dead_volume_1", "dead_volume_2"}:
        usual.pop("clearance", None)
    return usual


def _lines(keys: Mapping[str, Key], values: Mapping[str, str]) -> list[str]:
    found: list[str] = []
    for name, key in keys.items():
        entry = f"{name} = {values.get(name, key.example or example_of(key.kind))}"
        mark = "" if name in values or key.required else "# "
        unsaid = [word for word in key.choices if f'"{word}"' not in key.says]
        words = f" ({', '.join(unsaid)})" if unsaid else ""
        found.append(f"{mark + entry:<48}  # {key.says}{words}")
    return found
