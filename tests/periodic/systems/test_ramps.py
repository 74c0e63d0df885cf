"""Steps whose coefficients ramp, against an independent integrator, and at their order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp

RNG = np.random.default_rng(3)
DURATIONS = [0.4, 0.6, 0.5]


def pair(n: int = 3, m: int = 2) -> tuple[lp.PeriodicSystem, lp.PeriodicSystem]:
    """Two systems that are the ends of ramps; the last step does not change."""
    ends = []
    A, B = RNG.normal(size=(2, 3, n, n)) - 1.5 * np.eye(n), RNG.normal(size=(2, 3, n, m))
    f = RNG.normal(size=(2, 3, n))
    for part in (A, B, f):
        part[1, 2] = part[0, 2]
    for i in range(2):
        ends.append(lp.PeriodicSystem.from_matrices(A[i], f[i], DURATIONS, B=B[i]))
    return ends[0], ends[1]


def integrated(starts: lp.PeriodicSystem, ends: lp.PeriodicSystem, z: np.ndarray) -> np.ndarray:
    """The state after a period, by an independent integrator."""
    for step, T in enumerate(starts.durations):

        def rate(t: float, z: np.ndarray, step: int = step, T: float = T) -> np.ndarray:
            A = starts.A[step] + t / T * (ends.A[step] - starts.A[step])
            f = starts.f[step] + t / T * (ends.f[step] - starts.f[step])
            return A @ z + f

        z = solve_ivp(rate, (0, T), z, rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
    return z


def period_map(system: lp.PeriodicSystem, z: np.ndarray) -> np.ndarray:
    return lp.response(system, n_periods=1, initial_state=z).states[:, -1]


@pytest.mark.parametrize(("order", "least"), [(4, 3.8), (2, 1.9)])
def test_the_error_has_the_stated_order(order, least):
    starts, ends = pair()
    z = np.array([0.4, -1.0, 0.2])
    exact = integrated(starts, ends, z)
    counts = [4, 8, 16, 32]
    errors = [np.abs(period_map(lp.ramped(starts, ends, parts=k, order=order), z) - exact).max() for k in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > least
    if order == 4:
        assert errors[-1] < 1e-7


def test_means_have_second_order_only():
    """Inside its parts a ramp is another system, whatever the order of the states between them."""
    starts, ends = pair()

    def means(parts: int) -> np.ndarray:
        orbit = lp.steady_state(lp.ramped(starts, ends, parts=parts))
        return np.array([orbit.mean(i) for i in range(3)])

    exact = (4 * means(512) - means(256)) / 3
    counts = [8, 16, 32, 64]
    errors = [np.abs(means(k) - exact).max() for k in counts]
    assert 1.8 < -np.polyfit(np.log(counts), np.log(errors), 1)[0] < 2.3


def test_inputs_ramp_with_their_levels():
    starts, ends = (replace(system, levels=np.array([0.3, -0.7])) for system in pair())
    z = np.array([0.4, -1.0, 0.2])
    found = period_map(lp.ramped(starts, ends, parts=64), z)
    np.testing.assert_allclose(found, integrated(starts, ends, z), atol=1e-8)


def test_steps_that_do_not_change_stay_one_and_equal_ends_change_nothing():
    starts, ends = pair()
    assert lp.ramped(starts, ends, parts=5).n_steps == 11
    same = lp.ramped(starts, starts, parts=5)
    assert same.n_steps == 3
    np.testing.assert_array_equal(same.A, starts.A)


def test_a_scalar_ramp_has_its_exact_multiplier():
    """Scalars commute, so means alone are exact: the multiplier is the exponential of the integral."""
    starts, ends = (lp.PeriodicSystem.from_matrices([[[a]]], [[0.0]], [2.0]) for a in (-1.0, 0.5))
    assert lp.monodromy(lp.ramped(starts, ends, parts=1))[0, 0] == pytest.approx(np.exp(-0.5), rel=1e-14)


def test_systems_that_differ_otherwise_are_refused():
    starts, ends = pair()
    other = lp.PeriodicSystem.from_matrices(ends.A, ends.r, [0.4, 0.6, 0.6], B=ends.B)
    with pytest.raises(ValueError, match="ends: found other durations"):
        lp.ramped(starts, other)
    with pytest.raises(ValueError, match="ends: found states"):
        lp.ramped(starts, lp.PeriodicSystem.from_matrices(np.zeros((3, 2, 2)), np.zeros((3, 2)), DURATIONS))
    with pytest.raises(ValueError, match="order: found 3"):
        lp.ramped(starts, ends, order=3)
    with pytest.raises(TypeError, match="expected a PeriodicSystem"):
        lp.ramped(starts, 1)
