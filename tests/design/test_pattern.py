"""Patterns against brute force, orbits computed anew and the nonlinear machine."""

import itertools

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.pattern_problem import turned_first
from ltvpneu.design.slots import first_points, pattern_system, two_positions
from ltvpneu.models.linearize import linearize_steps


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


def by_brute_force(machine, frequency, n_slots, measure, allowed):
    """Best of all patterns on the model of the first operating points, orbits by `steady_state`."""
    areas = two_positions(machine)
    point = first_points(machine, frequency)
    linearization = linearize_steps(machine, point, areas, "paper")
    best = np.inf
    for slots in itertools.product((False, True), repeat=n_slots):
        pattern = np.array(slots)
        if not np.array_equal(pattern, turned_first(pattern)):
            continue
        orbit = lp.steady_state(pattern_system(machine, linearization, pattern, frequency))
        if allowed(orbit, pattern):
            best = min(best, measure(orbit, pattern))
    return best


def swing(orbit, pattern):
    return np.ptp(orbit.step_states[:, 0]) / 2


def n_pulses(pattern):
    return int(np.sum(pattern & ~np.roll(pattern, 1)))


@pytest.mark.parametrize(
    ("goals", "measure", "allowed"),
    [
        ({"mean": {"position": (0.04, 0.05)}}, swing, lambda o, p: 0.04 <= o.mean("position") <= 0.05),
        (
            {"mean": {"position": (0.03, 0.06)}, "minimize": "switching", "amplitude": {"position": 0.04}},
            lambda o, p: n_pulses(p),
            lambda o, p: 0.03 <= o.mean("position") <= 0.06 and swing(o, p) <= 0.04,
        ),
        (
            {"mean": {"position": (0.04, 0.05)}, "n_pulses": 2},
            swing,
            lambda o, p: 0.04 <= o.mean("position") <= 0.05 and n_pulses(p) <= 2,
        ),
    ],
)
def test_ten_slots_equal_brute_force(machine, goals, measure, allowed):
    found = design.optimize_pattern(machine, 4.0, 10, refit=False, **goals)
    assert found.status == "optimal"
    assert found.value == pytest.approx(by_brute_force(machine, 4.0, 10, measure, allowed), rel=1e-6)
    assert found.relaxation <= found.value + 1e-9
    assert measure(lp.steady_state(found.system), found.pattern) == pytest.approx(found.value, rel=1e-6)


def test_air_use_is_that_of_the_linear_flow(machine):
    found = design.optimize_pattern(machine, 4.0, 8, mean={"position": (0.04, 0.06)}, minimize="air_use", refit=False)
    areas, point = two_positions(machine), first_points(machine, 4.0)
    from ltvpneu.models.supply_flow import supply_flow_tangents
    from ltvpneu.periodic.exponential import ExponentialTrajectory

    rows, inputs, offsets = supply_flow_tangents(point, areas, 1e-3, machine.arrays)
    cycle = ExponentialTrajectory(system=found.system, step_states=lp.steady_state(found.system).step_states)
    chosen = found.pattern.astype(int)
    flows = np.sum(rows[chosen] * cycle.step_state_means(), axis=1) + inputs[chosen] @ machine.levels + offsets[chosen]
    assert found.value == pytest.approx(float(flows.mean()), rel=1e-6)


def test_a_refitted_pattern_is_checked_on_the_nonlinear_machine(machine):
    found = design.optimize_pattern(machine, 4.0, 8, mean={"position": (0.03, 0.06)}, shortest_on=2, shortest_off=2)
    assert found.n_pulses >= 1
    assert found.n_rounds >= 2
    runs = "".join("1" if on else "0" for on in np.concatenate([found.pattern, found.pattern]))
    assert "010" not in runs
    assert "101" not in runs
    orbit = lp.nonlinear_orbit(found.machine, 4.0)
    assert orbit.amplitude("position") == pytest.approx(found.nonlinear.amplitude("position"), rel=1e-9)
    assert found.machine.duty == pytest.approx(found.pattern.mean())


def test_what_cannot_be_reached_or_asked_is_said(machine):
    found = design.optimize_pattern(machine, 4.0, 6, mean={"position": (0.5, 0.6)}, refit=False)
    assert (found.status, found.pattern.size, found.machine) == ("infeasible", 0, None)
    with pytest.raises(ValueError, match="ramp"):
        design.optimize_pattern(lp.load_machine("double_acting_5_2"), 4.0, 6)
    with pytest.raises(ValueError, match="expected one of position"):
        design.optimize_pattern(machine, 4.0, 6, mean={"x": 0.1})
    with pytest.raises(ValueError, match="more than n_slots"):
        design.optimize_pattern(machine, 4.0, 6, shortest_on=4, shortest_off=4)
    with pytest.raises(ValueError, match="minimize"):
        design.optimize_pattern(machine, 4.0, 6, minimize="noise")


def test_pictures(machine):
    found = design.optimize_pattern(machine, 4.0, 6, mean={"position": (0.03, 0.06)}, refit=False)
    assert len(lp.plot(found).axes) == 2
    assert len(lp.plot(design.optimize_duty(machine, 12.0, mean={"position": 0.045})).axes) == 2


def test_a_valve_with_an_inner_volume_has_patterns_though_always_off_it_has_no_cycle():
    machine = lp.load_machine("kunt_singh_1990").with_collapse("dynamic")
    found = design.optimize_pattern(machine, 10.0, 8, mean={"position": (0.04, 0.05)})
    assert found.status == "optimal"
    assert found.system is not None
    assert 0.04 <= lp.steady_state(found.system).mean("position") <= 0.05
    assert not isinstance(found.nonlinear, str)
