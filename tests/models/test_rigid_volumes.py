"""Tanks without a piston: filled and emptied by a switching valve, and leaking."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp
from ltvpneu.face.machine_file import parse_machine

SUPPLY, EXHAUST, VOLUME, CONDUCTANCE = 6e5, 1e5, 1e-4, 0.5e-8
HEAT = 287.05 * 293.15
TANK = """
name = "Tank"
supply_pressure = "6 bar"
exhaust_pressure = "1 bar"
ambient_pressure = "1 bar"

[[volumes]]
name = "tank"
volume = "0.1 l"

[valve]
type = "3/2"
sonic_conductance = "0.5 dm^3/(s bar)"
critical_pressure_ratio = 0.3
duty = 0.5
"""


@pytest.fixture(scope="module")
def tank() -> lp.Machine:
    return parse_machine(TANK, "tank.toml")


def flow(up: float, down: float) -> float:
    if up < down:
        return -flow(down, up)
    r, b, B = down / up, 0.3, 0.999
    share = 1.0 if r <= b else math.sqrt(1 - ((min(r, B) - b) / (1 - b)) ** 2)
    return CONDUCTANCE * 1.185 * up * (share if r <= B else share * (1 - r) / (1 - B))


@pytest.mark.parametrize("frequency", [5.0, 25.0, 50.0])
@pytest.mark.parametrize("duty", [0.25, 0.5, 0.75])
def test_pressure_of_a_tank_under_pwm_is_that_of_another_integration(
    tank: lp.Machine, frequency: float, duty: float
) -> None:
    orbit = lp.nonlinear_orbit(tank.with_duty(duty), frequency)
    period, pressure, parts = 1 / frequency, orbit.initial_state[2], []
    for begin, end, source in ((0.0, duty * period, SUPPLY), (duty * period, period, EXHAUST)):
        found = solve_ivp(
            lambda _t, p, source=source: [HEAT / VOLUME * flow(source, p[0])], (begin, end), [pressure],
            rtol=1e-9, atol=1e-3, dense_output=True,
        )  # fmt: skip
        times = np.linspace(begin, end, 2001)
        parts.append((times, found.sol(times)[0]))
        pressure = found.y[0, -1]
    assert pressure == pytest.approx(orbit.initial_state[2], rel=1e-4)
    mean = sum(float(np.trapezoid(values, times)) for times, values in parts) * frequency
    assert orbit.mean("pressure_tank") == pytest.approx(mean, rel=5e-4)
    assert orbit.maximum("pressure_tank") == pytest.approx(max(values.max() for _, values in parts), rel=5e-4)
    assert orbit.minimum("pressure_tank") == pytest.approx(min(values.min() for _, values in parts), rel=5e-4)


def test_choked_leak_decays_as_its_closed_form() -> None:
    law = lp.ISO6358(sonic_conductance=1e-11, critical_pressure_ratio=0.2)
    machine = lp.Machine(
        name="leak", supply_pressure=7e5, exhaust_pressure=1e5, cylinder=lp.Cylinder.absent(), load=lp.Load.absent(),
        valve=lp.OnOffValve(duty=0.0), rigid_volumes=(lp.InnerVolume(name="tank", volume=1e-3),),
        flow_paths=(lp.FlowPath(source="exhaust", chamber="tank", law=law),),
    )  # fmt: skip
    found = lp.simulate(machine, 0.05, 1, [0.0, 0.0, 7e5], method=lp.DormandPrince(rtol=1e-12))
    times, pressures = np.asarray(found.time), np.asarray(found.states)[2]
    rate = 1e-11 * 1.185 * HEAT / 1e-3
    assert pressures == pytest.approx(7e5 * np.exp(-rate * times), rel=1e-9)


def test_all_models_take_a_tank(tank: lp.Machine) -> None:
    assert tank.states == ("position", "velocity", "pressure_tank")
    orbit = lp.nonlinear_orbit(tank, 25.0)
    assert orbit.rest == ""
    found = lp.orbit_floquet(tank, orbit)
    # The tank's own multiplier is all there is: nothing moves a piston that is none.
    assert found.is_stable
    assert np.count_nonzero(np.abs(found.multipliers) > 1e-9) == 1
    fitted = lp.ltv_model(tank, 25.0, n_steps=32, operating_points="fitted")
    assert fitted.orbit.mean("pressure_tank") == pytest.approx(orbit.mean("pressure_tank"), rel=1e-5)
    assert lp.ltv_model(tank, 25.0).orbit.mean("pressure_tank") == pytest.approx(orbit.mean("pressure_tank"), rel=1e-2)
    assert lp.balance(tank, orbit).mass_error < 1e-9


def test_tank_beside_a_cylinder(double_acting: lp.Machine) -> None:
    reservoir = lp.InnerVolume(name="reservoir", volume=2e-4)
    link = lp.FlowPath(source="reservoir", chamber="chamber_1", area=2e-6)
    machine = replace(double_acting, rigid_volumes=(reservoir,), flow_paths=(*double_acting.flow_paths, link))
    assert machine.states[-1] == "pressure_reservoir"
    orbit = lp.nonlinear_orbit(machine, 10.0)
    assert lp.balance(machine, orbit).mass_error < 1e-9
    # It takes up some of the chamber's pressure.
    assert orbit.amplitude("pressure_1") < lp.nonlinear_orbit(double_acting, 10.0).amplitude("pressure_1")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "tank"', 'name = "chamber_1"', r"rigid_volumes\[0\]: found the name 'chamber_1'"),
        ('name = "tank"', 'name = "my tank"', "expected a word of its own"),
        ('volume = "0.1 l"', 'volume = "0 l"', r"volumes\[0\].volume: found 0 m\^3"),
        ('[[volumes]]\nname = "tank"\nvolume = "0.1 l"', "", "cylinder: missing, expected a table"),
        ('type = "3/2"', 'type = "5/2"', "which feeds two chambers"),
        ('type = "3/2"', 'type = "3/2"\nchamber = "tonk"', "valve.chamber: found 'tonk', expected one of tank"),
    ],
)
def test_bad_tanks_are_named(old: str, new: str, said: str) -> None:
    assert old in TANK
    with pytest.raises(lp.MachineFileError, match=said):
        parse_machine(TANK.replace(old, new), "tank.toml")


def test_tank_has_no_stroke(tank: lp.Machine) -> None:
    with pytest.raises(ValueError, match="without a cylinder"):
        lp.stroke(tank)
