"""Bounds that reach into a valve's ramps, and what comes back where no setting keeps all goals."""

import dataclasses
import math
from collections import ChainMap

import cvxpy as cp
import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.switching.duty_variables import least_shares
from ltvpneu.design.switching.nearest import ranges_of
from ltvpneu.design.switching.subproblem import Noted
from tests.conftest import EXTENSIONS, MACHINES, ramped

CATALOGUE = ChainMap(MACHINES, EXTENSIONS)


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_default_bounds_keep_the_pieces_of_the_turn(name):
    """At both ends of them the openings are those of the middle, moved; a little beyond they are not, with ramps."""
    machine = CATALOGUE[name]
    low, high = design.duty_problem(machine, 8.0).bounds["duty"]
    areas = machine.with_duty(0.5).openings.areas
    for duty in (low, high):
        np.testing.assert_allclose(machine.with_duty(duty).openings.areas, areas, atol=1e-9 * areas[areas < 1].max())
    assert (low > 0.02) == machine.openings.ramped.any()
    if low > 0.02:
        assert machine.with_duty(low - 3e-3).openings.areas.shape != areas.shape


@pytest.mark.parametrize("name", ["double-acting", "ramped"])
def test_a_ramped_machine_has_an_answer_with_its_default_bounds(name):
    """The mean that it has at a duty of 0.5, for the least air, and no faster than a tenth above that cycle."""
    machine = CATALOGUE[name]
    there = lp.nonlinear_orbit(machine.with_duty(0.5), 8.0)
    mean, fastest = there.mean("position"), there.maximum("velocity")
    found = design.optimize_duty(
        machine, 8.0, mean={"position": mean}, goals=design.Goals(maximum={"velocity": 1.1 * fastest}),
        minimize="air_use",
    )  # fmt: skip
    assert found.status == "optimal"
    # The fitted model is off by a percent or so of the stroke that the duty commands.
    assert found.values["duty"] == pytest.approx(0.5, abs=0.02)


def test_goals_out_of_reach_of_a_ramped_machine_are_said_to_be(double_acting):
    """A piston without a spring goes to and fro at its own speed: the mean can be had, a third of the speed cannot."""
    mean = lp.nonlinear_orbit(double_acting.with_duty(0.49), 5.0).mean("position")
    found = design.optimize_duty(
        double_acting, 5.0, mean={"position": mean}, goals=design.Goals(maximum={"velocity": 0.3}), minimize="air_use"
    )
    assert found.status == "infeasible"
    assert found.constraints["mean position"] < 1e-6
    assert "maximum velocity" in found.broken


def test_a_goal_that_can_be_met_is_met_beside_one_that_cannot(double_acting):
    """Over duty and frequency: of all settings that keep the mean, the slowest, and that is at the lowest frequency."""
    mean = lp.nonlinear_orbit(double_acting.with_duty(0.53), 1.0).mean("position")
    found = design.optimize_duty(
        double_acting, (1.0, 10.0), {"duty": (0.1, 0.9)}, mean={"position": mean},
        goals=design.Goals(maximum={"velocity": 0.3}), minimize="air_use",
    )  # fmt: skip
    assert found.status == "infeasible"
    assert found.constraints["mean position"] < 1e-6
    fastest = 0.3 + found.constraints["maximum velocity"]
    for frequency in (1.0, 4.0):
        other = design.optimize_duty(double_acting, frequency, {"duty": (0.3, 0.7)}, mean={"position": mean})
        at_best = np.max(other.model.orbit.maximum("velocity"))
        assert fastest <= 1.02 * at_best


def test_a_wanted_mean_comes_before_a_bound_that_could_be_met_elsewhere():
    """45 mm, and less ripple than there is about it: as little as the mean leaves, not a mean where it is quiet."""
    machine = lp.load_machine("kunt_singh_1990")
    problem = design.duty_problem(machine, 10.0, {"duty": (0.3, 0.8)})
    mean, ripple = problem.nominal.mean("position"), problem.nominal.amplitude("position")
    at_the_mean = problem.solve(cp.Minimize(ripple), {"mean": mean == 0.045}, n_starts=21)
    found = problem.solve(cp.Minimize(ripple), {"mean": mean == 0.045, "ripple": ripple <= 4e-3}, n_starts=21)
    # The bound by itself is kept at other duties.
    assert lp.nonlinear_orbit(machine.with_duty(0.8), 10.0).amplitude("position") < 4e-3
    assert (at_the_mean.status, found.status) == ("optimal", "infeasible")
    assert found.constraints["mean"] < 1e-6
    assert found.constraints["ripple"] == pytest.approx(at_the_mean.objective - 4e-3, rel=1e-3)


def test_bounds_that_reach_into_a_ramp_are_drawn_in_and_those_within_it_refused(double_acting):
    least = least_shares(double_acting)[0]
    problem = design.duty_problem(double_acting, 8.0, {"duty": (0.0, 1.0)})
    assert problem.bounds["duty"] == (least, 1 - least)
    with pytest.raises(ValueError, match="found bounds 0.01 to 0.04 of 'duty', at which the valve's ramps meet"):
        design.duty_problem(double_acting, 8.0, {"duty": (0.01, 0.04)})
    # Of least air the shortest pulse: the edge of what the ramps leave, and it is named.
    found = design.optimize_duty(
        ramped(lp.load_machine("kunt_singh_1990")), 8.0, {"duty": (0.0, 0.5)}, minimize="air_use"
    )
    assert found.status == "optimal"
    assert any(name.startswith("duty >= 0.11") for name in found.active)


def test_pulses_of_a_ramped_valve_keep_their_ramps_apart(double_acting):
    pulsed = double_acting.with_pulses([(0.5, 1.5), (3.0, 4.5)])
    problem = design.duty_problem(pulsed, 8.0, {"off_1": (0.6, 2.9)})
    shortest = 2 * math.pi * least_shares(double_acting)[0]
    low, high = 0.6, 2.9
    for width, allowed in ((shortest - 0.01, False), (shortest + 0.01, True)):
        problem.variables["off_1"].variables()[0].value = np.array([(0.5 + width - low) / (high - low)])
        assert bool(problem.limits["shortest pulse 1"].value()) == allowed
    # Edges that do not move are the machine's own business, ramps that meet included.
    narrow = double_acting.with_pulses([(0.5, 0.7), (3.0, 4.5)])
    assert "shortest pulse 1" not in design.duty_problem(narrow, 8.0, {"supply_pressure": (4e5, 6e5)}).limits


def test_a_ramp_that_grows_until_it_meets_the_other_stops_no_search(double_acting):
    """The ramp is the variable, so no bound of the duty can keep it off; its least is best, or an edge is said."""
    machine = double_acting.with_duty(0.3)
    problem = design.duty_problem(machine, 8.0, {"valve.ramp": (0.1, 1.5)})
    found = problem.solve(cp.Maximize(1e3 * problem.nominal.air_use()), n_starts=9)
    assert found.status in ("optimal", "edge", "stopped")
    assert found.nonlinear_objective == pytest.approx(found.objective, rel=0.05)


def test_ranges_are_those_of_the_sides_differences():
    noted = [
        Noted(np.array([share]), {"mean": np.array([share - 0.5]), "fixed": np.array([2.0])}, frozenset({"mean"}), 0.0)
        for share in (0.0, 0.25, 1.0)
    ]
    # What does not change is measured by its size.
    assert ranges_of(noted) == {"mean": 1.0, "fixed": 2.0}
    assert ranges_of([]) == {}


def test_goals_that_the_nonlinear_machine_breaks_are_named():
    machine = lp.load_machine("kunt_singh_1990")
    found = design.optimize_duty(machine, 12.0, {"duty": (0.3, 0.6)}, mean={"position": 0.045})
    assert found.status == "optimal"
    # A hundredth of 45 mm, on either side.
    assert found.tolerances["mean position"] == pytest.approx(0.45e-3, rel=0.05)
    assert found.broken == ()
    for missed in (1e-3, math.nan):
        worse = dataclasses.replace(found, nonlinear_constraints={"mean position": missed})
        assert worse.broken == ("mean position",)
        assert "the machine breaks mean position" in repr(worse)
