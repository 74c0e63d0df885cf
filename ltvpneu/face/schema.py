"""JSON Schema of machine files, from the same tables that the reader reads."""

from typing import Any

from ltvpneu.face.machine_keys import ALTERNATIVES, TABLES, Key
from ltvpneu.face.machine_text import bundled_valves
from ltvpneu.face.units import example_of


def machine_schema() -> dict[str, Any]:
    """Return the schema of a machine file, JSON Schema draft 7."""
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Machine file of ltvpneu",
        **_table("machine"),
        "definitions": {name: _table(name) for name in TABLES if name != "machine"},
    }


def _table(name: str) -> dict[str, Any]:
    keys = TABLES[name]
    found: dict[str, Any] = {
        "type": "object",
        "properties": {key: _property(key, spec) for key, spec in keys.items()},
        "additionalProperties": False,
    }
    required = [key for key, spec in keys.items() if spec.required]
    return {**found, "required": required} if required else found


def _property(name: str, key: Key) -> dict[str, Any]:
    if name == "model":
        return {"enum": list(bundled_valves()), "description": key.says}
    if key.kind is dict:
        return {"description": key.says, **_either(key.table)}
    if key.kind is list:
        items = _either(key.table) if key.table else {}
        return {"type": "array", "description": key.says, **({"items": items} if items else {})}
    plain: dict[Any, str] = {str: "string", bool: "boolean", int: "integer"}
    if key.kind in plain:
        # A valve of another kind says so by a word of its own.
        words: dict[str, Any] = {"enum": list(key.choices)} if key.choices else {"type": plain[key.kind]}
        return {**words, "description": key.says}
    example = key.example or example_of(key.kind)
    says = f"{key.says} [{key.kind}]: such as {example}; a plain number is SI"
    return {"type": ["number", "string"], "description": says}


def _either(table: str) -> dict[str, Any]:
    names = ALTERNATIVES.get(table, (table,))
    found = [{"$ref": f"#/definitions/{name}"} for name in names]
    return found[0] if len(found) == 1 else {"anyOf": found}
