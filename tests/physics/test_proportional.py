"""A proportional valve's command and its openings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ltvpneu as lp
from ltvpneu.physics.profile import TURN

points = st.lists(
    st.tuples(st.floats(0, TURN * (1 - 1e-6)), st.floats(-1, 1)),
    min_size=1,
    max_size=6,
    unique_by=lambda p: round(p[0], 3),
).map(sorted)


def command(points) -> lp.Command:
    return lp.Command(angles=tuple(a for a, _ in points), openings=tuple(v for _, v in points))


@given(points=points, angle=st.floats(0, TURN * 0.999))
def test_the_openings_are_the_two_signs_of_the_interpolated_command(points, angle):
    one = command(points)
    expected = np.interp(angle, one.angles, one.openings, period=TURN)
    assert one.profile.at(angle) == pytest.approx(max(expected, 0.0), abs=1e-6)
    assert one.complement.profile.at(angle) == pytest.approx(max(-expected, 0.0), abs=1e-6)


@pytest.mark.parametrize("apart", [0.0, 4.5e-16, 1e-12, 5e-9, 7e-9, 1e-3])
@pytest.mark.parametrize("first", [0.0, 1e-16, 1e-10, 1e-8, 0.5])
@pytest.mark.parametrize("last", [4.0, TURN - 1e-8, TURN - 1e-10, math.nextafter(TURN, 0)])
def test_points_almost_together_make_a_jump_and_nothing_else(apart, first, last):
    one = lp.Command(angles=(first, 2.0, 2.0 + apart, last), openings=(0.2, 1.0, -1.0, 0.6))
    for angle in np.linspace(0.01, TURN - 0.01, 500):
        if not 1.999 < angle < 2.003:
            expected = np.interp(angle, one.angles, one.openings, period=TURN)
            assert one.profile.at(angle) == pytest.approx(max(expected, 0.0), abs=1e-7)
            assert one.complement.profile.at(angle) == pytest.approx(max(-expected, 0.0), abs=1e-7)


def test_two_equal_angles_make_a_jump():
    step = lp.Command(angles=(0.0, 2.0, 2.0), openings=(1.0, 1.0, -1.0))
    assert step.profile.at(1.999) == 1.0
    assert step.profile.at(2.0) == 0.0
    assert step.complement.profile.at(2.0) == pytest.approx(1.0)


def test_a_constant_command_holds_one_side_open():
    half = lp.Command(angles=(1.0,), openings=(0.5,))
    assert half.profile.mean(0.0, TURN) == 0.5
    assert half.complement.profile.mean(0.0, TURN) == 0.0
    assert half.width == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("angles", "openings", "match"),
    [
        ((0.0, 1.0), (1.0,), "found 2 and 1"),
        ((), (), "found 0 and 0"),
        ((1.0, 0.5), (0.0, 0.0), r"angles\[1\]: found 0.5 rad after 1 rad"),
        ((0.0, 7.0), (0.0, 0.0), "found 0 to 7 rad"),
        ((0.0,), (1.5,), r"openings\[0\]: found 1.5"),
    ],
)
def test_impossible_commands_are_refused(angles, openings, match):
    with pytest.raises(ValueError, match=match):
        lp.Command(angles=angles, openings=openings)


def test_a_proportional_valve_has_neither_duty_nor_pulses(double_acting):
    from dataclasses import replace

    machine = replace(double_acting, valve=lp.ProportionalValve(command=command([(0.0, -1.0), (3.0, 1.0)])))
    with pytest.raises(ValueError, match="duty: found 0.3 for a proportional valve"):
        machine.with_duty(0.3)
    with pytest.raises(ValueError, match="for a proportional valve"):
        machine.with_pulses([(0.0, 1.0)])
    with pytest.raises(ValueError, match="found a valve that switches"):
        double_acting.with_command(command([(0.0, 0.5)]))
    assert machine.with_command(command([(0.0, 0.5)])).duty == pytest.approx(0.5)
