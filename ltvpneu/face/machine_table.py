"""Tables of a machine file read by their keys: known, complete, of the right kind, in SI units."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, cast, final

from ltvpneu.errors import MachineFileError
from ltvpneu.face.machine_keys import Key, Kind
from ltvpneu.face.machine_text import nearest
from ltvpneu.face.units import Dimension, cut, parse
from ltvpneu.physics.cylinder import ATMOSPHERE

T = TypeVar("T")


@final
@dataclass(frozen=True)
class File:
    """A machine file: the name that its errors begin with, and what its gauge pressures are counted from [Pa]."""

    name: str
    ambient: float

    def __str__(self) -> str:
        return self.name


LONGEST_KEY = 60


def read_table(data: object, keys: Mapping[str, Key], file: File, where: str) -> dict[str, Any]:
    """Return a table's entries in SI units, after checking that all are known, complete and of the right kind."""
    prefix = f"{where}." if where else ""
    if not isinstance(data, dict):
        raise MachineFileError(f"{file}: {where}: found {cut(data)}, expected a table")
    for key in data:
        if key not in keys:
            raise MachineFileError(
                f"{file}: {prefix}{_named(key)}: unknown key{nearest(key, tuple(keys))}; expected {', '.join(keys)}"
            )
    for key, spec in keys.items():
        if spec.required and key not in data:
            close = nearest(key, tuple(k for k in data if k not in keys))
            raise MachineFileError(f"{file}: {prefix}{key}: missing{close}, expected {_kind_name(spec.kind)}")
    return {key: _chosen(value, keys[key], file, f"{prefix}{key}") for key, value in data.items()}


def _chosen(value: object, key: Key, file: File, where: str) -> Any:
    """Return an entry; a word where it may be one of some."""
    if value in key.choices:
        return value
    if key.choices and (key.kind is str or (isinstance(value, str) and value.isalpha())):
        words = ", ".join(f'"{word}"' for word in key.choices)
        other = "" if key.kind is str else f", or {_kind_name(key.kind)}"
        close = nearest(value, key.choices) if isinstance(value, str) else ""
        raise MachineFileError(f"{file}: {where}: found {cut(value)}{close}, expected one of {words}{other}")
    return read_entry(value, key.kind, file, where)


def read_entry(value: object, kind: Kind, file: File, where: str) -> Any:
    """Return a value of a kind, a quantity in SI units."""
    if isinstance(kind, type):
        if not isinstance(value, kind):
            raise MachineFileError(f"{file}: {where}: found {cut(value)}, expected {_kind_name(kind)}")
        if isinstance(value, str) and not value.isprintable():
            raise MachineFileError(f"{file}: {where}: found {cut(value)}, expected text without control characters")
        return value
    try:
        return parse(value, kind, file.ambient)
    except ValueError as error:
        raise MachineFileError(f"{file}: {where}: {error}") from None


def _named(key: str) -> str:
    """Return a key as a message may show it."""
    return key if key.isprintable() and len(key) < LONGEST_KEY else cut(key)


def ambient_of(data: dict[str, Any], file: str) -> float:
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


def build(
    make: Callable[..., T],
    values: dict[str, Any],
    file: File,
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


def read_pair(entry: Any, kinds: tuple[Dimension, Dimension], file: File, where: str) -> tuple[Any, Any]:
    """Return two quantities that stand in one array."""
    if not isinstance(entry, list) or len(pair := cast(list[Any], entry)) != 2:
        raise MachineFileError(f"{file}: {where}: found {cut(entry)}, expected two: {kinds[0]}, {kinds[1]}")
    return read_entry(pair[0], kinds[0], file, where), read_entry(pair[1], kinds[1], file, where)
