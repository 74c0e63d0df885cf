"""Openings that ramp between switching instants: proportional valves, and what a step makes of a ramp."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from tests.conftest import MACHINES


def proportional() -> lp.Machine:
    """The double-acting drive on a proportional valve, its spool never at rest."""
    machine = lp.load_machine("double_acting_5_2").without_dry_friction()
    command = lp.Command(angles=(0.0, 0.7 * math.pi, 1.2 * math.pi), openings=(-0.8, 1.0, 0.3))
    return replace(machine, valve=lp.ProportionalValve(command=command))


@pytest.mark.parametrize(("hold", "least"), [("first", 3.5), ("zero", 1.7)])
def test_a_hold_has_its_order_with_operating_points_that_stay(hold, least):
    machine = MACHINES["ramped"]
    counts = [16, 32, 64, 128]

    def cycle(n_steps: int, hold: str) -> lp.Orbit:
        model = lp.ltv_model(machine, 10.0, n_steps=n_steps, operating_points="quasi-static", hold=hold)
        return lp.steady_state(model.system)

    exact = cycle(1024, "first").initial_state
    errors = [np.abs((cycle(n, hold).initial_state - exact) / machine.state_scales).max() for n in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > least
    if hold == "first":
        assert errors[0] < 1e-4


@pytest.mark.parametrize("frequency", [2.0, 10.0])
def test_self_consistent_models_of_a_proportional_valve_converge_with_second_order(frequency):
    machine = proportional()
    exact = lp.nonlinear_orbit(machine, frequency, method=lp.DormandPrince(rtol=1e-10)).amplitude("position")
    counts, errors = [40, 80, 160, 320], []
    for n_steps in counts:
        model = lp.ltv_model(machine, frequency, n_steps=n_steps, operating_points="self-consistent", spacing="even")
        errors.append(abs(model.orbit.amplitude("position") / exact - 1))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.8
    assert errors[-1] < 1e-4
    fitted = lp.ltv_model(machine, frequency, n_steps=8, operating_points="fitted").orbit.amplitude("position")
    assert fitted == pytest.approx(exact, rel=0.01)


def test_mass_closes_with_ramps_throughout():
    machine = proportional()
    assert lp.balance(machine, lp.nonlinear_orbit(machine, 5.0)).mass_error < 1e-9


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"hold": "second"}, "hold: found 'second'"),
        ({"hold": "first", "operating_points": "fitted"}, "hold: found 'first', which is for"),
        ({"hold": "first", "n_steps": 3}, "n_steps: found 3, expected at least 5 with hold"),
    ],
)
def test_holds_that_do_not_go_are_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.ltv_model(proportional(), 5.0, **arguments)
