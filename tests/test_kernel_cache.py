"""Kernels on disk are found as long as nothing that they were compiled from has changed, wherever they lie."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
INNER = """
from ltvpneu._compiled import compiled
FACTOR = 2.0

@compiled
def law(x: float) -> float:
    return FACTOR * x

@compiled
def other(x: float) -> float:
    return x + 1.0
"""
OUTER = """
from ltvpneu._compiled import compiled
from laws.inner import law, other

@compiled
def kernel(x: float) -> float:
    return law(x) + 1.0

@compiled
def apart(x: float) -> float:
    return other(x)
"""
ASK = """
from laws.outer import apart, kernel
from ltvpneu._kernel_cache import counts
print(kernel(3.0), apart(1.0), counts.compiled, counts.loaded, counts.shipped)
"""


@pytest.fixture
def laws(tmp_path):
    """A package of two laws and two kernels that call them."""
    folder = tmp_path / "laws"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "inner.py").write_text(INNER)
    (folder / "outer.py").write_text(OUTER)
    return folder


def start(laws: Path, code: str = ASK, **environment: str) -> "subprocess.Popen[str]":
    known = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    known |= {"PYTHONPATH": f"{laws.parent}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1", **environment}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-c", code], env=known, text=True, **pipes)  # type: ignore[call-overload]


def ask(laws: Path, code: str = ASK, **environment: str) -> tuple[str, str]:
    """Return what a process of its own prints, and its complaints."""
    process = start(laws, code, **environment)
    out, complaints = process.communicate()
    assert process.returncode == 0, complaints
    return out.strip(), complaints


def edit(path: Path, before: str, after: str) -> None:
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after))


def test_an_edited_law_compiles_what_calls_it_and_nothing_else(laws):
    assert ask(laws)[0] == "7.0 2.0 4 0 0"
    assert ask(laws)[0] == "7.0 2.0 0 2 0"
    edit(laws / "inner.py", "FACTOR * x", "FACTOR * x * x")
    assert ask(laws)[0] == "19.0 2.0 2 1 0"
    # A constant is part of what a kernel is compiled from.
    edit(laws / "inner.py", "FACTOR = 2.0", "FACTOR = 3.0")
    assert ask(laws)[0] == "28.0 2.0 2 1 0"
    # One file for each kernel: what an earlier state made is not kept.
    assert len(list(laws.rglob("*.nbc"))) == 4


def test_comments_line_numbers_and_times_of_files_do_not_count(laws):
    assert ask(laws)[0] == "7.0 2.0 4 0 0"
    edit(laws / "inner.py", "\nFACTOR", "\n\n# A number.\nFACTOR")
    assert ask(laws)[0] == "7.0 2.0 0 2 0"
    edit(laws / "inner.py", "FACTOR * x", "FACTOR * x * x")
    # A clock that was set back: the edited file is older than the kernels made of it before.
    os.utime(laws / "inner.py", (1e9, 1e9))
    assert ask(laws)[0] == "19.0 2.0 2 1 0"


SIDE = """
from typing import NamedTuple
from ltvpneu._compiled import compiled

class Side(NamedTuple):
    pressure: float
    temperature: float

@compiled
def difference(side: Side) -> float:
    return side.pressure - side.temperature
"""
ASK_SIDE = """
from laws.side import Side, difference
from ltvpneu._kernel_cache import counts
print(difference(Side(pressure=3.0, temperature=1.0)), counts.compiled)
"""


def test_fields_that_change_places_in_an_argument_are_seen(laws):
    (laws / "side.py").write_text(SIDE)
    assert ask(laws, ASK_SIDE)[0] == "2.0 1"
    edit(
        laws / "side.py",
        "    pressure: float\n    temperature: float\n",
        "    temperature: float\n    pressure: float\n",
    )
    assert ask(laws, ASK_SIDE)[0] == "2.0 1"


TOLD = "import ltvpneu._telling as told\ntold.SILENT = told.BETWEEN = 0.0\n"


def test_compiling_is_told_and_what_is_found_is_not(laws):
    out, said = ask(laws, TOLD + ASK)
    assert out == "7.0 2.0 4 0 0"
    # Two kernels, one after the other, each with the law that it calls.
    lines = dict.fromkeys(re.sub(r"[0-9]+ s$", "some s", line) for line in said.splitlines())
    assert list(lines) == [
        "compiling the machine's equations, once: 1 of 2, some s",
        "compiled the machine's equations: 2 parts in some s",
    ]
    assert ask(laws, TOLD + ASK) == ("7.0 2.0 0 2 0", "")


@pytest.mark.parametrize("place", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_kernels_are_kept_where_the_package_cannot_be_written_to(laws, tmp_path, place):
    if place == "XDG_CACHE_HOME" and sys.platform != "linux":
        pytest.skip("the user's cached files lie elsewhere")
    # A file where the folder would be made: nobody can write there, whatever his rights.
    (laws / "__pycache__").touch()
    folder = tmp_path / "kept"
    for expected in ("7.0 2.0 4 0 0", "7.0 2.0 0 2 0"):
        out, complaints = ask(laws, **{place: str(folder)})
        assert out == expected
        assert "Warning" not in complaints
    assert len(list(folder.rglob("*.nbc"))) == 4
    # A law that is edited is in force at once, wherever the kernels lie, and whatever the clock says.
    edit(laws / "inner.py", "FACTOR * x", "FACTOR * x * x")
    os.utime(laws / "inner.py", (0, 0))
    assert ask(laws, **{place: str(folder)})[0].startswith("19.0 ")


def test_with_no_place_to_keep_kernels_one_warning_says_what_to_do(laws, tmp_path):
    (laws / "__pycache__").touch()
    (tmp_path / "file").touch()
    out, complaints = ask(laws, XDG_CACHE_HOME=str(tmp_path / "file" / "below"), HOME=str(tmp_path / "file"))
    assert out == "7.0 2.0 4 0 0"
    assert complaints.count("RuntimeWarning") == 1
    assert "set NUMBA_CACHE_DIR to a folder of yours" in complaints


def test_processes_that_compile_at_once_leave_kernels_that_all_can_use(laws):
    processes = [start(laws) for _ in range(3)]
    for process in processes:
        out, complaints = process.communicate()
        assert out.startswith("7.0 2.0 "), complaints
    assert ask(laws)[0] == "7.0 2.0 0 2 0"
    assert not list(laws.rglob("*.part"))


def test_a_kernel_that_was_cut_short_on_disk_is_compiled_anew(laws):
    ask(laws)
    for path in laws.rglob("*.nbc"):
        path.write_bytes(path.read_bytes()[:100])
    assert ask(laws)[0] == "7.0 2.0 4 0 0"


def test_shipped_kernels_are_found_on_any_processor_without_compiling(laws, tmp_path):
    made, shipped = tmp_path / "made", tmp_path / "shipped"
    assert ask(laws, NUMBA_CACHE_DIR=str(made), NUMBA_CPU_NAME="generic")[0] == "7.0 2.0 4 0 0"
    shipped.mkdir()
    for path in made.rglob("*.nbc"):
        path.rename(shipped / path.name)
    code = f"import pathlib, ltvpneu._kernel_cache as cache; cache.SHIPPED = pathlib.Path({str(shipped)!r})\n{ASK}"
    assert ask(laws, code, NUMBA_CACHE_DIR=str(tmp_path / "empty"))[0] == "7.0 2.0 0 0 2"
    # What does not fit is compiled.
    edit(laws / "inner.py", "FACTOR * x", "FACTOR * x * x")
    assert ask(laws, code, NUMBA_CACHE_DIR=str(tmp_path / "empty"))[0] == "19.0 2.0 2 0 1"
