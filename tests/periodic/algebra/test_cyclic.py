"""The cyclic solve against one dense system, and where forming the product fails."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ltvpneu as lp
from ltvpneu.periodic.algebra.cyclic import solve_cyclic, solve_cyclic_adjoint


@given(st.integers(1, 40), st.integers(1, 4), st.booleans(), st.integers(0, 2**32 - 1))
def test_the_solution_and_its_adjoint_satisfy_every_equation(N, n, is_complex, seed):
    random = np.random.default_rng(seed)
    factors, forcing = random.normal(size=(N, n, n)), random.normal(size=(N, n, 2))
    if is_complex:
        factors = factors + 1j * random.normal(size=(N, n, n))
    z, y = solve_cyclic(factors, forcing), solve_cyclic_adjoint(factors, forcing)
    forward = factors @ z + forcing - np.roll(z, -1, axis=0)
    backward = np.swapaxes(factors, 1, 2) @ np.roll(y, -1, axis=0) + forcing - y
    # Backward error: relative to the terms of each equation.
    assert np.abs(forward).max() <= 1e-13 * (1 + 10 * np.abs(z).max())
    assert np.abs(backward).max() <= 1e-13 * (1 + 10 * np.abs(y).max())


def test_growth_and_decay_by_hundreds_of_decades_cost_no_accuracy():
    """Fifty per step up, fifty down: the product spans 10^680, the orbit is of size one."""
    random = np.random.default_rng(0)
    basis = random.normal(size=(3, 3))
    factor = np.linalg.inv(basis) @ np.diag([50.0, 1.3, 0.02]) @ basis
    constant = random.normal(size=3)
    z = solve_cyclic(np.tile(factor, (200, 1, 1)), np.tile(constant[:, None], (200, 1, 1)))[:, :, 0]
    np.testing.assert_allclose(z, np.tile(np.linalg.solve(np.eye(3) - factor, constant), (200, 1)), rtol=1e-11)


def test_the_orbit_of_an_unstable_system_is_exact_at_every_step():
    A = [np.diag([40.0, -40.0]), np.array([[0.0, 30.0], [20.0, 0.0]])] * 10
    f = np.random.default_rng(1).normal(size=(20, 2))
    orbit = lp.steady_state(lp.PeriodicSystem.from_matrices(A, f, np.full(20, 0.5)))
    from mpmath import expm, eye, lu_solve, matrix, workdps, zeros

    with workdps(400):
        states = zeros(40, 1)
        system, rhs = eye(40) * 0, zeros(40, 1)
        for k in range(20):
            block = zeros(3)
            for i in range(2):
                block[i, 2] = f[k, i]
                for j in range(2):
                    block[i, j] = A[k][i, j]
            step = expm(block * 0.5)
            following = 2 * ((k + 1) % 20)
            for i in range(2):
                system[2 * k + i, following + i] += 1
                rhs[2 * k + i] = step[i, 2]
                for j in range(2):
                    system[2 * k + i, 2 * k + j] -= step[i, j]
        states = lu_solve(system, rhs)
        expected = np.array([float(x) for x in matrix(states)]).reshape(20, 2)
    np.testing.assert_allclose(orbit.step_states, expected, atol=1e-12 * np.abs(expected).max())
    # In the middle of a step, where one state has grown by e^10 and the other by less.
    later = orbit.at([0.25, 0.5])
    assert later[0, 1] == pytest.approx(expected[1, 0], rel=1e-9)


def test_many_steps_are_solved_in_linear_time_and_memory():
    """A hundred thousand steps; in a dense form this would take 1.3 TB."""
    random = np.random.default_rng(2)
    N = 100_000
    system = lp.PeriodicSystem.from_matrices(
        random.normal(size=(N, 4, 4)) - 3 * np.eye(4), random.normal(size=(N, 4)), np.full(N, 0.01)
    )
    assert lp.steady_state(system).residual < 1e-12
    total = -12 * 0.01 * N + 0.01 * np.trace(system.A + 3 * np.eye(4), axis1=1, axis2=2).sum()
    assert np.sum(lp.floquet(system).log_moduli) == pytest.approx(total, rel=1e-10)
