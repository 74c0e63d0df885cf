"""The commands of the bench: drive, simulate, new, machines, schema."""

import csv
import json
import tomllib
from importlib import resources
from pathlib import Path

import jsonschema
import pytest

import ltvpneu as lp
from ltvpneu.face.cli import main
from ltvpneu.face.machine_file import parse_machine
from ltvpneu.face.machine_keys import TABLES
from ltvpneu.face.machine_text import bundled_machines, bundled_valves, machine_text
from ltvpneu.face.schema import machine_schema

OPTIONS = [
    "new", "--bore", "32", "--rod", "12", "--stroke", "100", "--mass", "3", "--mounting", "up", "--valve", "5/2",
    "--C", "0.7", "--b", "0.3", "--delay", "12", "18", "--supply", "6 bar(g)",
]  # fmt: skip


@pytest.fixture
def drive_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(OPTIONS) == 0
    path = tmp_path / "drive.toml"
    path.write_text(capsys.readouterr().out, encoding="utf-8")
    return path


def test_new_prints_a_file_that_is_the_drive(drive_file: Path) -> None:
    machine = lp.load_machine(drive_file)
    assert machine.supply_pressure == 701325.0
    assert machine.cylinder.upper_stop == pytest.approx(0.1)
    assert machine.load.mounting > 1.5
    assert isinstance(machine.valve, lp.OnOffValve)
    assert (machine.valve.opening_delay, machine.valve.closing_delay) == pytest.approx((0.012, 0.018))


def test_new_alone_is_a_file_to_start_from(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("#:schema ")
    assert lp.stroke(parse_machine(text, "new.toml")).arrives
    # What is commented out can be put in: each line is TOML too.
    for line in text.splitlines():
        if line.startswith("# ") and " = " in line and "  # " in line:
            tomllib.loads(line[2:])


@pytest.mark.parametrize(
    ("more", "said"),
    [(["--b", "1.3"], "critical_pressure_ratio"), (["--mounting", "sideways"], "cylinder.mounting"),
     (["--valve", "7/2"], "valve.type"), (["--supply", "6 bra"], "supply_pressure")],
)  # fmt: skip
def test_new_names_a_wrong_word(more: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*OPTIONS, *more]) == 2
    assert said in capsys.readouterr().err


def test_drive_prints_one_screen_and_two_pictures(
    drive_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["drive", str(drive_file), "--frequency", "20", "--life", "5e7", "--out", str(tmp_path / "d")]) == 0
    shown = capsys.readouterr().out
    for words in ("132.9", "156.5", "chamber 1", "position 0 at the lower stop", "usable duty        0.240 to 0.640",
                  "no duty holds a mean position", "694 hours"):  # fmt: skip
        assert words in shown
    assert len(shown.splitlines()) < 60
    assert {path.name for path in (tmp_path / "d").iterdir()} == {"strokes.png", "duty.png"}


def test_drive_prints_json(drive_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", str(drive_file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["strokes"]["out"]["time"] == pytest.approx(0.13295, rel=1e-3)
    assert "switching" not in found


OIL = """
name = "Oil"
supply_pressure = "100 bar"
exhaust_pressure = "3 bar"
[liquid]
[cylinder]
bore = "32 mm"
rod = "18 mm"
stroke = "100 mm"
clearance = "20 %"
[load]
mass = "20 kg"
viscous_damping = "400 N s/m"
[valve]
type = "5/2"
Kv = 0.4
"""


def test_drive_of_a_liquid_weighs_what_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "oil.toml"
    path.write_text(OIL, encoding="utf-8")
    assert main(["drive", str(path), "--frequency", "10", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "drawn [kg]" in shown
    assert "Nl" not in shown
    # The swept volume of the bore, and what oil is compressed by besides.
    drawn = lp.stroke(lp.load_machine(path)).air_mass
    assert drawn == pytest.approx(860 * 8.04e-4 * 0.1, rel=0.03)


def test_tube_of_a_liquid_is_refused() -> None:
    text = OIL.replace("stroke =", 'tube_1 = { length = "1 m", inner_diameter = "8 mm" }\nstroke =')
    with pytest.raises(lp.MachineFileError, match="found a tube in a machine of a liquid"):
        parse_machine(text, "oil.toml")


def test_drive_names_what_it_cannot(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", "kunt_singh_1990"]) == 2
    assert "without both end stops" in capsys.readouterr().err


def test_simulate_writes_a_picture_and_numbers(
    drive_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "s"
    given = ["simulate", str(drive_file), "--duty", "1", "--duration", "0.5", "--from", "retracted"]
    assert main([*given, "--out", str(folder)]) == 0
    assert "position 0.1" in capsys.readouterr().out
    with (folder / "simulate.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "position [m]", "velocity [m/s]", "pressure_1 [Pa]", "pressure_2 [Pa]"]
    assert float(rows[1][1]) == 0.0
    arrived = next(float(row[0]) for row in rows[1:] if float(row[1]) >= 0.1)
    assert arrived == pytest.approx(0.133, abs=1e-3)
    assert (folder / "simulate.png").exists()
    assert main([*given, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["position"][-1] == pytest.approx(0.1)


@pytest.mark.parametrize("bad", [["--duration", "0"], ["--duration", "1", "--frequency", "-2"]])
def test_simulate_names_bad_times(bad: list[str], drive_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(drive_file), *bad]) == 2
    assert f"--{'duration' if len(bad) == 2 else 'frequency'}" in capsys.readouterr().err


def test_machines_lists_what_is_bundled(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["machines"]) == 0
    shown = capsys.readouterr().out
    for name in (*bundled_machines(), *bundled_valves()):
        assert name in shown
    assert main(["machines", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["valves"]) == set(bundled_valves())


@pytest.mark.parametrize("model", bundled_valves())
def test_bundled_valves_can_be_named(model: str) -> None:
    known = bundled_valves()[model]
    text = (
        'name = "x"\nsupply_pressure = "6 bar(g)"\nexhaust_pressure = "0 bar(g)"\n[load]\nmass = "1 kg"\n'
        '[cylinder]\nbore = "20 mm"\nstroke = "50 mm"\nclearance = 0.1\n'
    )
    if known["type"] in ("2/2 nc", "3/2"):
        text += 'acting = "push"\nreturn_spring = ["10 N", "20 N"]\n'
    machine = parse_machine(f'{text}[valve]\nmodel = "{model}"\n', "x.toml")
    law = machine.flow_paths[0].law
    assert law is not None
    assert law.critical_pressure_ratio == known["critical_pressure_ratio"]
    faster = parse_machine(f'{text}[valve]\nmodel = "{model}"\nsonic_conductance = "9 l/(s bar)"\n', "x.toml")
    assert faster.flow_paths[0].law == lp.ISO6358(sonic_conductance=9e-8)


def test_unknown_valve_is_named(drive_file: Path) -> None:
    text = drive_file.read_text(encoding="utf-8").replace('type = "5/2"', 'model = "SMC SY300"')
    with pytest.raises(lp.MachineFileError, match="valve.model: found 'SMC SY300', did you mean 'SMC SY3000'"):
        parse_machine(text, "drive.toml")


def test_schema_holds_for_every_bundled_file_and_refuses_a_typo(
    drive_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema == machine_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    for name in bundled_machines():
        jsonschema.validate(tomllib.loads(machine_text(name)[0]), schema)
    data = tomllib.loads(drive_file.read_text(encoding="utf-8"))
    jsonschema.validate(data, schema)
    data["cylinder"]["bor"] = data["cylinder"].pop("bore")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(data, schema)


def test_page_of_keys_is_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys"]) == 0
    page = capsys.readouterr().out
    # After a change of the keys: ltvpneu keys > ltvpneu/machines/KEYS.md
    assert page == (resources.files("ltvpneu") / "machines" / "KEYS.md").read_text(encoding="utf-8")
    for keys in TABLES.values():
        for name in keys:
            assert f"| {name} |" in page or f"| **{name}** |" in page


def test_valve_data_name_their_source() -> None:
    for name, valve in bundled_valves().items():
        assert valve["source"], name
    assert (resources.files("ltvpneu") / "valves.toml").is_file()


def test_size_finds_parts_and_writes_their_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task = ["size", "--stroke", "100", "--mass", "5", "--time", "0.2", "--supply", "6 bar(g)"]
    assert main([*task, "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "ISO 6432, 10 mm, rod 4 mm, with CKD M4GA1 (5/2); supply 7.013 bar(a) = 6 bar(g)" in shown
    assert "does it" in shown
    machine = lp.load_machine(tmp_path / "drive.toml")
    assert main([*task, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["found"]
    assert found["best"]["strokes"]["out"]["time"] == pytest.approx(lp.stroke(machine, "out").time, rel=1e-9)


def test_size_without_an_answer_shows_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    task = [
        "size",
        "--stroke",
        "100",
        "--mass",
        "1e6",
        "--time",
        "0.1",
        "0.2",
        "--supply",
        "701325",
        "--mounting",
        "up",
    ]
    assert main(task) == 1
    assert "no pair of the catalogue does it; the nearest" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (["--supply", "6"], "supply: found 6 Pa, expected more than the exhaust"),
        (["--supply", "6 m"], "--supply: found '6 m', a length"),
        (["--mounting", "sideways"], "--mounting: found 'sideways'"),
        (["--time", "1", "2", "3"], "--time: found 3 numbers"),
        (["--kind", "5/4"], "kinds: found '5/4'"),
    ],
)
def test_size_names_bad_input(bad: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    task = ["size", "--stroke", "100", "--mass", "5", "--time", "0.2", "--supply", "6 bar(g)"]
    assert main([*task, *bad]) == 2
    assert said in capsys.readouterr().err
