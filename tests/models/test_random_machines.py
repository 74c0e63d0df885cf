"""Random machines: orbits against the twin, one verdict from every function."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import ltvpneu as lp
from tests.models.random_machines import random_machine
from tests.models.twin import Twin

SLOW = (2, 5, 11, 13, 14, 20, 21)


# The twin takes minutes where chambers lie at their sources' pressures for long; those seeds are left out.
@pytest.mark.parametrize("seed", [seed for seed in range(24) if seed not in SLOW])
def test_an_orbit_of_a_random_machine_is_the_twins(seed):
    machine, frequency = random_machine(np.random.default_rng(seed))
    try:
        orbit = lp.nonlinear_orbit(machine, frequency)
    except lp.LtvpneuError:
        # Chaotic, or a chamber without stops swept empty: said so, and nothing to compare.
        return
    twin, scales = Twin(machine), machine.state_scales
    lows, highs, state = np.full(scales.size, np.inf), np.full(scales.size, -np.inf), orbit.initial_state.copy()
    for _ in range(orbit.n_periods):
        _, states, state = twin.period(state, frequency)
        lows, highs = np.minimum(lows, states.min(axis=1)), np.maximum(highs, states.max(axis=1))
    # The twin's own event location and samples are good to some 1e-6 of the scales, extremes to less (200 samples).
    assert_allclose(state / scales, orbit.initial_state / scales, atol=2e-5)
    for i in (0, *range(2, scales.size)):
        assert_allclose(orbit.minimum(i) / scales[i], lows[i] / scales[i], atol=1e-4)
        assert_allclose(orbit.maximum(i) / scales[i], highs[i] / scales[i], atol=1e-4)


@settings(max_examples=15)
@given(st.integers(1000, 100000))
def test_a_position_pressed_on_a_stop_is_stable_in_every_model(seed):
    machine, frequency = random_machine(np.random.default_rng(seed))
    try:
        orbit = lp.nonlinear_orbit(machine, frequency)
        model = lp.ltv_model(machine, frequency, operating_points="fitted")
    except lp.LtvpneuError:
        return
    if not (orbit.rest.startswith("rests on") and model.orbit.rest == orbit.rest):
        return
    for found in (lp.orbit_floquet(machine, orbit), lp.cycle_floquet(model), lp.floquet(model.system)):
        assert found.is_stable
    assert_allclose(lp.steady_state(model.system).mean(0), orbit.mean(0), rtol=1e-9)


@settings(max_examples=15)
@given(st.integers(1000, 100000))
def test_an_isolated_orbit_attracts_and_a_band_is_marginal(seed):
    machine, frequency = random_machine(np.random.default_rng(seed))
    try:
        orbit = lp.nonlinear_orbit(machine, frequency)
    except lp.LtvpneuError:
        return
    found, scales = lp.orbit_floquet(machine, orbit), machine.state_scales
    whole, modes = found.monodromy * scales / scales[:, None], found.modes / scales[:, None]
    modes = modes / np.linalg.norm(modes, axis=0)
    # Modes belong to their multipliers, those of zero too, where a stop or stiction takes a direction away.
    assert np.abs(whole @ modes - modes * found.multipliers).max() < 1e-9 * max(np.abs(whole).max(), 1.0)
    assert not np.isnan(found.exponents).any()
    if orbit.is_isolated:
        assert found.spectral_radius < 1.0 + 1e-6
    else:
        assert found.verdict == "marginal"
        assert orbit.rest in ("held by stiction", "at the edge of a stiction band")
