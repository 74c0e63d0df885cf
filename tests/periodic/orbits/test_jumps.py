"""Jumps of the state at the ends of steps, against very short steps that do the same, and against closed forms."""

import numpy as np
import pytest
from scipy.linalg import expm

import ltvpneu as lp

SHORT = 1e-13
N, STATES, INPUTS, OUTPUTS = 3, 3, 2, 2


def _systems(seed: int) -> tuple[lp.PeriodicSystem, lp.PeriodicSystem]:
    """A system with jumps, and one with a very short step of a great rate, without inputs and outputs, for each."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((N, STATES, STATES)) - 4.0 * np.eye(STATES)
    B, C = rng.standard_normal((N, STATES, INPUTS)), rng.standard_normal((N, OUTPUTS, STATES))
    D, f = 0.1 * rng.standard_normal((N, OUTPUTS, INPUTS)), rng.standard_normal((N, STATES))
    durations = np.array([0.3, 0.5, 0.2])
    rates = 0.4 * rng.standard_normal((N, STATES, STATES))
    # The last step ends without a jump.
    rates[-1] = 0.0
    plain = lp.PeriodicSystem.from_matrices(A, f, durations, B=B, C=C, D=D)
    jumps = plain.with_jumps(np.array([expm(rate) for rate in rates]))

    def between(values: np.ndarray, others: np.ndarray) -> np.ndarray:
        return np.stack([values, others], axis=1).reshape(2 * N, *values.shape[1:])

    short = lp.PeriodicSystem.from_matrices(
        between(A, rates / SHORT),
        between(f, 0 * f),
        between(durations, np.full(N, SHORT)),
        B=between(B, 0 * B),
        C=between(C, 0 * C),
        D=between(D, 0 * D),
    )
    return jumps, short


def _every_other(weight: np.ndarray) -> np.ndarray:
    return np.stack([np.broadcast_to(weight, (N, *weight.shape)), np.zeros((N, *weight.shape))], axis=1).reshape(
        2 * N, *weight.shape
    )


@pytest.mark.parametrize("seed", range(5))
def test_jumps_are_very_short_steps(seed: int) -> None:
    jumps, short = _systems(seed)
    found, right = lp.floquet(jumps), lp.floquet(short)
    assert found.verdict == right.verdict
    np.testing.assert_allclose(found.log_moduli, right.log_moduli, rtol=1e-10)
    np.testing.assert_allclose(lp.monodromy(jumps), lp.monodromy(short), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(lp.steady_state(jumps).step_states, lp.steady_state(short).step_states[::2], rtol=1e-9)
    np.testing.assert_allclose(
        lp.harmonic_transfer(jumps, 0.3 + 2j, [0, 1, -2]), lp.harmonic_transfer(short, 0.3 + 2j, [0, 1, -2]), rtol=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_norms_gramians_and_lyapunov_with_jumps(seed: int) -> None:
    jumps, short = _systems(seed)
    found, right = lp.gramians(jumps), lp.gramians(short)
    np.testing.assert_allclose(found.controllability, right.controllability[::2], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.observability, right.observability[::2], rtol=1e-9, atol=1e-12)
    times = np.array([0.0, 0.1, 0.299, 0.31, 0.7, 0.9])
    np.testing.assert_allclose(
        found.hankel_singular_values_at(times), right.hankel_singular_values_at(times), rtol=1e-9, atol=1e-12
    )
    W = np.diag([1.0, -2.0, 0.5])
    for adjoint in (False, True):
        np.testing.assert_allclose(
            lp.lyapunov(jumps, W, adjoint=adjoint),
            lp.lyapunov(short, _every_other(W), adjoint=adjoint)[::2],
            rtol=1e-9,
            atol=1e-12,
        )
    assert lp.hinf_norm(jumps) == pytest.approx(lp.hinf_norm(short), rel=1e-9)
    assert lp.hankel_norm(jumps) == pytest.approx(lp.hankel_norm(short), rel=1e-6)
    no_feedthrough = [lp.PeriodicSystem.from_matrices(s.A, s.r, s.durations, B=s.B, C=s.C) for s in (jumps, short)]
    assert jumps.J is not None
    h2 = lp.h2_norm(no_feedthrough[0].with_jumps(jumps.J))
    assert h2 == pytest.approx(lp.h2_norm(no_feedthrough[1]), rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("sampled", [False, True])
def test_regulator_and_estimator_with_jumps(seed: int, sampled: bool) -> None:
    jumps, short = _systems(seed)
    Q, R = np.diag([1.0, 2.0, 0.5]), np.eye(INPUTS)
    found, right = lp.lqr(jumps, Q, R, sampled=sampled), lp.lqr(short, _every_other(Q), R, sampled=sampled)
    np.testing.assert_allclose(found.cost_to_go, right.cost_to_go[::2], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.step_gains, right.step_gains[::2], rtol=1e-8, atol=1e-10)
    if not sampled:
        times = np.array([0.1, 0.299, 0.5, 0.9])
        np.testing.assert_allclose(found.cost_to_go_at(times), right.cost_to_go_at(times), rtol=1e-8, atol=1e-10)
    # A measurement at the start of the short step sees nothing, its outputs being zero.
    seen, right_seen = lp.kalman(jumps, Q, R, sampled=sampled), lp.kalman(short, _every_other(Q), R, sampled=sampled)
    np.testing.assert_allclose(seen.covariance, right_seen.covariance[::2], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(np.abs(seen.multipliers), np.abs(right_seen.multipliers), rtol=1e-8, atol=1e-12)


def _orbit_figures(system: lp.PeriodicSystem) -> np.ndarray:
    orbit = lp.steady_state(system)
    return np.array([*orbit.initial_state, orbit.mean("z1"), orbit.maximum("z2"), orbit.amplitude("z3")])


def test_derivatives_with_jumps_are_differences() -> None:
    jumps, _ = _systems(1)
    sensitivity = lp.sensitivity(jumps)
    step = 1e-6
    for k in range(N):
        durations = np.zeros(N)
        durations[k] = step
        ahead, behind = (_with_durations(jumps, jumps.durations + sign * durations) for sign in (1, -1))
        right = (_orbit_figures(ahead) - _orbit_figures(behind)) / (2 * step)
        found = [
            *sensitivity.initial_state_by_duration[:, k],
            sensitivity.of_mean("z1").by_duration[k],
            sensitivity.of_maximum("z2").by_duration[k],
            sensitivity.of_amplitude("z3").by_duration[k],
        ]
        np.testing.assert_allclose(found, right, rtol=1e-6, atol=1e-8)
        along = sensitivity.along(durations=durations / step)
        np.testing.assert_allclose([*along.initial_state, along.mean("z1")], right[:4], rtol=1e-6, atol=1e-8)
        logs = (lp.floquet(ahead).log_moduli - lp.floquet(behind).log_moduli) / (2 * step)
        np.testing.assert_allclose(sensitivity.log_multipliers_by_duration[:, k].real, logs, rtol=1e-6, atol=1e-7)


def _with_durations(system: lp.PeriodicSystem, durations: np.ndarray) -> lp.PeriodicSystem:
    assert system.J is not None
    return lp.PeriodicSystem.from_matrices(
        system.A, system.r, durations, B=system.B, C=system.C, D=system.D
    ).with_jumps(system.J)


def test_a_singular_jump_has_multipliers_of_exactly_zero() -> None:
    jumps, _ = _systems(2)
    reset = jumps.with_jumps([np.diag([1.0, 0.0, 1.0]), np.eye(3), np.outer([1.0, 2.0, 3.0], [1.0, 0.0, -1.0])])
    found = lp.floquet(reset)
    assert list(np.isneginf(found.log_moduli)) == [False, True, True]
    product = np.eye(3)
    for k in range(N):
        assert reset.J is not None
        product = reset.J[k] @ expm(reset.A[k] * reset.durations[k]) @ product
    assert found.multipliers[0].real == pytest.approx(np.trace(product), rel=1e-12)
    assert lp.floquet(jumps.with_jumps(np.zeros((N, 3, 3)))).verdict == "stable"
    np.testing.assert_allclose(lp.gramians(reset).controllability[0], lp.gramians(reset).controllability[0].T)


def test_a_jump_with_a_shift() -> None:
    # z' = -z for ln 2, then z+ = z- / 2 + 3: z0 = z0 / 4 + 3.
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[0.0]], [np.log(2)]).with_jumps([[[0.5]]], [[3.0]])
    orbit = lp.steady_state(system)
    assert orbit.initial_state[0] == pytest.approx(4.0, rel=1e-14)
    assert orbit.minimum("z1") == pytest.approx(2.0, rel=1e-14)
    found = lp.response(system, n_periods=2, initial_state=[4.0])
    assert found.states[0, -1] == pytest.approx(4.0, rel=1e-14)
    lifted = lp.lifted(system)
    assert lifted.A[0, 0] == pytest.approx(0.25)
    assert lifted.B[0, -1] == pytest.approx(3.0)


def test_parts_of_systems_keep_their_jumps() -> None:
    jumps, _ = _systems(3)
    right = lp.floquet(jumps).log_moduli
    np.testing.assert_allclose(lp.floquet(jumps.split([3, 1, 2])).log_moduli, right, rtol=1e-10)
    gain = lp.feedback(jumps, np.zeros((INPUTS, OUTPUTS)))
    np.testing.assert_allclose(lp.floquet(gain).log_moduli, right, rtol=1e-10)
    slow = lp.PeriodicSystem.from_matrices([[[-0.1]]], [[0.0]], [2.0], B=[[[1.0, 0.0]]], C=[[[1.0], [0.0]]])
    both = lp.append(jumps, slow)
    expected = np.sort(np.append(2 * right, -0.2))[::-1]
    np.testing.assert_allclose(lp.floquet(both).log_moduli, expected, rtol=1e-10)
    # A step of no duration hands its jump to the step before.
    assert jumps.J is not None
    parted = lp.PeriodicSystem.from_matrices(
        np.concatenate([jumps.A[:1], jumps.A]), np.zeros((N + 1, 3)), [0.0, *jumps.durations]
    ).with_jumps([jumps.J[0], *jumps.J])
    np.testing.assert_allclose(
        lp.monodromy(parted.without_empty_steps()), lp.monodromy(lp.append(parted, np.eye(1))), rtol=1e-10, atol=1e-14
    )
    order = np.sort(np.abs(lp.floquet(parted).multipliers))
    np.testing.assert_allclose(order, np.sort(np.abs(lp.floquet(parted.without_empty_steps()).multipliers)), rtol=1e-9)


@pytest.mark.parametrize("what", ["averaged", "to_iosys"])
def test_what_knows_no_jumps_says_so(what: str) -> None:
    jumps, _ = _systems(0)
    with pytest.raises(ValueError, match=f"{what}: found a system whose state jumps"):
        getattr(lp, what)(jumps)


def test_jumps_of_the_wrong_shape() -> None:
    jumps, _ = _systems(0)
    with pytest.raises(ValueError, match=r"J: found shape \(1, 3, 3\), expected \(3, 3, 3\)"):
        jumps.with_jumps([np.eye(3)])
    with pytest.raises(ValueError, match=r"j: found shape"):
        jumps.with_jumps([np.eye(3)] * 3, [[0.0]] * 3)
