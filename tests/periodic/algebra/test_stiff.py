"""Steps whose rates, growth or structure are at the end of what doubles hold."""

import math
import warnings

import numpy as np
import pytest

import ltvpneu as lp


def _system(A, durations=None, **rest):
    n = np.shape(A)[1]
    return lp.PeriodicSystem.from_matrices(
        A, np.zeros((len(A), n)), np.ones(len(A)) if durations is None else durations, **rest
    )


def _trace(A, durations):
    return sum(np.trace(a) * T for a, T in zip(A, durations, strict=True))


@pytest.mark.parametrize("rate", [1.0, 1e3, 1e5, 1e7, 1e9])
@pytest.mark.parametrize("seed", range(4))
def test_logarithms_sum_to_the_trace_at_any_rate(rate, seed):
    """Liouville's formula; random real rates over all decades in random, well-conditioned coordinates."""
    rng = np.random.default_rng(seed)
    n, N = rng.integers(2, 6), rng.integers(1, 5)
    A = []
    for _ in range(N):
        turn = np.eye(n) + 0.3 * rng.standard_normal((n, n))
        A.append(turn @ np.diag(-(rate ** rng.uniform(0, 1, n))) @ np.linalg.inv(turn))
    durations = rng.uniform(0.3, 3, N)
    found = lp.floquet(_system(A, durations))
    # Rounding of A in coordinates of some condition: a hundred units of the last place of its norm.
    assert found.log_moduli.sum() == pytest.approx(_trace(A, durations), rel=1e-11)
    assert found.verdict == "stable"


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0, 100.0])
def test_two_stiff_steps_that_hand_over_have_both_logarithms_right(share):
    """Step 1 keeps z2 and step 2 keeps z1: the slow vectors (1/a, 1) and (1, 1/b) overlap by 1/a and 1/b."""
    a, b = 1e7 * share, 5e6 * share
    A = [np.array([[-a, share], [0.0, -1e-3 * share]]), np.array([[-share, 0.0], [share, -b]])]
    found = lp.floquet(_system(A, [0.5, 0.5]))
    first = -0.5005 * share + math.log(share / (a - 1e-3 * share)) + math.log(share / (b - share))
    assert found.log_moduli[0] == pytest.approx(first, abs=1e-6)
    assert found.log_moduli.sum() == pytest.approx(_trace(A, [0.5, 0.5]), rel=1e-14)


def test_steps_that_are_diagonal_have_exact_logarithms_however_they_alternate():
    found = lp.floquet(_system([np.diag([-1e9, -1.0]), np.diag([-1.0, -1e9])], [1.0, 2.0]))
    np.testing.assert_array_equal(found.log_moduli, [-1e9 - 2, -2e9 - 1])
    assert found.verdict == "stable"
    assert len(found.maps.factors) < 20


def test_a_fast_oscillation_beside_a_slow_decay_is_not_split_into_millions():
    found = lp.floquet(_system([[[0.0, 1e9], [-1e9, 0.0]], np.diag([-1.0, -2.0])], [1.0, 2.0]))
    # 1e9 radians have a last place of 1e-7, and the squarings of the exponential add up a hundred of these.
    assert found.log_moduli.sum() == pytest.approx(-6.0, abs=1e-4)
    assert len(found.maps.factors) < 10_000


def test_modes_whose_shapes_underflow_leave_verdict_and_norms_right():
    system = _system([[[-3e4]], [[1e3]]], [0.1, 0.3], B=[[[1.0]]] * 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lp.floquet(system)
        assert found.log_moduli[0] == pytest.approx(-2700, rel=1e-14)
        assert found.verdict == "stable"
        assert found.margin == 1e-12
        assert np.isfinite(found.mode_shapes).all()
        assert np.isfinite(found.adjoint_shapes).all()
        # P at the end of the growing step, from P = 1/6e4 at its start.
        peak = (math.exp(600) - 1) / 2e3 + math.exp(600) / 6e4
        assert lp.gramians(system).controllability[0, 0, 0] == pytest.approx(peak, rel=1e-9)
        energy = (peak - 1 / 6e4 - 0.3) / 2e3 + (peak - math.exp(-6000) * peak) / 6e4 + (0.1 - 1 / 6e4) / 6e4
        assert lp.h2_norm(system) == pytest.approx(math.sqrt(energy / 0.4), rel=1e-12)
        with pytest.raises(lp.StepOverflowError, match="though s is no characteristic exponent"):
            lp.harmonic_transfer(system, 0.0)
        with pytest.raises(lp.StepOverflowError, match="no Floquet multiplier is one"):
            lp.steady_state(system)


def test_mode_shapes_solve_the_equations_of_a_stiff_system():
    """A mode goes from the start of one step to that of the next by the step's map, over the exponent's growth."""
    A = [np.array([[-700.0, 2.0], [1.0, -1.0]]), np.array([[-1.0, 0.5], [1.0, -2.0]])]
    system = _system(A, [1.0, 1.0])
    found = lp.floquet(system)
    maps = system.maps.maps[:, :2, :2]
    shapes = found.mode_shapes[:, :, 0]
    # In balanced coordinates the maps are those of the shapes over the scales.
    scales = system.scaled.scales
    reached = scales * (maps[0] @ (shapes[0] / scales)) * np.exp(-found.exponents[0])
    np.testing.assert_allclose(reached, shapes[1], rtol=1e-9)


@pytest.mark.parametrize("forcing", [0.0, 1.0, 1e6])
def test_a_nilpotent_chain_keeps_its_digits_beside_a_forcing(forcing):
    entries = 8e2 * np.array([1.0, -0.3, 0.7, -1.2, 0.05, 2.0, -0.6])
    right = np.array(
        [[np.prod(entries[i:j]) / math.factorial(j - i) if j >= i else 0.0 for j in range(8)] for i in range(8)]
    )
    system = lp.PeriodicSystem.from_matrices([np.diag(entries, 1)], [np.full(8, forcing)], [1.0])
    error = np.abs(lp.monodromy(system) - right).max() / np.abs(right).max()
    # scipy's exponential without a forcing is right to 1e-12.
    assert error < 2e-12
    reached = lp.response(system, n_periods=1, initial_state=np.zeros(8)).states[:, -1]
    exact = forcing * np.array(
        [sum(np.prod(entries[i:j]) / math.factorial(j - i + 1) for j in range(i, 8)) for i in range(8)]
    )
    np.testing.assert_allclose(reached, exact, atol=1e-11 * np.abs(exact).max())


# Conservative systems
# -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "half", "verdict"), [(0.3, 1.0, "bounded"), (0.5, 1.0, "bounded"), (1.0, 1.9, "unstable")]
)
def test_an_undamped_meissner_pendulum_is_bounded_or_unstable(depth, half, verdict):
    """Hill's equation with a square wave; its trace decides: bounded below two in modulus."""
    strengths = 1 + depth, 1 - depth
    system = _system([[[0.0, 1.0], [-k, 0.0]] for k in strengths], [half, half])
    found = lp.floquet(system)
    assert (abs(np.trace(lp.monodromy(system))) < 2) == (verdict == "bounded")
    assert found.verdict == verdict
    assert found.is_bounded == (verdict == "bounded")
    assert not found.is_stable


def test_a_double_multiplier_on_the_circle_is_marginal_since_rounding_hides_whether_it_grows():
    double_integrator = lp.floquet(_system([[[0.0, 1.0], [0.0, 0.0]]] * 2))
    assert double_integrator.verdict == "marginal"
    assert not double_integrator.is_bounded
    assert double_integrator.separation < 10 * math.sqrt(double_integrator.margin)
    assert lp.floquet(_system([[[-1.0]]] * 2)).separation == math.inf


# Without states
# -----------------------------------------------------------------------------------------------------------------


def test_a_static_periodic_gain_has_right_answers_everywhere():
    gain = lp.PeriodicSystem.from_matrices(
        np.zeros((2, 0, 0)), np.zeros((2, 0)), [1.0, 1.0], B=np.zeros((2, 0, 1)), C=np.zeros((2, 1, 0)),
        D=[[[1.0]], [[3.0]]],
    )  # fmt: skip
    found = lp.floquet(gain)
    assert found.is_stable
    assert found.verdict == "stable"
    assert found.spectral_radius == 0.0
    assert found.mode_shapes.shape == (2, 0, 0)
    assert found.adjoint_shapes.shape == (2, 0, 0)
    assert lp.hinf_norm(gain) == 3.0
    assert lp.h2_norm(gain) == math.inf
    assert lp.hankel_norm(gain) == 0.0
    assert lp.gramians(gain).controllability.shape == (2, 0, 0)
    orbit = lp.steady_state(gain.with_levels([2.0]))
    assert orbit.mean("y1") == pytest.approx(4.0)
    assert orbit.amplitude("y1") == pytest.approx(2.0)
    np.testing.assert_array_equal(lp.lifted(gain).D, [[1.0, 0.0]])
    np.testing.assert_array_equal(lp.averaged(gain).D, [[2.0, 0.0]])
    np.testing.assert_allclose(lp.harmonic_transfer(gain, 1j, [0, 1]).ravel(), [2.0, 2j / np.pi], atol=1e-14)
    assert lp.lqr(gain, np.zeros((0, 0)), [[1.0]]).gain(0.5).shape == (1, 0)
    assert lp.kalman(gain, np.zeros((0, 0)), [[1.0]], sampled=True).gain(0.5).shape == (0, 1)
    assert lp.lyapunov(gain, np.zeros((0, 0))).shape == (2, 0, 0)
    assert lp.product_multipliers(np.zeros((2, 0, 0))).multipliers.size == 0


def test_steps_of_no_duration_change_no_norm():
    rng = np.random.default_rng(1)
    A, B, C = (
        rng.standard_normal((3, 3, 3)) - 2 * np.eye(3),
        rng.standard_normal((3, 3, 1)),
        rng.standard_normal((3, 1, 3)),
    )
    durations = np.array([0.3, 0.2, 0.5])
    plain = _system(A, durations, B=B, C=C)
    for k in range(4):
        padded = _system(
            np.insert(A, k, 5 * rng.standard_normal((3, 3)), axis=0), np.insert(durations, k, 0.0),
            B=np.insert(B, k, 10.0, axis=0), C=np.insert(C, k, 10.0, axis=0),
        )  # fmt: skip
        for norm in (lp.h2_norm, lp.hinf_norm, lp.hankel_norm):
            assert norm(padded) == pytest.approx(norm(plain), rel=1e-12)


def test_shapes_of_modes_between_the_starts_of_stiff_steps():
    """p' = (A - exponent) p, by differences, and p is continuous at the switches."""
    A = [[[-1e4, 3.0], [1.0, -1.0]], [[-2.0, 1.0], [0.5, -3e4]]]
    system = lp.PeriodicSystem.from_matrices(A, np.zeros((2, 2)), [0.5, 0.5])
    found = lp.floquet(system)
    times, h = np.array([0.0, 1e-4, 0.2, 0.4999, 0.4999999, 0.5, 0.50001, 0.7, 0.9999]), 1e-7
    step, _ = system.step_at(times)
    for mode in (0, 1):
        before, after = found.mode_shape(mode, times), found.mode_shape(mode, times + h)
        rates = np.einsum("kij,jk->ik", system.A[step] - found.exponents[mode] * np.eye(2), (before + after) / 2)
        inside = times + h <= system.switching_times[step + 1]
        sizes = np.abs(rates).max(axis=0)
        gaps = np.abs((after - before) / h - rates).max(axis=0)
        assert (gaps <= 1e-4 * sizes)[inside].all()
        np.testing.assert_allclose(before[:, 5], found.mode_shapes[1, :, mode], rtol=1e-9, atol=1e-300)
