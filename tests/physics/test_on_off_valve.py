"""Delays and travel times of on-off valves: the share that is open, and when."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.profile import TURN
from ltvpneu.physics.window import Window

T = 0.05


def share(duty: float, opening: float, closing: float) -> float:
    return OnOffValve(duty=duty, opening_delay=opening, closing_delay=closing).open_share(1 / T)


def test_open_share_is_the_duty_less_the_delays() -> None:
    assert share(0.45, 0.012, 0.018) == pytest.approx(0.45 + 0.006 / T)
    assert share(0.45, 0.018, 0.012) == pytest.approx(0.45 - 0.006 / T)


@given(duty=st.floats(0, 1), opening=st.floats(0, 0.02), closing=st.floats(0, 0.02))
def test_open_share_is_zero_below_and_one_above_its_range(duty: float, opening: float, closing: float) -> None:
    found = share(duty, opening, closing)
    if duty * T <= opening * (1 - 1e-9):
        assert found == 0.0
    elif (1 - duty) * T <= closing * (1 - 1e-9):
        assert found == 1.0
    elif duty * T > opening * (1 + 1e-9) and (1 - duty) * T > closing * (1 + 1e-9):
        assert found == pytest.approx(duty - (opening - closing) / T, abs=1e-9)


def test_without_a_command_it_stays_shut_and_without_a_pause_open() -> None:
    assert share(0.0, 0.0, 0.01) == 0.0
    assert share(1.0, 0.01, 0.0) == 1.0


def test_paths_open_late_and_in_the_second_half_of_the_travel() -> None:
    valve = OnOffValve(duty=0.5, opening_delay=0.005, closing_delay=0.010, opening_time=0.004, closing_time=0.002)
    on = valve.open_window(1 / T).profile
    off = valve.open_window(1 / T).complement.profile

    def at(time: float) -> tuple[float, float]:
        return on.at(TURN * time / T), off.at(TURN * time / T)

    # The spool leaves its rest 5 ms after the command and is across, at 7 ms, with all paths shut.
    assert at(0.0045) == pytest.approx((0.0, 1.0))
    assert at(0.0060) == pytest.approx((0.0, 0.5))
    assert at(0.0070) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert at(0.0080) == pytest.approx((0.5, 0.0))
    assert at(0.0095) == pytest.approx((1.0, 0.0))
    # Off again at 25 ms: moving from 35 ms, across at 36, over at 37.
    assert at(0.0345) == pytest.approx((1.0, 0.0))
    assert at(0.0355) == pytest.approx((0.5, 0.0))
    assert at(0.0365) == pytest.approx((0.0, 0.5))
    assert at(0.0375) == pytest.approx((0.0, 1.0))


def test_short_pauses_between_pulses_are_not_noticed() -> None:
    pulses = OnOffValve(closing_delay=0.006).with_pulses(
        [(0.0, 0.2 * TURN), (0.3 * TURN, 0.5 * TURN), (0.8 * TURN, 0.85 * TURN)]
    )
    # 5 ms between the first two, 15 ms and 7.5 ms after.
    window = pulses.open_window(1 / T)
    assert window.width / TURN == pytest.approx(0.5 + 0.05 + 2 * 0.006 / T)
    late = replace(pulses, opening_delay=0.004).open_window(1 / T)
    # The last pulse lasts 2.5 ms, less than the opening delay.
    assert isinstance(late, Window)
    assert late.width / TURN == pytest.approx(0.5 + 0.002 / T)
    assert late.start / TURN == pytest.approx(0.004 / T)


def test_pause_over_the_end_of_the_turn_is_not_noticed_either() -> None:
    valve = OnOffValve(closing_delay=0.006).with_pulses([(0.05 * TURN, 0.4 * TURN), (0.6 * TURN, 0.95 * TURN)])
    window = valve.open_window(1 / T)
    assert window.width / TURN == pytest.approx(0.35 + 0.35 + 0.1 + 0.006 / T)


def test_shortest_commands_narrow_the_duty_band() -> None:
    valve = OnOffValve(opening_delay=0.002, closing_delay=0.003, shortest_on=0.005, shortest_off=0.001)
    assert valve.duty_band(20.0) == pytest.approx((0.1, 0.94))
    # Models follow the command that is given.
    assert replace(valve, duty=0.08).open_share(20.0) == pytest.approx(0.08 + 0.001 * 20)


def test_valve_without_times_is_as_told() -> None:
    valve = OnOffValve(duty=0.3, ramp=0.1, start=0.2)
    assert valve.open_window(20.0) == valve.on_window()


@pytest.mark.parametrize("name", ["opening_delay", "closing_delay", "opening_time", "closing_time"])
@pytest.mark.parametrize("value", [-1e-3, 12.0, math.nan])
def test_impossible_times_are_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        OnOffValve(**{name: value})  # pyright: ignore[reportArgumentType]
