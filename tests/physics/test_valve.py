"""Openings over the turn: windows, rotary valve kinematics (1)-(2), on-off valves."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.profile import TURN, Profile
from ltvpneu.physics.valve import Port, RotaryValve
from ltvpneu.physics.window import Window

angles = st.floats(0, TURN)


def profiles() -> st.SearchStrategy[Profile]:
    return st.builds(
        lambda start, width, ramp, scale: Window(start=start, width=width, ramp=ramp).profile.scaled(scale),
        st.floats(-math.pi, TURN), angles, st.floats(0, 2), st.floats(0, 3),
    )  # fmt: skip


@given(st.floats(-math.pi, TURN), angles, st.floats(0, 2), angles)
def test_a_window_opens_as_its_definition_says(start, width, ramp, angle):
    profile = Window(start=start, width=width, ramp=ramp).profile
    inside = (angle - start) % TURN
    edges = np.array([0, ramp, width - ramp, width, TURN])
    if np.abs(inside - edges).min() < 1e-6 or np.abs(profile.angles - angle).min() < 1e-6:
        return
    expected = 0.0
    if inside < width:
        expected = min(1.0, inside / ramp, (width - inside) / ramp) if ramp > 0 else 1.0
    if width >= TURN - 1e-8:
        expected = 1.0
    assert profile.at(angle) == pytest.approx(expected, abs=1e-6 / max(ramp, 1e-6))


@given(profiles(), profiles(), angles)
def test_sum_and_minimum_of_profiles_hold_at_every_angle(a, b, angle):
    near = np.concatenate([a.angles, b.angles, a.minimum(b).angles])
    if np.abs(near - angle).min() < 1e-6:
        return
    assert a.plus(b).at(angle) == pytest.approx(a.at(angle) + b.at(angle), abs=1e-6)
    assert a.minimum(b).at(angle) == pytest.approx(min(a.at(angle), b.at(angle)), abs=1e-6)


@given(profiles(), st.lists(angles, min_size=1, max_size=5))
def test_means_over_parts_add_up_to_the_mean_over_the_turn(profile, cuts):
    edges = np.unique([0.0, *cuts, TURN])
    edges = edges[np.append(True, np.diff(edges) > 1e-12)]
    parts = sum(profile.mean(a, b) * (b - a) for a, b in pairwise(edges))
    assert parts == pytest.approx(profile.mean(0, TURN) * TURN, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("degrees", [-180, -100, -30, 0, 30, 100, 180])
def test_offset_angle_sets_the_on_time(degrees):
    half = Window(start=0.0, width=math.pi)
    ports = (
        Port(way="supply", area=2e-5, discharge_coefficient=0.5, window=half),
        Port(way="chamber_1", area=1e-5, discharge_coefficient=0.4, window=half, turns_with_offset=True),
    )
    valve = RotaryValve(ports=ports).with_offset(math.radians(degrees))
    area = valve.collapsed_area("supply", "chamber_1")
    assert area.mean(0, TURN) / 0.4e-5 == pytest.approx((180 - abs(degrees)) / 360, abs=1e-12)
    window = valve.on_window()
    assert window.width == pytest.approx(math.radians(180 - abs(degrees)), abs=1e-9)
    if abs(degrees) < 180:
        assert window.start == pytest.approx(max(0.0, math.radians(degrees)), abs=1e-9)


def test_ports_of_a_way_add_up_and_inner_volumes_collapse_to_the_smaller_area():
    """Eqs. (1) and (2) for three ways, two volumes and five ports, against sums written out."""
    rng = np.random.default_rng(3)
    plan = [
        ("supply", "a"),
        ("supply", "a"),
        ("chamber_1", "a"),
        ("supply", "b"),
        ("chamber_1", "b"),
        ("exhaust", "b"),
    ]
    ports = tuple(
        Port(
            way=way, volume=volume, area=float(rng.uniform(1e-6, 1e-5)), discharge_coefficient=float(rng.uniform(0.3, 1)),
            window=Window(start=float(rng.uniform(0, 6)), width=float(rng.uniform(1, 5)), ramp=0.3),
        )
        for way, volume in plan
    )  # fmt: skip
    valve = RotaryValve(ports=ports)
    for angle in np.linspace(0.05, 6.2, 50):
        single = [p.discharge_coefficient * p.area * p.window.profile.at(angle) for p in ports]
        volume_a = min(single[0] + single[1], single[2])
        volume_b = min(single[3], single[4])
        assert valve.collapsed_area("supply", "chamber_1").at(angle) == pytest.approx(volume_a + volume_b, abs=1e-13)
        assert valve.collapsed_area("exhaust", "chamber_1").at(angle) == pytest.approx(
            min(single[5], single[4]), abs=1e-13
        )


def test_duty_overrides_the_geometry_and_splits_the_turn_between_phases():
    half = Window(start=1.0, width=2.0)
    on = Port(way="supply", area=1e-5, discharge_coefficient=1.0, window=half)
    off = replace(on, way="exhaust", phase="off")
    bleed = replace(on, way="chamber_1", phase="always")
    valve = RotaryValve(ports=(on, off, bleed)).with_duty(0.3)
    assert valve.window(on) == Window(start=0.0, width=0.3 * TURN)
    assert valve.window(off).profile.mean(0, TURN) == pytest.approx(0.7)
    assert valve.window(bleed).profile.mean(0, TURN) == 1.0
    assert valve.with_offset(0.0).duty is None


@pytest.mark.parametrize("duty", [0.0, 1.0])
def test_duty_zero_and_one_have_no_switching(duty):
    profile = OnOffValve(duty=duty, ramp=0.1).on_window().profile
    assert profile.angles.size == 2
    assert profile.mean(0, TURN) == duty
    assert OnOffValve(duty=duty).on_window().complement.profile.mean(0, TURN) == 1 - duty


def test_no_duty_is_no_duty():
    port = Port(way="supply", area=1e-5, discharge_coefficient=1.0, window=Window(start=0.0, width=1.0))
    with pytest.raises(TypeError, match="duty: found None"):
        RotaryValve(ports=(port,)).with_duty(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("duty", [-0.1, 1.1, math.nan, math.inf])
def test_duty_outside_zero_to_one_is_refused(duty):
    with pytest.raises(ValueError, match=r"duty: found"):
        OnOffValve(duty=duty)


def test_profiles_check_their_pieces():
    with pytest.raises(ValueError, match="rising from 0 to 2 pi"):
        Profile(angles=np.array([0.0, 1.0]), starts=np.ones(1), ends=np.ones(1))
    with pytest.raises(ValueError, match="negative opening"):
        Profile(angles=np.array([0.0, TURN]), starts=-np.ones(1), ends=np.ones(1))
    with pytest.raises(ValueError, match=r"starts: found shape \(2,\)"):
        Profile(angles=np.array([0.0, TURN]), starts=np.ones(2), ends=np.ones(1))


def test_ports_and_windows_check_their_numbers():
    window = Window(start=0.0, width=1.0)
    with pytest.raises(ValueError, match="width: found 7 rad, expected 0 to 2 pi"):
        Window(start=0.0, width=7.0)
    with pytest.raises(ValueError, match="discharge_coefficient: found 1.2"):
        Port(way="supply", area=1e-5, discharge_coefficient=1.2, window=window)
    with pytest.raises(ValueError, match="area: found -1"):
        Port(way="supply", area=-1.0, discharge_coefficient=0.5, window=window)
    with pytest.raises(ValueError, match="phase: found 'of'"):
        Port(way="supply", area=1.0, discharge_coefficient=0.5, window=window, phase="of")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="offset_angle: found 4 rad"):
        RotaryValve(ports=(Port(way="supply", area=1.0, discharge_coefficient=0.5, window=window),), offset_angle=4.0)
    with pytest.raises(ValueError, match="ports: found none"):
        RotaryValve(ports=())
