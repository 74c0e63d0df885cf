"""The stability map: its certificate against random switching, its regions against orbits computed anew."""

import numpy as np
import pytest
from scipy.linalg import expm

import ltvpneu as lp
from ltvpneu import design

DUTIES, FREQUENCIES = [0.1, 0.45, 0.9], [2.0, 8.0, 18.0]


@pytest.fixture(scope="module")
def found(table_1):
    return design.stability_map(table_1, DUTIES, FREQUENCIES)


def test_what_is_certified_decays_under_random_switching(table_1, found):
    assert found.is_certified.any()
    P = found.certificate.functions[0]
    scales = 1 / np.sqrt(np.diag(P))
    random = np.random.default_rng(1)
    for row, column in np.argwhere(found.is_certified):
        matrices = lp.ltv_model(table_1.with_duty(DUTIES[column]), FREQUENCIES[row]).system.A
        state = random.normal(size=3) * scales
        for _ in range(40):
            time = random.exponential(0.02)
            following = expm(random.choice(matrices) * time) @ state
            bound = state @ P @ state * np.exp(-2 * found.decay_rates[row, column] * time)
            assert following @ P @ following <= bound * (1 + 1e-9)
            state = following


def test_stability_and_ripple_are_those_of_the_models(table_1, found):
    machine = table_1.with_duty(0.45)
    model = lp.ltv_model(machine, 18.0)
    orbit = lp.nonlinear_orbit(machine, 18.0)
    assert found.spectral_radii[2, 1] == pytest.approx(lp.floquet(model.system).spectral_radius, rel=1e-12)
    assert found.amplitudes[2, 1] == pytest.approx(orbit.amplitude("position"), rel=1e-9)
    assert found.is_stable.all()
    assert not found.is_isolated[2, 2]
    low, high = found.box.position
    inside = low <= orbit.minimum("position") and orbit.maximum("position") <= high
    low, high = found.box.pressures[0]
    inside = inside and low <= orbit.minimum("pressure_1") and orbit.maximum("pressure_1") <= high
    assert inside == found.stays_in_box[2, 1]
    # At 2 Hz the pressures run from next to the exhaust's to next to the supply's.
    assert not found.stays_in_box[0].any()


def test_a_box_of_one_s_own(table_1):
    box = design.Box(position=(0.03, 0.06), pressures=((1.6e5, 3.6e5),))
    found = design.stability_map(table_1, [0.45], [15.0, 20.0], box=box)
    assert found.box is box
    assert found.certificate.is_stable
    assert found.stays_in_box[1, 0]


def test_where_no_box_has_a_function_nothing_is_certified(double_acting):
    # With both ports of a chamber choked or shut its pressure does not settle by itself.
    found = design.stability_map(double_acting, [0.5], [4.0])
    assert (found.box, found.certificate) == (None, None)
    assert not found.is_certified.any()
    assert found.is_stable.all()
    assert lp.plot(found).axes


def test_a_machine_without_a_box_says_why(table_1):
    machine = table_1.with_thermal("adiabatic")
    found = design.stability_map(machine, [0.5], [15.0])
    assert found.certificate is None
    assert "expected a box over position and one pressure a chamber" in found.remark
    with pytest.raises(ValueError, match="expected a box over position"):
        design.stability_map(machine, [0.5], [15.0], box=design.Box(position=(0.03, 0.06), pressures=((1e5, 2e5),)))


def test_failures_are_kept_and_bad_input_named(table_1):
    found = design.stability_map(table_1, [0.855], [8.54])
    assert [failure.model for failure in found.failures] == ["nonlinear"]
    assert np.isnan(found.amplitudes[0, 0])
    with pytest.raises(ValueError, match="duties"):
        design.stability_map(table_1, [1.2], [8.0])
    with pytest.raises(ValueError, match="expected rising values"):
        design.stability_map(table_1, [0.5], [8.0], box=design.Box(position=(0.06, 0.03), pressures=((1e5, 2e5),)))
