"""Settled means: near the orbit. Slow machines, calls that may be stopped, orbits that do not attract."""

import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import ltvpneu as lp
from ltvpneu.models.machine.parameters import with_values
from ltvpneu.models.nonlinear.attractors import default_starts
from tests.conftest import MACHINES
from tests.models.random_machines import random_kind


def leaking(area: float) -> lp.Machine:
    """A frictionless drive with one chamber on a valve, and one that only leaks."""
    drive = lp.load_machine("double_acting_5_2")
    fed = tuple(path for path in drive.flow_paths if path.chamber == "chamber_1")
    leak = lp.FlowPath(source="exhaust", chamber="chamber_2", area=area)
    return replace(drive, flow_paths=(*fed, leak)).without_dry_friction()


def throttled(machine: lp.Machine, share: float) -> lp.Machine:
    """A rotary machine with all its areas a share of what they are."""
    assert isinstance(machine.valve, lp.RotaryValve)
    ports = tuple(replace(port, area=share * port.area) for port in machine.valve.ports)
    paths = tuple(replace(path, area=share * path.area) for path in machine.flow_paths)
    return replace(machine, valve=replace(machine.valve, ports=ports), flow_paths=paths)


def starts_of(machine: lp.Machine, count: int) -> np.ndarray:
    return default_starts(machine, count, np.random.default_rng(0))


@pytest.mark.parametrize("leak", [1e-8, 1e-10, 1e-12])
def test_a_leaking_chamber_is_empty_in_the_end_from_every_start(leak):
    # The piston is pressed on its stop, where the chamber's pressure is the exhaust's; larger leaks show it by waiting.
    machine = leaking(leak)
    for start in starts_of(machine, 2):
        orbit = lp.nonlinear_orbit(machine, 200.0, start)
        assert orbit.rest.startswith("rests on the upper stop")
        assert_allclose(orbit.mean("position"), 0.05, atol=1e-9)
        assert_allclose(orbit.mean("pressure_2"), machine.exhaust_pressure, rtol=1e-6)


@pytest.mark.parametrize("leak", [1e-8, 1e-10, 1e-12])
def test_a_leaking_chamber_that_breathes_has_one_orbit_from_every_start(leak):
    machine = leaking(leak)
    found = [lp.nonlinear_orbit(machine, 20.0, start) for start in starts_of(machine, 2)]
    for i, scale in enumerate(machine.state_scales):
        assert_allclose([orbit.mean(i) for orbit in found], found[0].mean(i), atol=2e-6 * scale)
    # One turn with tolerances of its own moves the state by no more than the distance asked for, over a slow period.
    turn = lp.PeriodMap(machine=machine, frequency=20.0, method=lp.DormandPrince(rtol=1e-13)).turn(
        found[0].initial_state
    )
    assert_allclose((turn.end - turn.start) / machine.state_scales, 0.0, atol=1e-8)


@pytest.mark.parametrize("share", [1e-3, 1e-5, 1e-8])
def test_where_a_machine_settles_does_not_depend_on_how_slow_it_is(table_1, share):
    slow = throttled(table_1, share).without_dry_friction()
    for start in starts_of(slow, 2):
        orbit = lp.nonlinear_orbit(slow, 20.0, start)
        assert_allclose(orbit.mean("pressure_1"), 302937.8, atol=0.6)
        assert_allclose(orbit.mean("position"), 0.0607749, atol=2e-7)
        assert orbit.residual < 1e-6


@pytest.mark.parametrize("leak", [1e-9, 1e-11])
def test_slow_leaks_beside_a_piston_that_sticks_are_followed_to_their_end(leak):
    machine = leaking(leak)
    sticking = replace(machine, load=replace(machine.load, dry_friction=12.0, stiction=20.0))
    orbit = lp.nonlinear_orbit(sticking, 100.0)
    assert_allclose(orbit.mean("pressure_2"), machine.exhaust_pressure, rtol=1e-5)
    assert orbit.rest.startswith("rests on the upper stop")


def test_the_residual_is_the_distance_from_the_orbit(table_1):
    machine = table_1.without_dry_friction()
    close = lp.nonlinear_orbit(machine, 12.0, tolerance=1e-10, method=lp.DormandPrince(rtol=1e-12))
    loose = lp.nonlinear_orbit(machine, 12.0, tolerance=1e-2, method=lp.DormandPrince(rtol=1e-12))
    apart = np.max(np.abs(loose.initial_state - close.initial_state) / machine.state_scales)
    assert 1e-6 < loose.residual <= 1e-2
    assert loose.residual < 3 * apart + 1e-9
    assert apart < 1e-2


@pytest.mark.parametrize("frequency", [2.0, 5.4, 12.0, 33.0])
@pytest.mark.parametrize("name", ["frictionless", "polytropic", "double-acting, free", "in series"])
def test_orbits_come_back_to_their_start(name, frequency):
    machine = MACHINES[name]
    orbit = lp.nonlinear_orbit(machine, frequency)
    # Errors of integration are larger than the distance from the orbit, at the default tolerances.
    method = lp.DormandPrince(rtol=1e-11)
    turn = lp.PeriodMap(machine=machine, frequency=frequency, n_periods=orbit.n_periods, method=method).turn(
        orbit.initial_state
    )
    assert_allclose((turn.end - turn.start) / machine.state_scales, 0.0, atol=1e-6)


def test_orbits_of_many_periods_are_found(table_1):
    assert lp.nonlinear_orbit(table_1.with_duty(0.86), 5.4).n_periods == 2


# Limits
# -------------------------------------------------------------------------------------------------------------------


def endless() -> lp.Machine:
    """A piston that drifts between stops a kilometre apart."""
    drive = lp.load_machine("double_acting_5_2")
    cylinder = replace(drive.cylinder, dead_volume_1=1e4, dead_volume_2=1e4, lower_stop=-1e6, upper_stop=1e6)
    load = replace(drive.load, spring_stiffness=0.0, dry_friction=0.0, stiction=0.0)
    return replace(drive, cylinder=cylinder, load=load)


def interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def test_a_call_that_takes_long_can_be_interrupted():
    lp.simulate(endless(), 50.0, 1, method=lp.RungeKutta4())
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.5)
        with pytest.raises(KeyboardInterrupt):
            lp.simulate(endless(), 0.001, method=lp.RungeKutta4(steps_per_period=4_000_000))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_call_ends_when_its_time_is_over():
    with pytest.raises(lp.TimeLimitError, match=r"max_seconds: 0.2 s are over.*valve periods simulated") as caught:
        lp.simulate(endless(), 0.001, max_seconds=0.2, method=lp.RungeKutta4(steps_per_period=4_000_000))
    assert caught.value.seconds == 0.2
    machine = lp.load_machine("kunt_singh_1990")
    with pytest.raises(ValueError, match="max_seconds: found -1 s"):
        lp.nonlinear_orbit(machine, 4.0, max_seconds=-1)
    with pytest.raises(lp.TimeLimitError, match="of linear steps marched"):
        lp.ltv_model(machine, 4.0, operating_points="fitted", max_seconds=1e-9)
    with pytest.raises(lp.TimeLimitError, match="1 of 17 starts"):
        lp.attractors(machine, 4.0, max_seconds=1e-9)
    ticks: list[int] = []
    lp.ltv_model(machine, 4.0, operating_points="fitted", progress=ticks.append)
    assert len(ticks) > 3


def test_a_pause_within_a_period_leaves_no_trace(table_1, monkeypatch):
    from ltvpneu.models.nonlinear import periods

    whole = lp.simulate(table_1, 4.0, 2, method=lp.RungeKutta4())
    monkeypatch.setattr(periods, "CHUNK", 7)
    cut = lp.simulate(table_1, 4.0, 2, method=lp.RungeKutta4())
    assert_allclose(cut.states, whole.states, rtol=1e-12)
    adaptive = lp.nonlinear_orbit(table_1, 4.0)
    assert_allclose(adaptive.amplitude(0), 0.0352831, rtol=1e-4)


# Orbits that do not attract
# -------------------------------------------------------------------------------------------------------------------


def test_an_orbit_that_does_not_attract_is_found_where_it_is_asked_for(table_1):
    machine = table_1.with_duty(0.86)
    attracting = lp.nonlinear_orbit(machine, 5.4)
    assert attracting.n_periods == 2
    lost = lp.nonlinear_orbit(machine, 5.4, attracting.initial_state, stable_only=False)
    assert lost.n_periods == 1
    assert lost.residual < 1e-7
    found = lp.orbit_floquet(machine, lost)
    assert found.multipliers[0].real < -1.0
    turn = lp.PeriodMap(machine=machine, frequency=5.4).turn(lost.initial_state)
    assert_allclose((turn.end - turn.start) / machine.state_scales, 0.0, atol=1e-6)


def test_newtons_method_finds_the_orbit_that_attracts_too(table_1):
    for frequency in (4.0, 15.0):
        one = lp.nonlinear_orbit(table_1, frequency)
        other = lp.nonlinear_orbit(table_1, frequency, one.initial_state * 1.01, stable_only=False)
        assert_allclose(other.initial_state, one.initial_state, atol=1e-6 * table_1.state_scales.max())


def test_where_no_orbit_is_near_that_is_said():
    drive = replace(endless(), cylinder=replace(endless().cylinder, lower_stop=-math.inf, upper_stop=math.inf))
    heavy = replace(drive, load=replace(drive.load, force=1e4))
    with pytest.raises(lp.NotSettledError, match="no orbit next to the start by Newton's method") as caught:
        lp.nonlinear_orbit(heavy, 50.0, stable_only=False)
    assert caught.value.residual > 0


# The period map
# -------------------------------------------------------------------------------------------------------------------


def differences(period: lp.PeriodMap, start: np.ndarray) -> np.ndarray:
    columns = []
    for j, scale in enumerate(period.machine.state_scales):
        move = np.zeros(start.size)
        move[j] = 1e-6 * scale
        columns.append((period.turn(start + move).end - period.turn(start - move).end) / (2e-6 * scale))
    return np.array(columns).T


@pytest.mark.parametrize("name", ["table 1", "ramped in series", "polytropic", "double-acting"])
@pytest.mark.parametrize("n_periods", [1, 2])
def test_the_derivative_of_the_period_map_is_that_of_differences(name, n_periods):
    machine = MACHINES[name]
    period = lp.PeriodMap(machine=machine, frequency=7.0, n_periods=n_periods, method=lp.DormandPrince(rtol=1e-12))
    scales = np.array(machine.state_scales)
    start = lp.nonlinear_orbit(machine, 7.0).initial_state + 1e-3 * scales
    found = period.derivative(period.turn(start)) * scales / scales[:, None]
    assert_allclose(found, differences(period, start) * scales / scales[:, None], atol=3e-5)


def test_the_derivative_over_parameters_is_that_of_differences(table_1):
    period = lp.PeriodMap(machine=table_1, frequency=7.0, method=lp.DormandPrince(rtol=1e-11))
    turn = period.turn(lp.nonlinear_orbit(table_1, 7.0).initial_state)
    found = period.parameter_derivative(turn, ["load.mass", "duty", "frequency"])
    assert found.shape == (3, 3)
    heavier, lighter = (
        replace(table_1, load=replace(table_1.load, mass=table_1.load.mass + step)) for step in (1e-3, -1e-3)
    )
    ends = [
        lp.PeriodMap(machine=one, frequency=7.0, method=period.method).turn(turn.start).end
        for one in (heavier, lighter)
    ]
    assert_allclose(found[:, 0], (ends[0] - ends[1]) / 2e-3, rtol=1e-3)
    with pytest.raises(ValueError, match="no 'weight'"):
        period.parameter_derivative(turn, ["load.weight"])
    assert period.parameter_derivative(turn, []).shape == (3, 0)


def test_a_turn_names_its_events(table_1, double_acting):
    turn = lp.PeriodMap(machine=table_1, frequency=8.0).turn(lp.nonlinear_orbit(table_1, 8.0).initial_state)
    assert turn.sequence == ("reverses", "switches", "reverses")
    assert [event.time for event in turn.events] == sorted(event.time for event in turn.events)
    whole = lp.PeriodMap(machine=double_acting, frequency=0.5).turn(
        lp.nonlinear_orbit(double_acting, 0.5).initial_state
    )
    assert "meets the upper stop" in whole.sequence
    assert "breaks away" in whole.sequence
    assert "2" in repr(lp.PeriodMap(machine=table_1, frequency=8.0, n_periods=2))


def test_a_period_map_refuses_what_it_cannot_map(table_1):
    with pytest.raises(ValueError, match="frequency: found 0 Hz"):
        lp.PeriodMap(machine=table_1, frequency=0.0)
    with pytest.raises(ValueError, match="n_periods: found 0"):
        lp.PeriodMap(machine=table_1, frequency=1.0, n_periods=0)
    with pytest.raises(ValueError, match="start: pressure_1: found -1 Pa"):
        lp.PeriodMap(machine=table_1, frequency=1.0).turn([0.0, 0.0, -1.0])


@pytest.mark.parametrize("seed", range(40, 64))
def test_what_a_model_says_of_its_cycle_is_so_on_the_machine(seed):
    machine, frequency = random_kind(np.random.default_rng(seed))
    try:
        orbit = lp.nonlinear_orbit(machine, frequency, max_periods=1000)
        model = lp.ltv_model(machine, frequency, operating_points="fitted", max_seconds=20)
    except lp.LtvpneuError:
        return
    estimate = model.error_estimate
    if not estimate.is_reliable or "several" in estimate.verdict:
        return
    assert model.orbit.n_periods == orbit.n_periods
    for what in ("amplitude", "mean"):
        true = getattr(model.orbit, what)(0) - getattr(orbit, what)(0)
        slack = 2e-3 * max(orbit.amplitude(0), 1e-3 * machine.state_scales[0])
        assert abs(getattr(estimate, what)(0) - true) <= 0.5 * abs(true) + slack


@pytest.mark.parametrize("most", [38, 39, 40, 41])
def test_a_state_that_repeats_at_the_last_period_allowed_ends_the_search(most):
    # Of this one the last of 40 periods repeats, without being near an orbit: one more leads there.
    drive = with_values(lp.load_machine("double_acting_5_2"), {"load.spring_stiffness": 2e3})
    start = [0.013246662440558093, -2.0468138633521473, 276570.8836639049, 460446.3731707513]
    method = lp.DormandPrince(rtol=1e-5)
    try:
        found = lp.nonlinear_orbit(
            drive.with_duty(0.46819930555555556), 12.0, start, method=method, tolerance=1e-6, max_periods=most
        )
    except lp.NotSettledError as error:
        assert f"after {most} valve periods" in str(error)  # noqa: PT017 - or it settles, here or elsewhere
    else:
        assert found.n_simulated <= most
