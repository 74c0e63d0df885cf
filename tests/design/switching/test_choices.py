"""Lists to choose from: each entry by itself, in the right order, and what cannot be."""

import math

import pytest

import ltvpneu as lp
from ltvpneu import design

GOALS = {"mean": {"position": 0.005}, "amplitude": {"position": 3e-3}, "minimize": "air_use"}


@pytest.fixture(scope="module")
def drive():
    """A double-acting one between springs."""
    return lp.load_machine("double_acting_5_2")


@pytest.fixture(scope="module")
def chosen(drive):
    choices = {"valve": ["SMC SY5000", "SMC SY3000"], "bore": [0.032, 0.025]}
    return design.optimize_duty(drive, (10.0, 40.0), choices=choices, **GOALS)


def test_every_combination_is_solved_and_the_best_returned(chosen):
    assert len(chosen.choices) == 4
    assert {(one.choice["valve"], one.choice["bore"]) for one in chosen.choices} == {
        (valve, bore) for valve in ("SMC SY5000", "SMC SY3000") for bore in (0.032, 0.025)
    }
    assert chosen.choice == chosen.choices[0].choice
    assert all(one.keeps_goals for one in chosen.choices)
    worths = [one.final.nonlinear_objective for one in chosen.choices]
    assert worths == sorted(worths)
    assert chosen.nonlinear_objective == worths[0]


def test_one_entry_is_the_design_of_its_machine(drive, chosen):
    alone = lp.with_bore(lp.with_valve(drive, lp.catalogue().valve("SMC SY3000")), 0.025)
    found = design.optimize_duty(alone, (10.0, 40.0), **GOALS)
    same = next(one for one in chosen.choices if one.choice == {"valve": "SMC SY3000", "bore": 0.025})
    assert same.final.objective == pytest.approx(found.objective, rel=1e-6)
    assert same.final.machine.flow_paths == alone.flow_paths


def test_those_that_miss_the_goals_come_last_with_their_nearest(drive):
    # Only the stiffer spring keeps the piston's swing that small.
    found = design.optimize_duty(
        drive, 12.0, choices={"load.spring_stiffness": [6e3, 20e3]}, mean={"position": 0.0},
        amplitude={"position": 20e-3}, minimize="air_use",
    )  # fmt: skip
    first, second = found.choices
    assert (first.choice, first.keeps_goals) == ({"load.spring_stiffness": 20e3}, True)
    assert not second.keeps_goals
    assert second.solution is not None
    assert second.solution.status == "infeasible"
    assert "amplitude position" in second.solution.broken


def test_pulses_and_frequencies_are_choices(drive):
    machine = lp.load_machine("kunt_singh_1990")
    found = design.optimize_duty(
        machine, 8.0, {"supply_pressure": (3e5, 5e5)}, choices={"pulses": [1, 3]}, mean={"position": 0.045}
    )
    # More pulses a period, less of a ripple.
    assert found.choice == {"pulses": 3}
    found = design.optimize_duty(machine, 8.0, choices={"frequency": [9.0, 14.0]}, mean={"position": 0.045})
    assert found.choice == {"frequency": 14.0}
    assert found.frequency == 14.0


def test_an_entry_without_a_solution_says_why(drive):
    machine = lp.load_machine("kunt_singh_1990")
    found = design.optimize_duty(
        machine, 8.0, {"supply_pressure": (3e5, 5e5)}, choices={"pulses": [1, 400]}, mean={"position": 0.045}
    )
    assert found.choices[1].solution is None
    assert "pulses: found 400" in found.choices[1].failure
    assert "pulses 400: pulses: found 400" in repr(found.choices[1])


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({}, "choices: found none, expected lists by name"),
        ({"valve": []}, r"choices\['valve'\]: found \[\], expected a list with at least one entry"),
        ({"bore": 0.032}, "expected a list with at least one entry"),
        ({"valve": "SMC SY3000"}, "expected a list with at least one entry"),
        ({"bores": [0.032]}, "did you mean 'bore'?"),
        ({"valve": ["SMC SY3001"]}, "such as SMC SY3000"),
        ({"bore": [32.0]}, "expected at most 1 m"),
        ({"pulses": [1.5]}, "pulses"),
        ({"load.mass": [math.nan]}, "load.mass"),
        ({"duty": [0.4, 0.5]}, "found 'duty', which is a variable of the design"),
    ],
)
def test_bad_lists(drive, choices, said):
    with pytest.raises(ValueError, match=said):
        design.optimize_duty(drive, 12.0, choices=choices, minimize="air_use")


def test_a_valve_for_a_machine_that_has_none_of_its_kind():
    with pytest.raises(ValueError, match=r"none has a solution; the first, .* whose valve is no on-off valve"):
        design.optimize_duty(lp.load_machine("kunt_singh_1990"), 8.0, choices={"valve": ["SMC SY3000"]})
