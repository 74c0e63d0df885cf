"""Duty optimization: against sweeps on the same model, its own conditions of optimality, and the nonlinear machine."""

import dataclasses
import math

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import brentq

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.errors import LtvpneuError, NotConvexError
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.cycles.linear_cycles import LinearCycles
from ltvpneu.models.cycles.nonlinear_cycles import NonlinearCycles
from ltvpneu.models.machine.parameters import present_value, with_values

FIGURES = [Figure("mean", 0), Figure("minimum", 0), Figure("maximum", 0), Figure("air_use")]


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


def sweep(machine, frequency, n_points=400):
    cycles, found = LinearCycles(machine, frequency), []
    for duty in np.linspace(0.02, 0.98, n_points):
        try:
            found.append(cycles.figures({"duty": duty}, FIGURES, []).values)
        except LtvpneuError:
            continue
    return np.array(found)


@pytest.mark.parametrize("frequency", [5.0, 6.0, 8.0, 14.0, 18.0])
def test_no_worse_than_a_sweep_on_random_feasible_targets(machine, frequency):
    values = sweep(machine, frequency)
    means, amplitudes, flows = values[:, 0], (values[:, 2] - values[:, 1]) / 2, values[:, 3]
    random = np.random.default_rng(int(frequency))
    moving = np.flatnonzero(amplitudes > 1e-3)
    size = machine.state_scales[0]
    for number in range(10):
        chosen = random.choice(moving)
        mean, amplitude = float(means[chosen]), float(amplitudes[chosen])
        if number % 3 == 0:
            goals = {"mean": {"position": mean}, "minimize": "mean_error"}
            objective, allowed = ((means - mean) / size) ** 2, np.full(means.size, True)
        elif number % 3 == 1:
            goals = {"mean": {"position": (mean - 2e-3, mean + 2e-3)}, "minimize": "amplitude"}
            objective, allowed = amplitudes, np.abs(means - mean) <= 2e-3
        else:
            goals = {"mean": {"position": (mean, None)}, "amplitude": {"position": amplitude}, "minimize": "air_use"}
            objective, allowed = flows, (means >= mean) & (amplitudes <= amplitude)
        found = design.optimize_duty(machine, frequency, **goals)
        best = float(np.min(objective[allowed]))
        assert found.objective <= best + 1e-7 * abs(best) + 1e-9, (number, found)
        assert max(found.constraints.values(), default=0.0) <= 1e-6 * size
        if found.status == "optimal":
            assert found.residual <= 1e-6
        for before, after in found.merits:
            assert after <= before


def test_two_settings_against_a_sweep(machine):
    cycles, best = LinearCycles(machine, 8.0), math.inf
    for duty in np.linspace(0.1, 0.9, 20):
        for frequency in np.linspace(6.0, 14.0, 20):
            try:
                mean, low, high, flow = cycles.figures({"duty": duty, "frequency": frequency}, FIGURES, []).values
            except LtvpneuError:
                continue
            if abs(mean - 0.05) <= 1e-3 and (high - low) / 2 <= 8e-3:
                best = min(best, flow)
    found = design.optimize_duty(
        machine, (6.0, 14.0), {"duty": (0.1, 0.9)}, mean={"position": (0.049, 0.051)}, amplitude={"position": 8e-3},
        minimize="air_use",
    )  # fmt: skip
    assert found.status == "optimal"
    assert found.objective <= best
    assert 0 < found.spectral_radius < 1


def test_the_residual_is_that_of_the_problem(machine):
    """KKT conditions by hand: two goals active in two settings, gradients by differences of whole cycles."""
    found = design.optimize_duty(
        machine, (6.0, 18.0), mean={"position": 0.045}, amplitude={"position": 4e-3}, minimize="air_use"
    )
    cycles, names = LinearCycles(machine, 8.0), ["duty", "frequency"]

    def gradient(figure):
        slopes = []
        for name in names:
            step = 1e-4 * found.values[name]
            up, down = (
                cycles.figures({**found.values, name: found.values[name] + side * step}, [figure], []).values[0]
                for side in (1, -1)
            )
            slopes.append((up - down) / (2 * step))
        return np.array(slopes)

    flow, mean = gradient(FIGURES[3]), gradient(FIGURES[0])
    amplitude = (gradient(FIGURES[2]) - gradient(FIGURES[1])) / 2
    left = flow + found.duals["mean position"] * mean + found.duals["amplitude position"] * amplitude
    widths = np.array([0.96, 12.0])
    assert np.max(np.abs(left * widths)) < 1e-4 * np.max(np.abs(flow * widths))
    assert found.duals["amplitude position"] > 0
    assert set(found.active) == {"mean position", "amplitude position"}
    # A dual is what one more unit of its bound saves.
    looser = design.optimize_duty(
        machine, (6.0, 18.0), mean={"position": 0.045}, amplitude={"position": 4.02e-3}, minimize="air_use"
    )
    saved = (found.objective - looser.objective) / 2e-5
    assert saved == pytest.approx(found.duals["amplitude position"], rel=0.05)


def test_an_optimum_on_a_kink_is_one(machine):
    """Least air at 45 mm lies where the piston begins to rest within its cycle; a line along the goal shows it."""
    found = design.optimize_duty(
        machine, (10.0, 30.0), mean={"position": 0.045}, amplitude={"position": 2e-3}, minimize="air_use"
    )
    assert (found.status, found.at_kink) == ("optimal", True)
    assert found.residual < 1e-6
    beside = []
    for frequency in found.frequency * (1 + np.array([-0.02, -1e-3, 1e-3, 0.02])):
        cycles = LinearCycles(machine, frequency)

        def off(duty, cycles=cycles):
            return cycles.figures({"duty": duty}, FIGURES, []).values[0] - 0.045

        duty = brentq(off, found.values["duty"] - 0.03, found.values["duty"] + 0.03, xtol=1e-10)
        beside.append(cycles.figures({"duty": duty}, FIGURES, []).values[3])
    assert min(beside) > found.objective
    # A kink, no valley: the slope does not shrink with the distance.
    near, far = (beside[1] - found.objective) / 1e-3, (beside[0] - found.objective) / 0.02
    assert near > 0.3 * far


def test_45_mm_at_8_hz_on_the_nonlinear_machine(machine):
    found = design.optimize_duty(machine, 8.0, mean={"position": 0.045}, correct=True)
    assert found.status == "optimal"
    assert abs(found.nonlinear["nominal"].mean("position") - 0.045) < 2e-3
    assert abs(found.corrected.nonlinear["nominal"].mean("position") - 0.045) < 1e-4
    again = lp.nonlinear_orbit(found.corrected.machine, 8.0)
    assert abs(again.mean("position") - 0.045) < 1e-4
    assert found.model.system.n_steps >= 2


def test_several_pulses(machine):
    pulsed = machine.with_pulses([(0.0, 0.7), (math.pi / 2, 2.4), (math.pi, 4.0), (1.5 * math.pi, 5.6)])
    problem = design.duty_problem(pulsed, 2.0)
    assert list(problem.bounds) == ["off_1", "on_2", "off_2", "on_3", "off_3", "on_4", "off_4"]
    cycle = problem.nominal
    goals = {"mean": cycle.mean("position") == 0.045, "ripple": cycle.amplitude("position") <= 25e-3}
    found = problem.solve(cp.Minimize(cycle.air_use()), goals, start={})
    assert found.status == "optimal"
    assert found.residual < 1e-6
    edges = [0.0, *found.values.values()]
    assert (np.diff(edges) >= 2 * math.pi * 1.9e-3).all()
    orbit = lp.nonlinear_orbit(found.machine, 2.0)
    assert orbit.mean("position") == pytest.approx(0.045, abs=2e-3)
    assert orbit.amplitude("position") <= 27e-3
    at_start = LinearCycles(pulsed, 2.0).figures({}, FIGURES, []).values
    assert found.objective < at_start[3] or abs(at_start[0] - 0.045) > 1e-3


def test_tracking_and_a_user_s_own_problem(machine):
    wanted = lp.ltv_model(machine.with_duty(0.37), 9.0, operating_points="fitted").orbit
    angles = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    values = wanted.at(angles / (2 * math.pi * 9.0))[0]
    found = design.optimize_duty(
        machine, 9.0, minimize="tracking", goals=design.Goals(cycle={"position": (angles, values)})
    )
    assert found.values["duty"] == pytest.approx(0.37, abs=1e-4)
    problem = design.duty_problem(machine, 9.0)
    cycle = problem.nominal
    off = cp.norm_inf(cycle.at("position", angles) - values) / 1e-3
    again = problem.solve(cp.Minimize(off), {"speed": cycle.maximum("velocity") <= 10.0})
    assert again.values["duty"] == pytest.approx(0.37, abs=1e-3)


def test_an_unreachable_goal_comes_back_with_the_nearest(machine):
    found = design.optimize_duty(machine, 8.0, mean={"position": 0.12})
    assert found.status == "infeasible"
    assert math.isnan(found.objective)
    reached = 0.12 - found.constraints["mean position"]
    assert reached == pytest.approx(float(sweep(machine, 8.0, 100)[:, 0].max()), abs=1e-3)
    assert found.nonlinear_constraints["mean position"] == pytest.approx(0.12 - reached, abs=2e-3)


def test_scenarios_are_borne_together(machine):
    def low(one):
        return one.with_supply_pressure(0.95 * one.supply_pressure)

    goals = {"mean": {"position": (0.042, 0.05)}, "minimize": "amplitude"}
    alone = design.optimize_duty(machine, 12.0, **goals)
    both = design.optimize_duty(machine, 12.0, scenarios={"low": low}, **goals)
    assert both.status == "optimal"
    assert both.objective >= alone.objective - 1e-9
    for name, orbit in both.nonlinear.items():
        assert 0.042 - 1e-4 < orbit.mean("position") < 0.05 + 1e-4, name
    assert both.scenario_machines["low"].supply_pressure == pytest.approx(0.95 * machine.supply_pressure)


def test_valve_limits_and_commands(machine):
    valve = design.ValveLimits(shortest_on=0.03, opening_delay=4e-3, closing_delay=7e-3)
    found = design.optimize_duty(machine, 8.0, mean={"position": (0.0, 0.06)}, minimize="air_use", valve=valve)
    ((on, off),) = found.commands
    assert off - on == pytest.approx(0.03, abs=1e-6)
    assert found.values["duty"] / 8.0 == pytest.approx(0.03 - 4e-3 + 7e-3, abs=1e-6)
    assert valve.open_share((off - on) * 8.0, 8.0) == pytest.approx(found.values["duty"], abs=1e-6)
    assert (valve.open_share(0.01, 8.0), valve.open_share(0.99, 8.0)) == (0.0, 1.0)


def test_a_global_search_bounds_what_is_left(machine):
    found = design.optimize_duty(machine, 8.0, mean={"position": (0.03, 0.045)}, minimize="air_use", globally=True)
    assert found.status == "optimal"
    assert found.lower_bound <= found.objective <= found.lower_bound * (1 + 5e-3)
    values = sweep(machine, 8.0)
    inside = (values[:, 0] >= 0.03) & (values[:, 0] <= 0.045)
    assert found.objective <= values[inside, 3].min() + 1e-9
    assert found.lower_bound <= values[inside, 3].min()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"mean": {"positon": 0.04}}, "did you mean 'position'"),
        ({"minimize": "air"}, "did you mean 'air_use'"),
        ({"variables": {"dutty": (0.1, 0.9)}}, "did you mean 'duty'"),
        ({"variables": {"duty": (0.9, 0.1)}}, "expected the lower one first"),
        ({"variables": {"duty": (0.5, 1.2)}}, "expected 0 to 1"),
        ({"mean": {"position": (0.05, 0.04)}}, "contradict"),
        ({"goals": design.Goals(minimum={"position": 0.05}, maximum={"position": 0.04})}, "contradict"),
        ({"minimize": "mean_error"}, "without wanted means"),
        ({"minimize": "tracking"}, "without a wanted cycle"),
        ({"valve": design.ValveLimits(shortest_on=0.1, shortest_off=0.1)}, "more than a period"),
        ({"variables": {"off_2": (0.1, 0.9)}}, "the valve has 1 pulses"),
        ({"model": "frozen"}, 'expected "fitted"'),
        ({"variables": {"supply_pressure": (1e4, 5e5)}}, "below the exhaust pressure"),
        ({"variables": {"duty": (0.1, 0.9), "off_1": (1.0, 5.0)}}, "set the same switching"),
        ({"variables": {"duty": (0.1, 0.9), "offset_angle": (0.0, 1.0)}}, "set the same switching"),
        ({"variables": {"frequency": (-4.0, 20.0)}}, "frequency: found -4 Hz"),
        ({"minimize": "mean_error", "mean": {"position": (0.05, 0.04)}}, "contradict each other"),
        ({"goals": design.Goals(cycle={"position": ([0.0], [0.04])})}, 'expected minimize="tracking"'),
    ],
)
def test_bad_input_is_named(machine, call, message):
    with pytest.raises(ValueError, match=message):
        design.optimize_duty(machine, 8.0, **call)


def test_what_is_not_convex_is_refused_with_the_reason(machine):
    problem = design.duty_problem(machine, 8.0)
    with pytest.raises(NotConvexError, match="ripple"):
        problem.solve(cp.Minimize(0), {"ripple": problem.nominal.amplitude("position") >= 1e-3})
    with pytest.raises(TypeError, match="comparison"):
        problem.solve(
            cp.Minimize(0), {"cone": cp.SOC(problem.nominal.mean("position"), problem.nominal.at("position", [0.0]))}
        )
    with pytest.raises(ValueError, match="expected duty"):
        problem.solve(cp.Minimize(0), start={"phase": 1.0})
    with pytest.raises(ValueError, match="found 5 for 'duty', expected 0.02 to 0.98"):
        problem.solve(cp.Minimize(0), start={"duty": 5.0})
    bound = cp.Variable()
    with pytest.raises(ValueError, match="none of this problem's"):
        problem.solve(cp.Minimize(bound), {"ripple": problem.nominal.amplitude("position") <= bound})
    with pytest.raises(TypeError, match="'bad' returned NoneType"):
        design.duty_problem(machine, 8.0, scenarios={"bad": lambda one: None})
    with pytest.raises(ValueError, match="expected their edges"):
        design.duty_problem(machine.with_pulses([(0.0, 0.5), (3.0, 4.5)]), 8.0, {"duty": (0.1, 0.9)})


def test_limits_that_leave_nothing_are_named(machine):
    problem = design.duty_problem(machine, 8.0, {"duty": (0.1, 0.2)}, valve=design.ValveLimits(shortest_on=0.05))
    with pytest.raises(ValueError, match="contradict each other"):
        problem.solve(cp.Minimize(problem.nominal.air_use()))


def test_where_stiction_holds_everywhere_the_reason_is_given(machine):
    with pytest.raises(LtvpneuError, match="stiction holds"):
        design.optimize_duty(machine, 20.0, {"duty": (0.7, 0.72)}, mean={"position": 0.07})


def test_a_scenario_changes_the_machine_with_its_variables_set(machine):
    """A free supply pressure that may be 30 % low: not the same pressure in both."""
    problem = design.duty_problem(
        machine, 12.0, {"duty": (0.2, 0.8), "supply_pressure": (3.5e5, 6e5)},
        scenarios={"low": lambda one: one.with_supply_pressure(0.9 * one.supply_pressure)},
    )  # fmt: skip
    means = {name: cycle.mean("position") for name, cycle in problem.scenarios.items()}
    goals = {f"least {name}": mean >= 0.035 for name, mean in means.items()}
    goals |= {f"most {name}": mean <= 0.055 for name, mean in means.items()}
    found = problem.solve(cp.Minimize(problem.nominal.amplitude("position")), goals, start={"duty": 0.45})
    low = found.scenario_machines["low"]
    assert low.supply_pressure == pytest.approx(0.9 * found.values["supply_pressure"], rel=1e-12)
    for name, orbit in found.nonlinear.items():
        assert 0.035 - 1e-3 < orbit.mean("position") < 0.055 + 1e-3, name
    assert found.nonlinear["low"].mean("position") < found.nonlinear["nominal"].mean("position") - 1e-3
    # And its derivatives are those of the changed machine.
    for kind in (LinearCycles, NonlinearCycles):
        cycles = kind(machine, 12.0, change=lambda one: one.with_supply_pressure(0.9 * one.supply_pressure))
        at = {"supply_pressure": 4.5e5, "duty": 0.45}
        slope = cycles.figures(at, FIGURES, ["supply_pressure"]).jacobian[:, 0]
        up, down = (cycles.figures({**at, "supply_pressure": p}, FIGURES, []).values for p in (4.502e5, 4.498e5))
        np.testing.assert_allclose(slope, (up - down) / 400, rtol=2e-3)


def test_commands_last_as_long_as_the_valve_needs(machine):
    both = design.ValveLimits(opening_delay=0.02, closing_delay=0.02)
    found = design.optimize_duty(machine, 8.0, minimize="air_use", valve=both)
    assert both.open_share((found.commands[0][1] - found.commands[0][0]) * 8.0, 8.0) == pytest.approx(
        found.values["duty"], abs=1e-6
    )
    long = design.ValveLimits(shortest_on=0.04)
    for variables in ({"duty": (0.02, 0.98), "frequency": (4.0, 20.0)}, {"frequency": (4.0, 20.0)}):
        found = design.optimize_duty(machine, 8.0, variables, mean={"position": (0.035, 0.06)}, valve=long)
        on, off = found.commands[0]
        assert off - on >= 0.04 - 1e-9, variables
    pulsed = machine.with_pulses([(0.0, 0.5), (3.0, 4.5)])
    found = design.optimize_duty(
        pulsed, (4.0, 20.0), {"off_2": (3.2, 6.0)}, valve=design.ValveLimits(shortest_on=0.015)
    )
    assert all(off - on >= 0.015 - 1e-9 for on, off in found.commands)
    with pytest.raises(ValueError, match="pulse 1 lasts"):
        design.duty_problem(pulsed, 20.0, {"off_2": (3.2, 6.0)}, valve=design.ValveLimits(shortest_on=0.02))


def test_the_offset_is_free_from_zero_on(machine):
    found = design.optimize_duty(
        machine, 8.0, {"offset_angle": (0.0, 2.4)}, mean={"position": 0.035}, minimize="air_use"
    )
    assert found.status == "optimal"
    assert found.nonlinear["nominal"].mean("position") == pytest.approx(0.035, abs=1e-3)


def test_switching_counts_pulses_of_ramped_valves_too(double_acting):
    pulsed = double_acting.with_pulses([(0.5, 1.5), (3.0, 4.5)])
    assert design.duty_problem(pulsed, 15.0).switching().value == pytest.approx(30.0)


def test_duals_say_what_a_looser_bound_is_worth(machine):
    """For either side of an inequality, and with either sense of the objective."""
    problem = design.duty_problem(machine, 8.0)
    mean, worst = problem.nominal.mean("position"), problem.nominal.maximum("position")

    def ask(bound):
        return (
            problem.solve(cp.Minimize(1e3 * problem.nominal.air_use()), {"c": mean >= bound}),
            problem.solve(cp.Maximize(1e3 * mean), {"c": worst <= bound + 0.02}),
        )

    (air, reach), (more_air, further) = ask(0.045), ask(0.0451)
    # The first bound got tighter, the second looser.
    assert air.duals["c"] == pytest.approx((more_air.objective - air.objective) / 1e-4, rel=0.05)
    assert reach.duals["c"] == pytest.approx((further.objective - reach.objective) / 1e-4, rel=0.05)


def test_a_correction_that_fails_leaves_the_linear_optimum(machine):
    found = design.optimize_duty(
        machine, 37.5125, {"duty": (0.40, 0.41)}, mean={"position": (0.03, 0.05)}, correct=True
    )
    assert found.status == "optimal"
    assert (found.corrected is None) == bool(found.not_corrected)


def test_settings_follow_parameters_as_optima_beside_do(machine):
    def best(machine, **more):
        return design.optimize_duty(
            machine, (6.0, 18.0), mean={"position": 0.045}, amplitude={"position": 4e-3}, minimize="air_use", **more
        )

    names = ["supply_pressure", "load.mass", "load.dry_friction"]
    found = best(machine, slopes=names)
    for name in names:
        value = present_value(machine, 10.0, name)
        ends = [best(with_values(machine, {name: share * value})) for share in (1.01, 0.99)]
        for variable, slope in found.setting_slopes[name].items():
            expected = (ends[0].values[variable] - ends[1].values[variable]) / (0.02 * value)
            assert slope == pytest.approx(expected, rel=2e-2), (name, variable)


def test_speed_impact_and_life_are_goals(machine):
    goals = design.Goals(speed=0.15, impact_energy=0.02, life=(500.0, 50e6))
    found = design.optimize_duty(machine, (6.0, 40.0), goals=goals, mean={"position": (0.03, 0.06)}, minimize="air_use")
    assert found.status == "optimal"
    orbit = found.nonlinear["nominal"]
    speed = max(orbit.maximum("velocity"), -orbit.minimum("velocity"))
    assert speed <= 0.15 * 1.001
    assert machine.load.mass * speed**2 / 2 <= 0.02 * 1.002
    assert found.frequency <= 50e6 / 500 / 3600 + 1e-6
    # Each of them holds the design, or none would be needed: the frequency is at what the life allows, or the speed.
    assert found.frequency == pytest.approx(50e6 / 500 / 3600) or speed == pytest.approx(0.15, rel=1e-3)
    faster = design.optimize_duty(
        machine, (6.0, 40.0), goals=design.Goals(speed=(0.4, None)), mean={"position": (0.03, 0.06)}, minimize="air_use"
    )
    assert faster.nonlinear["nominal"].amplitude("velocity") >= 0.4 * 0.999


@pytest.mark.parametrize(
    ("goals", "said"),
    [
        ({"speed": -1.0}, "speed"),
        ({"speed": (2.0, 1.0)}, "contradict"),
        ({"impact_energy": 0.0}, "impact_energy"),
        ({"life": 1000.0}, "expected hours, and the switches"),
        ({"life": (1000.0, -5.0)}, "life: switches"),
    ],
)
def test_bad_named_goals(machine, goals, said):
    with pytest.raises(ValueError, match=said):
        design.optimize_duty(machine, 12.0, goals=design.Goals(**goals))


def test_two_valves_have_duties_of_their_own():
    parts = lp.catalogue()
    load = lp.Load(mass=3.0, spring_stiffness=4e3, spring_preload=-200.0, viscous_damping=60.0)
    drive = lp.catalogue_drive(
        parts.cylinders[6], parts.valve("CKD M3GA1 2 x 3/2"), stroke=0.1, load=load, supply_pressure=7e5
    )
    both = design.optimize_duty(
        drive, 20.0, {"duty": (0.1, 0.9), "duty_2": (0.1, 0.9)}, mean={"position": 0.05}, minimize="air_use"
    )
    assert both.machine.more_valves[0].duty == pytest.approx(both.values["duty_2"])
    assert both.nonlinear["nominal"].mean("position") == pytest.approx(0.05, abs=2e-4)
    # The dotted name is the same number.
    dotted = design.optimize_duty(
        drive, 20.0, {"duty": (0.1, 0.9), "more_valves.0.duty": (0.1, 0.9)}, mean={"position": 0.05}, minimize="air_use"
    )
    assert dotted.objective == pytest.approx(both.objective, rel=1e-6)
    one = design.optimize_duty(drive, 20.0, mean={"position": 0.05}, minimize="air_use")
    assert both.objective < one.objective
    with pytest.raises(ValueError, match="of 'duty_2', expected 0 to 1"):
        design.duty_problem(drive, 20.0, {"duty_2": (0.1, 1.5)})
    with pytest.raises(ValueError, match="duty_3"):
        design.duty_problem(drive, 20.0, {"duty_3": (0.1, 0.5)})
    slow = dataclasses.replace(
        drive, more_valves=(dataclasses.replace(drive.more_valves[0], shortest_on=0.01, shortest_off=0.005),)
    )
    limits = design.duty_problem(slow, 20.0, {"duty_2": (0.1, 0.95)}).limits
    assert {"shortest pulse of valve 2", "shortest pause of valve 2"} <= set(limits)


def proportional():
    machine = lp.load_machine("double_acting_5_2").without_dry_friction()
    command = lp.Command(angles=(0.0, 2.2, 3.8), openings=(-0.8, 0.9, 0.3))
    return dataclasses.replace(machine, valve=lp.ProportionalValve(command=command))


def test_a_proportional_valves_command_is_designed_for_a_wanted_mean():
    names = "valve.command.angles.1", "valve.command.angles.2"
    problem = design.duty_problem(proportional(), 5.0, {name: (0.5, 6.0) for name in names})
    assert list(problem.limits)[-1] == f"order of {names[0]} and {names[1]}"
    found = problem.solve(
        cp.Minimize((problem.nominal.mean("position") / 1e-3 - 24) ** 2 + 1e-3 * problem.variables[names[1]]),
        n_starts=25,
    )
    # Along the settings of one mean the objective is all but flat, and slopes are good to 1e-3 of themselves.
    assert found.status == "optimal" or found.residual < 5e-6
    assert found.values[names[1]] > found.values[names[0]]
    assert found.model is not None
    assert 1e3 * found.model.orbit.mean("position") == pytest.approx(24, abs=0.1)
    # The machine is off by what the fitted model of this valve is, 4 % along all of these settings.
    assert 1e3 * found.nonlinear["nominal"].mean("position") == pytest.approx(24, rel=0.05)


def test_a_proportional_valve_has_no_edges_to_design():
    with pytest.raises(ValueError, match=r"neither duty nor pulses; expected points of its command"):
        design.duty_problem(proportional(), 5.0)
    for name in ("duty", "on_1"):
        with pytest.raises(ValueError, match=f"found '{name}' of a proportional valve"):
            design.duty_problem(proportional(), 5.0, {name: (0.1, 0.9)})


def test_short_commands_and_wide_bounds_of_the_frequency_have_an_answer(machine):
    found = design.optimize_duty(
        machine,
        (2.0, 60.0),
        mean={"position": 0.045},
        amplitude={"position": 4e-3},
        minimize="air_use",
        valve=design.ValveLimits(shortest_on=5e-3, shortest_off=5e-3),
        correct=True,
    )
    assert found.status == found.corrected.status == "optimal"
    assert max(found.corrected.constraints.values()) < 1e-6
    # What SLSQP finds on orbits of the nonlinear machine.
    assert found.corrected.objective == pytest.approx(2.27756e-3, rel=1e-4)


def test_the_better_of_two_optima_is_found_where_the_nearer_one_is_worse(machine):
    wanted = {"mean": {"position": 0.045}, "amplitude": {"position": 2e-3}, "minimize": "air_use"}
    best = design.optimize_duty(machine, (10.0, 30.0), **wanted)
    near = design.optimize_duty(machine, (10.0, 20.0), **wanted)
    assert best.status == near.status == "optimal"
    # What SLSQP finds on orbits of the nonlinear machine, from a start near each of them.
    assert 1e3 * best.objective == pytest.approx(2.26427, abs=1e-4)
    assert 1e3 * near.objective == pytest.approx(2.28327, abs=1e-4)
    assert best.at_kink
