"""Machine files: units, bundled machines, and what is said of a bad entry."""

import math
import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import ltvpneu as lp
from ltvpneu.face.machine_file import parse_machine
from ltvpneu.face.machine_text import bundled_machines
from ltvpneu.face.units import parse

GOOD = """
name = "rig"
supply_pressure = "4.1 bar"
exhaust_pressure = "1 bar"
[cylinder]
piston_area_1 = "5.9 cm^2"
piston_area_2 = "6.4 cm^2"
dead_volume_1 = "8.2 cm^3"
[load]
mass = "1.75 kg"
spring_stiffness = "2.1 kN/m"
[valve]
type = "on_off"
duty = "50 %"
[[flow_paths]]
source = "supply"
chamber = "chamber_1"
area = "6.4 mm^2"
opening = "on"
[[flow_paths]]
source = "exhaust"
chamber = "chamber_1"
area = "3.88 mm^2"
opens_at = "0 deg"
open_for = "1 turn"
"""


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("0.41 MPa", "pressure", 0.41e6),
        ("4.1bar", "pressure", 4.1e5),
        ("60 psi", "pressure", 413685.4),
        ("3 bar(g)", "pressure", 401325.0),
        ("3 bar (g)", "pressure", 401325.0),
        ("3 bar(a)", "pressure", 3e5),
        ("2 barg", "pressure", 301325.0),
        ("8.2 cm^3", "volume", 8.2e-6),
        ("8.2 cm³", "volume", 8.2e-6),
        ("8.2 cm**3", "volume", 8.2e-6),
        ("20 degC", "temperature", 293.15),
        ("20 °C", "temperature", 293.15),
        ("68 degF", "temperature", 293.15),
        ("43.7 N s/m", "damping", 43.7),
        ("43.7 N*s/m", "damping", 43.7),
        ("43.7 N-s/m", "damping", 43.7),
        ("2.1 kN / m", "stiffness", 2100.0),
        ("-30 deg", "angle", -math.pi / 6),
        ("287.05 J/(kg K)", "gas constant", 287.05),
        ("1e-5 m^2", "area", 1e-5),
        ("30 %", "number", 0.3),
        (1.4, "number", 1.4),
        (410000, "pressure", 410000.0),
    ],
)
def test_quantities_become_si(text, dimension, value):
    assert parse(text, dimension) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "dimension", "match"),
    [
        ("0.41 kg", "pressure", "found '0.41 kg', a mass, expected a pressure, such as '0.41 MPa'"),
        ("0.41", "pressure", "found '0.41' without a unit"),
        ("four bar", "pressure", "does not begin with a number"),
        ("4 Bar", "pressure", "unknown unit 'Bar'.*known: Pa"),
        ("3 mm(g)", "length", "only a pressure is gauge"),
        ("3 mm(a)", "length", "only a pressure is gauge"),
        (True, "number", "found True"),
        ([1], "mass", r"found \[1\]"),
    ],
)
def test_other_quantities_say_what_was_found_and_expected(text, dimension, match):
    with pytest.raises(ValueError, match=match):
        parse(text, dimension)


@given(st.floats(1e-3, 1e3))
def test_a_unit_scales_its_number(value):
    assert parse(f"{value!r} kPa", "pressure") == pytest.approx(1e3 * value, rel=1e-14)


def test_bundled_machines_load_and_differ_in_kind():
    assert set(bundled_machines()) >= {"double_acting_5_2", "kunt_singh_1990"}
    kinds = {name: lp.load_machine(name).states for name in bundled_machines()}
    assert kinds["kunt_singh_1990"] == ("position", "velocity", "pressure_1")
    assert kinds["double_acting_5_2"] == ("position", "velocity", "pressure_1", "pressure_2")


def test_the_bundled_machine_is_table_1():
    machine = lp.load_machine("kunt_singh_1990")
    assert machine.duty == 0.5
    area = {c.source: c.first.starts.max() for c in machine.connections}
    assert area["supply"] == pytest.approx(0.64e-5, rel=1e-12)
    assert area["exhaust"] == pytest.approx(0.4 * 0.97e-5, rel=1e-12)
    assert machine.load.stiction == 26.6
    assert machine.gas == lp.Gas()


def test_a_file_is_read_by_its_path(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(GOOD)
    machine = lp.load_machine(path)
    assert machine.duty == 0.5
    assert lp.load_machine(str(path)) == machine
    # The same machine as Table 1 without friction, damping and seal, so orbits exist too.
    assert lp.nonlinear_orbit(machine, 4.0).amplitude("position") > 0


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"8.2 cm^3"', '"-8.2 cm^3"', r"rig.toml: cylinder.dead_volume_1: found -8.2e-06 m\^3, expected a finite number above"),
        ('"8.2 cm^3"', '"nan cm^3"', r"rig.toml: cylinder.dead_volume_1: found nan"),
        ('"4.1 bar"', '"0.41 kg"', r"rig.toml: supply_pressure: found '0.41 kg', a mass, expected a pressure"),
        ('"4.1 bar"', '"0.5 bar"', r"rig.toml: supply_pressure: found 50000 Pa, below the exhaust pressure"),
        ("dead_volume_1", "dead_volum_1", r"rig.toml: cylinder.dead_volum_1: unknown key, did you mean 'dead_volume_1'\?"),
        ('mass = "1.75 kg"', "", r"rig.toml: load.mass: missing, expected a quantity: mass"),
        ('"50 %"', '"150 %"', r"rig.toml: valve.duty: found 1.5, expected on-time over period, 0 to 1"),
        ('"on_off"', '"spool"', r'rig.toml: valve.type: found \'spool\', expected "rotary", "on_off" or "proportional"'),
        ('"6.4 mm^2"', '"-6.4 mm^2"', r"rig.toml: flow_paths\[0\].area: found -6.4e-06 m\^2"),
        ('chamber = "chamber_1"', 'chamber = "chamber_2"', r"rig.toml: flow_paths: found a path to 'chamber_2'"),
        ('opening = "on"', 'opening = "onn"', r"rig.toml: flow_paths\[0\].opening: found 'onn'"),
        ('"1 turn"', '"2 turn"', r"rig.toml: flow_paths\[1\].open_for: found 12.5664 rad, expected 0 to 2 pi"),
        ('open_for = "1 turn"', "", r"rig.toml: flow_paths\[1\].open_for: missing"),
        ('opens_at = "0 deg"\nopen_for = "1 turn"', 'ramp = "3 deg"', r"flow_paths\[1\].ramp: found it without"),
        ('opens_at = "0 deg"', 'opens_at = "0 deg"\nopening = "on"', r"flow_paths\[1\].opening: found it beside"),
        ("[cylinder]", "[[cylinder]]", r"rig.toml: cylinder: found .* expected a table"),
        ('name = "rig"', "name = 3", r"rig.toml: name: found 3, expected a string"),
        ("[load]", "[load", r"rig.toml: not valid TOML"),
        ('piston_area_1 = "5.9 cm^2"', 'piston_area_1 = "inf cm^2"', "cylinder.piston_area_1: found inf"),
        ('dead_volume_1 = "8.2 cm^3"', "", "cylinder.dead_volume_1, dead_volume_2: found neither"),
        ('dead_volume_1 = "8.2 cm^3"', 'dead_volume_1 = "8.2 cm^3"\ndead_volume_2 = "9 cm^3"', "no path leads to chamber_2"),
    ],
)  # fmt: skip
def test_a_bad_entry_is_named_with_file_key_finding_and_expectation(old, new, match):
    assert old in GOOD
    with pytest.raises(lp.MachineFileError, match=match):
        parse_machine(GOOD.replace(old, new, 1), "rig.toml")


def test_a_missing_key_that_is_misspelt_is_found_by_its_neighbour():
    with pytest.raises(lp.MachineFileError, match=re.escape("rig.toml: load.maas: unknown key, did you mean 'mass'?")):
        parse_machine(GOOD.replace("mass =", "maas ="), "rig.toml")


def test_machines_that_do_not_exist_are_named(tmp_path):
    with pytest.raises(lp.MachineFileError, match="did you mean 'kunt_singh_1990'"):
        lp.load_machine("kunt_sing_1990")
    with pytest.raises(lp.MachineFileError, match="cannot be read"):
        lp.load_machine(tmp_path / "none.toml")


def test_rotary_ports_are_checked_by_name():
    table_1 = """
name = "rig"
supply_pressure = "4.1 bar"
exhaust_pressure = "1 bar"
collapse = "COLLAPSE"
[cylinder]
piston_area_1 = "5.9 cm^2"
piston_area_2 = "6.4 cm^2"
dead_volume_1 = "8.2 cm^3"
[load]
mass = "1.75 kg"
[valve]
type = "rotary"
[[valve.ports]]
way = "WAY"
area = "16 mm^2"
discharge_coefficient = 0.4
opens_at = "0 deg"
open_for = "180 deg"
[[valve.ports]]
way = "chamber_1"
area = "16 mm^2"
discharge_coefficient = 0.4
opens_at = "0 deg"
open_for = "180 deg"
[[valve.ports]]
way = "exhaust"
area = "16 mm^2"
discharge_coefficient = 0.4
opens_at = "START"
open_for = "180 deg"
"""

    def make(way: str = "supply", collapse: str = "minimum", start: str = "180 deg") -> lp.Machine:
        text = table_1.replace("WAY", way).replace("COLLAPSE", collapse).replace("START", start)
        return parse_machine(text, "rig.toml")

    assert len(make().connections) == 2
    with pytest.raises(lp.MachineFileError, match="valve.ports: found way 'suply', expected one of supply, exhaust"):
        make(way="suply")
    with pytest.raises(lp.MachineFileError, match="collapse: found 'max'"):
        make(collapse="max")
    assert make(collapse="in_series").collapse == "in_series"
    with pytest.raises(lp.MachineFileError, match="found 3 ways open to the inner volume 'valve' at once"):
        make(collapse="in_series", start="90 deg")


def test_what_a_user_turns_is_checked(table_1, double_acting):
    with pytest.raises(ValueError, match="duty: found -0.1"):
        table_1.with_duty(-0.1)
    with pytest.raises(ValueError, match="supply_pressure: found 50000 Pa, below the exhaust"):
        table_1.with_supply_pressure(0.5e5)
    with pytest.raises(ValueError, match="supply_pressure: found nan"):
        table_1.with_supply_pressure(math.nan)
    with pytest.raises(ValueError, match="found an on-off valve, expected a rotary valve"):
        double_acting.with_offset(0.1)
    assert table_1.with_duty(0.3).with_offset(0.0).duty == pytest.approx(0.5)
    assert not table_1.without_dry_friction().has_dry_friction


EXTENDED = """
name = "rig"
supply_pressure = "6 bar"
exhaust_pressure = "1 bar"
collapse = "dynamic"
{medium}
[cylinder]
piston_area_1 = "5 cm^2"
piston_area_2 = "5 cm^2"
dead_volume_1 = "20 cm^3"
{cylinder}
[load]
mass = "1 kg"
spring_stiffness = "2 kN/m"
[valve]
type = "rotary"
[[valve.inner_volumes]]
volume = "4 cm^3"
{inner}
[[valve.ports]]
way = "supply"
area = "10 mm^2"
discharge_coefficient = 0.8
opens_at = "0 deg"
open_for = "180 deg"
[[valve.ports]]
way = "chamber_1"
area = "10 mm^2"
discharge_coefficient = 0.8
opens_at = "0 deg"
open_for = "180 deg"
[[flow_paths]]
source = "exhaust"
chamber = "chamber_1"
area = "4 mm^2"
"""
WALL = 'heat_transfer_coefficient = "60 W/(m^2 K)"\nwall_area = "50 cm^2"\nwall_temperature = "25 degC"'


def test_a_file_holds_thermal_models_and_inner_volumes():
    text = EXTENDED.format(medium="", cylinder=f"[cylinder.energy_balance_1]\n{WALL}", inner="energy_balance = {}")
    machine = parse_machine(text, "rig.toml")
    assert machine.states == (
        "position", "velocity", "pressure_1", "pressure_valve", "temperature_1", "temperature_valve"
    )  # fmt: skip
    balance = machine.cylinder.energy_balance_1
    assert balance is not None
    assert balance.conductance == pytest.approx(0.3)
    assert balance.wall_temperature == pytest.approx(298.15)


def test_a_file_holds_other_media():
    real = '[gas]\nfluid = "Nitrogen"\npressure_range = ["0.5 bar", "12 bar"]'
    machine = parse_machine(EXTENDED.format(medium=real, cylinder="", inner=""), "rig.toml")
    assert isinstance(machine.gas, lp.RealGas)
    assert machine.gas.pressure_range == (0.5e5, 12e5)
    oil = '[liquid]\ndensity = "0.87 kg/l"\nbulk_modulus = "1.5 GPa"\nviscosity = "30 mPa s"'
    machine = parse_machine(EXTENDED.format(medium=oil, cylinder="", inner=""), "rig.toml")
    assert machine.gas == lp.Liquid(density=870.0, bulk_modulus=1.5e9, viscosity=0.03)


def test_a_file_holds_a_proportional_valve():
    text = EXTENDED.format(medium="", cylinder="", inner="")
    text = text[: text.index("[valve]")].replace('collapse = "dynamic"', "") + (
        '[valve]\ntype = "proportional"\ncommand = [["0 deg", -1], ["90 deg", 0.5]]\n'
        '[[flow_paths]]\nsource = "supply"\nchamber = "chamber_1"\narea = "4 mm^2"\nopening = "on"\n'
        '[[flow_paths]]\nsource = "exhaust"\nchamber = "chamber_1"\narea = "4 mm^2"\nopening = "off"\n'
    )
    machine = parse_machine(text, "rig.toml")
    assert isinstance(machine.valve, lp.ProportionalValve)
    assert machine.valve.command.openings == (-1.0, 0.5)
    with pytest.raises(lp.MachineFileError, match=r"rig.toml: valve.command\[1\]: found \['90 deg'\], expected two"):
        parse_machine(text.replace('["90 deg", 0.5]', '["90 deg"]'), "rig.toml")
    with pytest.raises(lp.MachineFileError, match=r"valve.command.openings\[0\]: found -2"):
        parse_machine(text.replace("-1]", "-2]"), "rig.toml")


@pytest.mark.parametrize(
    ("parts", "match"),
    [
        ({"medium": '[gas]\n[liquid]\ndensity = "860 kg/m^3"'}, "gas, liquid: found both tables"),
        ({"medium": '[gas]\nfluid = "Airr"'}, "rig.toml: gas.fluid: found 'Airr'.*nearest: Air"),
        ({"medium": '[gas]\nfluid = "Air"\npressure_range = ["1 bar"]'}, r"gas.pressure_range: found \['1 bar'\]"),
        (
            {"cylinder": '[cylinder.energy_balance_1]\nheat_transfer_coefficient = "60 W/(m^2 K)"'},
            "rig.toml: cylinder.energy_balance_1.wall_area, wall_temperature: found none",
        ),
        ({"inner": 'size = "1 cm^3"'}, r"valve.inner_volumes\[0\].size: unknown key"),
        ({"medium": '[liquid]\nbulk_modulus = "-1 GPa"'}, "rig.toml: liquid.bulk_modulus: found -1e.09 Pa"),
    ],
)
def test_bad_extensions_in_a_file_are_named(parts, match):
    with pytest.raises(lp.MachineFileError, match=match):
        parse_machine(EXTENDED.format(**{"medium": "", "cylinder": "", "inner": "", **parts}), "rig.toml")


# Damaged files
# -----------------------------------------------------------------------------------------------------------------

TABLE_1 = (Path(lp.__file__).parent / "machines" / "kunt_singh_1990.toml").read_text(encoding="utf-8")


def _with(key, value):
    return re.sub(rf"(?m)^({key}\s*=\s*).*$", lambda match: match[1] + value, TABLE_1, count=1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_with("mass", "9" * 300), "load.mass: found a whole number of about 300 digits, expected a mass"),
        (_with("mass", "9" * 5000), "found a number that cannot be read"),
        (_with("mass", "-1e300"), r"load.mass: found -1e\+300, expected a mass"),
        (_with("mass", '"1e300 kg"'), r"load.mass: found '1e300 kg', expected a mass"),
        (_with("mass", '"3,0 kg"'), r"load.mass: found '3,0 kg' with a decimal comma; write a point: '3.0 kg'"),
        (_with("mass", '"' + "k" * 100_000 + '"'), r"load.mass: found 'k{70,80} \.\.\., which does not begin"),
        (_with("name", '"a\\u001b[31m"'), r"name: found 'a\\x1b\[31m', expected text without control characters"),
        ("x = " + "[" * 500 + "]" * 500 + "\n" + TABLE_1, "nested hundreds deep"),
        ("x = " + "[" * 100_000 + "]" * 100_000 + "\n" + TABLE_1, "nested hundreds deep"),
        ("k" * 1000 + " = 1\n" + TABLE_1, r"bad.toml: 'k{70,80} \.\.\.: unknown key"),
        (TABLE_1 + "#" + "x" * 10_000_000, r"found 10.0 MB, expected a machine file, of 1 MB at most"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_one_clear_and_short_error(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(lp.MachineFileError, match=message) as caught:
        lp.load_machine(path)
    assert len(str(caught.value)) < 600
    assert "bad.toml" in str(caught.value)


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path):
    path = tmp_path / "marked.toml"
    path.write_text(TABLE_1, encoding="utf-8-sig")
    assert lp.load_machine(path) == lp.load_machine("kunt_singh_1990")


def test_what_is_no_regular_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(lp.MachineFileError, match=r"pipe.toml: cannot be read: found no regular file"):
        lp.load_machine(tmp_path / "pipe.toml")
    with pytest.raises(lp.MachineFileError, match=r"folder.toml: cannot be read: found a folder"):
        lp.load_machine(tmp_path / "folder.toml")


def test_a_bundled_name_means_the_bundled_machine_whatever_lies_in_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kunt_singh_1990").write_text("x = 1", encoding="utf-8")
    assert lp.load_machine("kunt_singh_1990").supply_pressure == 410000.0
