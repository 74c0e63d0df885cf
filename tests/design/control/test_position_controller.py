"""The position controller: its integrator acts while the reference moves, does not wind up and does not hunt."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design

FREQUENCY = 15.0
NUMBERS = np.arange(300)
BEGUN = 60
"""Periods in which the start from rest is forgotten: at a gain of 0.3 a correction is within 1e-9 of its goal then."""

REFERENCES = {
    "ramp up": 0.040 + 0.010 * NUMBERS / 300,
    "ramp down": 0.050 - 0.010 * NUMBERS / 300,
    "stairs": 0.040 + 0.0003 * (NUMBERS // 10),
    "sine": 0.045 + 0.005 * np.sin(2 * np.pi * NUMBERS / 240),
}


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="module")
def duties(machine):
    return design.duty_map(machine, np.linspace(0.25, 0.65, 9), [FREQUENCY])


def changed(machine, supply=1.0, force=0.0):
    weak = machine.with_supply_pressure(supply * machine.supply_pressure)
    return replace(weak, load=replace(weak.load, force=force))


@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("change", [{"supply": 0.9}, {"supply": 1.1}, {"force": -15.0}])
def test_the_integrator_acts_while_the_reference_moves(machine, duties, reference, change):
    """A machine off its map by 5 to 9 mm comes to within 0.1 mm on the mean, however the reference moves."""
    wanted, present = REFERENCES[reference], changed(machine, **change)
    alone = design.simulate_closed_loop(
        present, lambda seen: duties.duty_for(seen.reference, FREQUENCY), wanted, FREQUENCY
    )
    assert abs(np.mean((alone.mean_positions - wanted)[BEGUN:])) > 3e-3
    controller = design.PositionController(duties, FREQUENCY)
    errors = (design.simulate_closed_loop(present, controller, wanted, FREQUENCY).mean_positions - wanted)[BEGUN:]
    assert abs(errors.mean()) < 0.15e-3
    # Of a stair the period after is off by what the answer takes, up to the stair's height.
    assert np.abs(errors).max() < 0.35e-3


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_ramp_is_followed_without_the_lag_of_machine_and_command(machine, duties, delay):
    wanted = REFERENCES["ramp up"]
    valve = design.ValveLimits(delay=delay)
    told = design.PositionController(duties, FREQUENCY, delay=delay)
    errors = (design.simulate_closed_loop(machine, told, wanted, FREQUENCY, valve=valve).mean_positions - wanted)[
        BEGUN:
    ]
    # What is left, less than half a period's way, is that the map's straight lines are a little off everywhere else.
    assert np.abs(errors).max() < 0.5 * (wanted[1] - wanted[0])
    # A command that is late without the controller's knowledge leaves the slope times the delay.
    untold = design.PositionController(duties, FREQUENCY)
    late = (design.simulate_closed_loop(machine, untold, wanted, FREQUENCY, valve=valve).mean_positions - wanted)[
        BEGUN:
    ]
    np.testing.assert_allclose(late, -delay * (wanted[1] - wanted[0]), atol=0.5 * (wanted[1] - wanted[0]))


@pytest.mark.parametrize("delay", [0, 2, 4])
def test_a_delay_makes_no_integrator_swing(machine, duties, delay):
    """Of a plain integral with this gain the phase margin would be gone at four periods: 0.3 (0.5 + 1.6 + 1 + 4) > 2."""
    present = changed(machine, force=-8.0)
    controller = design.PositionController(duties, FREQUENCY, zone=0.0)
    valve = design.ValveLimits(delay=delay)
    done = design.simulate_closed_loop(present, controller, np.full(60, 0.045), FREQUENCY, valve=valve)
    errors = done.mean_positions - 0.045
    assert np.abs(errors[35:]).max() < 0.1e-3
    # From below, and past the goal by no more than a tenth of the 5 mm that the force moves it by.
    assert errors[8:].max() < 0.5e-3


def test_a_goal_beyond_the_valve_winds_nothing_up(machine, duties):
    """80 periods at the valve's longest pulse, 11 mm short: the way back is no slower than any step's."""
    valve = design.ValveLimits(shortest_on=5e-3, shortest_off=0.55 / FREQUENCY)
    wanted = np.repeat([0.045, 0.060, 0.045], [40, 80, 60])
    for delay in (0, 1):
        controller = design.PositionController(duties, FREQUENCY)
        done = design.simulate_closed_loop(machine, controller, wanted, FREQUENCY, valve=replace(valve, delay=delay))
        assert done.n_held_back >= 79
        assert (done.mean_positions - wanted)[100] < -10e-3
        settled = done.settling_periods(1e-3)[-1]
        assert settled is not None
        assert settled <= 3 + delay
        assert np.ptp(done.commands[80:120]) < 1e-3


@pytest.mark.parametrize("change", [{"supply": 0.9}, {"supply": 1.1}, {"force": 15.0}])
def test_steps_of_a_machine_off_its_map_end_at_one_duty(machine, duties, change):
    wanted = np.repeat([0.045, 0.055, 0.045, 0.035, 0.045], 60)
    controller = design.PositionController(duties, FREQUENCY)
    done = design.simulate_closed_loop(changed(machine, **change), controller, wanted, FREQUENCY)
    assert all(periods is not None and periods <= 15 for periods in done.settling_periods(1e-3))
    for end in range(60, 301, 60):
        assert np.ptp(done.duties[end - 20 : end]) == 0
        assert abs(done.mean_positions[end - 1] - wanted[end - 1]) < controller.zone


def test_what_the_valve_made_may_be_unknown(machine, duties):
    """A controller on a bench is told no duty: it takes its own command for it."""
    wanted, known = REFERENCES["ramp up"][:120], design.PositionController(duties, FREQUENCY)
    unknown = design.PositionController(duties, FREQUENCY)
    with_duty = design.simulate_closed_loop(machine, known, wanted, FREQUENCY)
    without = design.simulate_closed_loop(machine, lambda seen: unknown(replace(seen, duty=np.nan)), wanted, FREQUENCY)
    np.testing.assert_array_equal(with_duty.commands, without.commands)


def test_a_slower_answer_is_followed_to_its_end(machine, duties):
    """The lag is that of the step's answer, at any frequency: the same time, more periods."""
    slow = design.duty_map(machine, np.linspace(0.3, 0.5, 5), [25.0])
    controller = design.PositionController(slow, 25.0)
    assert controller.lag / 25.0 == pytest.approx(design.PositionController(duties, FREQUENCY).lag / FREQUENCY, rel=0.5)
    assert controller.lag > 3


def test_bad_controllers_of_a_map_are_named(machine, duties):
    with pytest.raises(ValueError, match="gain: found 2, expected below 2"):
        design.PositionController(duties, FREQUENCY, gain=2.0)
    with pytest.raises(ValueError, match="delay"):
        design.PositionController(duties, FREQUENCY, delay=-1)
    with pytest.raises(ValueError, match="found 1 duties at which the piston moves"):
        design.PositionController(design.duty_map(machine, [0.4], [FREQUENCY]), FREQUENCY)
    controller = design.PositionController(duties, FREQUENCY)
    with pytest.raises(ValueError, match="mean: found 500 mm"):
        design.simulate_closed_loop(machine, controller, [0.5], FREQUENCY)
