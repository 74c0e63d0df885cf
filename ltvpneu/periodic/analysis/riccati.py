r"""Periodic Riccati equations -X' = A' X + X A - (X B + S) R^-1 (B' X + S') + Q with X(T) = X(0).

Each step is taken exactly, in the form that never grows (`scattering`), and doubling whole periods gives X at once.
Where states that the cost does not see are unstable, doubling finds a solution that leaves them alone; then Newton's
method [Kleinman1968]_ goes on from one that does not.

.. [Kleinman1968] D. L. Kleinman, "On an iterative technique for Riccati equation computations", IEEE Trans. Autom.
   Control 13, 1968.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray
from ltvpneu.errors import NotStabilizableError
from ltvpneu.periodic.algebra.product import from_logs, log_multipliers
from ltvpneu.periodic.analysis.scattering import Scattering, over_period
from ltvpneu.periodic.orbits.floquet import floquet
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem


class Solution(NamedTuple):
    """X at the starts of all steps, the closed loop's multipliers, and how far X is from periodic, relative to it."""

    X: FloatArray
    multipliers: ComplexArray
    residual: float


def stabilizing(steps: Scattering, system: AnyPeriodicSystem, needed: str) -> Solution:
    """Return the stabilizing periodic solution at the starts of all steps, in balanced coordinates."""
    total = over_period(steps)
    n = total.E.shape[0]
    X = _doubled(total)
    if X is None or not _is_stabilizing(total, X):
        # Weight every state a little: then doubling stabilizes whatever can be, and Newton takes the weight off again.
        size = max(float(np.max(np.abs(total.H))), 1.0)
        seen = Scattering(E=total.E, G=total.G, H=total.H + size * np.eye(n))
        start = _doubled(seen)
        X = None if start is None or not _is_stabilizing(seen, start) else _newton(total, start)
    if X is None or not _is_stabilizing(total, X):
        own = floquet(system).multipliers
        unstable = ", ".join(f"{x:.6g}" for x in own if abs(x) >= 1 - 1e-9)
        raise NotStabilizableError(
            f"no stabilizing periodic solution: the system is not {needed}, or leaves a mode on the unit circle alone. "
            f"Multipliers of the open loop on or outside it: {unstable or 'none'}; at least one of them is "
            + ("not reached by any input, or not seen by Q" if needed == "stabilizable" else "not seen by any output"),
            multipliers=own,
        )
    found = np.empty_like(steps.E)
    after, factors = X, np.empty_like(steps.E)
    for k in range(len(found) - 1, -1, -1):
        step = Scattering(E=steps.E[k], G=steps.G[k], H=steps.H[k])
        factors[k] = step.closed_loop(after)
        found[k] = after = step.cost_before(after)
    size = max(float(np.max(np.abs(X), initial=0.0)), np.finfo(float).tiny)
    multipliers = from_logs(*log_multipliers(factors)).multipliers
    return Solution(found, multipliers, float(np.max(np.abs(found[0] - X), initial=0.0)) / size)


def _doubled(total: Scattering) -> FloatArray | None:
    """Return the limit of H over ever more periods, or None if there is none."""
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(60):
            before, total = total.H, total.then(total)
            size = float(np.max(np.abs(total.H), initial=0.0))
            if not (np.isfinite(total.E).all() and size < 1e150):
                return None
            if np.max(np.abs(total.H - before), initial=0.0) <= 4e-16 * size:
                return total.H
    return None


def _newton(total: Scattering, X: FloatArray) -> FloatArray | None:
    """Return the stabilizing solution by Newton's method from a stabilizing start, or None."""
    for _ in range(60):
        loop = total.closed_loop(X)
        if _radius(loop) >= 1:
            return None
        before, weight = X, total.H + loop.T @ X @ total.G @ X @ loop
        X = _summed(loop, (weight + weight.T) / 2)
        if np.max(np.abs(X - before), initial=0.0) <= 1e-14 * np.max(np.abs(X), initial=0.0):
            break
    return X


def _summed(loop: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the sum of F'^k W F^k over all k for a stable F, by doubling: X of X = F' X F + W."""
    total = weight
    for _ in range(64):
        total = total + loop.T @ total @ loop
        loop = loop @ loop
        if np.max(np.abs(loop), initial=0.0) < 1e-100:
            break
    return total


def _is_stabilizing(total: Scattering, X: FloatArray) -> bool:
    return _radius(total.closed_loop(X)) < 1 - 1e-12


def _radius(matrix: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0))


def semidefinite(name: str, stack: FloatArray) -> FloatArray:
    """Return symmetric matrices (N, n, n), or raise `ValueError` where one is not positive semidefinite."""
    values = np.linalg.eigvalsh(stack)
    if values.size and np.min(values) < -1e-12 * np.max(np.abs(values)):
        raise ValueError(f"{name}: found an eigenvalue of {np.min(values):.6g}, expected none below zero")
    return stack


def definite(name: str, stack: FloatArray) -> FloatArray:
    """Return symmetric matrices (N, n, n), or raise `ValueError` where one is not positive definite."""
    values = np.linalg.eigvalsh(stack)
    if values.size and np.min(values) <= 1e-15 * np.max(np.abs(values)):
        raise ValueError(f"{name}: found an eigenvalue of {np.min(values):.6g}, expected all above zero")
    return stack


def root_of(stack: FloatArray) -> FloatArray:
    """Return L with L L' = M for positive semidefinite M, (N, n, n)."""
    values, vectors = np.linalg.eigh(stack)
    return vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
