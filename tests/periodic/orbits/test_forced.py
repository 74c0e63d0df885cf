"""Responses to inputs in time, against an independent integrator and against the system's own response."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp


def _system(n_steps: int = 2, seed: int = 0) -> lp.PeriodicSystem:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n_steps, 2, 2)) - np.eye(2)
    return lp.PeriodicSystem.from_matrices(
        A,
        rng.standard_normal((n_steps, 2)),
        rng.uniform(0.1, 0.5, n_steps),
        B=rng.standard_normal((n_steps, 2, 2)),
        C=rng.standard_normal((n_steps, 1, 2)),
        D=rng.standard_normal((n_steps, 1, 2)),
    )


@pytest.mark.parametrize("interpolation", ["linear", "held"])
@pytest.mark.parametrize("start", [0.0, 0.37, -1.2])
def test_an_integrator_gives_the_same(interpolation: str, start: float) -> None:
    system = _system()
    times = start + np.sort(np.random.default_rng(1).uniform(0, 3, 12))
    inputs = np.random.default_rng(2).standard_normal((2, times.size))
    found = lp.forced_response(system, times, inputs, initial_state=[1.0, -2.0], interpolation=interpolation)
    switches = (np.arange(-20, 20)[:, None] * system.period + system.switching_times[:-1]).ravel()
    state, at = np.array([1.0, -2.0]), times[0]
    for k in range(times.size - 1):
        cuts = [at, *switches[(switches > at) & (switches < times[k + 1])], times[k + 1]]
        for low, high in itertools.pairwise(cuts):
            step = int(system.step_at(np.array([((low + high) / 2) % system.period]))[0][0])

            def rate(t: float, z: np.ndarray, k: int = k, step: int = step) -> np.ndarray:
                u = inputs[:, k]
                if interpolation == "linear":
                    u = u + (inputs[:, k + 1] - u) * (t - times[k]) / (times[k + 1] - times[k])
                return system.A[step] @ z + system.B[step] @ u + system.r[step]

            state = solve_ivp(rate, (low, high), state, rtol=1e-11, atol=1e-12).y[:, -1]
        at = times[k + 1]
        np.testing.assert_allclose(found.states[:, k + 1], state, rtol=1e-8, atol=1e-9)
    step = int(system.step_at(np.array([times[-1] % system.period]))[0][0])
    output = system.C[step] @ state + system.D[step] @ inputs[:, -1] + system.q[step]
    np.testing.assert_allclose(found.outputs[:, -1], output, rtol=1e-8)


@pytest.mark.parametrize("n_steps", [1, 3])
def test_inputs_at_their_levels_give_the_systems_own_response(n_steps: int) -> None:
    system = _system(n_steps).with_levels([0.3, -0.7]).with_jumps(np.tile(np.diag([0.5, -0.8]), (n_steps, 1, 1)))
    right = lp.response(system, n_periods=4, initial_state=[1.0, 2.0], points_per_period=7)
    for interpolation in ("linear", "held"):
        found = lp.forced_response(
            system,
            right.time,
            np.tile([[0.3], [-0.7]], right.time.size),
            initial_state=[1.0, 2.0],
            interpolation=interpolation,
        )
        # The last instant begins another period: its output is that of the first step again.
        np.testing.assert_allclose(found.states, right.states, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.outputs[:, :-1], right.outputs[:, :-1], rtol=1e-11, atol=1e-12)


def test_many_periods_between_two_samples() -> None:
    system = _system(3)
    end = 40 * system.period
    found = lp.forced_response(system, [0.0, end], np.zeros((2, 2)), initial_state=[1.0, 1.0])
    right = lp.response(system, n_periods=40, initial_state=[1.0, 1.0])
    np.testing.assert_allclose(found.states[:, -1], right.states[:, -1], rtol=1e-10)


@pytest.mark.parametrize(
    ("times", "inputs", "options", "says"),
    [
        ([0.0, 1.0, 1.0], np.zeros((2, 3)), {}, "timepts: found 3 times, not all rising"),
        ([0.0], np.zeros((2, 1)), {}, "timepts: found 1 times"),
        ([0.0, 1.0], np.zeros((1, 2)), {}, r"inputs: found shape \(1, 2\), expected \(2, 2\)"),
        ([0.0, 1.0], np.zeros((2, 2)), {"interpolation": "cubic"}, "interpolation: found 'cubic'"),
        ([0.0, 1.0], np.zeros((2, 2)), {"initial_state": [0.0]}, "initial_state: found shape"),
        ([0.0, np.nan], np.zeros((2, 2)), {}, "timepts: found nan"),
    ],
)
def test_bad_input(times: list[float], inputs: np.ndarray, options: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        lp.forced_response(_system(), times, inputs, **options)  # pyright: ignore[reportArgumentType]


def test_a_response_that_overflows_says_so() -> None:
    system = lp.PeriodicSystem.from_matrices([[[1e3]]], [[1.0]], [1.0], B=[[[1.0]]])
    with pytest.raises(lp.StepOverflowError, match="grows by more than double precision holds, up to t = 1"):
        lp.forced_response(system, [0.0, 1.0], [0.0, 0.0])
    discrete = lp.DiscretePeriodicSystem.from_matrices([[[1e200]]], [[1.0]], [1.0])
    for grows in (system, discrete):
        with pytest.raises(lp.StepOverflowError, match="take fewer periods"):
            lp.response(grows, n_periods=3, initial_state=[1.0])
