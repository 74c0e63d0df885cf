"""What a machine settles on from different starts, and which positions no duty holds."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.errors import NotSettledError
from ltvpneu.models.nonlinear.attractors import default_starts, stroke_of
from tests.models.twin import Twin

MACHINES = Path(__file__).parents[2] / "reference" / "machines"


@pytest.fixture(scope="module")
def free_cylinder() -> lp.Machine:
    return lp.load_machine(MACHINES / "free_cylinder.toml")


def without_surroundings(machine: lp.Machine) -> lp.Machine:
    """As cases were simulated elsewhere, without air on the rod: the open side at exhaust pressure."""
    cylinder = replace(machine.cylinder, rod_area_1=0.0, rod_area_2=0.0)
    return replace(machine, cylinder=cylinder, ambient_pressure=machine.exhaust_pressure)


@pytest.mark.parametrize(
    ("duty", "means"),
    [
        # A separate simulator, own equations re-stepped at events, without the rod's force [mm].
        (0.40, (-49.24, 47.77)),
        (0.45, (-46.40, 49.98)),
        (0.50, (-46.03, 50.00)),
    ],
)
def test_a_free_cylinder_goes_to_either_stop(free_cylinder, duty, means):
    found = lp.attractors(without_surroundings(free_cylinder).with_duty(duty), 20.0)
    assert not found.is_single
    assert_allclose(sorted(1e3 * orbit.mean("position") for orbit in found.orbits), means, atol=0.02)
    assert_allclose(found.shares.sum(), 1.0)
    assert all(np.abs(multipliers).max() < 1 for multipliers in found.multipliers)
    assert "% to" in repr(found)


def test_every_start_leads_where_the_machine_goes(free_cylinder):
    found = lp.attractors(free_cylinder, 20.0)
    for start, number in list(zip(found.starts, found.reached, strict=True))[::5]:
        again = lp.nonlinear_orbit(free_cylinder, 20.0, start)
        assert_allclose(again.mean(0), found.orbits[number].mean(0), atol=1e-6)


def test_both_attractors_are_the_twins(free_cylinder):
    found = lp.attractors(free_cylinder, 20.0)
    assert len(found.orbits) == 2
    for orbit in found.orbits:
        state = orbit.initial_state.copy()
        for _ in range(3 * orbit.n_periods):
            state = Twin(free_cylinder, rtol=1e-8).period(state, 20.0)[2]
        scales = free_cylinder.state_scales
        assert_allclose(state / scales, orbit.initial_state / scales, atol=1e-5)


def test_the_starts_are_those_that_are_stated(free_cylinder, table_1):
    starts = default_starts(free_cylinder, 12, np.random.default_rng(0))
    assert starts.shape == (1 + 2 * 4 + 12, 4)
    assert_allclose(starts[0], free_cylinder.rest_state)
    assert set(starts[1:9, 0]) == {-0.05, 0.05}
    assert {tuple(pressures) for pressures in starts[1:5, 2:]} == {
        (a, b) for a in free_cylinder.levels[:2] for b in free_cylinder.levels[:2]
    }
    # Spread evenly: one start in each twelfth of the stroke, and of each pressure's range.
    shares = (starts[9:, 0] + 0.05) / 0.1
    assert sorted(int(12 * share) for share in shares) == list(range(12))
    assert_allclose(starts, default_starts(free_cylinder, 12, np.random.default_rng(0)))
    low, high = stroke_of(table_1)
    assert -0.0139 < low < 0 < 0.1 < high < 0.13


def test_given_starts_are_followed_and_checked(free_cylinder):
    low = np.array([-0.05, 0.0, free_cylinder.exhaust_pressure, free_cylinder.supply_pressure])
    found = lp.attractors(without_surroundings(free_cylinder), 20.0, [low])
    assert found.is_single
    assert found.reached.tolist() == [0]
    # The separate simulator, from there: two periods.
    assert found.orbits[0].n_periods == 2
    assert_allclose(found.orbits[0].mean(0), -46.03e-3, atol=2e-5)
    with pytest.raises(ValueError, match=r"starts\[1\]: found position 0.06 m, expected it between the end stops"):
        lp.attractors(free_cylinder, 20.0, [low, [0.06, 0.0, 1e5, 1e5]])
    with pytest.raises(ValueError, match="starts: found none, expected one state or more"):
        lp.attractors(free_cylinder, 20.0, np.empty((0, 4)))
    with pytest.raises(ValueError, match=r"starts: found shape \(2,\)"):
        lp.attractors(free_cylinder, 20.0, [1.0, 2.0])
    with pytest.raises(ValueError, match="frequency: found -1 Hz"):
        lp.attractors(free_cylinder, -1.0)


def test_a_band_is_one_attractor_wherever_the_piston_rests(table_1):
    found = lp.attractors(table_1.with_duty(0.7), 20.0)
    assert found.is_single
    assert not found.orbits[0].is_isolated
    assert_allclose(found.floquet[0].spectral_radius, 1.0)


def test_a_band_beside_an_orbit_makes_two_attractors():
    machine = without_surroundings(lp.load_machine(MACHINES / "false_period_two.toml"))
    found = lp.attractors(machine, 0.5930484420074003)
    assert sorted(orbit.is_isolated for orbit in found.orbits) == [False, True]
    moving = next(orbit for orbit in found.orbits if orbit.is_isolated)
    # A separate simulator: 5.426 mm, one period.
    assert moving.n_periods == 1
    assert_allclose(moving.amplitude("position"), 5.426e-3, atol=1e-6)


def test_an_orbit_at_the_edge_of_a_band_belongs_to_the_band():
    machine = lp.load_machine(MACHINES / "edge_of_band.toml")
    for present in (machine, without_surroundings(machine)):
        orbit = lp.nonlinear_orbit(present, 36.12281831685486)
        assert not orbit.is_isolated
        found = lp.orbit_floquet(present, orbit)
        assert found.verdict == "marginal"
        # Beside it, to the inside, the piston rests.
        beside = orbit.initial_state + np.array([54e-6, 0.0, 0.0])
        assert lp.nonlinear_orbit(present, 36.12281831685486, beside).amplitude("position") == 0.0


def test_chaos_is_no_orbit_of_many_periods(table_1):
    # It comes within the tolerance of a state 62 periods before by chance, and does not once more.
    machine, seen = table_1.with_duty(0.8078947368421052), 0
    for start in default_starts(machine, 6, np.random.default_rng(0)):
        try:
            orbit = lp.nonlinear_orbit(machine, 11.0, start, max_periods=1000)
        except NotSettledError:
            seen += 1
            continue
        assert lp.orbit_floquet(machine, orbit).spectral_radius < 1
    assert seen > 0


def test_a_map_says_where_the_start_decides(free_cylinder):
    found = lp.orbit_map(free_cylinder, [0.2, 0.45, 0.8], [20.0])
    assert found.kinds == (("unique", "depends on the start", "unique"),)
    assert found.depends_on_start.tolist() == [[False, True, False]]
    assert [len(branches) for branches in found.branches[0]] == [1, 2, 1]
    assert found.branches[0][0][0].rest == "rests on the lower stop, -50 mm"
    assert_allclose(sum(branch.share for branch in found.branches[0][1]), 1.0)
    low, high = found.unheld(20.0)
    assert -0.05 < low < -0.04
    assert 0.045 < high <= 0.0501
    assert "no duty holds a mean position between -4" in found.remark()
    assert "Feedback holds it" in found.remark(20.0)


def test_a_coarse_map_claims_nothing_that_a_finer_one_refutes(free_cylinder):
    # At 1 Hz the piston goes all the way, and its mean follows the duty between two that are far apart.
    coarse = design.duty_map(free_cylinder, [0.3, 0.5], [1.0])
    assert coarse.orbits.remark() == ""
    duty = coarse.duty_for(-0.0066, 1.0)
    assert_allclose(lp.nonlinear_orbit(free_cylinder.with_duty(duty), 1.0).mean(0), -0.0066, atol=1e-3)
    assert lp.orbit_map(free_cylinder, [0.45], [20.0]).remark() == ""
    low, high = lp.orbit_map(free_cylinder, [0.05, 0.275, 0.5, 0.725, 0.95], [5.0]).unheld(5.0)
    for held in (lp.nonlinear_orbit(free_cylinder.with_duty(d), 5.0).mean(0) for d in (0.3, 0.4, 0.45, 0.475)):
        assert not low < held < high


def test_starts_that_creep_for_ten_thousand_periods_come_to_rest_in_the_band():
    found = lp.attractors(lp.load_machine(MACHINES / "edge_of_band.toml"), 36.12281831685486, max_periods=2500)
    assert found.is_single
    assert found.n_unsettled == 0
    assert not found.failures


def test_starts_lie_within_the_stops_also_of_a_piston_pressed_far_beyond():
    machine = lp.load_machine(MACHINES / "spring_return.toml")
    one = replace(
        machine, cylinder=replace(machine.cylinder, upper_stop=math.inf), load=replace(machine.load, force=-200.0)
    )
    assert lp.attractors(one, 10.0).orbits[0].rest == "rests on the lower stop, 0 mm"


def test_an_excursion_past_a_stop_between_the_places_looked_at_ends_on_the_stop(free_cylinder):
    cylinder = replace(
        free_cylinder.cylinder, dead_volume_1=6e-4, dead_volume_2=5.4e-4, lower_stop=-8e-4, upper_stop=8e-4
    )
    load = replace(free_cylinder.load, stiction=5.0, dry_friction=5.0)
    short = replace(free_cylinder, cylinder=cylinder, load=load).with_duty(0.45)
    orbit = lp.nonlinear_orbit(short, 20.0, [0.0, 0.0, 101300.0, 701325.0])
    # To the rounding of the root.
    assert orbit.maximum(0) <= 8e-4 * (1 + 1e-10)
    # From every start, the corners of the pressures among them, and told apart by the stroke, not the dead length.
    assert lp.attractors(short, 20.0).is_single


def test_a_map_of_a_sprung_drive_holds_every_position(table_1, double_acting):
    for machine in (table_1, double_acting):
        found = lp.orbit_map(machine, np.linspace(0.2, 0.8, 5), [15.0])
        assert found.count("depends on the start") == 0
        assert found.unheld(15.0) is None
        assert found.remark() == ""


def test_a_mean_that_no_duty_holds_is_refused_with_the_remedy(free_cylinder):
    duties = design.duty_map(free_cylinder, np.linspace(0.2, 0.8, 7), [20.0])
    with pytest.raises(ValueError, match=r"mean: found 10 mm\. At 20 Hz no duty holds .* Feedback holds it: measure"):
        duties.duty_for(0.01, 20.0)


def test_a_stability_map_says_where_the_start_decides(free_cylinder):
    found = design.stability_map(free_cylinder, [0.2, 0.45], [20.0], operating_points="fitted")
    assert found.depends_on_start.tolist() == [[False, True]]


def test_a_failed_point_carries_every_coordinate(table_1):
    machine = replace(table_1, load=replace(table_1.load, spring_stiffness=0.0))
    found = lp.orbit_map(machine, [0.3, 0.6], [4.0, 9.0])
    assert {(f.frequency, f.duty) for f in found.failures} == {(f, d) for f in (4.0, 9.0) for d in (0.3, 0.6)}
    assert found.failures[0].where == "4 Hz, duty 0.3"
    linear = lp.validity_map(machine, [0.3], [4.0], operating_points="lti")
    assert (linear.failures[0].frequency, linear.failures[0].duty) == (4.0, 0.3)
    response = lp.amplitude_response(machine.with_duty(0.4), [5.0])
    assert all(math.isclose(f.duty, 0.4) for f in response.failures)


def test_a_drifting_piston_between_far_stops_is_told_how_it_drifts(double_acting):
    load = replace(double_acting.load, spring_stiffness=0.0, dry_friction=0.0, stiction=0.0)
    machine = replace(double_acting, load=load, supply_pressure=1.0001 * double_acting.exhaust_pressure)
    with pytest.raises(NotSettledError, match=r"its position moved by \+.*Raise max_periods until it reaches"):
        lp.nonlinear_orbit(machine, 8.0, max_periods=200)
