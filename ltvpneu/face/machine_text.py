"""Where machine files are found, and whether they can be read; loads nothing that takes time."""

import difflib
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from ltvpneu.errors import MachineFileError
from ltvpneu.physics.makers import makers_table

LARGEST_FILE = 1_000_000
"""[byte]; the largest bundled machine has four thousand."""


def bundled_machines() -> tuple[str, ...]:
    """Return the names of the machines that come with the package."""
    folder = resources.files("ltvpneu") / "machines"
    return tuple(sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")))


def bundled_valves() -> dict[str, dict[str, Any]]:
    """Return what is known of each valve that comes with the package, by name, as in a file's `valve` table."""
    return makers_table("valves")


def machine_text(source: str | Path) -> tuple[str, str]:
    """Return the text of a machine file, or of a bundled machine, and the name that errors call it.

    Raises
    ------
    MachineFileError
        No such file or bundled machine, or it cannot be read.
    """
    path = Path(source)
    # A bundled name means the bundled machine, whatever lies in the working folder.
    if str(source) not in bundled_machines() and (path.suffix == ".toml" or path.exists()):
        return _text_of(path), path.name
    name = str(source)
    if name not in bundled_machines():
        raise MachineFileError(
            f"{name}: found neither a file nor a bundled machine{nearest(name, bundled_machines())}; bundled: "
            f"{', '.join(bundled_machines())}; a file's name ends in .toml"
        )
    return (resources.files("ltvpneu") / "machines" / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"


def _text_of(path: Path) -> str:
    """Return the text of a regular file of a moderate size; a byte-order mark is dropped."""
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise MachineFileError(f"{path}: cannot be read: found {kind}, expected a machine file")
    try:
        size = path.stat().st_size
        text = path.read_text(encoding="utf-8-sig") if size <= LARGEST_FILE else ""
    except (OSError, UnicodeDecodeError) as error:
        raise MachineFileError(f"{path}: cannot be read ({error}), expected a machine file") from error
    if size > LARGEST_FILE:
        raise MachineFileError(
            f"{path}: found {size / 1e6:.1f} MB, expected a machine file, of {LARGEST_FILE / 1e6:g} MB at most"
        )
    return text


def parsed(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `name` is what errors call it."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise MachineFileError(f"{name}: not valid TOML: {error}") from error
    except RecursionError:
        raise MachineFileError(
            f"{name}: found arrays or tables nested hundreds deep, expected three levels at most"
        ) from None
    except ValueError as error:
        # Python refuses whole numbers of thousands of digits.
        raise MachineFileError(f"{name}: found a number that cannot be read ({error})") from None


def nearest(name: str, known: tuple[str, ...]) -> str:
    """Return a hint at the name that is most like a wrong one, or nothing."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f", did you mean {close[0]!r}?" if close else ""
