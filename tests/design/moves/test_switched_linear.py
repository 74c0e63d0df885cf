"""Switching times of switched linear systems: a published number, slopes against differences, least time."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.moves.switched_linear import _Task

A = [[[-1.0, 0.0], [1.0, 2.0]], [[1.0, 1.0], [1.0, -2.0]]]


def two_modes(repeats=1):
    return lp.PeriodicSystem.from_matrices(A * repeats, np.zeros((2 * repeats, 2)), [1.0 / repeats] * (2 * repeats))


def test_the_published_two_mode_problem():
    """One switch in one second, cost the integral of x'x: tau = 0.264866, J = 5.2545429449."""
    found = design.optimize_switching(two_modes(), [1.0, 1.0], duration=1.0)
    assert found.status == "optimal"
    assert found.switching_times[0] == pytest.approx(0.264866, abs=5e-7)
    assert found.cost == pytest.approx(5.2545429449, abs=1e-9)


def test_the_cost_is_that_of_an_integration():
    found = design.optimize_switching(two_modes(), [1.0, 1.0], duration=1.0)
    state = np.array([1.0, 1.0, 0.0])
    for matrix, lasts in zip(np.array(A), found.durations, strict=True):
        way = solve_ivp(
            lambda _, x, matrix=matrix: np.append(matrix @ x[:2], x[:2] @ x[:2]), (0.0, lasts), state,
            rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        state = way.y[:, -1]
    assert found.cost == pytest.approx(state[2], rel=1e-10)
    assert found.end_state == pytest.approx(state[:2], rel=1e-10)


def test_slopes_are_those_of_differences():
    random = np.random.default_rng(3)
    n, N = 3, 4
    system = lp.PeriodicSystem.from_matrices(random.normal(size=(N, n, n)), random.normal(size=(N, n)), [0.3] * N)
    Q = random.normal(size=(N, n, n))
    task = _Task(system, random.normal(size=n), Q, random.normal(size=(n, n)), 0.7)
    durations = random.uniform(0.1, 0.5, N)
    way, step = task.way(durations), 1e-6
    for m in range(N):
        up, down = (task.way(durations + sign * step * np.eye(N)[m]) for sign in (1, -1))
        assert way.slopes[m] == pytest.approx((up.cost - down.cost) / (2 * step), rel=1e-6, abs=1e-7)
        assert way.end_slopes[:, m] == pytest.approx((up.end - down.end) / (2 * step), rel=1e-6, abs=1e-7)


def test_more_switches_are_never_worse():
    costs = [
        design.optimize_switching(two_modes(repeats), [1.0, 1.0], duration=1.0).cost for repeats in (1, 2, 3)
    ]  # fmt: skip
    assert costs[0] > costs[1] > costs[2]


def test_a_double_integrator_goes_a_metre_in_two_seconds():
    """Bang, bang: one second each way, at an acceleration of one."""
    one = [[0.0, 1.0], [0.0, 0.0]]
    system = lp.PeriodicSystem.from_matrices([one, one], [[0.0, 1.0], [0.0, -1.0]], [1.0, 1.0])
    found = design.optimize_switching(
        system, [0.0, 0.0], cost=np.zeros((2, 2)), time_cost=1.0, end=[1.0, 0.0], duration=(0.0, 10.0)
    )
    assert found.status == "optimal"
    assert found.durations == pytest.approx([1.0, 1.0], abs=1e-8)
    short = design.optimize_switching(
        system, [0.0, 0.0], cost=np.zeros((2, 2)), time_cost=1.0, end=[1.0, 0.0], duration=(0.0, 1.5)
    )
    assert short.status == "infeasible"


def test_the_machines_own_linear_model_can_be_switched():
    model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), 8.0, operating_points="fitted")
    start = lp.steady_state(model.system).step_states[0]
    scale = np.diag([1.0, 0.0, 0.0])
    found = design.optimize_switching(model.system, start, cost=scale)
    own = _Task(model.system, start, scale, None, 0.0).way(np.array(model.system.durations))
    assert found.cost <= own.cost * (1 + 1e-9)
    assert found.durations.sum() == pytest.approx(model.system.period)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="contradict"):
        design.optimize_switching(two_modes(), [1.0, 1.0], shortest=2.0)
    with pytest.raises(ValueError, match="initial_state"):
        design.optimize_switching(two_modes(), [1.0])
    with pytest.raises(ValueError, match="end: found shape"):
        design.optimize_switching(two_modes(), [1.0, 1.0], end=[1.0])
    with pytest.raises(ValueError, match="jumps"):
        design.optimize_switching(two_modes().with_jumps(np.stack([2 * np.eye(2)] * 2)), [1.0, 1.0])
    with pytest.raises(TypeError, match="expected a PeriodicSystem"):
        design.optimize_switching("system", [1.0, 1.0])  # type: ignore[arg-type]
