"""Machine files in the words of data sheets and catalog pages."""

import math
from pathlib import Path

import pytest

import ltvpneu as lp
from ltvpneu.face.machine_file import parse_machine
from ltvpneu.models.machine.parameters import with_values

DRIVE = """
schema = 1
name = "Lift"
supply_pressure = "6 bar(g)"
exhaust_pressure = "0 bar(g)"

[cylinder]
bore = "32 mm"
rod = "12 mm"
stroke = "100 mm"
clearance = "10 %"
mounting = "up"

[load]
mass = "3 kg"
dry_friction = "20 N"
stiction = "35 N"

[valve]
type = "5/2"
sonic_conductance = "0.7 dm3/(s·bar)"
critical_pressure_ratio = 0.3
opening_delay = "12 ms"
closing_delay = "18 ms"
"""


def drive(*changes: tuple[str, str]) -> lp.Machine:
    text = DRIVE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return parse_machine(text, "lift.toml")


def test_catalog_page_becomes_areas_volumes_stops_and_weight() -> None:
    machine = drive()
    bore, rod, stroke = math.pi / 4 * 0.032**2, math.pi / 4 * 0.012**2, 0.1
    cylinder = machine.cylinder
    assert cylinder.piston_area_1 == pytest.approx(bore, rel=1e-12)
    assert cylinder.piston_area_2 == pytest.approx(bore - rod, rel=1e-12)
    assert (cylinder.lower_stop, cylinder.upper_stop) == (0.0, stroke)
    assert cylinder.dead_volume_1 == pytest.approx(0.1 * bore * stroke, rel=1e-12)
    # At position zero, where the rod is in, chamber 2 has its clearance and the whole stroke.
    assert cylinder.dead_volume_2 == pytest.approx(1.1 * (bore - rod) * stroke, rel=1e-12)
    assert cylinder.rod_areas == pytest.approx((0.0, rod), rel=1e-12)
    assert machine.load.constant_force == pytest.approx(-3 * 9.80665, rel=1e-12)
    assert machine.supply_pressure == 701325.0


def test_weight_follows_the_mass() -> None:
    machine = drive()
    assert machine.levels[2] == machine.load.constant_force
    heavier = with_values(machine, {"load.mass": 5.0})
    assert heavier.levels[2] == pytest.approx(-5 * 9.80665)


@pytest.mark.parametrize(
    ("word", "force"), [('"horizontal"', 0.0), ('"down"', 29.42), ('"30 deg"', -14.71), ('"-90 deg"', 29.42)]
)
def test_mounting_is_a_word_or_an_angle(word: str, force: float) -> None:
    assert drive(('"up"', word)).load.constant_force == pytest.approx(force, abs=5e-3)


def test_valve_with_five_ports_has_four_paths() -> None:
    found = [(path.source, path.chamber, path.opening) for path in drive().flow_paths]
    assert sorted(found) == [
        ("exhaust", "chamber_1", "off"),
        ("exhaust", "chamber_2", "on"),
        ("supply", "chamber_1", "on"),
        ("supply", "chamber_2", "off"),
    ]
    law = drive().flow_paths[0].law
    assert law is not None
    assert law.sonic_conductance == pytest.approx(0.7e-8)


OPEN_IN_THE_MIDDLE = {
    "5/3 closed": set[tuple[str, str]](),
    "5/3 exhausted": {("exhaust", "chamber_1"), ("exhaust", "chamber_2")},
    "5/3 pressurized": {("supply", "chamber_1"), ("supply", "chamber_2")},
}
OUT = {("supply", "chamber_1"), ("exhaust", "chamber_2")}
BACK = {("supply", "chamber_2"), ("exhaust", "chamber_1")}


def open_paths(machine: lp.Machine) -> set[tuple[str, str]]:
    return {(c.source, c.chamber) for c in machine.connections if c.first.at(0.1) > 0}


@pytest.mark.parametrize("kind", OPEN_IN_THE_MIDDLE)
def test_three_positions_are_those_of_two_coils(kind: str) -> None:
    for first, second, expected in ((1.0, 0.0, OUT), (0.0, 1.0, BACK), (0.0, 0.0, OPEN_IN_THE_MIDDLE[kind])):
        machine = drive(
            ('"5/2"', f'"{kind}"\nsecond = {{ duty = {second} }}\nduty = {first}'),
            ('opening_delay = "12 ms"\nclosing_delay = "18 ms"', ""),
        )
        assert open_paths(machine) == expected


def test_two_valves_do_as_one_with_five_ports_unless_told_otherwise() -> None:
    no_delays = ('opening_delay = "12 ms"\nclosing_delay = "18 ms"', "duty = 0.3")
    one, two = drive(no_delays), drive(('"5/2"', '"2 x 3/2"'), no_delays)
    assert len(two.more_valves) == 1
    orbits = [lp.nonlinear_orbit(machine, 10.0) for machine in (one, two)]
    assert orbits[1].mean("position") == pytest.approx(orbits[0].mean("position"), rel=1e-9)


def test_single_acting_cylinder_has_one_chamber_and_a_spring() -> None:
    machine = drive(
        ('clearance = "10 %"', 'clearance = "10 %"\nacting = "push"\nreturn_spring = ["30 N", "60 N"]'),
        ('"5/2"', '"3/2"'),
    )
    assert machine.cylinder.chambers == ("chamber_1",)
    assert machine.load.spring_preload == 30.0
    assert machine.load.spring_stiffness == pytest.approx(300.0)
    assert [(path.source, path.opening) for path in machine.flow_paths] == [("supply", "on"), ("exhaust", "off")]


def test_pulling_cylinder_is_fed_on_the_side_of_the_rod() -> None:
    machine = drive(('clearance = "10 %"', 'clearance = "10 %"\nacting = "pull"'), ('"5/2"', '"3/2"'))
    assert machine.cylinder.chambers == ("chamber_2",)
    assert {path.chamber for path in machine.flow_paths} == {"chamber_2"}


def test_rods_through_and_rods_missing() -> None:
    through = drive(('rod = "12 mm"', 'rod = "12 mm"\nthrough_rod = true')).cylinder
    assert through.piston_area_1 == through.piston_area_2
    assert through.ambient_push_area == 0.0
    rodless = drive(('rod = "12 mm"', "rodless = true")).cylinder
    assert rodless.piston_area_1 == rodless.piston_area_2 == pytest.approx(math.pi / 4 * 0.032**2)


def test_tubes_add_volume_and_resistance() -> None:
    tube = 'tube_1 = { length = "1 m", inner_diameter = "4 mm" }'
    machine, plain = drive(('clearance = "10 %"', f'clearance = "10 %"\n{tube}')), drive()
    volume = math.pi / 4 * 0.004**2
    assert machine.cylinder.dead_volume_1 == pytest.approx((plain.cylinder.dead_volume_1 or 0) + volume)
    assert machine.cylinder.dead_volume_2 == plain.cylinder.dead_volume_2
    for path in machine.flow_paths:
        assert (path.in_series is not None) == (path.chamber == "chamber_1")


def test_silencer_and_exhaust_have_their_own_numbers() -> None:
    machine = drive(
        (
            "[valve]",
            '[valve]\nsilencer = { sonic_conductance = "0.5 dm^3/(s bar)" }\nexhaust = { nominal_flow = "300 l/min" }',
        )
    )
    for path in machine.flow_paths:
        assert (path.in_series is not None) == (path.source == "exhaust")
        law = path.law
        assert law is not None
        if path.source == "exhaust":
            assert law.volume_flow(7e5, 6e5) * 6e4 == pytest.approx(300.0)


@pytest.mark.parametrize(
    ("text", "conductance"),
    [('nominal_flow = "178.03 l/min"', 0.7), ("Kv = 0.146427", 0.7), ("Cv = 0.169280", 0.7)],
)
def test_flow_may_be_given_as_a_makers_nominal_flow_or_as_that_of_water(text: str, conductance: float) -> None:
    machine = drive(('sonic_conductance = "0.7 dm3/(s·bar)"', text))
    law = machine.flow_paths[0].law
    assert law is not None
    assert law.sonic_conductance * 1e8 == pytest.approx(conductance, rel=1e-3)


def test_directional_valve_takes_an_area_too_and_a_liquid() -> None:
    area = drive(
        (
            'sonic_conductance = "0.7 dm3/(s·bar)"\ncritical_pressure_ratio = 0.3',
            'area = "4 mm2"\ndischarge_coefficient = 0.8',
        )
    )
    assert area.flow_paths[0].effective_area == pytest.approx(3.2e-6)
    water = drive(
        ('sonic_conductance = "0.7 dm3/(s·bar)"\ncritical_pressure_ratio = 0.3', "Kv = 0.2"),
        ("[load]", "[liquid]\n[load]"),
    )
    assert water.flow_paths[0].effective_area == pytest.approx(0.2 / 3600 / math.sqrt(200.0))


BAD = [
    ('sonic_conductance = "0.7 dm3/(s·bar)"', "sonic_conductance = 0.7", r"valve.sonic_conductance: found 0.7 m\^3"),
    ('"0.7 dm3/(s·bar)"', '"700 l/min"', "valve.sonic_conductance: found '700 l/min', a volume flow, expected"),
    ("ratio = 0.3", "ratio = 1.3", "valve.critical_pressure_ratio: found 1.3, expected b"),
    ('bore = "32 mm"', "bore = 32", "cylinder.bore: found 32 m, expected at most 1 m"),
    ('stroke = "100 mm"', "stroke = 100", "cylinder.stroke: found 100 m"),
    ('rod = "12 mm"', 'rod = "40 mm"', "cylinder.rod: found a diameter of 0.04 m, expected less than the bore"),
    ('stroke = "100 mm"', 'stroke = "100 mm"\nupper_stop = "50 mm"', "cylinder.upper_stop: found it beside bore"),
    ('bore = "32 mm"', 'bore = "32 mm"\npiston_area_1 = "8 cm^2"', "cylinder.piston_area_1: found it beside"),
    ('bore = "32 mm"', "", "cylinder.bore: missing"),
    ('clearance = "10 %"', "", "cylinder.clearance, dead_volume_1: found neither"),
    ('clearance = "10 %"', 'acting = "pushing"\nclearance = 0.1', "cylinder.acting: found 'pushing', did you mean 'push'"),
    ('"up"', '"upwards"', "cylinder.mounting: found 'upwards', expected one of"),
    ('"5/2"', '"5/4"', "valve.type: found '5/4', did you mean '5/2'"),
    ('"5/2"', '"5/2"\nsecond = { duty = 0.5 }', "valve.second: found it of a"),
    ('"0 bar(g)"', '"0 bar"', "exhaust_pressure: found 0 Pa, .*0 bar\\(g\\)"),
    ('"0 bar(g)"', '"7 bar(g)"', "supply_pressure: found 701325 Pa, below the exhaust pressure"),
    ('opening_delay = "12 ms"', "opening_delay = 12", "valve.opening_delay: found 12 s, expected at most 10 s"),
    ('opening_delay = "12 ms"', 'ramp = "5 deg"\nopening_time = "3 ms"', "valve.ramp: found it beside opening_time"),
    ("schema = 1", "schema = 2", "schema: found 2, expected 1"),
    ('clearance = "10 %"', 'clearance = 0.1\nreturn_spring = ["60 N", "30 N"]', "return_spring: found 60 N with the rod"),
    ('critical_pressure_ratio = 0.3', 'nominal_flow = "500 l/min"', "found sonic_conductance and nominal_flow of"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), BAD)
def test_likely_mistakes_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(lp.MachineFileError, match=said):
        drive((old, new))


def test_exchanged_frictions_are_warned_of() -> None:
    with pytest.warns(UserWarning, match="were the two exchanged"):
        drive(('stiction = "35 N"', 'stiction = "15 N"'))


def test_file_is_read_from_disk(tmp_path: Path) -> None:
    path = tmp_path / "lift.toml"
    path.write_text(DRIVE, encoding="utf-8")
    assert lp.load_machine(path) == drive()
