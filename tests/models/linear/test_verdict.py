"""What a linear model says of its cycle: does the machine have it, and how far is it off?"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.linear.march import MAX_EVENTS
from tests.models.random_machines import random_machine

MACHINES = Path(__file__).parents[2] / "reference" / "machines"


def test_a_cycle_that_the_machine_does_not_have_is_refuted():
    machine = lp.load_machine(MACHINES / "false_period_two.toml")
    coarse = lp.ltv_model(machine, 0.5930484420074003, operating_points="fitted", n_steps=2).error_estimate
    assert not coarse.is_reliable
    assert coarse.verdict.startswith("refuted: the piston moves in the model, in the machine it comes to rest")
    assert "refuted" in repr(coarse)
    fine = lp.ltv_model(machine, 0.5930484420074003, rtol=0.02)
    assert fine.orbit.n_periods == 1
    assert fine.error_estimate.is_reliable
    assert "one of a band: held by stiction" in fine.error_estimate.verdict


def test_a_model_beyond_the_stops_is_refuted():
    machine = lp.load_machine(MACHINES / "spring_return.toml")
    with pytest.warns(UserWarning, match="beyond the cylinder's end stops"):
        estimate = lp.ltv_model(machine, 10.0).error_estimate
    assert not estimate.is_reliable
    assert "rests on the upper stop" in estimate.verdict


def test_a_cycle_beside_others_says_so():
    machine = lp.load_machine(MACHINES / "free_cylinder.toml").with_duty(0.45)
    estimate = lp.ltv_model(machine, 20.0, operating_points="fitted").error_estimate
    assert estimate.is_reliable
    assert "one of several: from its stop at -50 mm the machine settles on" in estimate.verdict


def test_a_band_beside_an_orbit_says_so():
    machine, frequency = random_machine(np.random.default_rng(176))
    estimate = lp.ltv_model(machine, frequency, operating_points="fitted").error_estimate
    assert estimate.is_reliable
    assert "one of a band: held by stiction" in estimate.verdict
    assert "one of several: from rest the machine settles on an amplitude of 0.9" in estimate.verdict


def test_a_machine_that_settles_nowhere_refutes_with_its_reason(table_1):
    # Mean pressures far above what the spring can hold within the chamber: the volume is swept empty.
    machine = replace(table_1, load=replace(table_1.load, force=-70.0)).without_dry_friction()
    model = lp.ltv_model(machine, 2.0, operating_points="lti-position")
    estimate = model.error_estimate
    assert not estimate.is_reliable
    assert estimate.verdict.startswith("refuted: the volume of chamber_1 would reach zero")


def test_a_chattering_piston_is_named():
    machine = lp.load_machine(MACHINES / "edge_of_band.toml")
    with pytest.raises(lp.NotConvergedError, match=rf"the piston chatters: .* more than {MAX_EVENTS} times") as caught:
        lp.ltv_model(machine, 36.12281831685486, operating_points="fitted")
    assert "no operating point" not in str(caught.value)


def test_a_stiff_model_is_bounded():
    machine = lp.load_machine(MACHINES / "slow_fit.toml")
    ticks: list[int] = []
    model = lp.ltv_model(machine, 1.0645281587109756, operating_points="fitted", progress=ticks.append)
    assert model.orbit.rest == "held by stiction"
    assert len(ticks) == model.iterations < 60


@pytest.mark.parametrize("seed", range(12))
def test_the_tolerance_asked_for_is_kept(seed):
    machine, frequency = random_machine(np.random.default_rng(seed))
    try:
        orbit = lp.nonlinear_orbit(machine, frequency)
        model = lp.ltv_model(machine, frequency, rtol=0.03, max_seconds=60)
    except lp.LtvpneuError:
        return
    assert model.error_estimate.is_reliable
    if "several" not in model.error_estimate.verdict and orbit.amplitude(0) > 1e-4 * machine.state_scales[0]:
        assert abs(model.orbit.amplitude(0) / orbit.amplitude(0) - 1) <= 0.031
