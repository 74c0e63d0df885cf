"""Derivatives of the best objective over numbers of the machine, against problems solved anew."""

import math

import pytest

from ltvpneu import design
from ltvpneu.models.machine.parameters import present_value, with_values

NAMES = ["load.force", "supply_pressure", "load.dry_friction"]
GOALS = {"mean": {"position": 0.045}, "amplitude": {"position": 4e-3}, "minimize": "air_use"}
BOUNDS = (12.0, 17.0)


@pytest.mark.parametrize("model", ["fitted", "nonlinear"])
@pytest.mark.parametrize("scenarios", [None, {"low": lambda one: one.with_supply_pressure(0.97 * one.supply_pressure)}])
def test_slopes_are_differences(table_1, model, scenarios):
    goals = GOALS if scenarios is None else {**GOALS, "mean": {"position": (0.042, 0.05)}, "scenarios": scenarios}
    found = design.optimize_duty(table_1, BOUNDS, model=model, slopes=NAMES, **goals)
    assert found.status == "optimal"
    assert set(found.slopes) == set(NAMES)
    for name in NAMES if scenarios is None else NAMES[1:2]:
        value = present_value(table_1, 14.0, name)
        step = 1e-3 * (value or 10.0)
        ahead, behind = (
            design.optimize_duty(with_values(table_1, {name: value + sign * step}), BOUNDS, model=model, **goals)
            for sign in (1, -1)
        )
        slope = (ahead.objective - behind.objective) / (2 * step)
        assert found.slopes[name] == pytest.approx(slope, rel=5e-3)


def test_slopes_are_not_known_without_an_optimum(table_1):
    found = design.optimize_duty(table_1, 15.0, {"duty": (0.44, 0.46)}, mean={"position": 0.07}, slopes=["load.force"])
    assert found.status == "infeasible"
    assert math.isnan(found.slopes["load.force"])
    assert design.optimize_duty(table_1, 15.0, {"duty": (0.42, 0.46)}, mean={"position": 0.045}).slopes == {}
    kink = design.optimize_duty(
        table_1, (24.0, 27.0), slopes=["load.force"], **{**GOALS, "amplitude": {"position": 2e-3}}
    )
    assert (kink.status, kink.at_kink) == ("optimal", True)
    assert math.isnan(kink.slopes["load.force"])
    with pytest.raises(ValueError, match=r"load\.forse"):
        design.optimize_duty(table_1, 15.0, mean={"position": 0.045}, slopes=["load.forse"])


def test_an_optimum_outlasts_slopes_that_cannot_be_had(table_1, monkeypatch):
    asked = design.DutyProblem._figures

    def beside(self, cycles, values, parameters):
        if "load.force" in parameters:
            raise ValueError("the order of the switching instants changes")
        return asked(self, cycles, values, parameters)

    monkeypatch.setattr(design.DutyProblem, "_figures", beside)
    found = design.optimize_duty(table_1, 15.0, {"duty": (0.4, 0.45)}, mean={"position": 0.045}, slopes=["load.force"])
    assert found.status == "optimal"
    assert math.isnan(found.slopes["load.force"])
