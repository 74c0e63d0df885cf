r"""Periodic Lyapunov equations in square-root form.

Forward, P' = A P + P A' + W with P(T) = P(0); backward (adjoint), -P' = A' P + P A + W. The solution is kept as a
factor, P = L L', from the first integral on, so that it is positive semidefinite by construction and its small
directions are as accurate as the large ones.

Over a step, V(T) = integral of e^{A s} W e^{A' s} is exact to rounding: over an h with norm(A) h <= 1/2 by Gauss's
formula with eight points, whose error is then below 1e-20 of W h [Davis1984]_ (2.7.12), and from h to T by doubling,
V(2 h) = V(h) + e^{A h} V(h) e^{A' h}, in which nothing cancels however stiff A is. The same doubling, over whole
periods, sums the series of the discrete Lyapunov equation of the monodromy matrix.

.. [Davis1984] P. J. Davis, P. Rabinowitz, "Methods of Numerical Integration", 2nd ed., Academic Press 1984.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.errors import NotStableError
from ltvpneu.periodic.algebra.propagate import exponentials, one_blas_thread
from ltvpneu.periodic.orbits.floquet import floquet
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.per_step import each_step, symmetric

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
NODES, WEIGHTS = (NODES + 1) / 2, WEIGHTS / 2


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class StepGramians(Value):
    """Integrals over single steps."""

    controllability: FloatArray
    """Factor L of the integral of e^{A s} B B' e^{A' s}, shape (N, n, n)."""
    observability: FloatArray
    """Factor L of the integral of e^{A' s} C' C e^{A s}, shape (N, n, n)."""
    energy: FloatArray
    """Integral of (T - s) |C e^{A s} B|^2: what inputs within the step do within it, shape (N,)."""


def compressed(columns: FloatArray) -> FloatArray:
    """Return L (N, n, n), lower triangular, with L L' = X X' for X (N, n, m)."""
    N, n, m = columns.shape
    triangle = np.linalg.qr(np.swapaxes(columns, 1, 2), mode="r")
    if m < n:
        triangle = np.concatenate([triangle, np.zeros((N, n - m, n))], axis=1)
    return np.swapaxes(triangle, 1, 2)


def step_gramians(A: FloatArray, B: FloatArray, C: FloatArray, durations: FloatArray) -> StepGramians:
    """Return the integrals over steps, shapes (N, n, n), (N, n, m), (N, p, n) and (N,)."""
    N, n = A.shape[:2]
    if n == 0:
        nothing = np.zeros((N, 0, 0))
        return StepGramians(controllability=nothing, observability=nothing, energy=np.zeros(N))
    largest = float(np.max(np.max(np.sum(np.abs(A), axis=1), axis=1, initial=0.0) * durations, initial=0.0))
    doublings = max(0, math.ceil(math.log2(2 * largest))) if largest > 0 else 0
    h = durations / 2.0**doublings
    with one_blas_thread(8 * N):
        maps = exponentials(A[:, None] * (h[:, None] * NODES)[:, :, None, None])
        roots = np.sqrt(h[:, None] * WEIGHTS)[:, :, None, None]
        reached = maps @ B[:, None] * roots
        seen = np.swapaxes(maps, 2, 3) @ np.swapaxes(C, 1, 2)[:, None] * roots
        # n columns for each node side by side.
        controllability = compressed(np.moveaxis(reached, 1, 2).reshape(N, n, -1))
        observability = compressed(np.moveaxis(seen, 1, 2).reshape(N, n, -1))
        energy = np.sum((C[:, None] @ reached) ** 2 * ((1 - NODES) * h[:, None])[:, :, None, None], axis=(1, 2, 3))
        for level in range(doublings):
            step = exponentials(A * (h * 2.0**level)[:, None, None])
            energy = 2 * energy + np.sum((np.swapaxes(observability, 1, 2) @ controllability) ** 2, axis=(1, 2))
            controllability = compressed(np.concatenate([controllability, step @ controllability], axis=2))
            observability = compressed(np.concatenate([observability, np.swapaxes(step, 1, 2) @ observability], axis=2))
    return StepGramians(controllability=controllability, observability=observability, energy=energy)


def periodic_factors(maps: FloatArray, gains: FloatArray) -> FloatArray:
    """Return the factors of the periodic solution of P_{k+1} = F_k P_k F_k' + V_k at the start of each step, (N, n, n).

    Parameters
    ----------
    maps : ndarray, shape (N, n, n)
        F_k, their product stable.
    gains : ndarray, shape (N, n, n)
        Factors of V_k.
    """
    n = maps.shape[1]
    total, gained = np.eye(n), np.zeros((n, n))
    for step, gain in zip(maps, gains, strict=True):
        total, gained = step @ total, _sum(step @ gained, gain)
    # Sum of total^k V total'^k by doubling; an eigenvalue of 1 - 1e-15 takes some 60 rounds.
    for _ in range(64):
        size = float(np.max(np.abs(total), initial=0.0))
        if size < 1e-160:
            break
        total, gained = total @ total, _sum(gained, total @ gained)
    found = np.empty_like(gains)
    for k in range(len(maps)):
        found[k] = gained
        gained = _sum(maps[k] @ gained, gains[k])
    return found


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return L with L L' = a a' + b b'."""
    return compressed(np.concatenate([a, b], axis=1)[None])[0]


def from_reversed(values: FloatArray) -> FloatArray:
    """Return values at the starts of the steps from those of the steps transposed and run backward."""
    # The reversed step j starts where step N - 1 - j ends, which is where step N - j starts.
    return np.roll(values[::-1], 1, axis=0)


def expect_stable(system: AnyPeriodicSystem, what: str) -> None:
    """Raise `NotStableError` unless every perturbation decays."""
    found = floquet(system)
    if not found.is_stable:
        raise NotStableError(
            f"{what} needs a stable system; this one is {found.verdict}: spectral radius {found.spectral_radius:.12g}, "
            f"margin {found.margin:.1e}. Look at floquet(system), or stabilize it first: lqr, state_feedback",
            floquet=found,
        )


def lyapunov_factors(system: AnyPeriodicSystem, B: ArrayLike, *, adjoint: bool = False) -> FloatArray:
    """Return factors L of the periodic solution P = L L' for W = B B', at the start of each step.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    B : array_like, shape (n, m) or (n_steps, n, m)
    adjoint : bool
        Of -P' = A' P + P A + W instead of P' = A P + P A' + W.

    Returns
    -------
    ndarray, shape (n_steps, n, n)

    Raises
    ------
    NotStableError
        Unstable, or too close to it to tell.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.
    """
    expect_periodic(system)
    N, n = system.n_steps, system.n_states
    columns = each_step("B", B, N, n)
    expect_stable(system, "a periodic Lyapunov equation")
    scales = 1 / system.scales if adjoint else system.scales
    columns, maps = columns / scales[:, None], system.maps.maps[:, :n, :n]
    if adjoint:
        maps = np.swapaxes(maps[::-1], 1, 2)
    gains = _gains(system, columns, adjoint)
    found = periodic_factors(maps, gains) * scales[:, None]
    return read_only(from_reversed(found) if adjoint else found)


def _gains(system: AnyPeriodicSystem, columns: FloatArray, adjoint: bool) -> FloatArray:
    """Return the factors of what comes in over each step, balanced, in the order in which steps are passed."""
    if isinstance(system, DiscretePeriodicSystem):
        return compressed(columns[::-1] if adjoint else columns)
    n, nothing = system.n_states, np.zeros((system.n_steps, 0, system.n_states))
    A = system.scaled.matrices[:, :n, :n]
    if adjoint:
        A = np.swapaxes(A[::-1], 1, 2)
        return step_gramians(A, columns[::-1], nothing, system.durations[::-1]).controllability
    # What came in within a step jumps at its end; backward it comes in before the jump is reached.
    return system.scaled_jumps[:, :n, :n] @ step_gramians(A, columns, nothing, system.durations).controllability


def lyapunov(system: AnyPeriodicSystem, W: ArrayLike, *, adjoint: bool = False) -> FloatArray:
    """Return the periodic solution P of P' = A P + P A' + W at the start of each step.

    In discrete time of P_{k+1} = A P_k A' + W; adjoint of P_k = A' P_{k+1} A + W.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    W : array_like, shape (n, n) or (n_steps, n, n)
        Symmetric, not necessarily definite.
    adjoint : bool
        Solve -P' = A' P + P A + W instead.

    Returns
    -------
    ndarray, shape (n_steps, n, n)

    Raises
    ------
    NotStableError
        Unstable, or too close to it to tell.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0], [0.0]], [0.5, 0.5])
    >>> lp.lyapunov(system, [[1.0]]).round(4).ravel()
    array([0.1774, 0.3813])
    """
    expect_periodic(system)
    weights = symmetric("W", W, system.n_steps, system.n_states)
    values, vectors = np.linalg.eigh(weights)
    roots = vectors * np.sqrt(np.abs(values))[:, None, :]
    found = np.zeros_like(weights)
    for sign in (1.0, -1.0):
        part = roots * (sign * values > 0)[:, None, :]
        if sign > 0 or part.any():
            factors = lyapunov_factors(system, part, adjoint=adjoint)
            found = found + sign * factors @ np.swapaxes(factors, 1, 2)
    return read_only(found)
