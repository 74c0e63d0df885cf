"""`ltvpneu move`: what it prints, writes and answers."""

import csv
import json
from pathlib import Path

import pytest

import ltvpneu as lp
from ltvpneu.face.cli import main

TASK = ["move", "kunt_singh_1990", "--from", "20mm", "--to", "70mm", "--switches", "2"]


def test_a_move_is_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*TASK, "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "20 mm to 70 mm in the least time: 84.74 ms, 2 switches" in shown
    assert "optimal: no small change" in shown
    found = json.loads((tmp_path / "move.json").read_text(encoding="utf-8"))
    assert found["time"] == pytest.approx(0.084742, rel=1e-4)
    rows = list(csv.reader((tmp_path / "move.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[0] == ["time [s]", "position [m]", "velocity [m/s]", "pressure_1 [Pa]"]
    assert float(rows[-1][1]) == pytest.approx(0.07, abs=1e-6)
    assert (tmp_path / "move.png").stat().st_size > 10_000


def test_bounds_of_speed_impact_and_states(capsys: pytest.CaptureFixture[str]) -> None:
    bounds = ["--max", "speed=950mm/s", "--max", "impact_energy=200mJ", "--max", "pressure_1=4bar"]
    code = main([*TASK, "--switches", "3", "--no-hold", "--longest", "250ms", *bounds, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert (code, found["status"]) == (0, "optimal")
    assert "speed" in found["missed"]
    assert "impact energy" in found["missed"]
    assert "maximum pressure_1" in found["missed"]
    assert found["figures"]["speed"] <= 0.95 * (1 + 1e-5)


def test_a_stroke_from_stop_to_stop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = lp.load_machine("double_acting_5_2")
    task = ["move", "double_acting_5_2", "--from", "retracted", "--to", "extended", "--switches", "0"]
    main([*task, "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["start"][0] == machine.cylinder.lower_stop
    assert found["end"][0] == pytest.approx(machine.cylinder.upper_stop)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (["--to", "70"], "--to: position: found '70' without a unit"),
        (["--to", "200mm"], "no pressure between exhaust and supply holds"),
        (["--to", "extended"], "--to: found 'extended', but the cylinder has no stop there"),
        (["--max", "speed"], "--max: found 'speed', expected a name and a value"),
        (["--max", "sped=1m/s"], "--max: found 'sped'"),
        (["--max", "speed=1m/s", "--max", "speed=2m/s"], "--max: found 'speed' twice"),
        (["--max", "impact_energy=1"], "expected an energy"),
        (["--longest", "3 kg"], "--longest: found '3 kg', a mass"),
        (["--switches", "-1"], "switches: found -1"),
    ],
)
def test_bad_input_is_named(bad: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*TASK, *bad]) == 2
    assert said in capsys.readouterr().err
