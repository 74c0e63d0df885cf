"""A folder of results: each file is written whole, under another name, and then given its own.

So a full disk, a folder in the way or a process that is killed leaves what was finished, and files of before as they
were.
"""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Results:
    """Files written to a folder, which is made where there is none.

    Attributes
    ----------
    written : list of Path
        What is finished, each once, in order.

    Raises
    ------
    ValueError
        A folder that cannot be made, or a file that cannot be written; the message names it.
    """

    def __init__(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"--out: found {str(folder)!r}, expected a folder that can be made ({error})") from None
        self.folder = folder
        self.written: list[Path] = []

    def picture(self, name: str, figure: "Figure", dpi: int = 150) -> None:
        """Write a figure as name.png."""
        self._write(f"{name}.png", lambda path: figure.savefig(path, dpi=dpi, format="png"))

    def data(self, name: str, data: dict[str, Any]) -> None:
        """Write name.json."""
        text = json.dumps(data, indent=1, allow_nan=False) + "\n"
        self.text(f"{name}.json", text)

    def text(self, name: str, text: str) -> None:
        """Write a text file, in UTF-8, its ends of lines as they are."""
        self._write(name, lambda path: path.write_text(text, encoding="utf-8", newline=""))

    def _write(self, name: str, write: Callable[[Path], object]) -> None:
        path, part = self.folder / name, self.folder / f".{name}.{os.getpid()}.part"
        try:
            write(part)
            part.replace(path)
        except OSError as error:
            done = f"; written before it: {', '.join(str(each) for each in self.written)}" if self.written else ""
            raise ValueError(f"{path}: could not be written ({error.strerror or error}){done}") from None
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
        if path not in self.written:
            self.written.append(path)

    def listed(self) -> str:
        """Return the lines that tell what was written."""
        return "\n".join(["written:", *(f"  {path}" for path in self.written)])
