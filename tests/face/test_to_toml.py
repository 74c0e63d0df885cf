"""Every machine, saved as a file, reads back as its equal."""

import math
import tomllib
from collections import ChainMap
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

import ltvpneu as lp
from ltvpneu.face.cli import main
from ltvpneu.face.machine_file import parse_machine
from ltvpneu.face.schema import machine_schema
from tests.conftest import EXTENSIONS, MACHINES
from tests.face.test_drive_file import drive

BUNDLED = {name: lp.load_machine(name) for name in ("kunt_singh_1990", "double_acting_5_2", "hydraulic_4_2")}
TIMES = ('opening_delay = "12 ms"\nclosing_delay = "18 ms"', 'opening_delay = "1 ms"\nopening_time = "3 ms"')
MORE = {
    "lift": drive(),
    "travel times": drive(TIMES),
    "two coils": drive(('"5/2"', '"5/3 exhausted"\nsecond = { duty = 0.3, start = "180 deg" }')),
    "single-acting": drive(
        ('clearance = "10 %"', 'clearance = 0.1\nacting = "push"\nreturn_spring = ["30 N", "60 N"]'), ('"5/2"', '"3/2"')
    ),
    "pulses": BUNDLED["double_acting_5_2"].with_pulses([(0.0, 1.0), (2.0, 3.5)]),
    "rotary pulses": BUNDLED["kunt_singh_1990"].with_pulses([(0.0, 1.0), (2.0, 3.5)]),
    "tank": replace(
        drive(),
        rigid_volumes=(lp.InnerVolume(name="tank", volume=1e-3, polytropic_exponent=1.2),),
        flow_paths=(*drive().flow_paths, lp.FlowPath(source="supply", chamber="tank", area=1e-6)),
    ),
    "odd name": replace(drive(), name='A "lift" – 3 kg \\ °C'),
}
ALL = ChainMap(BUNDLED, MACHINES, EXTENSIONS, MORE)


@pytest.mark.parametrize("name", ALL)
def test_machine_reads_back_equal(name: str) -> None:
    text = ALL[name].to_toml()
    assert parse_machine(text, "saved.toml") == ALL[name]
    jsonschema.validate(tomllib.loads(text), machine_schema())


def test_tank_alone_reads_back_equal() -> None:
    tank = lp.Machine(
        name="leak", supply_pressure=7e5, exhaust_pressure=1e5, cylinder=lp.Cylinder.absent(), load=lp.Load.absent(),
        valve=lp.OnOffValve(duty=0.0), rigid_volumes=(lp.InnerVolume(name="tank", volume=1e-3),),
        flow_paths=(lp.FlowPath(source="exhaust", chamber="tank", law=lp.ISO6358(sonic_conductance=1e-11)),),
    )  # fmt: skip
    assert parse_machine(tank.to_toml(), "saved.toml") == tank


def test_proportional_machine_reads_back_equal(double_acting: lp.Machine) -> None:
    command = lp.Command(angles=(0.0, 2.0, 4.0), openings=(-0.8, 1.0, 0.3))
    machine = replace(double_acting, valve=lp.ProportionalValve(command=command))
    assert parse_machine(machine.to_toml(), "saved.toml") == machine


def test_window_of_its_own_reads_back_equal(double_acting: lp.Machine) -> None:
    window = lp.Window(start=0.3, width=1.2, ramp=0.1)
    bleed = lp.FlowPath(source="exhaust", chamber="chamber_1", area=1e-6, opening=window)
    machine = replace(double_acting, flow_paths=(*double_acting.flow_paths, bleed))
    assert parse_machine(machine.to_toml(), "saved.toml") == machine
    uneven = replace(bleed, opening=replace(window, closing_ramp=math.pi / 9))
    with pytest.raises(ValueError, match="a machine file has one"):
        replace(machine, flow_paths=(*double_acting.flow_paths, uneven)).to_toml()


def test_optimum_is_saved_as_a_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["optimize", "kunt_singh_1990", "--frequency", "15", "--mean", "position=45mm", "--out", str(tmp_path)]
    assert main(given) == 0
    assert "optimum.toml" in capsys.readouterr().out
    saved = lp.load_machine(tmp_path / "optimum.toml")
    assert lp.nonlinear_orbit(saved, 15.0).mean("position") == pytest.approx(0.045, abs=5e-4)
