"""Observer controllers: the separation principle, and a simulation."""

import numpy as np
import pytest

import ltvpneu as lp


def random_system(seed: int, jumps: bool = False) -> lp.PeriodicSystem:
    rng = np.random.default_rng(seed)
    system = lp.PeriodicSystem.from_matrices(
        rng.standard_normal((2, 3, 3)),
        rng.standard_normal((2, 3)),
        [0.4, 0.6],
        B=rng.standard_normal((2, 3, 1)),
        C=rng.standard_normal((2, 2, 3)),
        D=rng.standard_normal((2, 2, 1)),
    )
    return system.with_jumps(np.eye(3) + 0.2 * rng.standard_normal((2, 3, 3))) if jumps else system


def both(regulator: lp.Regulator, estimator: lp.Estimator) -> np.ndarray:
    return np.sort(np.abs(np.concatenate([regulator.multipliers, estimator.multipliers])))


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_closed_loop_has_the_multipliers_of_both(seed: int, jumps: bool) -> None:
    system = random_system(seed, jumps)
    Q, R, Rn = np.eye(3), np.eye(1), 0.1 * np.eye(2)
    regulator, estimator = lp.lqr(system, Q, R), lp.kalman(system, Q, Rn)
    for rtol in (1e-2, 1e-5):
        controller = lp.observer_controller(regulator, estimator, rtol=rtol)
        loop = lp.floquet(lp.feedback(system, controller, sign=1))
        np.testing.assert_allclose(np.sort(np.abs(loop.multipliers)), both(regulator, estimator), atol=rtol)
    held, seen = lp.lqr(system, Q, R, sampled=True), lp.kalman(system, Q, Rn, sampled=True)
    controller = lp.observer_controller(held, seen)
    loop = lp.floquet(lp.feedback(lp.sampled(system), controller, sign=1))
    np.testing.assert_allclose(np.sort(np.abs(loop.multipliers)), both(held, seen), rtol=1e-6, atol=1e-9)
    plain = lp.sampled(system)
    held, seen = lp.lqr(plain, Q, R), lp.kalman(plain, Q, Rn)
    loop = lp.floquet(lp.feedback(plain, lp.observer_controller(held, seen), sign=1))
    np.testing.assert_allclose(np.sort(np.abs(loop.multipliers)), both(held, seen), rtol=1e-6, atol=1e-9)


def test_estimates_come_near_the_states() -> None:
    system = random_system(1)
    regulator, estimator = lp.lqr(system, np.eye(3), np.eye(1)), lp.kalman(system, np.eye(3), 0.1 * np.eye(2))
    loop = lp.feedback(
        lp.PeriodicSystem.from_matrices(system.A, 0 * system.r, system.durations, system.B, system.C, system.D),
        lp.observer_controller(regulator, estimator),
        sign=1,
    )
    found = lp.response(loop, n_periods=60, initial_state=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]).states
    assert np.abs(found[3:, -1] - found[:3, -1]).max() < 1e-6
    assert np.abs(found[:3, -1]).max() < 1e-6


def test_what_does_not_fit_together() -> None:
    one, other = random_system(1), random_system(2)
    Q, R, Rn = np.eye(3), np.eye(1), np.eye(2)
    regulator = lp.lqr(one, Q, R)
    with pytest.raises(ValueError, match="estimator: found one of"):
        lp.observer_controller(regulator, lp.kalman(other, Q, Rn))
    with pytest.raises(ValueError, match="expected both or none"):
        lp.observer_controller(regulator, lp.kalman(one, Q, Rn, sampled=True))
    with pytest.raises(lp.NotConvergedError, match=r"more than rtol = 1e-12"):
        lp.observer_controller(regulator, lp.kalman(one, Q, Rn), rtol=1e-12)
