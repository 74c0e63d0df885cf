"""The air around the cylinder pushes on rods and on an open side, in every model."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import ltvpneu as lp
from tests.conftest import MACHINES
from tests.models.twin import Twin, rods


def vacuum_drive(**cylinder) -> lp.Machine:
    """A single-acting drive between ambient pressure and 60 kPa, against a spring."""
    given = {"piston_area_1": 5e-4, "piston_area_2": 5e-4, "dead_volume_1": 4e-5} | cylinder
    paths = [
        lp.FlowPath(source=s, chamber="chamber_1", area=4e-6, opening=o)
        for s, o in (("supply", "on"), ("exhaust", "off"))
    ]
    return lp.Machine(
        name="Vacuum",
        supply_pressure=101325.0,
        exhaust_pressure=60e3,
        cylinder=lp.Cylinder(**given),
        load=lp.Load(mass=0.5, spring_stiffness=2e3, viscous_damping=80.0),
        valve=lp.OnOffValve(duty=0.5),
        flow_paths=tuple(paths),
    )


def idle(machine: lp.Machine, pressure: float) -> lp.Machine:
    """The machine with nothing but one pressure all round, no spring and no friction."""
    free = replace(machine.load, spring_stiffness=0.0, dry_friction=0.0, stiction=0.0, force=0.0)
    return replace(machine, supply_pressure=pressure, exhaust_pressure=pressure, ambient_pressure=pressure, load=free)


@pytest.mark.parametrize("pressure", [101325.0, 0.5e5, 3e5])
def test_one_pressure_all_round_moves_no_piston(double_acting, pressure):
    orbit = lp.nonlinear_orbit(idle(double_acting, pressure), 8.0)
    # The forces cancel to rounding; pressures are integrated to 1e-7 of the supply's, some 1e-5 N on 2 kg.
    assert abs(orbit.mean("position")) < 1e-7
    assert orbit.amplitude("position") < 1e-7


@pytest.mark.parametrize("given", [{}, {"rod_area_1": 5e-5}, {"rod_area_2": 2e-4}])
def test_rods_make_both_sides_as_large_as_the_bore(double_acting, given):
    cylinder = replace(double_acting.cylinder, **given)
    first, second = cylinder.rod_areas
    assert_allclose(cylinder.piston_area_1 + first, cylinder.piston_area_2 + second, rtol=1e-14)
    assert_allclose((first, second), rods(cylinder), rtol=1e-12, atol=1e-20)
    orbit = lp.nonlinear_orbit(idle(replace(double_acting, cylinder=cylinder), 1e5), 8.0)
    assert abs(orbit.mean("position")) < 1e-7


def test_rods_follow_the_piston_areas_where_they_are_not_given(double_acting):
    narrower = replace(double_acting.cylinder, piston_area_2=5e-4)
    assert_allclose(narrower.rod_areas, (0.0, narrower.piston_area_1 - 5e-4), rtol=1e-14)


def test_rods_given_both_are_taken_as_they_are(table_1):
    assert table_1.cylinder.rod_areas == (0.0, 0.0)
    # The paper's open side alone, as in (7b).
    assert_allclose(table_1.cylinder.ambient_push_area, -(0.64e-3 - 0.32e-4), rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "mean"),
    [
        # From a separate simulator (own equations, events located), with -p_amb (A1 - A2) on the rod; printed to 1e-6 m.
        ("double_acting_5_2", 8.888e-3),
        ("hydraulic_4_2", 5.776e-3),
    ],
)
def test_bundled_drives_settle_where_the_rod_pushes_them(name, mean):
    assert_allclose(lp.nonlinear_orbit(lp.load_machine(name), 8.0).mean("position"), mean, atol=1e-6)


def test_the_papers_figures_do_not_move(table_1):
    # As before the surroundings were in the law: [mm] with friction at 1, 4 and 10 Hz.
    found = [1e3 * lp.nonlinear_orbit(table_1, f).amplitude("position") for f in (1.0, 4.0, 10.0)]
    assert_allclose(found, [39.32418, 35.28004, 10.94993], atol=1e-5)


def test_a_vacuum_drive_moves_towards_the_vacuum():
    # Slowly, so that it comes to rest on either side: (p - p_ambient) A / K, 41.325 kPa times 5 cm^2 over 2 kN/m.
    orbit = lp.nonlinear_orbit(vacuum_drive(), 0.5)
    assert_allclose(orbit.initial_state[0], -(101325 - 60e3) * 5e-4 / 2e3, rtol=2e-3)
    assert_allclose(orbit.at([0.999])[0], 0.0, atol=2e-5)
    assert orbit.maximum("position") < 5e-3


def test_a_single_acting_piston_feels_the_same_with_a_rod_on_its_open_side():
    # The air pushes on annulus and rod together: the bore, whichever is called the piston's area.
    plain, with_rod = vacuum_drive(), vacuum_drive(piston_area_2=4e-4)
    assert_allclose(
        lp.nonlinear_orbit(with_rod, 2.0).step_states, lp.nonlinear_orbit(plain, 2.0).step_states, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("name", ["double-acting", "end stops", "table 1"])
def test_the_surroundings_are_an_input_of_the_linear_models(name):
    machine = MACHINES[name]
    state = np.array(machine.rest_state)
    state[2:] = 2.3e5
    found = lp.linearize(machine, state)
    higher = lp.linearize(replace(machine, ambient_pressure=machine.ambient_pressure + 1e4), state)
    assert machine.inputs[3] == "ambient_pressure"
    push = machine.cylinder.ambient_push_area * 1e4 / machine.load.mass
    # The force is linear in the pressure: a tenth of a bar more is exact.
    assert_allclose((higher.f - found.f)[1], push, rtol=1e-9)
    assert_allclose(found.B[1, 3] * 1e4, push, rtol=1e-12)
    assert not found.r.any()


def test_superposition_holds_in_the_ambient_pressure(double_acting):
    model = lp.ltv_model(double_acting, 15.0)
    means = []
    for pressure in (0.9e5, 1.0e5, 1.1e5):
        levels = np.array([6e5, 1.013e5, 0.0, pressure])
        means.append(lp.steady_state(replace(model.system, levels=levels)).mean("position"))
    assert_allclose(means[2] - means[1], means[1] - means[0], rtol=1e-9)


def test_the_balance_closes_beside_the_surroundings(double_acting):
    found = lp.balance(double_acting, lp.nonlinear_orbit(double_acting, 8.0))
    assert found.mass_error < 1e-9
    assert found.energy_error < 1e-9


def test_a_rod_that_a_data_sheet_rounds_is_taken(double_acting):
    # 8.042 less 6.911 is 1.131 cm^2.
    cylinder = replace(double_acting.cylinder, piston_area_1=8.042e-4, piston_area_2=6.911e-4, rod_area_2=1.13e-4)
    assert cylinder.rod_areas == (0.0, 1.13e-4)


@pytest.mark.parametrize(
    ("cylinder", "message"),
    [
        ({"rod_area_1": -1e-5}, "rod_area_1: found -1e-05 m"),
        ({"rod_area_2": float("nan")}, "rod_area_2: found nan"),
        ({"piston_area_1": 6e-4, "rod_area_2": 2e-5}, "rod_area_2: found 2e-05 m.2, expected at least 0.0001 m.2"),
    ],
)
def test_impossible_rods_are_refused(cylinder, message):
    with pytest.raises(ValueError, match=message):
        vacuum_drive(**cylinder)


def test_a_negative_ambient_pressure_is_refused(table_1):
    with pytest.raises(ValueError, match="ambient_pressure: found -1 Pa"):
        replace(table_1, ambient_pressure=-1.0)


def test_a_twin_agrees_on_a_drive_between_surroundings_and_stops(double_acting):
    machine = replace(double_acting, ambient_pressure=0.7e5, load=replace(double_acting.load, force=40.0))
    orbit = lp.nonlinear_orbit(machine, 15.0)
    _, states, end = Twin(machine, rtol=1e-8).period(orbit.initial_state.copy(), 15.0)
    assert_allclose(end / machine.state_scales, orbit.initial_state / machine.state_scales, atol=2e-6)
    for i in (0, 2, 3):
        scale = machine.state_scales[i]
        assert_allclose([orbit.minimum(i), orbit.maximum(i)], [states[i].min(), states[i].max()], atol=2e-5 * scale)
