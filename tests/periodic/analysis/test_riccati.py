"""LQR and Kalman, continuous and sampled: python-control's LTI answers, ODE integration, duality, outcomes."""

import control as ct
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

import ltvpneu as lp
from tests.periodic.strategies import shifted, split_lti

Q, R = np.diag([1.0, 2.0, 0.5]), np.diag([1.0, 0.3])
S = 0.1 * np.array([[1.0, 0.0], [-1.0, 0.5], [0.0, 0.2]])


def unstable_lti(durations) -> lp.PeriodicSystem:
    system = split_lti(durations)
    return lp.PeriodicSystem.from_matrices(
        system.A + 2.5 * np.eye(3), system.f, system.durations, B=system.B, C=system.C
    )


def test_a_split_lti_system_has_the_lti_regulator_and_filter():
    system = unstable_lti([0.2, 0.0, 0.01, 0.5])
    A, B, C = system.A[0], system.B[0], system.C[0]
    K, X, poles = ct.lqr(A, B, Q, R, S)
    found = lp.lqr(system, Q, R, S=S)
    for k in range(4):
        np.testing.assert_allclose(found.cost_to_go[k], X, rtol=1e-9)
    np.testing.assert_allclose(found.gain(0.33), K, rtol=1e-9)
    expected = np.sort(np.abs(np.exp(poles * system.period)))
    np.testing.assert_allclose(np.sort(np.abs(found.multipliers)), expected, rtol=1e-9)
    L, P, _ = ct.lqe(A, np.eye(3), C, Q, R)
    estimator = lp.kalman(system, Q, R)
    np.testing.assert_allclose(estimator.covariance[2], P, rtol=1e-9)
    np.testing.assert_allclose(estimator.gain([0.1, 0.6])[1], L, rtol=1e-9)


def test_equal_steps_sampled_give_the_discrete_answers():
    h = 0.3
    system = unstable_lti([h, h])
    A, B, C = system.A[0], system.B[0], system.C[0]
    held = np.zeros((5, 5))
    held[:3, :3], held[:3, 3:] = A, B
    cost, noise = np.zeros((5, 5)), np.zeros((3, 3))
    weights = np.block([[Q, S], [S.T, R]])
    for x, w in zip(*np.polynomial.legendre.leggauss(20), strict=True):
        step = expm(held * h * (x + 1) / 2)
        cost += w * h / 2 * step.T @ weights @ step
        noise += w * h / 2 * step[:3, :3] @ Q @ step[:3, :3].T
    step = expm(held * h)
    F, Gamma = step[:3, :3], step[:3, 3:]
    X = solve_discrete_are(F, Gamma, cost[:3, :3], cost[3:, 3:], s=cost[:3, 3:])
    found = lp.lqr(system, Q, R, S=S, sampled=True)
    np.testing.assert_allclose(found.cost_to_go[1], X, rtol=1e-9)
    K = np.linalg.solve(cost[3:, 3:] + Gamma.T @ X @ Gamma, Gamma.T @ X @ F + cost[:3, 3:].T)
    np.testing.assert_allclose(found.gain(0.1), K, rtol=1e-8)
    P = solve_discrete_are(F.T, C.T, noise, R)
    estimator = lp.kalman(system, Q, R, sampled=True)
    np.testing.assert_allclose(estimator.covariance[0], P, rtol=1e-9)
    np.testing.assert_allclose(estimator.gain(0.1), P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=1e-9)


def example(seed: int) -> lp.PeriodicSystem:
    """Every step unstable; random, so that inputs and outputs reach every mode."""
    random = np.random.default_rng(seed)
    N = 1 + seed % 4
    return lp.PeriodicSystem.from_matrices(
        random.normal(size=(N, 3, 3)),
        np.zeros((N, 3)),
        random.uniform(0.1, 1.5, size=N),
        B=random.normal(size=(N, 3, 2)),
        C=random.normal(size=(N, 2, 3)),
    )


@pytest.mark.parametrize("seed", range(12))
def test_the_solution_integrates_the_riccati_equation_and_its_twins_agree(seed):
    system = example(seed)
    found = lp.lqr(system, Q, R)
    size = np.abs(found.cost_to_go).max()
    assert found.residual < 1e-9
    assert (np.abs(found.multipliers) < 1).all()
    k = system.n_steps - 1
    A, G = system.A[k], system.B[k] @ np.linalg.solve(R, system.B[k].T)

    def backward(t, x):
        X = x.reshape(3, 3)
        return (A.T @ X + X @ A - X @ G @ X + Q).ravel()

    reached = solve_ivp(
        backward, (0, system.durations[k]), found.cost_to_go[0].ravel(), method="LSODA", rtol=1e-10, atol=1e-12 * size
    ).y[:, -1]
    np.testing.assert_allclose(reached.reshape(3, 3), found.cost_to_go[k], atol=1e-6 * size)
    later = lp.lqr(shifted(system), Q, R)
    np.testing.assert_allclose(later.cost_to_go, np.roll(found.cost_to_go, -1, axis=0), atol=1e-8 * size)
    finer = lp.lqr(system.split(np.full(system.n_steps, 2)), Q, R)
    np.testing.assert_allclose(finer.cost_to_go[::2], found.cost_to_go, atol=1e-8 * size)
    middle = system.switching_times[:-1] + system.durations / 2
    np.testing.assert_allclose(found.cost_to_go_at(middle), finer.cost_to_go[1::2], atol=1e-8 * size)


@pytest.mark.parametrize("seed", range(12))
def test_the_filter_is_the_regulator_of_the_transposed_system_run_backward(seed):
    system = example(seed)
    dual = lp.PeriodicSystem.from_matrices(
        np.swapaxes(system.A[::-1], 1, 2), system.f, system.durations[::-1], B=np.swapaxes(system.C[::-1], 1, 2)
    )
    X = lp.lqr(dual, Q, R).cost_to_go
    P = lp.kalman(system, Q, R).covariance
    np.testing.assert_allclose(P, np.roll(X[::-1], 1, axis=0), atol=1e-9 * np.abs(P).max())


def test_holding_the_control_costs_more_and_finer_holding_less():
    system = unstable_lti([0.3, 0.4])
    free = np.trace(lp.lqr(system, Q, R).cost_to_go[0])
    held = [np.trace(lp.lqr(system.split([n, n]), Q, R, sampled=True).cost_to_go[0]) for n in (1, 4, 16)]
    assert held[0] > held[1] > held[2] > free
    assert held[2] == pytest.approx(free, rel=1e-2)


def test_the_sampled_closed_loop_has_the_multipliers_and_the_cost():
    system = unstable_lti([0.3, 0.4])
    found = lp.lqr(system, Q, R, sampled=True)
    loop, z, cost = np.eye(3), np.array([1.0, -1.0, 0.5]), 0.0
    start = z.copy()
    for k in [0, 1] * 200:
        held = np.zeros((5, 5))
        held[:3, :3], held[:3, 3:] = system.A[k], system.B[k]
        u = -found.step_gains[k] @ z
        both, h = np.append(z, u), system.durations[k]
        for x, w in zip(*np.polynomial.legendre.leggauss(10), strict=True):
            at = expm(held * h * (x + 1) / 2) @ both
            cost += w * h / 2 * (at[:3] @ Q @ at[:3] + u @ R @ u)
        z = (expm(held * h) @ both)[:3]
    for k in range(2):
        held = np.zeros((5, 5))
        held[:3, :3], held[:3, 3:] = system.A[k], system.B[k]
        step = expm(held * system.durations[k])
        loop = (step[:3, :3] - step[:3, 3:] @ found.step_gains[k]) @ loop
    assert cost == pytest.approx(start @ found.cost_to_go[0] @ start, rel=1e-9)
    np.testing.assert_allclose(np.poly(found.multipliers), np.poly(loop), atol=1e-11)


def test_unstable_states_that_the_cost_does_not_see_are_stabilized_all_the_same():
    """x' = x + u with no weight on x: X = 2 puts the pole at -1 (python-control's lqr says so too)."""
    system = lp.PeriodicSystem.from_matrices([[[1.0]]] * 2, [[0.0]] * 2, [0.2, 0.5], B=[[[1.0]]] * 2)
    found = lp.lqr(system, [[0.0]], [[1.0]])
    assert found.cost_to_go.ravel() == pytest.approx([2.0, 2.0], rel=1e-10)
    assert found.multipliers[0] == pytest.approx(np.exp(-0.7), rel=1e-10)


def test_a_stiff_system_has_its_regulator():
    A, B = np.diag([0.5, -1e5]), np.array([[1.0], [1e3]])
    system = lp.PeriodicSystem.from_matrices([A] * 2, np.zeros((2, 2)), [0.5, 1.0], B=[B] * 2)
    _, X, _ = ct.lqr(A, B, np.eye(2), [[1.0]])
    np.testing.assert_allclose(lp.lqr(system, np.eye(2), [[1.0]]).cost_to_go[1], X, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("weight", [0.0, 1.0])
@pytest.mark.parametrize("sampled", [False, True])
def test_a_system_that_cannot_be_stabilized_is_named(weight, sampled):
    system = lp.PeriodicSystem.from_matrices([[[1.0]]] * 2, [[0.0]] * 2, [0.2, 0.5], B=[[[0.0]]] * 2)
    with pytest.raises(
        lp.NotStabilizableError, match="the system is not stabilizable, .* on or outside it: 2.01375"
    ) as caught:
        lp.lqr(system, [[weight]], [[1.0]], sampled=sampled)
    assert caught.value.multipliers == pytest.approx([np.exp(0.7)])
    blind = lp.PeriodicSystem.from_matrices([[[1.0]]] * 2, [[0.0]] * 2, [0.2, 0.5], C=[[[0.0]]] * 2)
    with pytest.raises(lp.NotStabilizableError, match="the system is not detectable"):
        lp.kalman(blind, [[1.0]], [[1.0]], sampled=sampled)


def test_an_integrator_that_the_cost_does_not_see_has_no_stabilizing_solution():
    system = lp.PeriodicSystem.from_matrices([[[0.0]]] * 2, [[0.0]] * 2, [0.2, 0.5], B=[[[1.0]]] * 2)
    with pytest.raises(lp.NotStabilizableError, match="a mode on the unit circle alone"):
        lp.lqr(system, [[0.0]], [[1.0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(2), R), r"Q: found shape \(2, 2, 2\), expected \(2, 3, any\)"),
        ((-np.eye(3), R), "Q: found an eigenvalue of -1, expected none below zero"),
        ((Q, np.zeros((2, 2))), "R: found an eigenvalue of 0, expected all above zero"),
        ((Q, [[1.0, 2.0], [0.0, 1.0]]), "R: found a difference of 2 from its transpose"),
        ((Q, R * np.nan), "R: found nan"),
    ],
)
def test_bad_weights_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        lp.lqr(unstable_lti([0.3, 0.4]), *arguments)


def test_weights_that_are_indefinite_only_together_are_named():
    with pytest.raises(ValueError, match=r"\[\[Q, S\], \[S', R\]\]: found an eigenvalue of -"):
        lp.lqr(unstable_lti([0.3, 0.4]), Q, R, S=10 * S)
