"""Periodic systems in discrete time, against scipy, brute force and the systems in continuous time they are samples of."""

import control as ct
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

import ltvpneu as lp
from ltvpneu import design

N, STATES, INPUTS, OUTPUTS = 3, 4, 2, 2


def random_system(seed: int, size: float = 0.35) -> lp.DiscretePeriodicSystem:
    rng = np.random.default_rng(seed)
    return lp.DiscretePeriodicSystem.from_matrices(
        size * rng.standard_normal((N, STATES, STATES)),
        rng.standard_normal((N, STATES)),
        [0.1, 0.2, 0.3],
        B=rng.standard_normal((N, STATES, INPUTS)),
        C=rng.standard_normal((N, OUTPUTS, STATES)),
        D=rng.standard_normal((N, OUTPUTS, INPUTS)),
    )


def chained(system: lp.DiscretePeriodicSystem) -> ct.StateSpace:
    """The stacked system of one period, without offsets, by plain products."""
    n, m, p = STATES, INPUTS, OUTPUTS
    rows, C, D = np.eye(n, n + N * m), [], []
    for k in range(N):
        seen = system.C[k] @ rows
        seen[:, n + k * m : n + (k + 1) * m] += system.D[k]
        rows = system.A[k] @ rows
        rows[:, n + k * m : n + (k + 1) * m] += system.B[k]
        C.append(seen[:, :n])
        D.append(seen[:, n:])
    assert p * N == len(np.concatenate(C))
    return ct.ss(rows[:, :n], rows[:, n:], np.concatenate(C), np.concatenate(D), 1.0)


@pytest.mark.parametrize("seed", range(4))
def test_multipliers_gramians_and_norms(seed: int) -> None:
    system = random_system(seed)
    lti = chained(system)
    found = lp.floquet(system)
    np.testing.assert_allclose(
        np.sort(np.abs(found.multipliers)), np.sort(np.abs(np.linalg.eigvals(lti.A))), rtol=1e-9, atol=1e-14
    )
    np.testing.assert_allclose(lp.monodromy(system), lti.A, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.monodromy, lti.A, rtol=1e-12, atol=1e-14)
    grams = lp.gramians(system)
    P, Q = solve_discrete_lyapunov(lti.A, lti.B @ lti.B.T), solve_discrete_lyapunov(lti.A.T, lti.C.T @ lti.C)
    np.testing.assert_allclose(grams.controllability[0], P, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(grams.observability[0], Q, rtol=1e-9, atol=1e-11)
    following = system.A[0] @ P @ system.A[0].T + system.B[0] @ system.B[0].T
    np.testing.assert_allclose(grams.controllability_at([0.15])[0], following, rtol=1e-9, atol=1e-11)
    # The norm of the stacked system is that of N steps.
    right = np.trace(lti.C @ P @ lti.C.T) + np.trace(lti.D @ lti.D.T)
    assert lp.h2_norm(system) ** 2 * N == pytest.approx(right, rel=1e-10)
    assert lp.hankel_norm(system) == pytest.approx(float(np.max(grams.hankel_singular_values)))
    omega = np.linspace(0, np.pi, 4001)
    response = lti.C @ np.linalg.solve(np.exp(1j * omega)[:, None, None] * np.eye(STATES) - lti.A, lti.B) + lti.D
    gains = np.linalg.norm(response, ord=2, axis=(1, 2))
    assert lp.hinf_norm(system) == pytest.approx(gains.max(), rel=1e-5)
    assert lp.hinf_norm(system) >= gains.max() * (1 - 1e-12)
    W = np.diag([1.0, -2.0, 0.5, 0.0])
    for adjoint in (False, True):
        X = lp.lyapunov(system, W, adjoint=adjoint)
        for k in range(N):
            A, after = system.A[k], X[(k + 1) % N]
            right = X[k] - A.T @ after @ A if adjoint else after - A @ X[k] @ A.T
            np.testing.assert_allclose(right, W, atol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_regulator_and_estimator_by_iteration(seed: int) -> None:
    system = random_system(seed, size=0.8)
    rng = np.random.default_rng(seed)
    Q, R, S = np.eye(STATES), np.diag([1.0, 3.0]), 0.2 * rng.standard_normal((STATES, INPUTS))
    X, Y = np.zeros((STATES, STATES)), np.zeros((STATES, STATES))
    costs, gains = np.zeros((N, STATES, STATES)), np.zeros((N, INPUTS, STATES))
    spreads, corrections = np.zeros((N, STATES, STATES)), np.zeros((N, STATES, OUTPUTS))
    for _ in range(400):
        for k in reversed(range(N)):
            A, B = system.A[k], system.B[k]
            gains[k] = np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A + S.T)
            costs[k] = X = Q + A.T @ X @ A - (A.T @ X @ B + S) @ gains[k]
            X = (X + X.T) / 2
        for k in range(N):
            A, C = system.A[k], system.C[k]
            spreads[k] = Y
            corrections[k] = np.linalg.solve(C @ Y @ C.T + R, C @ Y).T
            Y = A @ (Y - corrections[k] @ C @ Y) @ A.T + Q
            Y = (Y + Y.T) / 2
    found = lp.lqr(system, Q, R, S=S)
    np.testing.assert_allclose(found.cost_to_go, costs, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.step_gains, gains, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.gain(0.15), gains[1], rtol=1e-8, atol=1e-10)
    loop = lp.floquet(lp.state_feedback(system, found.step_gains))
    np.testing.assert_allclose(np.abs(loop.multipliers), np.abs(found.multipliers), rtol=1e-7, atol=1e-12)
    seen = lp.kalman(system, Q, R)
    np.testing.assert_allclose(seen.covariance, spreads, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(seen.step_gains, corrections, rtol=1e-8, atol=1e-10)
    assert found.is_sampled
    assert seen.is_sampled
    with pytest.raises(ValueError, match="take cost_to_go"):
        found.cost_to_go_at([0.1])


def test_a_duty_model_is_one_in_si_units() -> None:
    model = design.duty_model(lp.load_machine("kunt_singh_1990"), 15.0, 0.5, inputs=["duty"])
    system = lp.DiscretePeriodicSystem.from_control(model)
    Q, R = np.diag([1e4, 1.0, 1e-12, 1e-12][: system.n_states]), np.eye(1)
    found = lp.lqr(system, Q, R)
    right = solve_discrete_are(model.A, model.B, Q, R)
    np.testing.assert_allclose(found.cost_to_go[0], right, rtol=1e-6, atol=1e-9 * np.abs(right).max())
    assert lp.floquet(system).is_stable
    np.testing.assert_allclose(lp.lifted(system).A, model.A)


def test_orbit_and_response() -> None:
    system = random_system(7).with_levels([0.5, -1.0])
    orbit = lp.steady_state(system)
    found = lp.response(system, n_periods=2, initial_state=orbit.initial_state)
    np.testing.assert_allclose(found.states[:, N], orbit.initial_state, rtol=1e-10)
    np.testing.assert_allclose(found.time, [0, 0.1, 0.3, 0.6, 0.7, 0.9, 1.2])
    outputs = found.outputs[:, :N]
    assert orbit.mean("y1") == pytest.approx(outputs[0].mean())
    assert orbit.maximum("y2") == pytest.approx(outputs[1].max())
    np.testing.assert_allclose(orbit.at([0.25])[:STATES, 0], found.states[:, 1], rtol=1e-10)
    integrator = lp.DiscretePeriodicSystem.from_matrices([[[1.0]]], [[0.5]], [1.0])
    with pytest.raises(lp.NoOrbitError, match=r"drifts by z1 \+0.5"):
        lp.steady_state(integrator)


def test_samples_of_a_system_in_continuous_time() -> None:
    rng = np.random.default_rng(3)
    system = lp.PeriodicSystem.from_matrices(
        rng.standard_normal((2, 3, 3)) - 2 * np.eye(3),
        rng.standard_normal((2, 3)),
        [0.3, 0.7],
        B=rng.standard_normal((2, 3, 1)),
        C=rng.standard_normal((2, 1, 3)),
    ).with_levels([0.7])
    found = lp.sampled(system)
    np.testing.assert_allclose(lp.floquet(found).log_moduli, lp.floquet(system).log_moduli, rtol=1e-9)
    np.testing.assert_allclose(lp.steady_state(found).step_states, lp.steady_state(system).step_states, rtol=1e-10)
    for stacked in (False, True):
        one, other = lp.lifted(found, stacked=stacked), lp.lifted(system, stacked=stacked)
        for letter in "ABCD":
            np.testing.assert_allclose(getattr(one, letter), getattr(other, letter), rtol=1e-12, atol=1e-14)


def test_interconnections_are_those_of_the_chained_systems() -> None:
    a, b = random_system(1), random_system(2)
    s = np.exp(0.3j)

    def gain(system: lp.DiscretePeriodicSystem) -> np.ndarray:
        lti = lp.lifted(system, stacked=True)
        value = lti(s)
        # Stacked by input and by output first; without "one".
        return np.asarray(value)[:, :-1]

    H, K = gain(a), gain(b)
    np.testing.assert_allclose(gain(lp.series(a, b)), K @ H, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(gain(a + b), H + K, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(gain(a - 2 * b), H - 2 * K, rtol=1e-9, atol=1e-11)
    closed = np.linalg.solve(np.eye(len(H)) + H @ K, H)
    np.testing.assert_allclose(gain(lp.feedback(a, b)), closed, rtol=1e-9, atol=1e-11)
    even = lp.DiscretePeriodicSystem.from_matrices([[[0.5]]] * 2, [[0.0]] * 2, [0.1, 0.1], B=[[[1.0]]] * 2)
    lag = ct.ss([[0.3]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    three = lp.DiscretePeriodicSystem.from_matrices([[[0.2]]] * 3, [[0.0]] * 3, [0.1] * 3, B=[[[1.0]]] * 3)
    assert lp.series(even, lag).n_steps == 2
    assert lp.series(even, three).n_steps == 6


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda: lp.series(random_system(1), ct.ss(-1, [[1, 1]], [[1], [1]], 0)), ValueError, "found dt = 0"),
        (lambda: lp.series(random_system(1), ct.ss(0.5, [[1, 1]], [[1], [1]], 0, 0.1)), ValueError, "steps differ"),
        (lambda: random_system(1) + lp.sampled(_other_durations()), ValueError, "found step 0 of 0.1 s"),
        (lambda: lp.DiscretePeriodicSystem.from_control(ct.ss(-1, 1, 1, 0)), ValueError, "in continuous time"),
        (lambda: lp.DiscretePeriodicSystem.from_control(ct.ss(0.5, 1, 1, 0, True)), ValueError, "without a sampling"),
        (lambda: lp.lqr(ct.ss(0.5, 1, 1, 0, 0.1), [[1]], [[1]]), TypeError, "from_control makes one"),  # pyright: ignore
        (lambda: lp.forced_response(random_system(1), [0, 1], [[0, 0]] * 2), TypeError, "expected a PeriodicSystem"),  # pyright: ignore
        (
            lambda: lp.DiscretePeriodicSystem.from_matrices([[[0.5]]] * 2, [[0.0]] * 2, [0.1, 0.0]),
            ValueError,
            "found 0 s in step 1, expected all above zero",
        ),
    ],
)
def test_bad_input(call, error, says) -> None:
    with pytest.raises(error, match=says):
        call()


def _other_durations() -> lp.PeriodicSystem:
    return lp.PeriodicSystem.from_matrices(
        [-np.eye(2)] * 3, np.zeros((3, 2)), [0.2, 0.2, 0.2], B=[np.eye(2)] * 3, C=[np.eye(2)] * 3
    )
