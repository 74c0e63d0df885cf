"""A position held by a stop is held: one answer from the nonlinear model and from linear ones that follow their cycle."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import ltvpneu as lp
from ltvpneu.models.cycles.sensitivity import nonlinear_jacobians
from tests.conftest import EXTENSIONS

MACHINES = Path(__file__).parents[1] / "reference" / "machines"


def pressed() -> dict[str, lp.Machine]:
    """Return drives that lie on a stop through the whole period."""
    drive = lp.load_machine("double_acting_5_2")
    down = replace(drive, load=replace(drive.load, force=-900.0))
    return {
        "lower stop": down,
        "upper stop": drive.with_duty(1.0),
        "no friction": down.without_dry_friction(),
        "spring return": lp.load_machine(MACHINES / "spring_return.toml"),
        "walls": replace(EXTENSIONS["walls"], load=replace(drive.load, force=-900.0)),
        "free": lp.load_machine(MACHINES / "free_cylinder.toml").with_duty(0.2),
    }


PRESSED = pressed()
FREQUENCY = 10.0


@pytest.mark.parametrize("name", PRESSED)
def test_what_is_pressed_on_a_stop_returns_to_it(name):
    machine = PRESSED[name]
    orbit = lp.nonlinear_orbit(machine, FREQUENCY)
    stop = machine.cylinder.lower_stop if orbit.mean(0) < 0 else machine.cylinder.upper_stop
    assert_allclose(orbit.initial_state[0], stop, rtol=1e-15)
    off = orbit.initial_state.copy()
    off[0] -= np.sign(stop) * 1e-5
    after = lp.simulate(machine, FREQUENCY, n_periods=1, initial_state=off).states[0, -1]
    assert after == orbit.initial_state[0]
    side = "upper" if stop > 0 else "lower"
    assert orbit.rest == f"rests on the {side} stop, {1e3 * stop:.4g} mm"


@pytest.mark.parametrize("name", PRESSED)
def test_its_position_has_multiplier_zero_in_every_model(name):
    machine = PRESSED[name]
    orbit = lp.nonlinear_orbit(machine, FREQUENCY)
    model = lp.ltv_model(machine, FREQUENCY, operating_points="fitted")
    answers = {
        "orbit_floquet": lp.orbit_floquet(machine, orbit),
        "cycle_floquet": lp.cycle_floquet(model),
        "floquet": lp.floquet(model.system),
    }
    for which, found in answers.items():
        assert isinstance(found, lp.Floquet), which
        assert found.is_stable, which
    for which in ("orbit_floquet", "cycle_floquet"):
        # A disturbance of the position is gone after a period; cycle_floquet differs two marches at 1e-10 by 1e-5.
        assert np.abs(answers[which].monodromy[0, 0]) < 1e-5, which
        assert answers[which].orbit is not None
        assert answers[which].orbit.rest.startswith("rests on the")
        assert "rests on the" in repr(answers[which])
    assert_allclose(lp.steady_state(model.system).mean("position"), orbit.mean("position"), rtol=1e-12)


@pytest.mark.parametrize("name", ["lower stop", "no friction", "walls"])
def test_its_monodromy_matrix_is_that_of_differences_into_the_stroke(name):
    machine = PRESSED[name]
    orbit = lp.nonlinear_orbit(machine, FREQUENCY, method=lp.DormandPrince(rtol=1e-10))
    scales = machine.state_scales
    found = lp.orbit_floquet(machine, orbit).monodromy * scales / scales[:, None]
    expected = nonlinear_jacobians(machine, FREQUENCY, orbit, ()).by_state[0] * scales / scales[:, None]
    # Set 1e-5 beside the stop the piston is back within a moment, in which the chambers fill on: some 1e-3 of it.
    assert_allclose(found, expected, atol=5e-3)


def test_a_pressed_step_of_rest_leaves_no_free_direction():
    model = lp.ltv_model(PRESSED["lower stop"], FREQUENCY, operating_points="fitted")
    assert lp.floquet(model.system).spectral_radius < 0.1
    assert_allclose(lp.steady_state(model.system).initial_state[0], -0.05, rtol=1e-12)


def test_rest_by_stiction_at_a_stop_stays_a_free_direction(double_acting):
    # Pushed by less than stiction holds: one micrometre off, the piston stays there.
    load = replace(double_acting.load, spring_stiffness=0.0, stiction=2e3, dry_friction=1e3)
    machine = replace(double_acting, load=load)
    start = np.array([machine.cylinder.lower_stop, 0.0, 1.013e5, 1.013e5])
    orbit = lp.nonlinear_orbit(machine, FREQUENCY, start)
    assert orbit.rest == "held by stiction"
    found = lp.orbit_floquet(machine, orbit)
    assert found.verdict == "marginal"
    assert_allclose(found.spectral_radius, 1.0)


def test_free_directions_are_named_in_scaled_states():
    # A position that nothing brings back, beside a pressure in pascals that follows it.
    A = [[0.0, 1.0, 0.0], [0.0, -50.0, 1e-3], [0.0, -1e7, -200.0]]
    system = lp.PeriodicSystem.from_matrices([A], [[0.0, 0.0, 0.0]], [0.1])
    with pytest.raises(lp.NonUniqueOrbitError, match=r"Free direction: z1 [+-]1 \(in scaled states\)\. A state that"):
        lp.steady_state(system)


def test_derivatives_of_a_pressed_orbit_do_not_move_it(double_acting):
    machine = PRESSED["lower stop"]
    found = lp.nonlinear_sensitivity(machine, FREQUENCY, ["load.force", "supply_pressure"])
    assert_allclose(found.means[0], 0.0, atol=1e-12)
    model = lp.ltv_model(machine, FREQUENCY, operating_points="fitted")
    fitted = lp.parameter_sensitivity(model, ["load.force", "supply_pressure"])
    # Of 0.05 m, over a newton and over a pascal.
    assert_allclose(fitted.means[0], 0.0, atol=1e-9)


def test_a_model_outside_the_stops_says_so():
    machine = PRESSED["spring return"]
    with pytest.warns(UserWarning, match="lies beyond the cylinder's end stops, of which operating points 'lti' know"):
        model = lp.ltv_model(machine, FREQUENCY)
    assert_allclose(model.beyond_stops, model.orbit.maximum(0) - 0.025, rtol=1e-9)
    assert "passes the end stops by" in repr(model)
    fitted = lp.ltv_model(machine, FREQUENCY, operating_points="fitted")
    assert fitted.beyond_stops == 0.0
    assert_allclose(fitted.orbit.mean(0), 0.025, rtol=1e-9)


def test_the_monodromy_matrix_of_a_band_has_its_pressures_follow_the_position(table_1):
    machine = table_1.with_duty(0.7)
    orbit = lp.nonlinear_orbit(machine, 20.0)
    nonlinear = lp.orbit_floquet(machine, orbit).monodromy
    fitted = lp.cycle_floquet(lp.ltv_model(machine, 20.0, operating_points="fitted")).monodromy
    assert_allclose(nonlinear[:2, 0], (1.0, 0.0))
    assert_allclose(fitted[:2, 0], (1.0, 0.0))
    # As far as a model of two steps is from the machine.
    assert_allclose(fitted[2, 0], nonlinear[2, 0], rtol=0.05)


def test_modes_of_an_orbit_repeat_along_it(table_1):
    orbit = lp.nonlinear_orbit(table_1, 8.0)
    found = lp.orbit_floquet(table_1, orbit)
    mode = found.modes[:, 0]
    # The eigenvector of the map over the period, in the states' units.
    scales = table_1.state_scales
    reached = (found.monodromy * scales / scales[:, None]) @ (mode / scales)
    assert_allclose(reached, found.multipliers[0] * mode / scales, atol=1e-9 * np.abs(reached).max())
    assert found.mode_shapes.shape == (len(orbit.step_labels), 3, 3)
    assert np.isfinite(found.mode_shapes).all()
    with pytest.raises(ValueError, match="mode_shape: found the multipliers of an orbit"):
        found.mode_shape(0, np.array([0.0]))
