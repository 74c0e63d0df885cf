"""Delays of the valve in every model: as a valve without delays, told later and shorter."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.models.machine.parameters import present_value, with_values

FREQUENCY, DUTY = 20.0, 0.45
OPENING, CLOSING = 0.012, 0.018


@pytest.fixture(scope="module")
def delayed(double_acting: lp.Machine) -> lp.Machine:
    return replace(double_acting, valve=lp.OnOffValve(duty=DUTY, opening_delay=OPENING, closing_delay=CLOSING))


@pytest.fixture(scope="module")
def effective(double_acting: lp.Machine) -> lp.Machine:
    duty = DUTY - (OPENING - CLOSING) * FREQUENCY
    return replace(double_acting, valve=lp.OnOffValve(duty=duty, start=2 * np.pi * OPENING * FREQUENCY))


def test_nonlinear_orbit_is_that_of_the_open_share(delayed: lp.Machine, effective: lp.Machine) -> None:
    orbits = [lp.nonlinear_orbit(machine, FREQUENCY) for machine in (delayed, effective)]
    times = np.linspace(0.0, 1 / FREQUENCY, 50)
    assert np.abs(orbits[0].at(times) - orbits[1].at(times)).max(axis=1) == pytest.approx(
        [0.0] * 4, abs=1e-9 * delayed.supply_pressure
    )
    assert delayed.open_share(FREQUENCY) == pytest.approx(effective.duty)


@pytest.mark.parametrize("points", ["lti", "fitted", "self-consistent"])
def test_linear_model_is_that_of_the_open_share(delayed: lp.Machine, effective: lp.Machine, points: str) -> None:
    models = [
        lp.ltv_model(machine, FREQUENCY, n_steps=8, operating_points=points)  # pyright: ignore[reportArgumentType]
        for machine in (delayed, effective)
    ]
    for state in delayed.states:
        assert models[0].orbit.mean(state) == pytest.approx(models[1].orbit.mean(state), rel=1e-4, abs=1e-6)


def test_averaged_model_and_multipliers_are_those_of_the_open_share(delayed: lp.Machine, effective: lp.Machine) -> None:
    one, two = (lp.lti_model(machine, FREQUENCY).orbit.mean("position") for machine in (delayed, effective))
    assert one == pytest.approx(two, rel=1e-9)
    radii = [
        lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, FREQUENCY)).spectral_radius
        for machine in (delayed, effective)
    ]
    assert radii[0] == pytest.approx(radii[1], rel=1e-5)


def test_balance_of_air_closes(delayed: lp.Machine) -> None:
    assert lp.balance(delayed, lp.nonlinear_orbit(delayed, FREQUENCY)).mass_error < 1e-9


@pytest.mark.parametrize("name", ["frequency", "duty", "valve.opening_delay", "valve.closing_delay"])
def test_sensitivities_are_those_of_differences(delayed: lp.Machine, name: str) -> None:
    step = {"frequency": 1e-3, "duty": 1e-5}.get(name, 1e-6)

    def mean(change: float) -> float:
        value = present_value(delayed, FREQUENCY, name) + change
        frequency = value if name == "frequency" else FREQUENCY
        machine = with_values(delayed, {name: value})
        return lp.nonlinear_orbit(machine, frequency, method=lp.DormandPrince(rtol=1e-11)).mean("position")

    found = lp.nonlinear_sensitivity(delayed, FREQUENCY, [name])
    assert found.mean("position", name) == pytest.approx((mean(step) - mean(-step)) / (2 * step), rel=2e-4)


def test_sensitivities_of_the_linear_model_are_those_of_the_open_share(delayed: lp.Machine) -> None:
    model = lp.ltv_model(delayed, FREQUENCY, n_steps=64, operating_points="fitted")
    names = ["duty", "valve.opening_delay", "valve.closing_delay", "frequency"]
    linear, own = lp.parameter_sensitivity(model, names), lp.nonlinear_sensitivity(delayed, FREQUENCY, names)
    by_duty = linear.mean("position", "duty")
    assert linear.mean("position", "valve.closing_delay") == pytest.approx(FREQUENCY * by_duty, rel=1e-3)
    assert linear.mean("position", "valve.opening_delay") == pytest.approx(-FREQUENCY * by_duty, rel=1e-3)
    for name in names:
        assert linear.mean("position", name) == pytest.approx(own.mean("position", name), rel=0.02)


def test_duty_map_is_shifted_by_the_delays(delayed: lp.Machine, double_acting: lp.Machine) -> None:
    plain = replace(double_acting, valve=lp.OnOffValve(duty=0.5))
    duties = np.array([0.3, 0.45, 0.6])
    commanded = design.duty_map(delayed, duties, [FREQUENCY]).curve(FREQUENCY)[1]
    opened = design.duty_map(plain, duties + 0.12, [FREQUENCY]).curve(FREQUENCY)[1]
    assert commanded == pytest.approx(opened, abs=1e-6)


def test_beyond_the_delays_the_valve_is_shut_or_open(delayed: lp.Machine) -> None:
    shut, never = (lp.nonlinear_orbit(delayed.with_duty(duty), FREQUENCY) for duty in (0.23, 0.0))
    assert shut.mean("position") == pytest.approx(never.mean("position"), abs=1e-12)
    full, always = (lp.nonlinear_orbit(delayed.with_duty(duty), FREQUENCY) for duty in (0.65, 1.0))
    assert full.mean("position") == pytest.approx(always.mean("position"), abs=1e-12)


def test_optimizer_finds_the_command(delayed: lp.Machine) -> None:
    wanted = 0.002
    found = design.optimize_duty(delayed, FREQUENCY, mean={"position": wanted})
    assert found.status == "optimal"
    plain = lp.nonlinear_orbit(delayed.with_duty(found.values["duty"]), FREQUENCY)
    assert plain.mean("position") == pytest.approx(wanted, abs=1e-4)
    low, high = OPENING * FREQUENCY, 1 - CLOSING * FREQUENCY
    assert low < found.values["duty"] < high


def test_optimizer_refuses_delays_in_two_places(delayed: lp.Machine) -> None:
    with pytest.raises(ValueError, match="found delays here and in the machine's own valve"):
        design.optimize_duty(delayed, FREQUENCY, valve=design.ValveLimits(opening_delay=0.01))


def test_angles_of_times_need_a_frequency(delayed: lp.Machine) -> None:
    with pytest.raises(ValueError, match=r"expected machine.at\(frequency\)"):
        _ = delayed.openings
    assert delayed.at(FREQUENCY).openings.fractions.size > 2


def test_maps_and_boxes_take_delays(delayed: lp.Machine) -> None:
    found = lp.validity_map(delayed, [0.3, 0.45], [FREQUENCY])
    assert np.isfinite(found.errors).all()
    assert lp.orbit_map(delayed, [0.3, 0.45], [FREQUENCY], n_spread=0).count("failed") == 0
    stability = design.stability_map(delayed, [0.3, 0.45], [FREQUENCY])
    assert stability.is_stable.all()
    state = [0.0, 0.0, 3e5, 3e5]
    with pytest.raises(ValueError, match="expected machine.at"):
        lp.linearize(delayed, state)
    areas = np.array([[1e-6, 0.0, 0.0, 1e-6], [np.inf] * 4])
    assert lp.linearize(delayed, state, areas=areas).A.shape == (4, 4)
    assert lp.amplitude_response(delayed, [10.0, FREQUENCY]).failures == ()
    assert lp.attractors(delayed, FREQUENCY).orbits


def test_closed_loop_works_through_the_delays(delayed: lp.Machine) -> None:
    same = design.simulate_closed_loop(delayed, lambda _: DUTY, np.zeros(30), FREQUENCY)
    orbit = lp.nonlinear_orbit(delayed, FREQUENCY)
    assert same.mean_positions[-1] == pytest.approx(orbit.mean("position"), abs=1e-6)
