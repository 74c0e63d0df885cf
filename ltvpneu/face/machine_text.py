"""Where machine files are found, and whether they can be read; loads nothing that takes time."""

import difflib
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from ltvpneu.errors import MachineFileError


def bundled_machines() -> tuple[str, ...]:
    """Return the names of the machines that come with the package."""
    folder = resources.files("ltvpneu") / "machines"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def bundled_valves() -> dict[str, dict[str, Any]]:
    """Return what is known of each valve that comes with the package, by name, as in a file's `valve` table."""
    return tomllib.loads((resources.files("ltvpneu") / "valves.toml").read_text(encoding="utf-8"))


def machine_text(source: str | Path) -> tuple[str, str]:
    """Return the text of a machine file, or of a bundled machine, and the name that errors call it.

    Raises
    ------
    MachineFileError
        No such file or bundled machine, or it cannot be read.
    """
    path = Path(source)
    if path.suffix == ".toml" or path.is_file():
        try:
            return path.read_text(encoding="utf-8"), path.name
        except (OSError, UnicodeDecodeError) as error:
            raise MachineFileError(f"{path}: cannot be read ({error}), expected a machine file") from error
    name = str(source)
    if name not in bundled_machines():
        raise MachineFileError(
            f"{name}: found neither a file nor a bundled machine{nearest(name, bundled_machines())}; bundled: "
            f"{', '.join(bundled_machines())}; a file's name ends in .toml"
        )
    return (resources.files("ltvpneu") / "machines" / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"


def parsed(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `name` is what errors call it."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineFileError(f"{name}: not valid TOML: {error}") from error


def nearest(name: str, known: tuple[str, ...]) -> str:
    """Return a hint at the name that is most like a wrong one, or nothing."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f", did you mean {close[0]!r}?" if close else ""
