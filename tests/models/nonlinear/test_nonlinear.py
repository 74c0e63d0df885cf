"""The nonlinear model: published-style orbits, a slow twin, stiction bands, subharmonics, stops, the paper's method."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import ltvpneu as lp
from ltvpneu.models.machine.dynamics import external_force
from tests.conftest import MACHINES
from tests.models.twin import Twin

CASES = json.loads((Path(__file__).parents[2] / "reference" / "nonlinear_orbits.json").read_text())["orbits"]


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c['rig']} {c['speed']} Hz")
def test_orbits_of_a_separate_solver_come_out_again(table_1, case):
    """Orbits of Table 1 by DOP853 with located events, closed to 1e-7; the bound asked for is 1e-3, what is met 2e-6."""
    machine = table_1 if case["rig"] == "table1" else table_1.without_dry_friction()
    orbit = lp.nonlinear_orbit(machine.with_duty(case["duty"]), frequency=float(case["speed"]))
    stroke = 2 * case["amplitude_m"]
    figures = {
        "amplitude_m": orbit.amplitude("position"),
        "x_min": orbit.minimum("position"),
        "x_max": orbit.maximum("position"),
        "x_mean": orbit.mean("position"),
    }
    for name, value in figures.items():
        assert abs(value - case[name]) < 2e-6 * stroke, name
    pressures = {"p_min": orbit.minimum, "p_max": orbit.maximum, "p_mean": orbit.mean}
    for name, figure in pressures.items():
        # At 1 Hz the pressure touches the exhaust's, where the interpolant is good to some tenths of a pascal.
        assert figure("pressure_1") == pytest.approx(case[name], rel=5e-6)
    assert orbit.is_isolated
    assert orbit.n_periods == 1


@pytest.mark.parametrize("name", list(MACHINES))
def test_one_period_from_rest_equals_the_slow_twin(name):
    machine = MACHINES[name]
    # At low speed the chambers of a double-acting cylinder rest at a source's pressure, which takes the twin minutes.
    frequency = 20.0 if len(machine.states) == 4 else 5.0
    twin = Twin(machine)
    start = machine.rest_state.copy()
    for _ in range(2):
        _, states, start = twin.period(start, frequency)
    response = lp.simulate(machine, frequency, n_periods=2, points_per_period=50, method=lp.DormandPrince(rtol=1e-10))
    scale = machine.state_scales
    # Events differ by the integrators' tolerance, and the twin's areas are rounded at the switching instants.
    np.testing.assert_allclose(response.states[:, -1] / scale, start / scale, atol=2e-6)
    low, high = states.min(axis=1), states.max(axis=1)
    second = response.states[:, response.time >= 1 / frequency - 1e-12]
    assert np.all(second.min(axis=1) >= low - 1e-4 * scale)
    assert np.all(second.max(axis=1) <= high + 1e-4 * scale)


@pytest.mark.parametrize(("frequency", "duty"), [(4.0, 0.3), (7.0, 0.7), (15.0, 0.4)])
def test_other_frequencies_and_duty_cycles_equal_the_twin(table_1, frequency, duty):
    machine = table_1.with_duty(duty)
    orbit = lp.nonlinear_orbit(machine, frequency)
    found = Twin(machine).orbit(frequency, 1, start=orbit.initial_state)
    # The twin's period map returns to the orbit's start: 2e-6 of 14 mm and of 4 bar.
    assert found["closure"] < 4e-6
    stroke = orbit.maximum("position") - orbit.minimum("position")
    assert found["max"][0] - orbit.maximum("position") == pytest.approx(0, abs=1e-4 * stroke)
    assert found["min"][0] - orbit.minimum("position") == pytest.approx(0, abs=1e-4 * stroke)
    assert found["mean"][2] == pytest.approx(orbit.mean("pressure_1"), rel=1e-4)


@pytest.mark.parametrize("name", list(MACHINES))
@pytest.mark.parametrize("frequency", [1.0, 8.0])
def test_every_orbit_closes_and_repeats_in_simulation(name, frequency):
    machine = MACHINES[name]
    orbit = lp.nonlinear_orbit(machine, frequency)
    after = lp.simulate(machine, frequency, n_periods=3 * orbit.n_periods, initial_state=orbit.initial_state)
    change = np.abs(after.states[:, -1] - orbit.initial_state) / machine.state_scales
    assert change.max() < 2e-6
    assert orbit.residual < 1e-5


def test_mass_closes_over_the_period(table_1):
    """What a chamber takes in over a period it gives off: the mean mass flow, by quadrature on the orbit, is zero."""
    from ltvpneu.models.linear.linearize import areas_at
    from ltvpneu.models.machine.dynamics import state_rate

    machine = table_1.without_dry_friction()
    orbit = lp.nonlinear_orbit(machine, 6.0, method=lp.DormandPrince(rtol=1e-11), tolerance=1e-10)
    mass_rates = []
    knots = [0.0, orbit.period / 2, orbit.period]
    nodes, weights = np.polynomial.legendre.leggauss(400)
    for begin, end in pairwise(knots):
        times = (begin + end) / 2 + (end - begin) / 2 * nodes
        for time, state in zip(times, orbit.at(times).T, strict=True):
            rate = np.empty(3)
            state_rate(
                np.ascontiguousarray(state),
                areas_at(machine, 2 * np.pi * time * 6.0),
                0,
                machine.record,
                rate,
            )
            volume = machine.cylinder.dead_volume_1 + machine.cylinder.piston_area_1 * state[0]
            mass_rates.append(rate[2] * volume + state[2] * machine.cylinder.piston_area_1 * state[1])
    gained = sum(w * m for w, m in zip(np.tile(weights, 2), mass_rates, strict=True))
    moved = sum(w * abs(m) for w, m in zip(np.tile(weights, 2), mass_rates, strict=True))
    assert abs(gained) < 1e-7 * moved


def test_a_piston_locked_by_stiction_is_reported_as_one_of_a_band(table_1):
    """Where the force swings by less than 2 F_s, any position in a band is as good: errata, 49 N against 53 N."""
    machine = table_1.with_duty(0.7)
    orbit = lp.nonlinear_orbit(machine, 20.0)
    assert not orbit.is_isolated
    assert orbit.amplitude("position") == 0
    assert set(orbit.step_labels) == {"stuck"}
    times = np.linspace(0, orbit.period, 2001)[:-1]
    forces = [external_force(np.ascontiguousarray(z), machine.record) for z in orbit.at(times).T]
    assert np.ptp(forces) == pytest.approx(49, abs=0.5)
    elsewhere = orbit.initial_state + np.array([5e-4, 0.0, 0.0])
    other = lp.nonlinear_orbit(machine, 20.0, initial_state=elsewhere)
    assert not other.is_isolated
    assert other.mean("position") != pytest.approx(orbit.mean("position"), abs=1e-5)


def test_a_piston_that_creeps_to_its_place_rests_where_simulation_leaves_it(table_1):
    """Ratcheting up by ever smaller steps, it stops for good in period 43; any shortcut would carry it past."""
    machine, frequency = table_1.with_duty(0.05), 15.831578947368422
    orbit = lp.nonlinear_orbit(machine, frequency)
    assert not orbit.is_isolated
    late = lp.simulate(machine, frequency, n_periods=80, points_per_period=1)
    assert orbit.mean("position") == pytest.approx(late.states[0, -1], abs=1e-9)


@pytest.mark.parametrize(("frequency", "duty"), [(5.41, 0.856), (5.45, 0.855), (5.4, 0.86)])
def test_a_subharmonic_orbit_is_reported_with_its_period(table_1, frequency, duty):
    orbit = lp.nonlinear_orbit(table_1.with_duty(duty), frequency)
    assert orbit.n_periods == 2
    assert orbit.period == pytest.approx(2 / frequency)
    halves = orbit.at([0.0, 1 / frequency])
    assert abs(halves[0, 0] - halves[0, 1]) > 1e-3
    # Long simulation from elsewhere ends on one of its two phases.
    late = lp.simulate(table_1.with_duty(duty), frequency, n_periods=101, points_per_period=4)
    ends = late.states[0, -1]
    assert min(abs(halves[0] - ends)) < 1e-6


@pytest.mark.parametrize("duty", [0.0, 1.0])
def test_duty_zero_and_one_come_to_rest(table_1, duty):
    orbit = lp.nonlinear_orbit(table_1.with_duty(duty), 4.0)
    assert orbit.amplitude("position") == 0
    assert not orbit.is_isolated
    free = lp.nonlinear_orbit(table_1.without_dry_friction().with_duty(duty), 4.0)
    # Supply through 6.4 mm2 against the bleed of 3.88 mm2, choked: the pressure at which the flows agree.
    flux = Twin(table_1).flux
    pressure = brentq(lambda p: 6.4 * flux(4.1e5, p, 293.15) - 3.88 * flux(p, 1e5, 293.15), 1.1e5, 4e5) if duty else 1e5
    expected = ((0.59e-3 + 0.32e-4) * pressure - (0.64e-3 - 0.32e-4) * 1e5) / 2100
    assert free.mean("position") == pytest.approx(expected, abs=1e-7)
    assert free.n_periods == 1
    assert free.is_isolated


def test_end_stops_hold_the_piston_without_rebound(table_1):
    machine = replace(table_1, cylinder=replace(table_1.cylinder, lower_stop=0.0, upper_stop=0.06))
    orbit = lp.nonlinear_orbit(machine, 2.0)
    assert orbit.maximum("position") == pytest.approx(0.06, rel=1e-15)
    assert orbit.minimum("position") == pytest.approx(0.0, abs=1e-17)
    pressed = lp.nonlinear_orbit(machine.with_duty(1.0), 2.0)
    assert pressed.mean("position") == pytest.approx(0.06, rel=1e-15)
    # Pressed against the stop by more than stiction holds: there is nowhere else to rest.
    assert pressed.is_isolated


@pytest.mark.parametrize(
    ("change", "frequency"),
    [({"dead_volume_1": 1e-2}, 20.0), ({"dead_volume_1": 1e-1}, 20.0), ({"damping": 1e4}, 10.0)],
)
def test_slow_machines_settle_on_the_same_orbit_from_either_side(table_1, change, frequency):
    """Contractions of 0.97 to 0.9999 a period: the change in a period says little of what is left to go."""
    machine = table_1.without_dry_friction()
    if "damping" in change:
        machine = replace(machine, load=replace(machine.load, viscous_damping=change["damping"]))
    else:
        machine = replace(machine, cylinder=replace(machine.cylinder, **change))
    low = lp.nonlinear_orbit(machine, frequency)
    high = lp.nonlinear_orbit(machine, frequency, initial_state=[0.08, 0.0, 3.8e5])
    assert low.mean("position") == pytest.approx(high.mean("position"), abs=1e-3 * 2 * low.amplitude("position"))
    assert low.n_periods == high.n_periods == 1


def test_a_fixed_step_that_is_too_long_is_said_to_be(table_1):
    with pytest.raises(lp.IntegrationError, match="it is too long: raise steps_per_period"):
        lp.nonlinear_orbit(table_1, 4.0, method=lp.RungeKutta4(steps_per_period=20))


def test_the_papers_runge_kutta_converges_to_the_adaptive_method(table_1):
    machine = table_1.without_dry_friction()
    exact = lp.nonlinear_orbit(machine, 4.0, method=lp.DormandPrince(rtol=1e-11)).amplitude("position")
    errors = [
        abs(lp.nonlinear_orbit(machine, 4.0, method=lp.RungeKutta4(steps_per_period=n)).amplitude("position") - exact)
        for n in (250, 500, 1000)
    ]
    # Fourth order but where the flow's slope jumps or has no bound: at least second is seen.
    assert errors[0] > 4 * errors[1] > 16 * errors[2]
    with_friction = lp.nonlinear_orbit(table_1, 4.0, method=lp.RungeKutta4(steps_per_period=4000))
    assert with_friction.amplitude("position") == pytest.approx(
        lp.nonlinear_orbit(table_1, 4.0).amplitude("position"), rel=1e-3
    )


def test_extremes_are_not_read_off_samples(table_1):
    orbit = lp.nonlinear_orbit(table_1, 4.0)
    samples = orbit.at(np.linspace(0, orbit.period, 200001))
    for row, name in enumerate(orbit.states):
        scale = np.ptp(samples[row])
        assert orbit.maximum(name) >= samples[row].max() - 1e-9 * scale
        assert orbit.minimum(name) <= samples[row].min() + 1e-9 * scale
        assert orbit.maximum(name) == pytest.approx(samples[row].max(), abs=1e-5 * scale)
        assert orbit.mean(name) == pytest.approx(samples[row].mean(), abs=1e-5 * scale)


def test_a_transient_may_have_a_duty_cycle_of_its_own_each_period(table_1):
    constant = lp.simulate(table_1.with_duty(0.4), 5.0, n_periods=3)
    listed = lp.simulate(table_1, 5.0, n_periods=3, duty_by_period=[0.4, 0.4, 0.4])
    np.testing.assert_array_equal(constant.states, listed.states)
    stopped = lp.simulate(table_1, 5.0, n_periods=3, duty_by_period=[0.4, 0.0, 1.0])
    assert stopped.states[0, -1] != constant.states[0, -1]
    assert stopped.state_labels == list(table_1.states)


# Errors
# -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frequency", [0.0, -1.0, np.inf, np.nan])
def test_frequencies_must_be_above_zero(table_1, frequency):
    for function in (lp.nonlinear_orbit, lp.simulate, lp.lti_model, lp.ltv_model):
        with pytest.raises(ValueError, match="frequency: found"):
            function(table_1, frequency)


def test_a_vanishing_volume_is_an_error_that_says_when_and_what_to_do(table_1):
    weak = replace(table_1, load=replace(table_1.load, force=-400.0))
    with pytest.raises(
        lp.ChamberVolumeError, match=r"volume of chamber_1 would reach zero at t = .*end stops"
    ) as caught:
        lp.nonlinear_orbit(weak, 4.0)
    assert caught.value.time > 0
    assert caught.value.state[0] == pytest.approx(-0.82e-5 / 0.59e-3, rel=1e-3)


def test_an_orbit_that_does_not_settle_says_so_with_its_residual(table_1):
    with pytest.raises(lp.NotSettledError, match="no periodic orbit after 3 valve periods") as caught:
        lp.nonlinear_orbit(table_1, 10.0, max_periods=3)
    assert caught.value.residual > 1e-4
    assert caught.value.n_simulated == 3
    springless = replace(table_1, load=replace(table_1.load, spring_stiffness=0.0))
    with pytest.raises(lp.NotSettledError, match="piston without a spring.*position moved by"):
        lp.nonlinear_orbit(springless, 4.0, max_periods=50)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"initial_state": [0.0, 0.0]}, "initial_state: found shape"),
        ({"initial_state": [-1.0, 0.0, 1e5]}, "volume of chamber_1 at position -1 m"),
        ({"initial_state": [0.0, 0.0, 0.0]}, "initial_state: pressure_1: found 0 Pa"),
        ({"max_periods": 0}, "max_periods: found 0"),
    ],
)
def test_bad_arguments_of_an_orbit_are_named(table_1, arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.nonlinear_orbit(table_1, 4.0, **arguments)


def test_methods_check_their_numbers():
    for rtol in (0.0, 1e-20, 1.0):
        with pytest.raises(ValueError, match="rtol: found"):
            lp.DormandPrince(rtol=rtol)
    with pytest.raises(ValueError, match=r"steps_per_period: found 1\.5"):
        lp.RungeKutta4(steps_per_period=1.5)  # type: ignore[arg-type]


def test_bad_duties_of_a_transient_are_named(table_1):
    with pytest.raises(ValueError, match=r"duty_by_period\[1\]: found 1.5"):
        lp.simulate(table_1, 4.0, n_periods=2, duty_by_period=[0.5, 1.5])
    with pytest.raises(ValueError, match="duty_by_period: found 1 values, expected n_periods = 2"):
        lp.simulate(table_1, 4.0, n_periods=2, duty_by_period=[0.5])
    stops = replace(table_1, cylinder=replace(table_1.cylinder, upper_stop=0.06))
    with pytest.raises(ValueError, match="between the end stops"):
        lp.simulate(stops, 4.0, initial_state=[0.07, 0.0, 1e5])
