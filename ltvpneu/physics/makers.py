"""Tables of makers' data that come with the package; loads nothing that takes time."""

import tomllib
from importlib import resources
from typing import Any


def makers_table(name: str) -> dict[str, dict[str, Any]]:
    """Return one of the tables, "valves" or "cylinders": by name, what is printed of it and where."""
    return tomllib.loads((resources.files("ltvpneu") / f"{name}.toml").read_text(encoding="utf-8"))
