"""Files of results: whole or not at all, whatever happens while they are written."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from ltvpneu.face.cli import main
from ltvpneu.face.results import Results


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_what_is_written_is_listed_once_and_leaves_nothing_else(tmp_path):
    results = Results(tmp_path / "new" / "folder")
    results.data("numbers", {"a": 1.0})
    results.picture("picture", Figure())
    results.data("numbers", {"a": 2.0})
    assert names(results.folder) == ["numbers.json", "picture.png"]
    assert json.loads((results.folder / "numbers.json").read_text()) == {"a": 2.0}
    assert results.listed().splitlines() == ["written:", *(f"  {path}" for path in results.written)]
    assert [path.name for path in results.written] == ["numbers.json", "picture.png"]


def test_a_folder_in_the_way_is_named_with_what_was_finished(tmp_path):
    results = Results(tmp_path)
    results.data("first", {})
    (tmp_path / "second.png").mkdir()
    with pytest.raises(
        ValueError, match=r"second\.png: could not be written \(.*directory.*\); written before it: .*first"
    ):
        results.picture("second", Figure())
    assert names(tmp_path) == ["first.json", "second.png"]


@pytest.mark.parametrize("stop", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_full_disk_or_a_stop_leaves_the_file_of_before(tmp_path, stop):
    results = Results(tmp_path)
    results.text("table.csv", "old\n")

    class Cut(Figure):
        def savefig(self, path, **_options):
            Path(path).write_bytes(b"half a pic")
            raise stop

    (tmp_path / "picture.png").write_bytes(b"old")
    with pytest.raises(ValueError if isinstance(stop, OSError) else KeyboardInterrupt) as raised:
        results.picture("picture", Cut())
    if isinstance(stop, OSError):
        assert "picture.png: could not be written (No space left on device); written before it" in str(raised.value)
    assert (tmp_path / "picture.png").read_bytes() == b"old"
    assert names(tmp_path) == ["picture.png", "table.csv"]


def test_a_command_on_a_full_disk_ends_with_one_line(tmp_path, capsys, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    code = main(["simulate", "kunt_singh_1990", "--duration", "0.1", "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert code == 2
    assert said.count("\n") == 1
    assert "simulate.csv: could not be written (No space left on device)" in said


def test_a_file_in_place_of_the_folder(tmp_path, capsys):
    (tmp_path / "out").touch()
    assert main(["simulate", "kunt_singh_1990", "--duration", "0.1", "--out", str(tmp_path / "out")]) == 2
    assert "expected a folder that can be made" in capsys.readouterr().err


def test_what_was_finished_outlasts_a_kill_and_a_stop_is_one_line(tmp_path):
    """A study writes the numbers of its first part before the second, long one begins."""
    # What runs in the background of a shell ignores the signal unless it is told otherwise.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from ltvpneu.face.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "study", "--points", "2", "--frequency", "10", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 240
    while not (tmp_path / "amplitude.png").exists() and time.monotonic() < end and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert said.splitlines()[-1] == "ltvpneu study: stopped"
    assert "Traceback" not in said
    found = json.loads((tmp_path / "study.json").read_text())
    assert "design" not in found
    assert not [name for name in os.listdir(tmp_path) if name.endswith(".part")]
