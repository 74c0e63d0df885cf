"""The sampled model from the duty, and the nonlinear machine under a controller."""

import control as ct
import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design

FREQUENCY = 15.0


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="module")
def duties(machine):
    return design.duty_map(machine, np.linspace(0.25, 0.65, 9), [FREQUENCY])


def test_the_sampled_model_is_the_derivative_of_the_nonlinear_machine(machine):
    present = machine.with_duty(0.45)
    model = design.duty_model(machine, FREQUENCY, 0.45)
    assert model.dt == pytest.approx(1 / FREQUENCY)
    orbit = lp.nonlinear_orbit(present, FREQUENCY)
    exact = lp.orbit_floquet(present, orbit)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(model.A)), np.sort_complex(exact.multipliers), atol=2e-4
    )
    # In the steady state it is the derivative of the orbit, found another way.
    slopes = lp.nonlinear_sensitivity(present, FREQUENCY, ["duty", "supply_pressure", "load.force"])
    gains = model.dcgain()
    for column, parameter in enumerate(slopes.parameters):
        assert gains[1, column] == pytest.approx(slopes.mean("position", parameter), rel=1e-3)
    pushes = machine.volume_fields[0].push_area * slopes.mean("pressure_1", "duty")
    assert gains[2, 0] == pytest.approx(pushes, rel=1e-3)


def test_the_sampled_model_follows_the_machine_from_period_to_period(machine):
    """A step of one percent of duty, period by period."""
    model = design.duty_model(machine, FREQUENCY, 0.45, inputs=["duty"])
    orbit = lp.nonlinear_orbit(machine.with_duty(0.45), FREQUENCY)
    step = 0.002
    done = lp.simulate(
        machine.with_duty(0.45), FREQUENCY, 6, orbit.initial_state, [0.45 + step] * 6, points_per_period=1
    )
    at_starts = [done.states[0][np.argmin(np.abs(done.time - k / FREQUENCY))] for k in range(7)]
    moved = np.array(at_starts) - orbit.initial_state[0]
    state, predicted = np.zeros((3, 1)), []
    for _ in range(7):
        predicted.append(state[0, 0])
        state = model.A @ state + model.B * step
    np.testing.assert_allclose(moved, predicted, atol=0.05 * np.abs(predicted).max())


def test_the_sampled_model_serves_python_controls_design(machine):
    model = design.duty_model(machine, FREQUENCY, 0.45, inputs=["duty"])
    K, _, poles = ct.dlqr(model.A, model.B, np.diag([1e4, 0.0, 0.0]), np.eye(1))
    assert np.abs(poles).max() < 1
    assert K.shape == (1, 3)
    assert ct.frequency_response(model, [1.0]).magnitude.shape[0] == 3


def test_a_locked_piston_has_no_small_signal_model(machine):
    with pytest.raises(lp.NonUniqueOrbitError, match="stiction"):
        design.duty_model(machine, 20.0, 0.7)
    with pytest.raises(ValueError, match="an orbit that repeats every"):
        design.duty_model(machine, 5.4, 0.86)


@pytest.mark.parametrize("delay", [0, 1])
def test_steps_of_ten_millimetres_settle_within_one(machine, duties, delay):
    """Up and down, with dry friction and stiction; once there the duty no longer moves."""
    wanted = np.repeat([0.045, 0.055, 0.045, 0.035, 0.045], 60)
    controller = design.PositionController(duties, FREQUENCY)
    valve = design.ValveLimits(shortest_on=5e-3, shortest_off=5e-3, delay=delay)
    done = design.simulate_closed_loop(machine, controller, wanted, FREQUENCY, valve=valve)
    settled = done.settling_periods(1e-3)
    assert all(periods is not None and periods <= 30 for periods in settled), settled
    assert done.n_held_back == 0
    for end in range(60, 301, 60):
        # No hunting: the last twenty periods of each stretch are at one duty.
        assert np.ptp(done.duties[end - 20 : end]) == 0
        assert np.ptp(done.mean_positions[end - 20 : end]) < 1e-4


def test_a_load_that_the_map_does_not_know_is_made_up_for(machine, duties):
    from dataclasses import replace

    pulled = replace(machine, load=replace(machine.load, force=-30.0))
    controller = design.PositionController(duties, FREQUENCY)
    done = design.simulate_closed_loop(pulled, controller, [0.045] * 100, FREQUENCY)
    assert abs(done.mean_positions[0] - 0.045) > 2e-3
    assert done.settling_periods(1e-3)[0] <= 30
    # A correction that may not go so far leaves the rest of the error, and no more.
    timid = design.PositionController(duties, FREQUENCY, most=0.05)
    assert design.simulate_closed_loop(pulled, timid, [0.045] * 100, FREQUENCY).settling_periods(1e-3) == [None]
    assert timid.correction == 0.05


def test_a_state_space_controller_is_an_integrator_of_the_error(machine):
    period = 1 / FREQUENCY
    integrator = ct.ss([[1.0]], [[1.0]], [[2.0]], [[0.0]], period)
    done = design.simulate_closed_loop(machine.with_duty(0.4), integrator, [0.045] * 80, FREQUENCY)
    # First seen is the mean over a period of the machine's own duty, not the position that it starts at.
    before = design.simulate_closed_loop(machine.with_duty(0.4), lambda _: 0.4, [0.045], FREQUENCY).mean_positions[0]
    errors = 0.045 - np.concatenate([[before], done.mean_positions[:-1]])
    np.testing.assert_allclose(done.commands, 0.4 + 2.0 * np.concatenate([[0.0], np.cumsum(errors)[:-1]]), atol=1e-12)
    assert abs(done.mean_positions[-1] - 0.045) < 1e-3


def test_the_first_measurement_on_a_cycle_is_that_of_the_cycle(machine):
    orbit = lp.nonlinear_orbit(machine.with_duty(0.45), FREQUENCY)
    seen = []
    design.simulate_closed_loop(
        machine.with_duty(0.45),
        lambda measured: seen.append(measured) or 0.45,
        [0.045] * 2,
        FREQUENCY,
        initial_state=orbit.initial_state,
    )
    for measured in seen:
        assert measured.mean_position == pytest.approx(orbit.mean("position"), abs=1e-6)
        assert measured.duty == pytest.approx(0.45)


def test_the_open_loop_is_the_simulation(machine):
    done = design.simulate_closed_loop(machine, lambda measured: 0.3, [0.0] * 5, 10.0)
    expected = lp.simulate(machine, 10.0, 5, duty_by_period=[0.3] * 5)
    np.testing.assert_allclose(done.response.states[0][-1], expected.states[0][-1], rtol=1e-5)


def test_delays_and_shortest_pulses_are_kept_and_counted(machine):
    valve = design.ValveLimits(shortest_on=10e-3, shortest_off=5e-3, delay=2)
    done = design.simulate_closed_loop(
        machine.with_duty(0.5), lambda measured: 0.05 if measured.number % 2 else 1.0, [0.0] * 6, 10.0, valve=valve
    )
    np.testing.assert_allclose(done.duties, [0.5, 0.5, 0.95, 0.1, 0.95, 0.1])
    np.testing.assert_allclose(done.commands, [1.0, 0.05, 1.0, 0.05, 1.0, 0.05])
    assert done.n_held_back == 4


def test_the_duty_map_finds_duties_and_says_where_it_cannot(machine, duties):
    duty = duties.duty_for(0.045, FREQUENCY)
    assert lp.nonlinear_orbit(machine.with_duty(duty), FREQUENCY).mean("position") == pytest.approx(0.045, abs=5e-4)
    with pytest.raises(ValueError, match="mean: found 500 mm, expected"):
        duties.duty_for(0.5, FREQUENCY)
    with pytest.raises(ValueError, match="frequency: found 3 Hz, expected one of the map's: 15"):
        duties.duty_for(0.045, 3.0)


def test_maps_and_closed_loops_are_drawn(machine, duties):
    done = design.simulate_closed_loop(machine, design.PositionController(duties, FREQUENCY), [0.045] * 4, FREQUENCY)
    position, duty = lp.plot(done).axes
    np.testing.assert_allclose(position.lines[0].get_ydata(), 1e3 * done.response.states[0])
    assert "duty" in duty.get_ylabel()
    mean, ripple = lp.plot(duties).axes
    np.testing.assert_allclose(mean.lines[0].get_ydata(), 1e3 * duties.means[0])
    assert "amplitude" in ripple.get_ylabel()


def test_bad_controllers_are_named(machine):
    with pytest.raises(ValueError, match="controller: found dt = 0.5"):
        design.simulate_closed_loop(machine, ct.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.5), [0.04], FREQUENCY)
    with pytest.raises(ValueError, match="controller: at 0 s: found nan"):
        design.simulate_closed_loop(machine, lambda measured: np.nan, [0.04], FREQUENCY)
    with pytest.raises(TypeError, match="controller: found int"):
        design.simulate_closed_loop(machine, 3, [0.04], FREQUENCY)
    with pytest.raises(ValueError, match="more than a period"):
        design.simulate_closed_loop(
            machine,
            lambda measured: 0.5,
            [0.04],
            FREQUENCY,
            valve=design.ValveLimits(shortest_on=0.05, shortest_off=0.05),
        )
    with pytest.raises(ValueError, match="reference: found none"):
        design.simulate_closed_loop(machine, lambda measured: 0.5, [], FREQUENCY)
    with pytest.raises(ValueError, match="inputs: found 'dutty'"):
        design.duty_model(machine, FREQUENCY, inputs=["dutty"])
    with pytest.raises(ValueError, match="delay"):
        design.ValveLimits(delay=-1)


def test_a_transfer_function_is_a_controller_like_its_state_space():
    table_1 = lp.load_machine("kunt_singh_1990")
    integrator = ct.tf([2.0, 0.0], [1.0, -1.0], 1 / 15)
    done, same = (
        design.simulate_closed_loop(table_1, law, [0.045] * 30, 15.0) for law in (integrator, ct.ss(integrator))
    )
    np.testing.assert_allclose(done.mean_positions, same.mean_positions, rtol=1e-9)
    assert done.mean_positions[-1] == pytest.approx(0.045, abs=1e-4)
    with pytest.raises(ValueError, match=r"controller: found dt = 0, expected the period"):
        design.simulate_closed_loop(table_1, ct.tf([1.0], [1.0, 1.0]), [0.045] * 3, 15.0)
