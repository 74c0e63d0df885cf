"""Designs for ranges of what is not known well, and how likely goals are kept."""

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.models.machine.parameters import with_values

RANGES = {"supply_pressure": "+-4 %", "load.force": (0.0, 5.0)}
BAND = (0.040, 0.055)


@pytest.fixture(scope="module")
def machine():
    """Table 1."""
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="module")
def robust(machine):
    return design.optimize_duty(machine, (8.0, 30.0), ranges=RANGES, mean={"position": BAND})


def _figures(machine, solution, points):
    """Mean and amplitude of the machine as designed, at points of the ranges, each a separate orbit."""
    found = []
    for pressure, force in points:
        varied = with_values(solution.machine, {"supply_pressure": pressure, "load.force": force})
        orbit = lp.nonlinear_orbit(varied, solution.frequency)
        found.append((orbit.mean("position"), orbit.amplitude("position")))
    return np.array(found).T


def test_the_worst_case_holds_everywhere_in_the_ranges(machine, robust):
    assert robust.status == "optimal"
    assert robust.broken == ()
    rng = np.random.default_rng(3)
    share = np.vstack([[(0, 0), (0, 1), (1, 0), (1, 1)], rng.random((40, 2))])
    points = np.array([0.96 * 4.1e5, 0.0]) + share * np.array([0.08 * 4.1e5, 5.0])
    means, amplitudes = _figures(machine, robust, points)
    assert means.min() > BAND[0] - 1e-5
    assert means.max() < BAND[1] + 1e-5
    # The objective is the worst one's.
    assert amplitudes.max() <= robust.nonlinear_objective * 1.01
    assert len(robust.ranges.points) == 4 + 32
    assert robust.ranges.kept.all()


def test_what_is_best_without_the_ranges_breaks_the_goals_in_them(machine):
    plain = design.optimize_duty(machine, (8.0, 30.0), mean={"position": (0.050, 0.055)}, minimize="air_use")
    goals = design.Goals(mean={"position": (0.050, 0.055)})
    check = design.check_goals(plain.machine, plain.frequency, RANGES, goals=goals, minimize="air_use", n=20)
    assert not check.kept.all()
    assert check.broken
    assert check.worst("least mean position") > 1e-4
    # The objective is there too, of the same flow as its own function gives.
    varied = with_values(plain.machine, check.point(1))
    orbit = lp.nonlinear_orbit(varied, plain.frequency)
    assert check.objectives[1] == pytest.approx(design.air_use(varied, orbit), rel=1e-9)
    assert check.missed["least mean position"][1] == pytest.approx(max(0.050 - orbit.mean("position"), 0), abs=1e-12)


def test_ranges_that_no_setting_bears_are_said_to_be(machine):
    found = design.optimize_duty(
        machine, (8.0, 30.0), ranges={"supply_pressure": "+-10 %"}, mean={"position": (0.044, 0.046)}
    )
    assert found.status == "infeasible"
    assert any(name.endswith("in the ranges") for name in found.broken)
    assert found.ranges.share < 0.9


def test_the_probability_of_a_random_machine(machine):
    # A mean that goes with the pressure alone: kept where the pressure is below a value that a bisection finds.
    goals = design.Goals(mean={"position": (None, 0.046)})
    ranges = {"supply_pressure": (3.9e5, 4.4e5)}
    designed = machine.with_duty(0.42)

    def mean(pressure):
        return lp.nonlinear_orbit(with_values(designed, {"supply_pressure": pressure}), 15.0).mean("position")

    low, high = 3.9e5, 4.4e5
    for _ in range(25):
        middle = (low + high) / 2
        low, high = (middle, high) if mean(middle) < 0.046 * 1.01 else (low, middle)
    expected = (low - 3.9e5) / 0.5e5
    assert 0.2 < expected < 0.9
    even = design.check_goals(designed, 15.0, ranges, goals=goals, n=256)
    assert even.share == pytest.approx(expected, abs=0.01)
    drawn = design.check_goals(
        designed, 15.0, ranges, goals=goals, n=300, corners=False, generator=np.random.default_rng(1)
    )
    assert drawn.interval[0] < expected < drawn.interval[1]
    normal = design.check_goals(designed, 15.0, ranges, goals=goals, n=256, spread="normal")
    # About the middle, more of them lie on the side of the bound where the middle is.
    assert (normal.share > even.share) == (expected > 0.5)
    assert f"{normal.share:.3g} of those inside" in repr(normal)


def test_machines_without_a_cycle_count_as_missing(machine):
    # At 40 Hz stiction holds the piston of the larger friction.
    check = design.check_goals(
        machine.with_duty(0.38), 40.0, {"load.stiction": (26.6, 400.0)},
        goals=design.Goals(amplitude={"position": 1e-3}), n=8,
    )  # fmt: skip
    assert check.failures
    assert not check.kept[list(check.failures)].any()
    assert "a cycle" in check.broken


def test_a_choice_and_ranges_together(machine):
    found = design.optimize_duty(
        machine, 20.0, choices={"load.mass": [1.0, 2.5]}, ranges={"supply_pressure": "+-3 %"},
        mean={"position": BAND},
    )  # fmt: skip
    assert found.choice == {"load.mass": 2.5}
    assert all(one.solution.ranges is not None for one in found.choices)


@pytest.mark.parametrize(
    ("ranges", "said"),
    [
        ({}, "ranges: found none"),
        ({"load.force": (50.0, 0.0)}, "found 50 to 0 of 'load.force'; they contradict each other"),
        ({"load.force": "+-10 %"}, "of a number that is zero"),
        ({"supply_pressure": "10 %"}, "or a text such as"),
        ({"supply_pressure": 4e5}, "expected two values"),
        ({"supply_pressure": (4e5, np.nan)}, "supply_pressure"),
        ({"supply_pressure": (1.0, 4e5)}, "found 1 for 'supply_pressure'"),
        ({"load.wieght": (1.0, 2.0)}, "load.wieght"),
        ({"duty": (0.4, 0.5)}, "found 'duty', which is a variable of the design"),
    ],
)
def test_bad_ranges(machine, ranges, said):
    with pytest.raises(ValueError, match=said):
        design.optimize_duty(machine, 12.0, ranges=ranges)


def test_bad_questions(machine):
    goals = design.Goals(amplitude={"position": 1e-3})
    with pytest.raises(ValueError, match='expected "uniform" or "normal"'):
        design.check_goals(machine, 12.0, RANGES, goals=goals, spread="even")
    with pytest.raises(ValueError, match="did you mean 'air_use'"):
        design.check_goals(machine, 12.0, RANGES, goals=goals, minimize="air_used")
    check = design.check_goals(machine, 12.0, RANGES, goals=goals, n=0)
    assert np.isnan(check.share)
    with pytest.raises(ValueError, match="expected one of amplitude position"):
        check.worst("mean")
