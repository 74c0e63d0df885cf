"""Ways through parts: derivatives against differences, across sticking, stops and rest at the end."""

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.nonlinear.passage import passage, positions_of


@pytest.fixture(scope="module")
def table_1():
    return lp.load_machine("kunt_singh_1990")


def at_20_mm(machine):
    return np.array([0.02, 0.0, 1.65e5])


def differences(parts, durations, start, of, step=1e-6):
    columns = []
    for j in range(durations.size):
        moved = [durations + sign * step * np.eye(durations.size)[j] for sign in (1, -1)]
        ends = [of(passage(parts, one, start, 1e-12)) for one in moved]
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("durations", [(0.05, 0.03, 0.02), (0.001, 0.002, 0.05), (0.06, 0.1, 0.01), (0.2, 0.2, 0.2)])
def test_end_slopes_are_those_of_differences(table_1, durations):
    """Through breaking away, reversals and rests in between."""
    held = positions_of(table_1)
    parts = [held[True,], held[False,], held[True,]]
    durations = np.array(durations)
    way = passage(parts, durations, at_20_mm(table_1), 1e-11)
    by_differences = differences(parts, durations, at_20_mm(table_1), lambda one: one.end)
    scale = table_1.state_scales[:, None] / 0.05
    assert way.end_slopes / scale == pytest.approx(by_differences / scale, rel=1e-4, abs=2e-5)


def test_times_and_extremes_are_those_of_the_parts(table_1):
    held = positions_of(table_1)
    way = passage([held[True,], held[False,]], np.array([0.06, 0.1]), at_20_mm(table_1))
    fine = way.at(np.linspace(0.0, way.duration, 20001))
    assert fine[:, 0] == pytest.approx(way.start)
    assert fine[:, -1] == pytest.approx(way.end, rel=1e-8, abs=1e-8)
    for state in range(3):
        assert way.extreme(state, greatest=True) == pytest.approx(fine[state].max(), rel=1e-6)
        assert way.extreme(state, greatest=False) == pytest.approx(fine[state].min(), rel=1e-6, abs=1e-9)
    alone = lp.PeriodMap(machine=held[True,], frequency=1 / 0.06).turn(at_20_mm(table_1))
    assert way.turns[0].end == pytest.approx(alone.end, rel=1e-7)


def test_rest_at_the_end_has_a_slope(table_1):
    """Held by friction the velocity is zero; to first order it goes on as it stopped, and is zero at the stop alone."""
    held = positions_of(table_1)
    parts, start = [held[True,], held[False,], held[True,]], at_20_mm(table_1)
    first, second, last = 0.06342806, 0.01305652, 0.00825745
    after, before = (passage(parts, np.array([first, second, last + more]), start) for more in (2e-4, -2e-4))
    assert after.end[1] == 0.0
    assert before.end[1] > 0
    assert after.unheld_end[0][1] == pytest.approx(-before.end[1], rel=0.1)
    assert np.array_equal(before.unheld_end[0], before.end)
    # The slopes of both sides agree to first order in the distance.
    assert after.unheld_end[1][1] == pytest.approx(before.end_slopes[1], rel=0.05)


def test_a_stop_that_is_met_has_a_slope_too():
    machine = lp.load_machine("double_acting_5_2")
    machine = machine.with_duty(0.5)
    from dataclasses import replace

    held = positions_of(replace(machine, valve=replace(machine.valve, ramp=0.0)))
    start = np.array([0.0, 0.0, 3e5, 3.3e5])
    way = passage([held[True,]], np.array([0.12]), start)
    assert way.end[0] == machine.cylinder.upper_stop
    assert way.end[1] == 0.0
    assert way.impact_energy > 0.1
    place, slopes = way.unheld_end
    assert place[0] > machine.cylinder.upper_stop
    speed = np.sqrt(2 * way.impact_energy / machine.load.mass)
    assert slopes[0, 0] == pytest.approx(speed, rel=1e-5)
    # Until the stop is met it is the piston's own place.
    met = 0.12 - (place[0] - machine.cylinder.upper_stop) / speed
    short = passage([held[True,]], np.array([met - 1e-5]), start)
    assert short.end[0] == pytest.approx(machine.cylinder.upper_stop - 1e-5 * speed, abs=1e-7)
