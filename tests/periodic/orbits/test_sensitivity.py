"""Derivatives of orbits and multipliers: forward against adjoint, and both against differences of the orbit itself."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ltvpneu as lp

N, n, m, p = 4, 3, 2, 2
QUANTITIES = ("mean", "minimum", "maximum", "amplitude")


def example(seed: int) -> lp.PeriodicSystem:
    random = np.random.default_rng(seed)
    system = lp.PeriodicSystem.from_matrices(
        random.normal(size=(N, n, n)) - 2 * np.eye(n),
        random.normal(size=(N, n)),
        random.uniform(0.3, 1.0, size=N),
        B=random.normal(size=(N, n, m)),
        C=random.normal(size=(N, p, n)),
        D=random.normal(size=(N, p, m)),
    )
    return system.with_levels(random.normal(size=m))


def direction(seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {
        "durations": 0.2 * random.normal(size=N),
        "forcing": random.normal(size=(N, n)),
        "levels": random.normal(size=m),
        "A": random.normal(size=(N, n, n)),
    }


def moved(system: lp.PeriodicSystem, along: dict[str, np.ndarray], by: float) -> lp.PeriodicSystem:
    return replace(
        system,
        durations=system.durations + by * along["durations"],
        r=system.r + by * along["forcing"],
        levels=system.levels + by * along["levels"],
        A=system.A + by * along["A"],
    )


def difference(quantity, system, along):
    """Fourth-order central difference."""
    h = 1e-4
    far, near, up, up2 = (np.asarray(quantity(moved(system, along, k * h))) for k in (-2, -1, 1, 2))
    return (far - 8 * near + 8 * up - up2) / (12 * h)


def applied(gradient: lp.Gradient, along: dict[str, np.ndarray]):
    pairs = ("by_duration", "durations"), ("by_forcing", "forcing"), ("by_level", "levels"), ("by_matrix", "A")
    return sum(np.sum(getattr(gradient, field) * along[key]) for field, key in pairs)


@given(st.integers(0, 2**32 - 1))
def test_forward_and_adjoint_derivatives_are_the_same(seed):
    system, along = example(seed), direction(seed + 1)
    found = lp.sensitivity(system)
    forward = found.along(**along)
    for quantity in QUANTITIES:
        for signal in found.orbit.signals:
            gradient = getattr(found, f"of_{quantity}")(signal)
            value = getattr(forward, quantity)(signal)
            assert applied(gradient, along) == pytest.approx(value, rel=1e-9, abs=1e-9 * np.abs(forward.starts).max())
    adjoint = [applied(found.of_initial_state(i), along) for i in range(n)]
    np.testing.assert_allclose(adjoint, forward.initial_state, atol=1e-9 * np.abs(forward.starts).max())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_derivatives_equal_differences(seed):
    system, along = example(seed), direction(seed + 10)
    found = lp.sensitivity(system).along(**along)
    # Rounding of the orbit over the step of the difference, and the next order's remainder.
    close = {"rtol": 1e-8, "atol": 1e-8 * np.abs(found.starts).max()}
    np.testing.assert_allclose(
        found.step_states, difference(lambda s: lp.steady_state(s).step_states, system, along), **close
    )
    for quantity in QUANTITIES:
        for signal in ("z1", "z3", "y1", "y2"):
            expected = difference(lambda s, q=quantity, x=signal: getattr(lp.steady_state(s), q)(x), system, along)
            np.testing.assert_allclose(getattr(found, quantity)(signal), expected, **close)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_derivatives_of_multipliers_equal_differences(seed):
    system, along = example(seed), direction(seed + 20)
    found = lp.sensitivity(system)
    for i in range(n):
        expected = difference(lambda s, i=i: lp.floquet(s).log_moduli[i] + 1j * lp.floquet(s).angles[i], system, along)
        gradient = found.of_log_multiplier(i)
        assert applied(gradient, along) == pytest.approx(complex(expected), rel=1e-7, abs=1e-8)
        assert not gradient.by_forcing.any()
    expected = difference(lambda s: lp.floquet(s).multipliers, system, {**along, "A": 0 * along["A"]})
    np.testing.assert_allclose(found.multipliers_by_duration @ along["durations"], expected, rtol=1e-7, atol=1e-9)


def test_a_multiplier_beyond_double_precision_still_has_a_derivative():
    """log lambda = sum of a_k T_k for a scalar system: its derivative by T_k is a_k, though lambda underflows."""
    system = lp.PeriodicSystem.from_matrices([[[-500.0]], [[-900.0]]], [[1.0], [0.0]], [1.0, 1.0])
    assert lp.sensitivity(system).log_multipliers_by_duration == pytest.approx(np.array([[-500.0, -900.0]]), rel=1e-12)


def test_the_names_of_the_initial_states_derivatives_have_their_shapes():
    found = lp.sensitivity(example(5))
    assert found.initial_state_by_duration.shape == (n, N)
    assert found.initial_state_by_forcing.shape == (n, N, n)
    assert found.initial_state_by_level.shape == (n, m)
    assert found.initial_state_by_matrix.shape == (n, N, n, n)
    assert found.log_multipliers_by_duration.shape == (n, N)


def test_units_of_the_states_do_not_matter():
    system, scale = example(6), np.array([1e-3, 1.0, 1e5])
    other = replace(
        system,
        A=scale[:, None] * system.A / scale,
        B=scale[:, None] * system.B,
        r=scale * system.r,
        C=system.C / scale,
    )
    a, b = lp.sensitivity(system).of_amplitude("z2"), lp.sensitivity(other).of_amplitude("z2")
    np.testing.assert_allclose(b.by_duration, a.by_duration, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(b.by_forcing * scale, a.by_forcing, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(
        scale[:, None] * b.by_matrix / scale, a.by_matrix, rtol=1e-10, atol=1e-12 * np.abs(a.by_matrix).max()
    )


def test_the_duty_cycle_of_a_machine_moves_its_mean_as_differences_say():
    machine = lp.load_machine("kunt_singh_1990")
    system = lp.ltv_model(machine, frequency=4.0).system
    on_time = np.array([1.0, -1.0]) * system.period

    def mean(by: float) -> float:
        return lp.steady_state(replace(system, durations=system.durations + by * on_time)).mean("position")

    found = lp.sensitivity(system).along(durations=on_time).mean("position")
    assert found == pytest.approx((mean(1e-5) - mean(-1e-5)) / 2e-5, rel=1e-7)


def test_a_system_without_an_orbit_has_no_sensitivity():
    with pytest.raises(lp.NoOrbitError):
        lp.sensitivity(lp.PeriodicSystem.from_matrices([[[0.0]]], [[1.0]], [1.0]))


@pytest.mark.parametrize(
    ("along", "message"),
    [
        ({"durations": [1.0]}, r"durations: found shape \(1,\), expected \(4\)"),
        ({"levels": [1.0, 2.0, 3.0]}, r"levels: found shape \(3,\), expected \(2\)"),
        ({"A": np.full((4, 3, 3), np.nan)}, "A: found nan"),
    ],
)
def test_bad_directions_are_named(along, message):
    with pytest.raises(ValueError, match=message):
        lp.sensitivity(example(0)).along(**along)
