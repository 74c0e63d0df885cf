"""LTV and LTI models: the paper's figures as read in the errata, solve_ivp, staircases, operating points."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import ltvpneu as lp
from ltvpneu.models.linear.operating_points import quasi_static_turn
from ltvpneu.models.linear.staircase import staircase
from tests.conftest import MACHINES, ramped


def amplitude(model: lp.LtvModel) -> float:
    """Of the position [mm]."""
    return 1e3 * lp.steady_state(model.system).amplitude("position")


@pytest.mark.parametrize(("frequency", "about", "alone"), [(1.0, 83, 94), (4.0, 50, 57), (10.0, 20, 23)])
def test_lti_amplitudes_of_table_1(table_1, frequency, about, alone):
    """Errata: 83 / 50 / 20 mm about zbar, 94 / 57 / 23 with G averaged alone; printed to whole millimetres."""
    assert amplitude(lp.lti_model(table_1, frequency)) == pytest.approx(about, abs=0.55)
    assert amplitude(lp.lti_model(table_1, frequency, about_operating_point=False)) == pytest.approx(alone, abs=0.5)


@pytest.mark.parametrize(("frequency", "expected"), [(1.0, 49), (2.0, 56), (4.0, 40), (6.0, 33), (8.0, 24), (10.0, 15)])
def test_ltv_amplitudes_of_table_1_from_the_lti_cycle(table_1, frequency, expected):
    """Errata, fact 6: tangents at operating points from the LTI cycle, held inside their range; whole millimetres."""
    model = lp.ltv_model(table_1, frequency)
    assert amplitude(model) == pytest.approx(expected, abs=0.5)
    assert {(h.step, h.state) for h in model.held_back} == {(0, "pressure_1")}


def test_nonlinear_amplitudes_that_the_errata_compare_with(table_1):
    machine = table_1.without_dry_friction()
    expected = {1.0: 45.541, 4.0: 39.929, 6.0: 31.43, 8.0: 22.87, 10.0: 13.972}
    for frequency, figure in expected.items():
        found = 1e3 * lp.nonlinear_orbit(machine, frequency).amplitude("position")
        # Printed digits.
        assert found == pytest.approx(figure, abs=0.01)


@pytest.mark.parametrize("frequency", [1.0, 4.0, 10.0])
def test_a_constant_position_is_more_accurate_as_the_paper_found(table_1, frequency):
    exact = 1e3 * lp.nonlinear_orbit(table_1.without_dry_friction(), frequency).amplitude("position")
    constant = abs(amplitude(lp.ltv_model(table_1, frequency)) - exact)
    assert constant < abs(amplitude(lp.ltv_model(table_1, frequency, operating_points="lti-position")) - exact)
    assert constant < abs(amplitude(lp.lti_model(table_1, frequency)) - exact)


@pytest.mark.parametrize("name", list(MACHINES))
@pytest.mark.parametrize("operating_points", ["lti", "lti-position", "mean", "quasi-static", "quasi-static-steps"])
def test_orbits_equal_solve_ivp_restarted_at_each_switch(name, operating_points):
    """To 1e-8 of each state's size, rtol 1e-10: the step maps and (14) on every machine."""
    machine = MACHINES[name]
    model = lp.ltv_model(machine, 6.0, n_steps=7, operating_points=operating_points)
    system, orbit = model.system, lp.steady_state(model.system)
    scale = np.abs(orbit.step_states).max(axis=0)
    z = orbit.initial_state / scale
    for m in range(system.n_steps):
        A, f = system.A[m] * scale / scale[:, None], system.f[m] / scale
        z = solve_ivp(
            lambda _t, y, A=A, f=f: A @ y + f,
            (0, system.durations[m]),
            z,
            method="DOP853",
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        after = orbit.step_states[(m + 1) % system.n_steps] / scale
        np.testing.assert_allclose(z, after, atol=1e-8)


def test_a_response_from_rest_equals_solve_ivp_restarted_at_each_switch(table_1):
    model = lp.ltv_model(table_1, 4.0)
    system = model.system
    scale = np.array([0.1, 1.0, 4e5])
    response = lp.response(system, n_periods=3, initial_state=table_1.rest_state)
    z = table_1.rest_state / scale
    for _ in range(3):
        for m in range(2):
            A, f = system.A[m] * scale / scale[:, None], system.f[m] / scale
            z = solve_ivp(
                lambda _t, y, A=A, f=f: A @ y + f,
                (0, system.durations[m]),
                z,
                method="DOP853",
                rtol=1e-10,
                atol=1e-12,
            ).y[:, -1]
    np.testing.assert_allclose(response.states[:, -1] / scale, z, atol=1e-8)


def test_superposition_holds_in_the_physical_inputs(table_1):
    """Isothermal, operating points frozen: the orbit is linear in the three pressures and the force."""
    system = lp.ltv_model(table_1, 5.0).system
    levels = np.array([4.1e5, 1e5, 1.0, 0.9e5])
    orbits = [lp.steady_state(system.with_levels(row)).initial_state for row in np.diag(levels)]
    whole = lp.steady_state(system.with_levels(levels)).initial_state
    np.testing.assert_allclose(sum(orbits), whole, rtol=1e-10)


def test_steps_are_state_spaces_with_physical_inputs(table_1, double_acting):
    for machine, n in ((table_1, 3), (double_acting, 4)):
        for step in lp.ltv_model(machine, 4.0, n_steps=6).system.steps:
            assert step.sys.input_labels == ["supply_pressure", "exhaust_pressure", "load_force", "ambient_pressure"]
            assert step.sys.nstates == n
            np.testing.assert_allclose(step.sys.B @ machine.levels, step.f, rtol=1e-12)
    assert "one" in lp.lti_model(table_1, 4.0).system.steps[0].sys.input_labels


def test_a_finer_staircase_with_full_tangents_comes_nearer_to_the_machine(table_1):
    """Linearized about the nonlinear orbit's own step means, the model converges to the orbit as N_s grows."""
    machine = table_1.without_dry_friction()
    orbit = lp.nonlinear_orbit(machine, 10.0)
    errors = []
    for n in (10, 40, 160):
        middles = (np.arange(n) + 0.5) / n * orbit.period
        model = lp.ltv_model(machine, 10.0, n_steps=n, operating_points=orbit.at(middles).T, tangent="full")
        errors.append(abs(amplitude(model) / 1e3 / orbit.amplitude("position") - 1))
    assert errors[0] > 8 * errors[1] > 64 * errors[2]
    assert errors[2] < 1e-3


# Staircases
# ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(MACHINES))
@pytest.mark.parametrize("n_steps", [2, 3, 4, 5, 6, 9, 20, 321])
def test_a_staircase_has_as_many_steps_as_asked_and_the_means_of_the_profile(name, n_steps):
    machine = MACHINES[name]
    stairs = staircase(machine, n_steps)
    assert stairs.areas.shape == (n_steps, 2, len(machine.connections))
    assert (np.diff(stairs.fractions) > 0).all()
    for number, connection in enumerate(machine.connections):
        for step in range(n_steps):
            begin, end = 2 * math.pi * stairs.fractions[step : step + 2]
            mean = connection.first.mean(begin, end)
            assert stairs.areas[step, 0, number] == pytest.approx(mean, abs=1e-12 + 1e-9 * mean)


@given(st.floats(0.01, 0.99), st.integers(2, 50))
def test_switching_instants_are_step_boundaries_at_every_duty(duty, n_steps):
    machine = MACHINES["table 1"].with_duty(duty)
    stairs = staircase(machine, n_steps)
    assert np.abs(stairs.fractions - duty).min() < 1e-12
    assert set(np.unique(stairs.areas[:, 0, 0]).round(12)) == {0.0, 0.64e-5}


def test_ramps_are_resolved_as_the_number_of_steps_grows():
    """First-order in 1/N_s for the areas: the largest difference from the profile falls with the step."""
    machine = ramped(MACHINES["table 1"])
    differences = []
    for n in (4, 40, 400):
        stairs = staircase(machine, n)
        middles = (stairs.fractions[1:] + stairs.fractions[:-1]) / 2
        profile = machine.connections[0].first
        edges = [
            abs(profile.at(2 * math.pi * f + 1e-6) - a)
            for f, a in zip(stairs.fractions[:-1], stairs.areas[:, 0, 0], strict=True)
        ]
        differences.append(max(edges))
        assert middles.size == n
    assert differences[0] > 4 * differences[1] > 16 * differences[2]
    # Two steps: the ramps are cut at their middles.
    assert staircase(machine, 2).fractions[1] == pytest.approx(170 / 360, abs=1e-9)


@pytest.mark.parametrize("offset", [-1.0, -0.2, 0.0, 0.2, 1.0])
def test_two_steps_are_enough_for_two_valve_positions_at_any_offset(table_1, offset):
    """With a positive offset the valve is shut across the start of the turn, where its step is cut in two."""
    machine = table_1.with_offset(offset)
    model = lp.ltv_model(machine, 6.0, n_steps=2)
    assert model.system.n_steps == (3 if offset > 0 else 2)
    exact = lp.nonlinear_orbit(machine.without_dry_friction(), 6.0)
    assert amplitude(model) / 1e3 == pytest.approx(exact.amplitude("position"), rel=0.25)
    assert lp.steady_state(model.system).mean("position") == pytest.approx(exact.mean("position"), rel=0.25)


def test_fewer_steps_than_valve_positions_are_refused(table_1):
    with pytest.raises(ValueError, match="n_steps: found 1, expected at least 2, the number of valve positions"):
        lp.ltv_model(table_1, 4.0, n_steps=1)


# Operating points
# ---------------------------------------------------------------------------------------------------------


def test_quasi_static_pressures_balance_the_mass_flows_erratum_e10(table_1):
    """At rest the sum of the flows vanishes; as printed, with dots, (17) would average rates of change, which are zero."""
    from ltvpneu.models.machine.dynamics import state_rate

    turn = quasi_static_turn(table_1, 2)
    for state, areas in zip(turn.quasi_static, turn.stairs.areas, strict=True):
        rate = np.empty(3)
        state_rate(state, areas, 0, table_1.without_dry_friction().record, rate)
        assert abs(rate[2]) < 1e-3
        assert abs(rate[1]) < 1e-9
    np.testing.assert_allclose(turn.mean, turn.quasi_static.mean(axis=0))
    assert turn.quasi_static[1, 2] == 1e5
    # The rates of change over the steps cancel over a cycle, so they can be no operating pressures.
    orbit, points = (
        lp.steady_state(lp.lti_model(table_1, 4.0).system),
        lp.ltv_model(table_1, 4.0).operating_points,
    )
    printed = np.diff(orbit.at([0.0, 0.125, 0.25])[2]) / 0.125
    assert abs(printed.sum()) < 1e-6 * abs(printed[0])
    assert (points[:, 2] > 1e5).all()


def test_the_nonlinear_orbit_tends_to_the_quasi_static_states_at_low_speed(table_1):
    machine = table_1.without_dry_friction()
    turn = quasi_static_turn(machine, 2)
    orbit = lp.nonlinear_orbit(machine, 0.5)
    np.testing.assert_allclose(orbit.at([0.999])[2], turn.quasi_static[0, 2], rtol=1e-6)
    assert orbit.mean("pressure_1") == pytest.approx(turn.mean[2], rel=0.02)


def test_a_shut_chamber_keeps_its_pressure_in_the_quasi_static_turn(table_1):
    """A 2/2 valve that holds: fill, hold, vent, hold."""
    window = lp.Window(start=0.0, width=1.0)
    paths = (
        lp.FlowPath(source="supply", chamber="chamber_1", area=1e-5, opening=window),
        lp.FlowPath(source="exhaust", chamber="chamber_1", area=1e-5, opening=lp.Window(start=3.0, width=1.0)),
    )
    machine = replace(table_1, valve=lp.OnOffValve(), flow_paths=paths)
    turn = quasi_static_turn(machine, None)
    np.testing.assert_allclose(turn.quasi_static[:, 2], [4.1e5, 4.1e5, 1e5, 1e5])
    model = lp.ltv_model(machine, 4.0, n_steps=4)
    # Shut: no leak, so the pressure row feels the velocity alone.
    assert model.system.A[1, 2, 2] == 0
    assert lp.floquet(model.system).is_stable
    assert lp.nonlinear_orbit(machine, 4.0).residual < 1e-5


def test_operating_points_are_held_back_and_say_so(table_1):
    model = lp.ltv_model(table_1, 1.0)
    held = model.held_back[0]
    assert held.asked > table_1.supply_pressure > held.used
    assert model.operating_points[0, 2] == held.used
    assert model.least_distance == 0.02
    near = lp.ltv_model(table_1.with_duty(0.0), 4.0)
    np.testing.assert_allclose(near.operating_points[:, 2], 1.02e5)
    wider = lp.ltv_model(table_1.with_duty(0.0), 4.0, least_distance=0.05)
    np.testing.assert_allclose(wider.operating_points[:, 2], 1.05e5)


def test_the_residual_says_how_far_the_points_are_from_the_models_own_cycle(table_1):
    rough = lp.ltv_model(table_1, 4.0)
    assert 0.001 < rough.residual < 0.5
    assert rough.iterations == 1
    assert lp.ltv_model(table_1, 4.0, operating_points="quasi-static").residual > rough.residual


@pytest.mark.parametrize("duty", [0.0, 1.0])
def test_duty_zero_and_one_work_in_the_linear_models(table_1, duty):
    machine = table_1.with_duty(duty)
    for model in (lp.lti_model(machine, 4.0), lp.ltv_model(machine, 4.0)):
        assert amplitude(model) == pytest.approx(0, abs=1e-9)
        assert lp.floquet(model.system).is_stable


# Errors
# -------------------------------------------------------------------------------------------------------------------


def test_no_spring_is_an_error_that_says_what_to_do(table_1):
    machine = replace(table_1, load=replace(table_1.load, spring_stiffness=0.0))
    for function in (lp.lti_model, lp.ltv_model):
        with pytest.raises(ValueError, match=r"load.spring_stiffness: found none, expected one above zero"):
            function(machine, 4.0)
    points = np.tile([0.04, 0.0, 2.4e5], (2, 1))
    model = lp.ltv_model(machine, 4.0, operating_points=points)
    found = lp.floquet(model.system)
    assert found.is_marginal
    # The pressure balance of a free piston drifts: there is no orbit.
    with pytest.raises(lp.NoOrbitError, match="position"):
        lp.steady_state(model.system)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"n_steps": 0}, "n_steps: found 0"),
        ({"n_steps": 2.0}, "n_steps: found 2.0"),
        ({"operating_points": "fited"}, "operating_points: found 'fited', expected one of"),
        (
            {"operating_points": [[0.0, 0.0, 2e5]]},
            r"operating_points: found shape \(1, 3\), expected \(2, 3\)",
        ),
        ({"operating_points": [[0.0, 0.0, -2e5]] * 2}, "found a pressure of chamber_1"),
        ({"operating_points": [[-1.0, 0.0, 2e5]] * 2}, "found a volume of chamber_1"),
        ({"tangent": "none"}, "tangent: found 'none'"),
        ({"least_distance": -0.1}, "least_distance: found -0.1"),
    ],
)
def test_bad_arguments_of_a_model_are_named(table_1, arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.ltv_model(table_1, 4.0, **arguments)
