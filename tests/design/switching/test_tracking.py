"""Many pulses along a wanted cycle, and the start that leads there."""

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.switching.pulses_along import pulses_along

FREQUENCY, MEAN, AMPLITUDE = 2.0, 0.045, 0.010
ANGLES = 2 * np.pi * np.arange(80) / 80
WANTED = MEAN + AMPLITUDE * np.sin(ANGLES)
GOALS = design.Goals(cycle={"position": (ANGLES, WANTED)})


@pytest.fixture(scope="module")
def machine():
    """Table 1."""
    return lp.load_machine("kunt_singh_1990")


def _missed(orbit):
    """Distance from the wanted sine at many times, not only those that were asked for [m]."""
    times = np.arange(2000) / 2000 / FREQUENCY
    return orbit.at(times)[0] - MEAN - AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * times)


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))


def test_pulses_along_a_sine_nearly_follow_it(machine):
    # No search yet: the dead time of half a slot and the ripple are left.
    pulses = pulses_along(machine, FREQUENCY, ANGLES, WANTED, 20)
    orbit = lp.nonlinear_orbit(machine.with_pulses(pulses), FREQUENCY)
    assert _rms(_missed(orbit)) < 0.2 * AMPLITUDE


def test_pulses_to_rest_at_one_place_let_in_what_the_bleed_lets_out(machine):
    # Held at a place, all pulses are alike, and over a period the chamber takes in nothing.
    pulses = pulses_along(machine, 1.0, [0.0, 2.0, 4.0], [0.045] * 3, 100)
    widths = np.array([off - on for on, off in pulses])
    np.testing.assert_allclose(widths, widths[0], rtol=5e-3)
    orbit = lp.nonlinear_orbit(machine.without_dry_friction().with_pulses(pulses), 1.0)
    assert orbit.mean("position") == pytest.approx(0.045, abs=5e-4)


@pytest.mark.parametrize("model", ["fitted", "nonlinear"])
def test_a_sine_by_twenty_pulses_is_followed_to_a_seventh_of_a_millimetre(machine, model):
    found = design.optimize_duty(machine, FREQUENCY, pulses=20, minimize="tracking", goals=GOALS, model=model)
    orbit = found.nonlinear["nominal"]
    assert not isinstance(orbit, str)
    assert _rms(_missed(orbit)) <= 0.15e-3
    # Every edge stays within its slot.
    edges = np.array([found.values[f"{way}_{i}"] for i in range(1, 21) for way in ("on", "off")])
    assert (np.diff(edges) > 0).all()
    assert (edges // (2 * np.pi / 20) == np.repeat(np.arange(20), 2)).all()


def test_pulses_of_the_machine_itself_are_started_from_the_cycle_too(machine):
    slot = 2 * np.pi / 12
    pulsed = machine.with_pulses([(i * slot, (i + 0.4) * slot) for i in range(12)])
    found = design.optimize_duty(pulsed, FREQUENCY, minimize="tracking", goals=GOALS)
    assert "on_1" not in found.values
    assert _rms(_missed(found.nonlinear["nominal"])) < 1e-3


def test_pulses_without_a_cycle_are_spread_evenly(machine):
    found = design.optimize_duty(machine, 6.0, {"supply_pressure": (3e5, 4.5e5)}, pulses=2, mean={"position": 0.05})
    assert found.status == "optimal"
    np.testing.assert_allclose(found.machine.valve.on_window().edges, np.pi * np.array([0.0, 0.5, 1.0, 1.5]))


@pytest.mark.parametrize(
    ("angles", "positions", "said"),
    [
        ([0.0, 1.0], [0.04, 0.05], "found 2 points of the wanted cycle, expected three or more"),
        ([0.0, 2.0, 1.0], [0.04, 0.05, 0.04], "expected rising ones from 0 to below 2 pi"),
        ([0.0, 2.0, 7.0], [0.04, 0.05, 0.04], "expected rising ones from 0 to below 2 pi"),
        ([0.0, 2.0, 3.0], [0.04, np.nan, 0.04], "positions"),
        ([0.0, 2.0, 3.0], [0.04, 0.05], "positions"),
    ],
)
def test_bad_cycles(machine, angles, positions, said):
    with pytest.raises(ValueError, match=said):
        pulses_along(machine, FREQUENCY, angles, positions, 8)


def test_a_cycle_beyond_a_stop():
    with pytest.raises(ValueError, match="expected them between the stops, -50 to 50 mm"):
        pulses_along(lp.load_machine("double_acting_5_2"), FREQUENCY, ANGLES, 0.06 * np.sin(ANGLES), 8)


def test_more_pulses_than_ramps_leave_room_for():
    with pytest.raises(ValueError, match=r"pulses: found 20; .* expected at most 8"):
        design.optimize_duty(
            lp.load_machine("double_acting_5_2"), FREQUENCY, pulses=20, minimize="tracking", goals=GOALS
        )
    with pytest.raises(ValueError, match="pulses"):
        design.optimize_duty(lp.load_machine("double_acting_5_2"), FREQUENCY, pulses=0)
