"""A rodless cylinder without a spring on two 3/2 valves: steps, a curve, and a machine that is not as it is known."""

import math

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design

FREQUENCY, START = 100.0, 0.04


def rodless(kind="2 x 3/2"):
    """Bore 27 mm, stroke 152.4 mm, 0.94 kg; friction and 2 mm^2 paths are our assumptions."""
    area = math.pi / 4 * 0.027**2
    law = lp.ISO6358(sonic_conductance=0.4e-8, critical_pressure_ratio=0.3)
    valve = lp.OnOffValve(duty=0.5)
    return lp.Machine(
        name="rodless", supply_pressure=7.01e5, exhaust_pressure=1.01e5,
        cylinder=lp.Cylinder(
            piston_area_1=area, piston_area_2=area, dead_volume_1=area * 0.01, dead_volume_2=area * 0.1624,
            lower_stop=0.0, upper_stop=0.1524,
        ),
        load=lp.Load(mass=0.94, dry_friction=20.0, stiction=30.0), valve=valve,
        more_valves=(valve,) if kind == "2 x 3/2" else (), flow_paths=lp.directional_paths(kind, law),
    )  # fmt: skip


def stepped(steps, periods=40, kind="2 x 3/2", **options):
    machine = rodless(kind)
    delay = options["sensor"].delay if "sensor" in options else 0.0
    controller = design.SlideController(machine, FREQUENCY, delay=delay)
    places = START + np.cumsum([0.0, *steps])
    references = np.concatenate([np.full(5, places[0]), *(np.full(periods, place) for place in places[1:])])
    return design.simulate_closed_loop(
        machine, controller, references, FREQUENCY, initial_state=[START, 0.0, 4e5, 4e5], **options
    )


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"signals": {"supply_pressure": 7.7e5}},
        {"signals": {"supply_pressure": 6.3e5}},
        {"signals": {"load.mass": 1.88}},
        {"sensor": design.Sensor(delay=0.002)},
    ],
    ids=["as known", "supply +10 %", "supply -10 %", "twice the mass", "a sensor late by 2 ms"],
)
def test_steps_settle_within_a_fifth_of_a_millimetre(options):
    """From 0.11 to 64 mm; published for a like rig: 0.21 mm, and a rise of 180 ms at 64 mm."""
    done = stepped([0.00011, 0.01, 0.064, -0.064], **options)
    assert max(done.steady_errors()[1:]) <= 0.2e-3
    for rise in done.rise_times()[-2:]:
        assert rise is not None
        assert rise <= 0.18


def test_a_smooth_curve_is_followed_within_two_millimetres():
    machine = rodless()
    share = np.clip(np.arange(90) / 60, 0.0, 1.0)
    curve = START + 0.064 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    done = design.simulate_closed_loop(
        machine, design.SlideController(machine, FREQUENCY), curve, FREQUENCY, initial_state=[START, 0.0, 4e5, 4e5]
    )
    assert np.max(np.abs(done.states[:, 0] - curve)) <= 2e-3


def test_noise_and_quantization_are_tolerated():
    done = stepped([0.01], sensor=design.Sensor(noise=5e-5, quantization=1e-4))
    assert done.steady_errors()[-1] <= 0.3e-3


def test_a_load_step_of_20_newtons_is_rejected():
    force = np.concatenate([np.zeros(30), np.full(60, -20.0)])
    machine = rodless()
    done = design.simulate_closed_loop(
        machine, design.SlideController(machine, FREQUENCY), 0.06, FREQUENCY, n_periods=90,
        signals={"load.force": force}, initial_state=[0.05, 0.0, 4e5, 4e5],
    )  # fmt: skip
    assert np.max(np.abs(done.errors[20:30])) <= 0.2e-3
    assert np.max(np.abs(done.errors[-10:])) <= 0.3e-3


def test_one_valve_with_both_outlets_will_do():
    done = stepped([0.01, 0.05], kind="5/2")
    assert max(done.steady_errors()[1:]) <= 0.3e-3


def test_bad_machines_are_named():
    with pytest.raises(ValueError, match="found one with a spring"):
        design.SlideController(lp.load_machine("kunt_singh_1990"), 50.0)
    with pytest.raises(ValueError, match="frequency"):
        design.SlideController(rodless(), 0.0)
    with pytest.raises(ValueError, match="zone"):
        design.SlideController(rodless(), 50.0, zone=-1.0)
