"""Strokes of a drive by its data sheet against other integrations of its equations, and their air."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp
from ltvpneu.models.nonlinear.stroke import Direction
from ltvpneu.physics.iso6358 import ANR_DENSITY

SUPPLY, AMBIENT, STROKE = 701325.0, 101325.0, 0.1
TUBE = math.pi / 4 * 0.004**2


def lift(exhaust: float = 0.7e-8, tubes: float = 0.0, **changes: object) -> lp.Machine:
    """The drive of a bench: bore 32, rod 12, stroke 100 mm, 3 kg upwards, 6 bar gauge, C = 0.7 dm^3/(s bar)."""
    cylinder = lp.catalog_cylinder(bore=0.032, rod=0.012, stroke=STROKE, clearance=0.1)
    assert cylinder.dead_volume_1 is not None
    assert cylinder.dead_volume_2 is not None
    cylinder = replace(
        cylinder, dead_volume_1=cylinder.dead_volume_1 + tubes, dead_volume_2=cylinder.dead_volume_2 + tubes
    )
    law, out = (lp.ISO6358(sonic_conductance=c, critical_pressure_ratio=0.3) for c in (0.7e-8, exhaust))
    machine = lp.Machine(
        name="lift",
        supply_pressure=SUPPLY,
        exhaust_pressure=AMBIENT,
        cylinder=cylinder,
        load=lp.Load(mass=3.0, dry_friction=20.0, stiction=35.0, mounting=math.pi / 2),
        valve=lp.OnOffValve(duty=0.5, opening_delay=0.012, closing_delay=0.018),
        flow_paths=lp.directional_paths("5/2", law, exhaust=out),
    )
    return replace(machine, **changes)


def by_hand(out: bool) -> tuple[float, float]:
    """Return stroke time and end speed from scipy's integrator on the equations written out once more."""
    face, rod = math.pi / 4 * 0.032**2, math.pi / 4 * 0.012**2
    heat = 287.05 * 293.15

    def flow(up: float, down: float) -> float:
        if up < down:
            return -flow(down, up)
        r, b, B = down / up, 0.3, 0.999
        share = 1.0 if r <= b else math.sqrt(1 - ((min(r, B) - b) / (1 - b)) ** 2)
        return 0.7e-8 * 1.185 * up * (share if r <= B else share * (1 - r) / (1 - B))

    def push(y: np.ndarray) -> float:
        return face * y[2] - (face - rod) * y[3] - rod * AMBIENT - 3 * 9.80665

    sources = (SUPPLY, AMBIENT) if out else (AMBIENT, SUPPLY)

    def rate(_t: float, y: np.ndarray, moving: bool) -> list[float]:
        x, v = y[0], (y[1] if moving else 0.0)
        friction = 20.0 * (1 if out else -1)
        one = 0.1 * face * STROKE + face * x
        two = 0.1 * (face - rod) * STROKE + (face - rod) * (STROKE - x)
        return [
            v,
            (push(y) - friction) / 3 if moving else 0.0,
            (heat * flow(sources[0], y[2]) - y[2] * face * v) / one,
            (heat * flow(sources[1], y[3]) + y[3] * (face - rod) * v) / two,
        ]

    def breaks(_t: float, y: np.ndarray, _moving: bool) -> float:
        return (push(y) if out else -push(y)) - 35.0

    def arrives(_t: float, y: np.ndarray, _moving: bool) -> float:
        return (STROKE - y[0]) if out else y[0]

    for event in (breaks, arrives):
        event.terminal = True  # pyright: ignore[reportFunctionMemberAccess]
    arrives.direction = -1  # pyright: ignore[reportFunctionMemberAccess]
    start = [0.0, 0.0, AMBIENT, SUPPLY] if out else [STROKE, 0.0, SUPPLY, AMBIENT]
    how = {"method": "LSODA", "rtol": 1e-10, "atol": [1e-12, 1e-10, 1e-4, 1e-4], "max_step": 1e-3}
    rest = solve_ivp(rate, (0, 1), start, args=(False,), events=breaks, **how)  # pyright: ignore[reportArgumentType]
    way = solve_ivp(rate, (rest.t[-1], 2), rest.y[:, -1], args=(True,), events=arrives, **how)  # pyright: ignore
    return float(way.t[-1]), abs(float(way.y[1, -1]))


@pytest.mark.parametrize(("direction", "time", "speed"), [("out", 0.1329, 1.005), ("in", 0.1565, 0.884)])
def test_stroke_is_that_of_other_solvers(direction: Direction, time: float, speed: float) -> None:
    found = lp.stroke(lift(), direction)
    assert found.time == pytest.approx(time, rel=5e-3)
    assert found.end_velocity == pytest.approx(speed, rel=5e-3)
    hand_time, hand_speed = by_hand(direction == "out")
    assert found.time == pytest.approx(hand_time, rel=1e-5)
    assert found.end_velocity == pytest.approx(hand_speed, rel=1e-5)
    assert found.impact_energy == pytest.approx(1.5 * hand_speed**2, rel=1e-5)


def test_tubes_and_a_silencer_slow_it_down() -> None:
    """With a composite conductance of 0.7 and 0.5, (1/C^2 = sum 1/C_i^2), 199.2 and 246.7 ms were found elsewhere."""
    composite = (0.7e-8**-2 + 0.5e-8**-2) ** -0.5
    machine = lift(composite, TUBE)
    assert lp.stroke(machine, "out").time == pytest.approx(0.1992, rel=2e-3)
    assert lp.stroke(machine, "in").time == pytest.approx(0.2467, rel=2e-3)
    # Two restrictions that pass the same flow, each by its own law, let through a little more.
    silencer = lp.ISO6358(sonic_conductance=0.5e-8)
    paths = tuple(replace(p, in_series=silencer if p.source == "exhaust" else None) for p in lift().flow_paths)
    assert lp.stroke(replace(lift(tubes=TUBE), flow_paths=paths), "out").time == pytest.approx(0.1924, rel=2e-3)


def test_delay_stands_beside_the_time() -> None:
    plain = lift(valve=lp.OnOffValve())
    for direction, delay in (("out", 0.012), ("in", 0.018)):
        found = lp.stroke(lift(), direction)  # pyright: ignore[reportArgumentType]
        assert found.delay == delay
        assert found.time == pytest.approx(lp.stroke(plain, direction).time, rel=1e-12)  # pyright: ignore


def test_air_is_what_the_chambers_take_up() -> None:
    machine = lift()
    out, back = lp.stroke(machine, "out"), lp.stroke(machine, "in")
    face, side = machine.cylinder.piston_area_1, machine.cylinder.piston_area_2
    heat = 287.05 * 293.15
    # From a clearance at exhaust pressure to the whole chamber at supply pressure.
    assert out.air_mass == pytest.approx(face * STROKE * (1.1 * SUPPLY - 0.1 * AMBIENT) / heat, rel=1e-6)
    assert back.air_mass == pytest.approx(side * STROKE * (1.1 * SUPPLY - 0.1 * AMBIENT) / heat, rel=1e-6)


def test_work_is_kinetic_energy_friction_and_lift() -> None:
    out = lp.stroke(lift(), "out")
    spent = out.impact_energy + 20.0 * STROKE + 3 * 9.80665 * STROKE
    assert out.work == pytest.approx(spent, rel=1e-6)


def test_spring_returns_a_single_acting_piston() -> None:
    cylinder = lp.catalog_cylinder(bore=0.025, rod=0.01, stroke=0.05, clearance=0.1, acting="push")
    law = lp.ISO6358(sonic_conductance=0.5e-8)
    machine = lp.Machine(
        name="clamp", supply_pressure=7e5, exhaust_pressure=AMBIENT, cylinder=cylinder,
        load=lp.Load(mass=1.0, spring_stiffness=600.0, spring_preload=20.0, dry_friction=4.0, stiction=6.0),
        valve=lp.OnOffValve(), flow_paths=lp.directional_paths("3/2", law),
    )  # fmt: skip
    out, back = lp.stroke(machine, "out"), lp.stroke(machine, "in")
    assert out.arrives
    assert back.arrives
    assert back.air_mass == pytest.approx(0.0, abs=1e-12)
    assert out.start_position == 0.0


def test_drive_too_weak_says_so() -> None:
    weak = replace(lift(), load=replace(lift().load, mass=60.0))
    found = lp.stroke(weak, "out")
    assert not found.arrives
    assert "does not overcome load and stiction" in found.remark
    assert math.isinf(found.first_motion)
    stuck = replace(lift(), load=replace(lift().load, spring_stiffness=8000.0))
    assert "comes to rest at" in lp.stroke(stuck, "out").remark


def test_two_coils_are_on_one_at_a_time() -> None:
    law = lp.ISO6358(sonic_conductance=0.7e-8)
    off = lp.OnOffValve(duty=0.0)
    machine = lift(flow_paths=lp.directional_paths("5/3 closed", law), valve=off, more_valves=(off,))
    assert lp.stroke(machine, "out").time == pytest.approx(lp.stroke(lift(), "out").time, rel=1e-9)
    assert lp.stroke(machine, "in").time == pytest.approx(lp.stroke(lift(), "in").time, rel=1e-9)


def test_later_of_two_coils_counts() -> None:
    law = lp.ISO6358(sonic_conductance=0.7e-8)
    one, two = lp.OnOffValve(opening_delay=0.01, closing_delay=0.002), lp.OnOffValve(opening_delay=0.02)
    machine = lift(flow_paths=lp.directional_paths("5/3 closed", law), valve=one, more_valves=(two,))
    assert lp.stroke(machine, "out").delay == 0.01
    assert lp.stroke(machine, "in").delay == 0.02


def test_stroke_needs_stops_and_a_valve_that_switches(table_1: lp.Machine) -> None:
    with pytest.raises(ValueError, match="without both end stops"):
        lp.stroke(table_1)
    with pytest.raises(ValueError, match='expected "out" or "in"'):
        lp.stroke(lift(), "up")  # pyright: ignore[reportArgumentType]


def test_response_begins_at_rest_on_the_stop() -> None:
    found = lp.stroke(lift(), "in")
    first = np.asarray(found.response.states)[:, 0]
    assert first == pytest.approx([STROKE, 0.0, SUPPLY, AMBIENT], rel=1e-6)


# The data sheet -------------------------------------------------------------------------------------------------------


def test_balance_at_mid_stroke() -> None:
    """With tubes and the composite silencer the valve has to be open for 0.457 of the period at 20 Hz."""
    machine = lift((0.7e-8**-2 + 0.5e-8**-2) ** -0.5, TUBE)
    assert lp.balance_duty(replace(machine, valve=lp.OnOffValve()), 20.0) == pytest.approx(0.457, abs=3e-3)
    # The command is shorter: the valve closes later than it opens.
    assert lp.balance_duty(machine, 20.0) == pytest.approx(0.457 - 0.12, abs=3e-3)


def test_balance_needs_a_place(table_1: lp.Machine) -> None:
    with pytest.raises(ValueError, match="without both end stops"):
        lp.balance_duty(table_1, 10.0)
    assert 0.3 < lp.balance_duty(table_1, 15.0, 0.045) < 0.6


@pytest.fixture(scope="module")
def sheet() -> lp.DataSheet:
    return lp.data_sheet(lift(), 20.0, life=5e7)


def test_no_duty_holds_a_springless_piston_in_the_middle(sheet: lp.DataSheet) -> None:
    assert sheet.switching is not None
    gap = sheet.switching.unheld
    assert gap is not None
    assert gap[0] < 0.05 < gap[1]
    assert any("no duty holds a mean position" in remark and "Feedback holds it" in remark for remark in sheet.remarks)


def test_figures_at_a_frequency(sheet: lp.DataSheet) -> None:
    found = sheet.switching
    assert found is not None
    assert found.duty_band == pytest.approx((0.24, 0.64))
    assert found.switches_per_hour == 72000.0
    assert found.shortest_life == pytest.approx(5e7 / 72000)
    assert found.balance_open_share == pytest.approx(found.balance_duty + 0.12)


def test_air_of_a_double_stroke(sheet: lp.DataSheet) -> None:
    assert sheet.air is not None
    one, two = sheet.strokes["out"], sheet.strokes["in"]
    assert sheet.air.volume == pytest.approx((one.air_mass + two.air_mass) / ANR_DENSITY)
    assert sheet.air.double_stroke_time == pytest.approx(one.time + two.time + 0.030)
    assert sheet.air.exergy == pytest.approx(sheet.air.mass * 287.05 * 293.15 * math.log(SUPPLY / AMBIENT))
    assert 0 < sheet.air.efficiency < 1


def air_of_a_double_stroke(bore: float, rod: float, stroke: float, supply: float, ambient: float) -> float:
    """Air of both strokes without clearance [m^3 at ambient pressure and the cylinder's temperature]."""
    cylinder = lp.catalog_cylinder(bore=bore, rod=rod, stroke=stroke, clearance=1e-5)
    machine = lp.Machine(
        name="printed", supply_pressure=supply, exhaust_pressure=ambient, ambient_pressure=ambient, cylinder=cylinder,
        load=lp.Load(mass=2.0), valve=lp.OnOffValve(),
        flow_paths=lp.directional_paths("5/2", lp.ISO6358(sonic_conductance=3e-8)),
    )  # fmt: skip
    air = lp.data_sheet(machine).air
    assert air is not None
    return air.mass * 287.05 * 293.15 / ambient


def test_air_of_printed_examples() -> None:
    # Pneumax, general catalog, appendix A, "Cylinder air consumption": 63 mm, rod 20 mm, stroke 50 mm, 6 bar over an
    # atmosphere of 1 bar: 2.072 Nl a cycle, with pi taken as 3.14.
    found = air_of_a_double_stroke(0.063, 0.020, 0.050, 7e5, 1e5)
    assert f"{found * 1e3 * 3.14 / math.pi:.2f}" == "2.07"
    # Mead Fluid Dynamics, FAQ on cylinders: bore 2 in, stroke 4 in, 80 psi over 14.7 psi, 30 cycles a minute, the rod
    # left out: 2.81 cubic feet of free air a minute.
    inch, psi = 0.0254, 6894.757293168
    found = air_of_a_double_stroke(2 * inch, 0.0, 4 * inch, 94.7 * psi, 14.7 * psi)
    assert f"{30 * found / (12 * inch) ** 3:.2f}" == "2.81"
    # A nomogram of air consumption of cylinders: 100 mm, stroke 180 mm, 8 bar: 25.4 litres, 24.6 with a rod of 25 mm.
    # Read off a scale, so no better than a hundredth or two.
    for rod, printed in ((0.0, 25.4), (0.025, 24.6)):
        found = air_of_a_double_stroke(0.1, rod, 0.18, 9.013e5, 1.013e5)
        assert found * 1e3 == pytest.approx(printed, rel=0.015)


def test_json_is_complete_and_finite(sheet: lp.DataSheet) -> None:
    data = json.loads(sheet.to_json())
    assert data["strokes"]["out"]["time"] == pytest.approx(0.1329, rel=5e-3)
    assert set(data) == {"machine", "strokes", "remarks", "air", "switching"}
    assert len(data["switching"]["duties"]) == len(data["switching"]["mean_positions"])


def test_delays_that_fill_the_period_are_said() -> None:
    found = lp.data_sheet(lift(), 40.0)
    assert any("take up the whole period" in remark for remark in found.remarks)
