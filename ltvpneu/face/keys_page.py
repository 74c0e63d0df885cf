"""One page of all keys of a machine file, from the tables that the reader reads."""

from ltvpneu.face.machine_keys import ALTERNATIVES, TABLES, Key
from ltvpneu.face.units import example_of, units_of

TITLES = {
    "machine": "The file itself",
    "gas": "`[gas]`: an ideal gas",
    "real_gas": "`[gas]`: a real gas, where `fluid` is given",
    "liquid": "`[liquid]`",
    "energy_balance": "An energy balance, of a chamber or a volume",
    "inner_volume": "`[[valve.inner_volumes]]` of a rotary valve",
    "rigid_volume": "`[[volumes]]`",
    "tube": "A tube",
    "bore_cylinder": "`[cylinder]` by bore and stroke",
    "cylinder": "`[cylinder]` by areas and volumes",
    "load": "`[load]`",
    "law": "What a restriction lets through",
    "valve": "`[valve]`: a directional valve by its data sheet",
    "coil": "`[valve.second]`: the second coil",
    "on_off": "`[valve]` or `[[more_valves]]`: on or off, with flow paths of their own",
    "proportional": "`[valve]` or `[[more_valves]]`: proportional",
    "rotary": "`[valve]`: rotary",
    "port": "`[[valve.ports]]` of a rotary valve",
    "flow_path": "`[[flow_paths]]`",
}
_HEAD = """# Keys of a machine file

Quantities are strings of a number and a unit, or plain numbers in SI units. Pressures are absolute unless marked gauge,
as in "6 bar(g)". Keys in **bold** have to be there. `ltvpneu new` prints a file to start from, `ltvpneu schema` a JSON
Schema, with which editors complete and check it.
"""


def keys_page() -> str:
    """Return the page, in Markdown."""
    parts = [_HEAD]
    for name, keys in TABLES.items():
        rows = [_row(key, spec) for key, spec in keys.items()]
        parts.append(
            "\n".join([f"## {TITLES[name]}\n", "| key | what it is | such as |", "|---|---|---|", *rows]) + "\n"
        )
    units = ["## Units\n", *(f"- {dimension}: {', '.join(known)}" for dimension, known in units_of().items())]
    return "\n".join([*parts, *units]) + "\n"


def _row(name: str, key: Key) -> str:
    shown = f"**{name}**" if key.required else name
    says = key.says if not key.table else f"{key.says} (see: {' or '.join(_linked(key.table))})"
    unsaid = [word for word in key.choices if f'"{word}"' not in key.says]
    says += f": {', '.join(unsaid)}" if unsaid else ""
    example = key.example or example_of(key.kind)
    return f"| {shown} | {says} | `{example}` |".replace("| `{}` |", "| |").replace(" | `[]` |", " | |")


def _linked(table: str) -> list[str]:
    return [TITLES[name].replace("`", "") for name in ALTERNATIVES.get(table, (table,))]
