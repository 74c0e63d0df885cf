"""The loop closed on the machine: signals, sensors, several valves, systems of several inputs, metrics."""

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


def two_valves():
    law = lp.ISO6358(sonic_conductance=0.7e-8, critical_pressure_ratio=0.3)
    valve = lp.OnOffValve(duty=0.5)
    return lp.Machine(
        name="slide", supply_pressure=7.01e5, exhaust_pressure=1.01e5,
        cylinder=lp.catalog_cylinder(bore=0.032, rod=0.012, stroke=0.1, clearance=0.1),
        load=lp.Load(mass=3.0, dry_friction=20.0, stiction=35.0), valve=valve, more_valves=(valve,),
        flow_paths=lp.directional_paths("2 x 3/2", law),
    )  # fmt: skip


def test_a_load_step_is_rejected_without_a_reset(machine, duties):
    """20 N from the fortieth period on; the integrator goes on from where it is."""
    force = np.where(np.arange(120) < 40, 0.0, -20.0)
    controller = design.PositionController(duties, frequency=FREQUENCY)
    done = design.simulate_closed_loop(machine, controller, [0.045] * 120, FREQUENCY, signals={"load.force": force})
    assert np.max(np.abs(done.errors[30:40])) < 1e-3
    assert np.max(np.abs(done.errors[40:50])) > 2e-3
    assert np.max(np.abs(done.errors[-20:])) < 1e-3
    # By hand: two runs, the second from where the first ended.
    plain = design.simulate_closed_loop(machine, lambda _: 0.42, [0.045] * 4, FREQUENCY)
    loaded = design.simulate_closed_loop(
        machine, lambda _: 0.42, [0.045] * 4, FREQUENCY, signals={"load.force": [0.0, 0.0, -20.0, -20.0]}
    )
    assert np.array_equal(plain.mean_positions[:2], loaded.mean_positions[:2])
    from ltvpneu.models.machine.parameters import with_values

    rest = design.simulate_closed_loop(
        with_values(machine, {"load.force": -20.0}), lambda _: 0.42, [0.045] * 2, FREQUENCY,
        initial_state=plain.states[2],
    )  # fmt: skip
    assert loaded.mean_positions[2:] == pytest.approx(rest.mean_positions, rel=1e-9)


def test_signals_and_references_may_be_functions_of_time(machine):
    seen = []

    def law(measured):
        seen.append(measured.reference)
        return 0.42

    done = design.simulate_closed_loop(
        machine, law, lambda time: 0.04 + 0.01 * time, FREQUENCY, n_periods=6,
        signals={"supply_pressure": lambda time: machine.supply_pressure * (1 - time)},
    )  # fmt: skip
    assert seen == pytest.approx(0.04 + 0.01 * np.arange(6) / FREQUENCY)
    constant = design.simulate_closed_loop(machine, lambda _: 0.42, 0.04, FREQUENCY, n_periods=6)
    assert done.mean_positions[-1] < constant.mean_positions[-1]


def test_a_sensor_adds_noise_steps_and_delay(machine):
    seen = []

    def law(measured):
        seen.append((measured.position, measured.mean_position, measured.state[0]))
        return 0.42

    def run(**sensor):
        seen.clear()
        done = design.simulate_closed_loop(
            machine, law, 0.04, FREQUENCY, n_periods=30, sensor=design.Sensor(**sensor)
        )  # fmt: skip
        return done, np.array(seen)

    plain, exact = run()
    assert np.array_equal(exact[:, 0], exact[:, 2])
    assert exact[1:, 1] == pytest.approx(plain.mean_positions[:-1], rel=1e-12)
    _, stepped = run(quantization=1e-3)
    assert np.allclose(stepped[:, :2] / 1e-3, np.rint(stepped[:, :2] / 1e-3), atol=1e-9)
    assert np.max(np.abs(stepped[:, 0] - exact[:, 0])) <= 0.5e-3 + 1e-12
    _, noisy = run(noise=5e-5)
    assert 2e-5 < np.std(noisy[:, 0] - exact[:, 0]) < 1e-4
    late = 0.3 / FREQUENCY
    done, old = run(delay=late)
    times = np.arange(1, 30) / FREQUENCY - late
    assert old[1:, 0] == pytest.approx(np.interp(times, done.response.time, done.response.states[0]), abs=2e-4)
    fine = np.linspace(10 / FREQUENCY - late, 11 / FREQUENCY - late, 4001)
    mean = np.mean(np.interp(fine, done.response.time, done.response.states[0]))
    assert old[11, 1] == pytest.approx(mean, abs=2e-4)
    again = run(noise=5e-5)[1]
    assert np.array_equal(again, noisy)


def test_noise_and_steps_are_tolerated(machine, duties):
    controller = design.PositionController(duties, frequency=FREQUENCY)
    done = design.simulate_closed_loop(
        machine, controller, [0.045] * 80, FREQUENCY, sensor=design.Sensor(noise=5e-5, quantization=1e-4)
    )
    assert np.max(np.abs(done.errors[-20:])) < 1e-3


def test_a_law_sets_every_valve_by_name_or_in_order():
    machine = two_valves()
    by_name = design.simulate_closed_loop(machine, lambda _: {"valve_2": False, "valve": 0.6}, 0.05, 40.0, n_periods=5)
    in_order = design.simulate_closed_loop(machine, lambda _: (0.6, 0.0), 0.05, 40.0, n_periods=5)
    assert np.array_equal(by_name.mean_positions, in_order.mean_positions)
    assert by_name.duties.shape == (5, 2)
    assert by_name.duties[0].tolist() == [0.6, 0.0]
    other = design.simulate_closed_loop(machine, lambda _: (0.0, 0.6), 0.05, 40.0, n_periods=5)
    assert other.mean_positions[-1] < by_name.mean_positions[-1]
    first_alone = design.simulate_closed_loop(machine, lambda _: 0.6, 0.05, 40.0, n_periods=2)
    assert first_alone.duties[0].tolist() == [0.6, 0.5]
    assert len(lp.plot(by_name).axes) == 2


def test_laws_of_too_few_or_too_many_values_name_the_valves():
    machine = two_valves()
    for told, said in (
        ({"valve": 0.5}, "found values for valve, expected one for each of valve, valve_2"),
        ({"valve": 0.5, "valve_3": 0.1}, "expected one for each of valve, valve_2"),
        ((0.1, 0.2, 0.3), "found 3 values, expected one for each of valve, valve_2"),
        ({"valve": np.nan, "valve_2": 0.0}, "valve: found nan"),
    ):
        with pytest.raises(ValueError, match=said):
            design.simulate_closed_loop(machine, lambda _, told=told: told, 0.05, 40.0, n_periods=2)
    with pytest.raises(ValueError, match="controller: found 3 outputs"):
        design.simulate_closed_loop(machine, ct.ss([], [], [], np.ones((3, 1)), 1 / 40.0), 0.05, 40.0, n_periods=2)


def test_commands_beyond_what_a_valve_can_do_are_counted(machine):
    done = design.simulate_closed_loop(machine, lambda _: 1.4, 0.045, FREQUENCY, n_periods=5)
    assert done.n_held_back == 5
    assert done.commands.tolist() == [1.4] * 5
    assert done.duties.tolist() == [1.0] * 5
    assert "5 commands held back" in repr(done)


def test_a_state_space_of_several_inputs_sees_them_by_name(machine):
    gains = np.array([[2.0, -0.05, 1e-8]])
    system = ct.ss([], [], [], gains, 1 / FREQUENCY, inputs=["error", "velocity", "pressure_1"], outputs=["duty"])
    done = design.simulate_closed_loop(machine, system, 0.045, FREQUENCY, n_periods=10)

    def law(m):
        seen = [m.reference - m.mean_position, m.state[1], m.state[2]]
        return machine.duty + float(gains[0] @ seen)

    same = design.simulate_closed_loop(machine, law, 0.045, FREQUENCY, n_periods=10)
    assert done.commands == pytest.approx(same.commands, rel=1e-12)
    wrong = ct.ss([], [], [], gains, 1 / FREQUENCY, inputs=["error", "speed", "pressure_1"])
    with pytest.raises(ValueError, match="found input 'speed', expected some of error, reference"):
        design.simulate_closed_loop(machine, wrong, 0.045, FREQUENCY, n_periods=2)


def test_metrics_are_those_of_their_definitions(machine, duties):
    controller = design.PositionController(duties, frequency=FREQUENCY)
    reference = [0.045] * 40 + [0.055] * 40
    done = design.simulate_closed_loop(machine, controller, reference, FREQUENCY)
    errors = np.array(reference) - done.mean_positions
    assert done.errors == pytest.approx(errors)
    assert done.rms_error == pytest.approx(np.sqrt(np.mean(errors**2)))
    ages = np.concatenate([np.arange(40), np.arange(40)]) + 0.5
    assert done.itae == pytest.approx(np.sum(ages / FREQUENCY * np.abs(errors)) / FREQUENCY)
    assert done.steady_errors(10) == pytest.approx([np.abs(errors[30:40]).max(), np.abs(errors[70:]).max()])
    assert done.overshoots()[1] == pytest.approx(max(np.max(done.mean_positions[40:]) - 0.055, 0.0))
    rise = done.rise_times()[1]
    assert rise is not None
    assert rise <= 10 / FREQUENCY
    assert done.switchings_per_second == pytest.approx(FREQUENCY)


def test_bad_signals_and_references_are_named(machine):
    def run(*given, **options):
        return design.simulate_closed_loop(machine, lambda _: 0.4, *given, FREQUENCY, **options)

    with pytest.raises(ValueError, match="n_periods: found none"):
        run(lambda time: 0.04)
    with pytest.raises(ValueError, match="signals"):
        run([0.04] * 3, signals={"load.force": [0.0, 1.0]})
    with pytest.raises(ValueError, match="'load.forse'"):
        run([0.04] * 3, signals={"load.forse": 1.0})
    with pytest.raises(ValueError, match="noise"):
        design.Sensor(noise=-1.0)
