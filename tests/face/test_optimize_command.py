"""`ltvpneu optimize`: its tables, files and exit codes; the design part of `ltvpneu study`."""

import json

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.face import study_design
from ltvpneu.face.cli import _parser as parser_of
from ltvpneu.face.cli import main
from ltvpneu.face.request import Request, parse_request


def test_an_optimum_is_printed_and_written(tmp_path, capsys):
    goals = ["--mean", "position=45mm", "--max", "amplitude=5mm", "--minimize", "air_use"]
    assert main(["optimize", "--frequency", "16 Hz", *goals, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "optimal: every goal is kept" in printed
    data = json.loads((tmp_path / "optimum.json").read_text())
    orbit = lp.nonlinear_orbit(lp.load_machine("kunt_singh_1990").with_duty(data["corrected"]["values"]["duty"]), 16.0)
    assert orbit.mean("position") == pytest.approx(0.045, abs=1e-5)
    assert data["corrected"]["nonlinear"]["nominal"]["mean_position"] == pytest.approx(0.045, abs=1e-5)
    assert data["nonlinear"]["nominal"]["amplitude"] < 5e-3
    assert data["residual"] < 1e-6
    assert (tmp_path / "optimum.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_reached_exits_1_with_the_nearest(capsys):
    assert main(["optimize", "--frequency", "12", "--mean", "position=150mm", "--free", "duty=0.2..0.6"]) == 1
    printed = capsys.readouterr().out
    assert "this one comes nearest" in printed
    assert "duty <= 0.6" in printed


def test_scenarios_delays_and_pulses_are_taken(capsys):
    valve = ["--shortest-on", "5", "--opening-delay", "3", "--closing-delay", "2"]
    mean = ["--mean", "position=40mm..55mm", "--minimize", "air_use", "--free", "duty=0.3..0.6"]
    assert main(["optimize", "--frequency", "12", *mean, *valve, "--scenario", "supply_pressure=-5%"]) == 0
    printed = capsys.readouterr().out
    assert "supply_pressure -5%" in printed
    assert next(line for line in printed.splitlines() if "command on" in line).split()[2:] == ["-3.000", "ms"] * 2


def test_a_wanted_cycle_is_followed(tmp_path, capsys):
    cycle = tmp_path / "cycle.csv"
    cycle.write_text("degrees,mm\n0,45\n90,50\n180,45\n270,40\n")
    status = main(["optimize", "--frequency", "2", "--pulses", "12", "--follow", str(cycle), "--out", str(tmp_path)])
    assert status in (0, 1)
    told = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("wanted cycle"))
    assert float(told.split()[4]) < 1.0
    assert len(json.loads((tmp_path / "optimum.json").read_text())["commands"]) == 12


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        ("0,45\n90\n", "expected rows of two numbers"),
        ("0,45,1\n90,50,1\n180,45,1\n", "found 3 columns"),
        ("0,45\n90,50\n80,45\n", "degrees rising"),
        ("0,45\n90,50\n", "three or more rows"),
    ],
)
def test_bad_files_of_a_cycle(rows, match, tmp_path, capsys):
    cycle = tmp_path / "cycle.csv"
    cycle.write_text(rows)
    assert main(["optimize", "--frequency", "2", "--pulses", "8", "--follow", str(cycle)]) == 2
    assert match in capsys.readouterr().err


def test_choices_are_listed_best_first(tmp_path, capsys):
    goals = ["--mean", "position=45mm", "--choose", "frequency=10,14", "--choose", "load.mass=1kg,2kg"]
    assert main(["optimize", "--frequency", "10", *goals, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    rows = printed[printed.index("Choices, best first") :].splitlines()[5:9]
    assert all("keeps all goals" in row for row in rows)
    data = json.loads((tmp_path / "optimum.json").read_text())
    assert data["choice"] == data["choices"][0]["choice"]
    objectives = [one["objective"] for one in data["choices"]]
    assert objectives == sorted(objectives)


def test_ranges_and_named_goals_are_told(tmp_path, capsys):
    goals = ["--mean", "position=40mm..55mm", "--range", "supply_pressure=+-3%", "--max", "speed=1m/s"]
    life = ["--min", "life=100h", "--life", "50e6", "--max", "impact_energy=2J", "--min", "speed=1mm/s"]
    assert main(["optimize", "--frequency", "10..30", *goals, *life, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "over the ranges: 34 of 34 machines looked at keep all goals" in printed
    ranges = json.loads((tmp_path / "optimum.json").read_text())["ranges"]
    assert ranges["n_kept"] == ranges["n_points"] == 34
    assert set(ranges["missed_by_at_most"]) >= {"speed out", "speed in", "impact_energy out", "least mean position"}


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["--mean", "positon=45mm"], "did you mean 'position'"),
        (["--mean", "position"], "expected NAME=VALUE"),
        (["--mean", "position=45kg"], "a mass, expected a length"),
        (
            ["--mean", "position=45"],
            "--mean: position: found '45' without a unit, expected \"80 mm\" or the like: m, cm",
        ),
        (["--mean", "pressure_1=3..4"], "pressure_1: found '3' without a unit"),
        (["--mean", "position=50mm..40mm"], "contradict each other"),
        (["--max", "noise=3"], "expected one of amplitude, air_use"),
        (["--free", "duty=0.1"], "its least and greatest value"),
        (["--free", "duti=0.1..0.9"], "did you mean 'duty'"),
        (["--scenario", "supply_pressure=10"], "expected a change such as -10%"),
        (["--minimize", "airuse"], "did you mean 'air_use'"),
        (["--pulses", "0"], "--pulses: found 0"),
        (["--follow", "no.csv"], "expected a sine as 45mm+-10mm, or a file (No such file"),
        (["--follow", "45+-10"], "found '45' without a unit"),
        (["--choose", "bores=25"], "did you mean 'bore'"),
        (["--choose", "bore=25"], "found '25' without a unit"),
        (["--choose", "pulses=two"], "choices['pulses']: found 'two'"),
        (["--range", "load.mass=2kg"], "expected a part such as +-10%"),
        (["--range", "load.mass=+-x%"], "ranges['load.mass']: found '+-x%'"),
        (["--min", "life=1000h"], "expected --life too"),
        (["--max", "impact_energy=3N"], "expected a number"),
        (["--shortest-on", "100", "--shortest-off", "100"], "more than a period"),
    ],
)
def test_bad_goals_exit_2(arguments, match, capsys):
    assert main(["optimize", "--frequency", "8", *arguments]) == 2
    captured = capsys.readouterr()
    assert match in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("frequency", ["0", "-3", "nan", "8..x", "12..6"])
def test_bad_frequencies_exit_2(frequency, capsys):
    assert main(["optimize", f"--frequency={frequency}", "--mean", "position=45mm"]) == 2
    assert "frequency" in capsys.readouterr().err


def test_the_study_s_design_part(table_1, monkeypatch):
    monkeypatch.setattr(study_design, "DUTIES", np.array([0.3, 0.45, 0.6]))
    monkeypatch.setattr(study_design, "MAP_DUTIES", np.array([0.3, 0.5]))
    monkeypatch.setattr(study_design, "N_FREQUENCIES", 3)
    done: list[int] = []
    found = study_design.run_design(table_1, [8.0, 12.0], done.append)
    assert sum(done) == study_design.n_design_parts([8.0, 12.0])
    printed, data = study_design.design_text(found), study_design.design_data(found)
    orbit = lp.nonlinear_orbit(table_1.with_duty(0.45), 12.0)
    assert f"{1e3 * orbit.mean('position'):.2f} / {1e3 * orbit.amplitude('position'):.2f}" in printed
    assert data["duty_map"]["means"][1][1] == pytest.approx(orbit.mean("position"), rel=1e-12)
    assert data["example"]["amplitude"] == pytest.approx(orbit.amplitude("position") / 2, rel=1e-12)
    corrected = data["optimum"]["corrected"]["nonlinear"]["nominal"]
    assert corrected["amplitude"] <= data["example"]["amplitude"] * (1 + 1e-6)
    assert corrected["mean_position"] == pytest.approx(data["example"]["mean"], abs=1e-6)
    assert np.array(data["stability_map"]["decay_rates"]).shape == (3, 2)
    assert "One Lyapunov function serves" in printed
    json.dumps(data, allow_nan=False)


def test_where_nothing_moves_the_study_says_so(table_1, monkeypatch):
    monkeypatch.setattr(study_design, "DUTIES", np.array([0.85, 0.9]))
    monkeypatch.setattr(study_design, "MAP_DUTIES", np.array([0.9]))
    monkeypatch.setattr(study_design, "N_FREQUENCIES", 1)
    found = study_design.run_design(table_1, [20.0], lambda n: None)
    assert found.optimum is None
    printed = study_design.design_text(found)
    assert "the piston moves at no duty" in printed
    assert "In brackets: stiction holds" in printed


def bounded(machine: str, text: str) -> Request:
    options = parser_of().parse_args(["optimize", machine, "--frequency", "12", "--max", text])
    return parse_request(lp.load_machine(machine), options)


@pytest.mark.parametrize(
    ("text", "kg_per_s"),
    [
        ("2 g/s", 2e-3),
        ("7.2kg/h", 2e-3),
        ("120 Nl/min", 0.002 * 1.185),
        ("0.12 m^3/min", 0.002 * 1.185),
        ("0.002kg/s", 2e-3),
    ],
)
def test_air_is_bounded_in_any_unit(text, kg_per_s):
    assert bounded("kunt_singh_1990", f"air_use={text}").named["air_use"] == pytest.approx(kg_per_s, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("2", 'air_use: found \'2\' without a unit, expected "2 g/s" or "100 Nl/min"'),
        ("2mm", "air_use: found '2mm', a length, expected a mass flow"),
    ],
)
def test_air_without_its_unit(text, says):
    with pytest.raises(ValueError, match=says):
        bounded("kunt_singh_1990", f"air_use={text}")


def test_a_liquid_has_no_normal_litres():
    with pytest.raises(ValueError, match="expected a mass flow"):
        bounded("hydraulic_4_2", "air_use=2 Nl/min")
