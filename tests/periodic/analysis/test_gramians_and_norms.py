"""Gramians, Lyapunov equations, H2, Hinf and Hankel norms: laws, LTI answers of python-control, and slow twins."""

import math

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_lyapunov

import ltvpneu as lp
from tests.periodic.strategies import shifted, split_lti, systems

DURATIONS = [0.7, 0.0, 0.01, 1.3]


def lti_of(system: lp.PeriodicSystem) -> ct.StateSpace:
    return ct.ss(system.A[0], system.B[0], system.C[0], system.D[0])


# Laws
# -----------------------------------------------------------------------------------------------------------------


def test_a_split_lti_system_has_the_lti_answers():
    system = split_lti(DURATIONS)
    lti = lti_of(system)
    P = solve_continuous_lyapunov(lti.A, -lti.B @ lti.B.T)
    Q = solve_continuous_lyapunov(lti.A.T, -lti.C.T @ lti.C)
    found = lp.gramians(system)
    for k in range(4):
        np.testing.assert_allclose(found.controllability[k], P, rtol=1e-12)
        np.testing.assert_allclose(found.observability[k], Q, rtol=1e-12)
    assert lp.h2_norm(system) == pytest.approx(ct.norm(lti, 2), rel=1e-12)
    assert lp.hinf_norm(system) == pytest.approx(ct.norm(lti, "inf"), rel=1e-5)
    peak = max(np.linalg.norm(lti(1j * w), 2) for w in np.linspace(0, 3, 3001))
    assert lp.hinf_norm(system) == pytest.approx(peak, rel=1e-6)
    assert lp.hankel_norm(system) == pytest.approx(math.sqrt(np.linalg.eigvals(P @ Q).real.max()), rel=1e-12)


@settings(max_examples=10)
@given(systems(ports=(2, 1)))
def test_norms_do_not_depend_on_the_starting_step(system):
    for norm in (lp.h2_norm, lp.hinf_norm, lp.hankel_norm):
        # The Hankel norm's peak inside a step is located to the root of the rounding error.
        assert norm(shifted(system)) == pytest.approx(norm(system), rel=1e-10)


@settings(max_examples=10)
@given(systems(ports=(1, 2)))
def test_splitting_steps_changes_no_norm_and_no_gramian(system):
    pieces = np.arange(system.n_steps) % 3 + 1
    finer, starts = system.split(pieces), np.cumsum(pieces) - pieces
    for norm in (lp.h2_norm, lp.hinf_norm, lp.hankel_norm):
        assert norm(finer) == pytest.approx(norm(system), rel=1e-10)
    a, b = lp.gramians(system), lp.gramians(finer)
    np.testing.assert_allclose(
        b.controllability[starts], a.controllability, atol=1e-12 * np.abs(a.controllability).max()
    )
    np.testing.assert_allclose(b.observability[starts], a.observability, atol=1e-12 * np.abs(a.observability).max())
    times = finer.switching_times[:-1]
    np.testing.assert_allclose(
        a.controllability_at(times), b.controllability, atol=1e-12 * np.abs(a.controllability).max()
    )
    np.testing.assert_allclose(a.observability_at(times), b.observability, atol=1e-12 * np.abs(a.observability).max())


def test_hankel_norm_finds_a_peak_just_before_the_period_ends():
    system = lp.PeriodicSystem.from_matrices(
        [
            [[-4.479294, -0.79449, -1.880515], [0.5, -6.334289, 0.0], [0.0, 1.585485, -3.644218]],
            [[-4.618818, 0.0, -0.690017], [-0.88579, -5.0, 0.237296], [-1.399429, 0.75, -4.01]],
        ],
        np.zeros((2, 3)),
        [0.59012714, 0.08295856],
        B=[[[-0.5], [0.293456], [0.016151]], [[1.907307], [0.5], [1.762023]]],
        C=[
            [[1.923397, 0.5, -0.62324], [0.5, 1.031176, 0.833333]],
            [[1.85491, 1.074189, 0.5], [0.224732, 0.5, -1.331155]],
        ],
    )
    dense = lp.gramians(system).hankel_singular_values_at(np.linspace(0, system.period, 20001))
    assert np.argmax(dense[:, 0]) > 19000
    assert lp.hankel_norm(system) == pytest.approx(dense.max(), rel=1e-7)
    assert lp.hankel_norm(system.split([1, 2])) == pytest.approx(lp.hankel_norm(system), rel=1e-12)


@settings(max_examples=10)
@given(systems(ports=(2, 2)))
def test_norms_do_not_depend_on_the_units_of_the_states_and_bound_each_other(system):
    scale = np.array([1e-3, 1.0, 1e5])
    other = lp.PeriodicSystem.from_matrices(
        scale[:, None] * system.A / scale, system.f, system.durations, B=scale[:, None] * system.B, C=system.C / scale
    )
    for norm in (lp.h2_norm, lp.hinf_norm, lp.hankel_norm):
        assert norm(other) == pytest.approx(norm(system), rel=1e-8)
    hankel = lp.gramians(system).hankel_singular_values
    assert hankel.max() <= lp.hankel_norm(system) * (1 + 1e-12)
    assert lp.hankel_norm(system) <= lp.hinf_norm(system) * (1 + 1e-9)


@settings(max_examples=10)
@given(systems(ports=(2, 2)))
def test_controllability_and_observability_give_the_same_h2_norm(system):
    """The mean of tr C P C' is that of tr B' Q B."""
    times = (np.arange(1000) + 0.5) / 1000 * system.period
    step, _ = system.step_at(times)
    found = lp.gramians(system)
    forward = np.einsum("tpi,tij,tpj->t", system.C[step], found.controllability_at(times), system.C[step])
    backward = np.einsum("tim,tij,tjm->t", system.B[step], found.observability_at(times), system.B[step])
    # The midpoint rule jumps at switches.
    assert np.mean(forward) == pytest.approx(lp.h2_norm(system) ** 2, rel=1e-2)
    assert np.mean(backward) == pytest.approx(lp.h2_norm(system) ** 2, rel=1e-2)


# Twins
# -----------------------------------------------------------------------------------------------------------------


def lossy() -> lp.PeriodicSystem:
    return lp.PeriodicSystem.from_matrices(
        [[[0.0, 1.0], [-1.0, -0.4]], [[0.0, 1.0], [-2.0, -0.4]]],
        np.zeros((2, 2)),
        [0.8, 1.2],
        B=[[[0.0], [1.0]], [[0.0], [2.0]]],
        C=[[[1.0, 0.0]], [[1.0, 0.3]]],
    )


def test_gramians_solve_their_differential_equations():
    system = lossy()
    found = lp.gramians(system)

    def forward(t, P, k):
        P = P.reshape(2, 2)
        return (system.A[k] @ P + P @ system.A[k].T + system.B[k] @ system.B[k].T).ravel()

    for k in range(2):
        reached = solve_ivp(
            forward, (0, system.durations[k]), found.controllability[k].ravel(), args=(k,), rtol=1e-11, atol=1e-13
        ).y[:, -1]
        np.testing.assert_allclose(reached.reshape(2, 2), found.controllability[1 - k], rtol=1e-9)


def test_the_h2_norm_equals_quadrature_of_the_impulse_responses():
    """H2^2 is the mean over the impulse's time of the energy of what comes out."""
    system = lossy()
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = 0.0
    for k, duration in enumerate(system.durations):
        for x, weight in zip(nodes, weights, strict=True):
            local = (x + 1) / 2 * duration
            z = expm(system.A[k] * (duration - local)) @ system.B[k]
            energy = energy_within(system, k, system.B[k], duration - local)
            for j in range(k + 1, k + 120):
                energy += energy_within(system, j % 2, z, system.durations[j % 2])
                z = expm(system.A[j % 2] * system.durations[j % 2]) @ z
            total += weight * duration / 2 * energy
    assert lp.h2_norm(system) == pytest.approx(math.sqrt(total / system.period), rel=1e-10)


def energy_within(system, k, z, duration) -> float:
    nodes, weights = np.polynomial.legendre.leggauss(12)
    values = [np.sum((system.C[k] @ expm(system.A[k] * (x + 1) / 2 * duration) @ z) ** 2) for x in nodes]
    return float(weights @ values) * duration / 2


@pytest.mark.parametrize("D", [0.0, 2.0])
def test_the_hinf_norm_is_the_limit_of_fast_sampling(D):
    system = lossy()
    system = lp.PeriodicSystem.from_matrices(
        system.A, system.f, system.durations, B=system.B, C=system.C, D=[[[D]], [[0.5 * D]]]
    )
    errors = []
    for rate in (10, 20):
        finer = system.split([2 * rate, 3 * rate])
        lifted = lp.lifted(finer, stacked=True)
        A, B, C, feed = lifted.A, lifted.B[:, :-1], lifted.C, lifted.D[:, :-1]
        gains = [
            np.linalg.norm(feed + C @ np.linalg.solve(np.exp(1j * x) * np.eye(2) - A, B), 2)
            for x in np.linspace(0, np.pi, 361)
        ]
        errors.append(max(gains) / lp.hinf_norm(system) - 1)
    # Sampling outputs at the start of each piece is of first order; what is left of it halves.
    assert abs(2 * errors[1] - errors[0]) < 1e-3


def test_the_hinf_norm_of_a_feedthrough_alone_is_its_gain():
    system = split_lti(DURATIONS, D=0.0)
    static = lp.PeriodicSystem.from_matrices(
        system.A,
        np.zeros((4, 3)),
        DURATIONS,
        B=np.zeros((4, 3, 2)),
        C=system.C,
        D=np.tile([[3.0, 0.0], [0.0, 4.0]], (4, 1, 1)),
    )
    assert lp.hinf_norm(static) == pytest.approx(4.0, rel=1e-10)
    assert lp.h2_norm(static) == math.inf
    assert lp.hankel_norm(static) == 0.0


def test_a_sharp_resonance_has_its_hinf_norm_to_full_accuracy():
    """|G| of 1 / (s^2 + 2 d s + 1) peaks at 1 / (2 d sqrt(1 - d^2))."""
    d = 1e-4
    A = [[[0.0, 1.0], [-1.0, -2 * d]]] * 2
    system = lp.PeriodicSystem.from_matrices(
        A, np.zeros((2, 2)), [0.4, 0.9], B=[[[0.0], [1.0]]] * 2, C=[[[1.0, 0.0]]] * 2
    )
    assert lp.hinf_norm(system) == pytest.approx(1 / (2 * d * math.sqrt(1 - d * d)), rel=1e-9)


def test_two_channels_with_the_same_gain_have_it():
    A, B = np.diag([-1.0, -1.0]), np.eye(2)
    system = lp.PeriodicSystem.from_matrices([A] * 2, np.zeros((2, 2)), [0.5, 1.0], B=[B] * 2, C=[B] * 2)
    assert lp.hinf_norm(system) == pytest.approx(1.0, rel=1e-12)


def test_a_stiff_system_has_its_norms():
    """A lag of a microsecond beside one of a second: H2^2 = sum of 1 / (2 a) parts, by hand."""
    A, B, C = np.diag([-1.0, -1e6]), np.ones((2, 1)), np.array([[1.0, 1e6]])
    system = lp.PeriodicSystem.from_matrices([A] * 2, np.zeros((2, 2)), [0.5, 1.0], B=[B] * 2, C=[C] * 2)
    exact = 0.5 + 2 * 1e6 / (1 + 1e6) + 1e12 / 2e6
    assert lp.h2_norm(system) ** 2 == pytest.approx(exact, rel=1e-12)
    assert lp.hinf_norm(system) == pytest.approx(2.0, rel=1e-9)


def test_a_short_pulse_of_input_gain_counts():
    """u acts for 1 % of the period only: H2^2 and the Gramian are 1 % of those of u acting all the time."""
    pulse = lp.PeriodicSystem.from_matrices(
        [[[-0.5]]] * 3, [[0.0]] * 3, [0.47, 0.01, 0.52], B=[[[0.0]], [[1.0]], [[0.0]]], C=[[[1.0]]] * 3
    )
    assert lp.h2_norm(pulse) ** 2 == pytest.approx(0.01, rel=1e-12)
    for norm in (lp.hinf_norm, lp.hankel_norm):
        assert norm(pulse) > 0.05


# Lyapunov
# -----------------------------------------------------------------------------------------------------------------


def test_lyapunov_takes_indefinite_weights_and_both_directions():
    system = split_lti(DURATIONS)
    A, W = system.A[0], np.diag([1.0, -2.0, 0.5])
    np.testing.assert_allclose(lp.lyapunov(system, W)[2], solve_continuous_lyapunov(A, -W), atol=1e-13)
    np.testing.assert_allclose(lp.lyapunov(system, W, adjoint=True)[3], solve_continuous_lyapunov(A.T, -W), atol=1e-13)


@settings(max_examples=10)
@given(systems(ports=(2, 2)))
def test_gramians_are_lyapunov_solutions_and_their_factors_triangular_roots(system):
    found, B, C = lp.gramians(system), system.B, system.C
    P = lp.lyapunov(system, B @ np.swapaxes(B, 1, 2))
    Q = lp.lyapunov(system, np.swapaxes(C, 1, 2) @ C, adjoint=True)
    np.testing.assert_allclose(P, found.controllability, atol=1e-11 * np.abs(P).max())
    np.testing.assert_allclose(Q, found.observability, atol=1e-11 * np.abs(Q).max())
    L = lp.lyapunov_factors(system, B)
    np.testing.assert_allclose(L @ np.swapaxes(L, 1, 2), found.controllability, atol=1e-12 * np.abs(P).max())
    np.testing.assert_allclose(np.triu(L, 1), 0.0, atol=0)


def test_a_factor_keeps_directions_that_its_square_loses():
    """Noise reaches the last of four lags through the others: its root is there though P's smallest eigenvalue is lost."""
    A = np.diag([-1e4, -1.0]) + np.array([[0.0, 0.0], [1e-9, 0.0]])
    system = lp.PeriodicSystem.from_matrices([A] * 2, np.zeros((2, 2)), [0.5, 1.0])
    L = lp.lyapunov_factors(system, [[1.0], [0.0]])[0]
    # By hand: p11 = 1 / 2e4, p12 = 1e-9 p11 / (1e4 + 1), p22 = 1e-9 p12; det P / p11 = p22 - p12^2 / p11.
    p11 = 1 / 2e4
    p12 = 1e-9 * p11 / (1e4 + 1)
    assert L[0, 0] ** 2 == pytest.approx(p11, rel=1e-12)
    assert L[1, 1] ** 2 == pytest.approx(1e-9 * p12 - p12**2 / p11, rel=1e-9)


# Outcomes
# -----------------------------------------------------------------------------------------------------------------


def test_unstable_and_bounded_systems_have_infinite_norms_and_no_gramians():
    for pole in (0.3, 0.0):
        system = lp.PeriodicSystem.from_matrices([[[pole]]] * 2, [[0.0]] * 2, [0.5, 0.5], B=[[[1.0]]] * 2)
        verdict = "unstable" if pole else "bounded"
        for norm in (lp.h2_norm, lp.hinf_norm, lp.hankel_norm):
            assert norm(system) == math.inf
        for function in (lp.gramians, lambda s: lp.lyapunov(s, [[1.0]]), lambda s: lp.lyapunov_factors(s, [[1.0]])):
            with pytest.raises(lp.NotStableError, match=f"this one is {verdict}: spectral radius") as caught:
                function(system)
            assert caught.value.floquet.spectral_radius == pytest.approx(math.exp(pole))


def test_a_system_without_inputs_has_norms_of_zero():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[0.0]] * 2, [0.5, 0.5])
    assert lp.h2_norm(system) == lp.hinf_norm(system) == lp.hankel_norm(system) == 0.0


@pytest.mark.parametrize(
    ("W", "message"),
    [
        (np.eye(2), r"W: found shape \(4, 2, 2\), expected \(4, 3, any\)"),
        (np.arange(9.0).reshape(3, 3), "W: found a difference of 4 from its transpose, expected a symmetric"),
        (np.full((3, 3), np.inf), "W: found inf"),
    ],
)
def test_bad_weights_are_named(W, message):
    with pytest.raises(ValueError, match=message):
        lp.lyapunov(split_lti(DURATIONS), W)
