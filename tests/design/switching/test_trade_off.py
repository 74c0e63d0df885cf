"""Fronts of two objectives: each point against its own problem solved from nothing, and against samples of settings."""

import json

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.air_use import air_use
from ltvpneu.face.cli import main

BOUNDS = (6.0, 18.0)


@pytest.fixture(scope="module")
def front(table_1):
    return design.trade_off(table_1, BOUNDS, mean={"position": 0.045}, points=6)


def test_every_point_is_the_optimum_with_its_bound(table_1, front):
    assert front.values.shape == (6, 2)
    assert [one.status for one in front.solutions] == ["optimal"] * 6
    for k in (1, 3):
        ripple = float(front.values[k, 1])
        alone = design.optimize_duty(
            table_1, BOUNDS, mean={"position": 0.045}, amplitude={"position": ripple}, minimize="air_use"
        )
        assert front.values[k, 0] == pytest.approx(alone.objective, rel=1e-6)
        assert front.slopes[k] == pytest.approx(alone.duals["amplitude position"], rel=1e-3)
    # The ends are the best for one alone.
    best = design.optimize_duty(table_1, BOUNDS, mean={"position": 0.045}, minimize="amplitude")
    assert front.values[-1, 1] == pytest.approx(best.objective, rel=1e-5)


def test_slopes_are_those_of_the_front(front):
    # On a convex stretch a secant's slope lies between those at its ends.
    air, ripple = front.values.T
    secants = np.diff(air) / -np.diff(ripple)
    for k in range(1, 4):
        low, high = sorted((front.slopes[k], front.slopes[k + 1]))
        assert low * (1 - 0.02) <= secants[k] <= high * (1 + 0.02)


def test_no_sampled_setting_is_better_in_both(table_1, front):
    """Settings whose mean is within a thousandth of a millimetre of the wanted one, on the nonlinear machine."""
    found = []
    for frequency in np.linspace(*BOUNDS, 9):
        low, high = 0.35, 0.5
        for _ in range(14):
            duty = (low + high) / 2
            orbit = lp.nonlinear_orbit(table_1.with_duty(duty), float(frequency))
            low, high = (duty, high) if orbit.mean("position") < 0.045 else (low, duty)
        if abs(orbit.mean("position") - 0.045) < 1e-5:
            found.append((air_use(table_1, orbit), orbit.amplitude("position")))
    assert len(found) >= 4
    for point in front.nonlinear_values:
        for air, ripple in found:
            # What the linear model is off by, and the tolerance of the mean.
            assert not (air < point[0] * (1 - 1e-3) and ripple < point[1] * (1 - 1e-3))
    assert not front.is_dominated.any()


def test_the_nonlinear_values_are_those_of_the_orbits(front):
    for values, one in zip(front.nonlinear_values, front.solutions, strict=True):
        orbit = one.nonlinear["nominal"]
        assert values[0] == pytest.approx(air_use(one.machine, orbit), rel=1e-6)
        assert values[1] == pytest.approx(orbit.amplitude("position"), rel=1e-6)


def test_objectives_that_do_not_conflict_are_one_point(table_1):
    # At one frequency and mean there is one duty.
    front = design.trade_off(table_1, 12.0, mean={"position": 0.045}, points=5)
    assert front.is_single
    assert "do not conflict" in repr(front)
    assert len(lp.plot(front).axes) == 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"minimize": "air_use"}, "minimize: found 'air_use', expected two objectives"),
        ({"minimize": ("air_use", "air_use")}, "found 'air_use' twice"),
        ({"minimize": ("air_use", "amplitute")}, "did you mean 'amplitude'"),
        ({"points": 1}, "points: found 1"),
        (
            {"mean": {"position": 0.06}, "variables": {"duty": (0.45, 0.46)}},
            "goals: found no setting that keeps mean position",
        ),
    ],
)
def test_bad_input(table_1, options, says):
    with pytest.raises(ValueError, match=says):
        design.trade_off(table_1, 12.0, **{"mean": {"position": 0.045}, **options})


def test_the_command(tmp_path, capsys):
    code = main(
        ["optimize", "kunt_singh_1990", "--frequency", "8..16", "--mean", "position=45mm", "--trade-off",
         "air_use,amplitude", "--points", "3", "--out", str(tmp_path)]
    )  # fmt: skip
    said = capsys.readouterr().out
    assert code == 0
    assert "worth [g/s per mm]" in said
    data = json.loads((tmp_path / "trade_off.json").read_text())
    assert data["minimize"] == ["air_use", "amplitude"]
    assert np.shape(data["values"]) == (3, 2)
    assert data["slopes"][0] is None
    assert (tmp_path / "trade_off.png").exists()
    assert main(["optimize", "kunt_singh_1990", "--frequency", "12", "--trade-off", "air_use"]) == 2
    assert "expected two objectives" in capsys.readouterr().err
