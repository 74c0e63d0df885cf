"""Fitted and self-consistent models against the nonlinear one: accuracy, order, labels, what they carry."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.cycles.sensitivity import PARAMETERS

FREQUENCIES = (0.5, 1.0, 2.0, 2.25, 2.75, 4.0, 6.0, 8.0, 10.0)


@pytest.fixture(scope="module")
def table_1():
    return lp.load_machine("kunt_singh_1990")


def errors(machine, frequencies, **arguments):
    """Return relative errors of the amplitude, and errors of the mean [m]."""
    found = []
    for frequency in frequencies:
        exact = lp.nonlinear_orbit(machine, frequency)
        orbit = lp.ltv_model(machine, frequency, **arguments).orbit
        found.append((orbit.amplitude(0) / exact.amplitude(0) - 1, orbit.mean(0) - exact.mean(0)))
    return np.abs(np.array(found)).T


@pytest.mark.parametrize(("n_steps", "relative"), [(2, 0.06), (6, 0.02)])
def test_a_fitted_model_of_few_steps_has_the_amplitude_and_mean_with_friction(table_1, n_steps, relative):
    amplitude, mean = errors(table_1, FREQUENCIES, operating_points="fitted", n_steps=n_steps)
    assert amplitude.max() < relative
    assert mean.max() < 2e-3


@pytest.mark.parametrize("duty", [0.3, 0.7])
def test_other_duties_are_fitted_as_well(table_1, duty):
    machine = table_1.with_duty(duty)
    amplitude, mean = errors(machine, FREQUENCIES, operating_points="fitted")
    assert amplitude.max() < 0.06
    assert mean.max() < 2e-3
    for frequency in FREQUENCIES:
        assert lp.floquet(lp.ltv_model(machine, frequency, operating_points="fitted").system).is_stable


def test_a_self_consistent_model_of_320_steps_has_the_nonlinear_amplitude(table_1):
    amplitude, _ = errors(table_1, FREQUENCIES, operating_points="self-consistent", n_steps=320)
    assert amplitude.max() < 0.002


def order(coarse: float, fine: float, ratio: float) -> float:
    return np.log(coarse / fine) / np.log(ratio)


@pytest.mark.parametrize("frequency", [10.0, 12.0, 15.0])
def test_second_order_where_the_pressure_stays_clear_of_the_return(table_1, frequency):
    machine = table_1.without_dry_friction()
    found = [
        errors(machine, [frequency], operating_points="self-consistent", n_steps=n, spacing="even")[0][0]
        for n in (40, 160)
    ]
    assert order(*found, 4) > 1.8


@pytest.mark.parametrize("frequency", [1.0, 2.0, 4.0])
def test_adaptive_steps_keep_an_order_of_one_and_a_half_where_it_does_not(table_1, frequency):
    machine = table_1.without_dry_friction()
    found = [errors(machine, [frequency], operating_points="self-consistent", n_steps=n)[0][0] for n in (20, 320)]
    assert order(*found, 16) > 1.5


def test_the_double_acting_machine_with_ramps_and_stops_is_met_too():
    machine = lp.load_machine("double_acting_5_2")
    amplitude, _ = errors(machine, [1.0, 3.0, 6.0], operating_points="fitted", n_steps=40)
    assert amplitude.max() < 0.02


@pytest.mark.parametrize("mode", ["fitted", "self-consistent"])
def test_the_cycle_is_the_systems_own_steady_state(table_1, mode):
    model = lp.ltv_model(table_1, 8.0, operating_points=mode, n_steps=12)
    steady = lp.steady_state(model.system)
    scales = table_1.state_scales
    np.testing.assert_allclose(model.orbit.step_states / scales, steady.step_states / scales, atol=1e-5)
    assert model.residual < 1e-6
    assert model.iterations > 0
    assert model.operating_points.shape == (model.system.n_steps, 3)


def test_self_consistent_points_are_the_tangents_points(table_1):
    machine = table_1.without_dry_friction()
    model = lp.ltv_model(machine, 10.0, operating_points="self-consistent", n_steps=20)
    assert not model.held_back
    for step in range(0, 20, 5):
        time = model.system.switching_times[step] + 0.5 * model.system.durations[step]
        tangent = lp.linearize(machine, model.operating_points[step], angle=2 * np.pi * time * 10.0, tangent="full")
        np.testing.assert_allclose(model.system.A[step], tangent.A, rtol=1e-9, atol=1e-9 * np.abs(tangent.A).max())
        np.testing.assert_allclose(model.system.f[step], tangent.f, rtol=1e-6, atol=1e-6 * np.abs(tangent.f).max())


def test_what_is_held_back_near_a_source_is_listed(table_1):
    model = lp.ltv_model(table_1, 1.0, operating_points="self-consistent", n_steps=20)
    assert model.held_back
    for held in model.held_back:
        assert held.state == "pressure_1"
        assert abs(held.asked - held.used) < 0.02 * held.used
        assert held.used in (table_1.supply_pressure, table_1.exhaust_pressure)


def test_bands_and_subharmonics_come_out_as_the_machine_has_them(table_1):
    rests = lp.ltv_model(table_1.with_duty(0.7), 20.0, operating_points="fitted", n_steps=20).orbit
    assert not rests.is_isolated
    assert rests.amplitude(0) < 1e-6
    machine = table_1.with_duty(0.86)
    exact = lp.nonlinear_orbit(machine, 5.4)
    twice = lp.ltv_model(machine, 5.4, operating_points="fitted", n_steps=20).orbit
    assert exact.n_periods == twice.n_periods == 2
    assert twice.amplitude(0) == pytest.approx(exact.amplitude(0), rel=1e-3)
    assert exact.branches.shape == (2, 3)
    # Which comes first depends on how long each was followed.
    np.testing.assert_allclose(np.sort(twice.branches[:, 0]), np.sort(exact.branches[:, 0]), atol=1e-4)


def test_rtol_chooses_the_steps(table_1):
    for rtol in (0.05, 0.001):
        model = lp.ltv_model(table_1, 2.0, rtol=rtol)
        exact = lp.nonlinear_orbit(table_1, 2.0).amplitude(0)
        assert abs(model.error_estimate.relative_amplitude("position")) <= rtol
        assert abs(model.orbit.amplitude(0) / exact - 1) < 2 * rtol


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"rtol": 0.01, "operating_points": "lti"}, r"rtol: found 0.01 with operating points 'lti'"),
        ({"rtol": 0.01, "n_steps": 4}, r"n_steps, rtol: found 4 and 0.01, expected one of them"),
        ({"rtol": -1.0}, r"rtol: found -1, expected a finite number above zero"),
        ({"operating_points": "fitted", "tangent": "full"}, r"tangent: found 'full', but 'fitted'"),
        ({"operating_points": "fitted", "spacing": "odd"}, r'spacing: found \'odd\', expected "adaptive" or "even"'),
        ({"spacing": "even"}, r"spacing: found 'even', which is for fitted and self-consistent"),
        ({"operating_points": "fitted", "n_steps": 1}, r"n_steps: found 1, expected at least 2"),
    ],
)
def test_arguments_at_odds_say_so(table_1, arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.ltv_model(table_1, 4.0, **arguments)


def test_a_cycle_that_never_repeats_is_an_error_with_its_residual(table_1):
    # The nonlinear machine is chaotic here: two starts draw apart by a factor 1.16 a period.
    frequency, duty = np.linspace(0.2, 20, 20)[8], np.linspace(0.05, 0.95, 20)[17]
    with pytest.raises(lp.NotConvergedError, match="the model's cycle does not repeat") as caught:
        lp.ltv_model(table_1.with_duty(duty), frequency, operating_points="fitted", n_steps=20)
    assert caught.value.residual > 1e-6
    assert caught.value.iterations > 100


# The error estimate
# -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "n_steps"), [("lti", 20), ("quasi-static", 20), ("fitted", 2), ("self-consistent", 6)]
)
@pytest.mark.parametrize("frequency", [1.0, 4.0, 9.0, 15.0])
def test_the_error_estimate_is_right_within_a_factor_of_two(table_1, mode, n_steps, frequency):
    model = lp.ltv_model(table_1, frequency, operating_points=mode, n_steps=n_steps)
    exact, estimate = lp.nonlinear_orbit(table_1, frequency), model.error_estimate
    true = model.orbit.amplitude(0) - exact.amplitude(0)
    assert estimate.is_reliable
    if abs(true) > 0.005 * exact.amplitude(0):
        assert 0.5 < estimate.amplitude("position") / true < 2
    else:
        assert abs(estimate.amplitude("position")) < 0.01 * exact.amplitude(0)
    assert estimate.mean("position") == pytest.approx(model.orbit.mean(0) - exact.mean(0), abs=2e-3)
    assert estimate.maximum(0) - estimate.minimum(0) == pytest.approx(2 * estimate.amplitude(0))


def test_the_error_estimate_tells_the_papers_good_frequencies_from_its_bad(table_1):
    machine = table_1.without_dry_friction()
    found = {f: lp.ltv_model(machine, f).error_estimate.relative_amplitude("position") for f in (2.0, 4.0, 15.0)}
    assert found[2.0] == pytest.approx(0.22, abs=0.05)
    assert abs(found[4.0]) < 0.03
    assert found[15.0] == pytest.approx(0.22, abs=0.05)


# Floquet, bands, sensitivities
# -------------------------------------------------------------------------------------------------------------------


def period_map(machine, frequency, state, n_periods):
    response = lp.simulate(machine, frequency, n_periods, state, method=lp.DormandPrince(rtol=1e-12))
    return np.array(response.states)[:, -1]


@pytest.mark.parametrize(
    ("duty", "frequency", "friction"), [(0.5, 8.0, True), (0.5, 8.0, False), (0.5, 20.0, True), (0.86, 5.4, True)]
)
def test_the_nonlinear_monodromy_with_saltation_equals_differences(table_1, duty, frequency, friction):
    machine = table_1.with_duty(duty)
    machine = machine if friction else machine.without_dry_friction()
    orbit = lp.nonlinear_orbit(machine, frequency, method=lp.DormandPrince(rtol=1e-11))
    found, scales = lp.orbit_floquet(machine, orbit), machine.state_scales
    for j in range(3):
        move = np.zeros(3)
        move[j] = 1e-6 * scales[j]
        ends = [period_map(machine, frequency, orbit.initial_state + s * move, orbit.n_periods) for s in (1, -1)]
        expected = (ends[0] - ends[1]) / 2e-6 / scales
        np.testing.assert_allclose(found.monodromy[:, j] * scales[j] / scales, expected, atol=2e-5)
    assert found.is_stable


def test_floquet_of_a_linear_models_cycle_is_refused_with_the_way_to_it(table_1):
    with pytest.raises(TypeError, match=r"lp.cycle_floquet\(model\)"):
        lp.orbit_floquet(table_1, lp.ltv_model(table_1, 4.0).orbit)


def test_a_self_consistent_models_multipliers_tend_to_the_nonlinear_ones_without_friction(table_1):
    machine = table_1.without_dry_friction()
    exact = lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, 8.0)).multipliers
    model = lp.ltv_model(machine, 8.0, operating_points="self-consistent", n_steps=160)
    np.testing.assert_allclose(lp.floquet(model.system).multipliers, exact, atol=1e-3)


def test_the_stiction_band_is_where_the_nonlinear_piston_stays(table_1):
    machine = table_1.with_duty(0.7)
    held = replace(machine, load=replace(machine.load, stiction=1e9))
    band = lp.stiction_band(machine, 20.0)
    assert band.exists
    for share, stays in ((0.02, True), (0.98, True), (-0.2, False), (1.2, False)):
        position = band.lowest + share * band.width
        # At rest there, with the pressures settled.
        start = lp.nonlinear_orbit(held, 20.0, [position, 0.0, 2.4e5]).initial_state
        orbit = lp.nonlinear_orbit(machine, 20.0, start)
        assert (abs(orbit.initial_state[0] - position) < 1e-9) == stays
    assert not lp.stiction_band(machine, 4.0).exists


@pytest.mark.parametrize(
    ("mode", "n_steps", "rtol"), [("fitted", 2, 0.25), ("fitted", 320, 0.02), ("self-consistent", 320, 0.02)]
)
@pytest.mark.parametrize(("frequency", "duty"), [(15.0, 0.5), (3.3, 0.224), (9.7, 0.65), (6.3, 0.777)])
def test_sensitivities_go_through_the_operating_points(table_1, mode, n_steps, rtol, frequency, duty):
    machine, h = table_1.with_duty(duty), 1e-3
    quotient = [lp.nonlinear_orbit(table_1.with_duty(duty + s * h), frequency).amplitude(0) for s in (1, -1)]
    expected = (quotient[0] - quotient[1]) / (2 * h)
    model = lp.ltv_model(machine, frequency, operating_points=mode, n_steps=n_steps)
    assert lp.parameter_sensitivity(model, ["duty"]).amplitude("position", "duty") == pytest.approx(expected, rel=rtol)


def test_every_parameter_has_the_nonlinear_models_derivative(table_1):
    names = [*PARAMETERS, "load.mass", "load.stiction", "cylinder.dead_volume_1", "flow_paths.0.area"]
    model = lp.ltv_model(table_1, 8.0, operating_points="self-consistent", n_steps=160)
    found, exact = lp.parameter_sensitivity(model, names), lp.nonlinear_sensitivity(table_1, 8.0, names)
    for name in names:
        assert found.amplitude(0, name) == pytest.approx(exact.amplitude(0, name), rel=0.01, abs=1e-12)
        assert found.mean(0, name) == pytest.approx(exact.mean(0, name), rel=0.01, abs=1e-12)


def test_sensitivities_that_do_not_exist_say_why(table_1):
    with pytest.raises(ValueError, match="found operating points 'lti'"):
        lp.parameter_sensitivity(lp.ltv_model(table_1, 4.0))
    with pytest.raises(ValueError, match="there is no 'weight' there"):
        lp.nonlinear_sensitivity(table_1, 4.0, ["load.weight"])
    with pytest.raises(lp.NonUniqueOrbitError, match="stiction band"):
        lp.nonlinear_sensitivity(table_1.with_duty(0.7), 20.0)


def with_load(machine, force):
    return replace(machine, load=replace(machine.load, force=force))


def test_a_leap_to_an_unstable_cycle_is_taken_back(table_1):
    machine = with_load(table_1, -100.0).with_duty(0.8)
    model = lp.ltv_model(machine, 15.0, operating_points="self-consistent", n_steps=64)
    exact = lp.nonlinear_orbit(machine, 15.0)
    assert model.orbit.n_periods == exact.n_periods == 2
    assert model.orbit.amplitude("position") == pytest.approx(exact.amplitude("position"), rel=0.01)


def test_a_leap_does_not_decide_where_the_piston_rests(table_1):
    machine = table_1.with_supply_pressure(6e5).with_duty(0.8)
    model = lp.ltv_model(machine, 15.0, operating_points="self-consistent", n_steps=64)
    exact = lp.nonlinear_orbit(machine, 15.0).mean("position")
    assert model.orbit.mean("position") == pytest.approx(exact, abs=2e-5)


@pytest.mark.parametrize("duty", [0.1, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("frequency", [5.0, 20.0, 40.0])
def test_the_double_acting_drive_has_a_cycle_at_every_duty(duty, frequency):
    machine = lp.load_machine("double_acting_5_2").with_duty(duty)
    model = lp.ltv_model(machine, frequency, operating_points="fitted", n_steps=8)
    assert model.orbit.minimum("position") >= machine.cylinder.lower_stop - 1e-9
    assert model.orbit.maximum("position") <= machine.cylinder.upper_stop + 1e-9


def test_a_piston_pressed_on_a_stop_is_where_it_is():
    machine = with_load(lp.load_machine("double_acting_5_2"), -1000.0)
    assert lp.ltv_model(machine, 4.0, operating_points="fitted").orbit.is_isolated
    assert lp.nonlinear_orbit(machine, 4.0).is_isolated


def test_multipliers_of_an_orbit_that_hits_its_stops_without_dry_friction():
    # In a vacuum it flies: with the air on its rod it begins the period at rest on a stop, and there is no difference.
    machine = replace(lp.load_machine("double_acting_5_2"), ambient_pressure=0.0).without_dry_friction().with_duty(0.8)
    orbit = lp.nonlinear_orbit(machine, 40.0, method=lp.DormandPrince(rtol=1e-11))
    found = lp.orbit_floquet(machine, orbit)
    scales = machine.state_scales
    differences = np.empty((4, 4))
    for j in range(4):
        ends = []
        for side in (1, -1):
            start = orbit.initial_state.copy()
            start[j] += side * 1e-6 * scales[j]
            done = lp.simulate(machine, 40.0, orbit.n_periods, start, method=lp.DormandPrince(rtol=1e-11))
            ends.append(done.states[:, -1])
        differences[:, j] = (ends[0] - ends[1]) / (2e-6 * scales[j])
    radius = np.abs(np.linalg.eigvals(differences * scales / scales[:, None])).max()
    assert found.spectral_radius == pytest.approx(radius, rel=1e-3)
    assert radius > 0.5


def test_the_estimate_does_not_miss_a_piston_that_turns_and_turns_back(table_1):
    """At 0.3 Hz a cell of the estimate lasts longer than the piston's way there and back."""
    machine = table_1.with_supply_pressure(6e5).with_duty(0.2)
    model = lp.ltv_model(machine, 0.3, operating_points="fitted", n_steps=64)
    true = model.orbit.mean("position") - lp.nonlinear_orbit(machine, 0.3).mean("position")
    assert model.error_estimate.mean("position") == pytest.approx(true, abs=1e-4)


def test_a_machine_at_rest_meets_any_tolerance(table_1):
    model = lp.ltv_model(table_1.with_supply_pressure(1.0e5), 4.0, rtol=0.01)
    assert model.orbit.amplitude("position") == 0


def test_wrong_names_and_tolerances_are_named(table_1):
    model = lp.ltv_model(table_1, 8.0, operating_points="fitted")
    with pytest.raises(TypeError, match=r"found 'duty', expected a list of names, such as \['duty'\]"):
        lp.parameter_sensitivity(model, "duty")
    with pytest.raises(TypeError, match="found 3 of type int"):
        lp.parameter_sensitivity(model, [3])
    with pytest.raises(ValueError, match="rtol: found 2, expected a relative error below 1"):
        lp.ltv_model(table_1, 8.0, rtol=2.0)
    assert len(lp.validity_map(with_load(table_1, -100.0), [0.2], [1.0], operating_points="lti").failures) == 1


@pytest.mark.parametrize(
    ("name", "frequency", "duty", "modes"),
    [
        ("kunt_singh_1990", 10.0, 0.2, {"fitted": 2, "self-consistent": 20}),
        ("kunt_singh_1990", 15.0, 0.2, {"fitted": 2, "self-consistent": 20}),
        ("double_acting_5_2", 2.0, 0.5, {"fitted": 2, "self-consistent": 20}),
        ("double_acting_5_2", 8.0, 0.4, {"self-consistent": 40}),
    ],
)
def test_a_cycles_multipliers_are_those_of_the_nonlinear_orbit(name, frequency, duty, modes):
    """With the steps kept as they are, the radius is 4 at 15 Hz and 6 for the double-acting drive at 2 Hz."""
    machine = lp.load_machine(name).with_duty(duty)
    exact = lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, frequency)).spectral_radius
    for mode, n_steps in modes.items():
        found = lp.cycle_floquet(lp.ltv_model(machine, frequency, n_steps=n_steps, operating_points=mode))
        assert found.is_stable
        assert found.verdict == "stable"
        assert found.spectral_radius == pytest.approx(exact, rel=0.12, abs=1e-5)


def test_a_cycle_in_a_stiction_band_is_marginal_and_other_models_have_their_systems_multipliers(table_1):
    resting = lp.ltv_model(table_1.with_duty(0.7), 20.0, operating_points="self-consistent", n_steps=10)
    assert not resting.orbit.is_isolated
    assert lp.cycle_floquet(resting).verdict == "marginal"
    model = lp.ltv_model(table_1, 4.0)
    assert lp.cycle_floquet(model).spectral_radius == lp.floquet(model.system).spectral_radius
