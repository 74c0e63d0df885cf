r"""The cyclic system of (14), z_{k+1} = F_k z_k + g_k with z_N = z_0, solved in time and memory linear in N.

Two neighbouring equations share one unknown; an orthogonal transformation of the two rows takes it out of the second
[Wright1992]_. Half of the unknowns go at once, and after log2 N rounds one equation A z_0 + B z_N = g is left. Nothing
is ever multiplied round the period, so growth within it, or an unstable orbit, costs no accuracy. Only a few steps
whose products stay moderate are multiplied after all, for speed.

.. [Wright1992] S. J. Wright, "Stable parallel algorithms for two-point boundary value problems", SIAM J. Sci. Stat.
   Comput. 13(3), 1992.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import one_blas_thread

Array = NDArray[Any]
"""Real or complex."""
FEW_STEPS = 16
MODERATE = 30.0
"""Largest entry of a product of steps that may be formed: it costs no more than a digit or two."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Eliminated(Value):
    """Unknowns taken out in one round: R z_middle = rhs - left z_before - right z_after."""

    R: Array
    left: Array
    right: Array
    rhs: Array


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Reduced(Value):
    """The one equation left, first z_0 + last z_N = rhs, and the way back."""

    first: Array
    """(n, n)"""
    last: Array
    """(n, n)"""
    rhs: Array
    """(n, m)"""
    rounds: tuple[Eliminated, ...]
    steps: tuple[Array, Array] | None = None
    """Factors and forcing of steps that were multiplied instead."""

    def all_from(self, start: Array, end: Array) -> Array:
        """Return z_0 ... z_N, shape (N + 1, n, m), from those at the ends."""
        if self.steps is not None:
            states = [start]
            for factor, forcing in zip(*self.steps, strict=True):
                states.append(factor @ states[-1] + forcing)
            return np.array(states)
        known = np.stack([start, end])
        for gone in reversed(self.rounds):
            pairs = len(gone.R)
            middle = gone.rhs - gone.left @ known[:pairs] - gone.right @ known[1 : pairs + 1]
            found = np.empty((len(known) + pairs, *known.shape[1:]), dtype=np.result_type(known, middle))
            found[0 : 2 * pairs + 1 : 2] = known[: pairs + 1]
            found[2 * pairs + 1 :] = known[pairs + 1 :]
            found[1 : 2 * pairs : 2] = np.linalg.solve(gone.R, middle)
            known = found
        return known


def reduced(factors: Array, forcing: Array) -> Reduced:
    """Reduce z_{k+1} = F_k z_k + g_k to one equation between z_0 and z_N.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
    forcing : ndarray, shape (N, n, m)
        m right-hand sides at once.
    """
    n = factors.shape[1]
    if len(factors) <= FEW_STEPS:
        total, gained = np.eye(n), np.zeros(forcing.shape[1:])
        for factor, more in zip(factors, forcing, strict=True):
            total, gained = factor @ total, factor @ gained + more
            # Before it overflows.
            if not np.abs(total).max(initial=0.0) <= MODERATE:
                break
        else:
            return Reduced(first=-total, last=np.eye(n), rhs=gained, rounds=(), steps=(factors, forcing))
    return reduced_pairs(-factors, np.broadcast_to(np.eye(n), factors.shape), forcing)


def reduced_pairs(left: Array, right: Array, rhs: Array) -> Reduced:
    """Reduce left_k z_k + right_k z_{k+1} = rhs_k to one equation; shapes (N, n, n) twice, and (N, n, m)."""
    n, rounds = left.shape[1], list[Eliminated]()
    with one_blas_thread(len(left)):
        while len(left) > 1:
            pairs = len(left) // 2
            upper, lower, odd = slice(0, 2 * pairs, 2), slice(1, 2 * pairs, 2), slice(2 * pairs, None)
            Q, R = np.linalg.qr(np.concatenate([right[upper], left[lower]], axis=1), mode="complete")
            turned = np.conj(np.swapaxes(Q, 1, 2))
            before = turned[:, :, :n] @ np.concatenate([left[upper], rhs[upper]], axis=2)
            after = turned[:, :, n:] @ np.concatenate([right[lower], rhs[lower]], axis=2)
            both = before[:, :, n:] + after[:, :, n:]
            rounds.append(Eliminated(R=R[:, :n], left=before[:, :n, :n], right=after[:, :n, :n], rhs=both[:, :n]))
            left = np.concatenate([before[:, n:, :n], left[odd]])
            right = np.concatenate([after[:, n:, :n], right[odd]])
            rhs = np.concatenate([both[:, n:], rhs[odd]])
    return Reduced(first=left[0], last=right[0], rhs=rhs[0], rounds=tuple(rounds))


def solve_cyclic(factors: Array, forcing: Array) -> Array:
    """Return z_0 ... z_{N-1} of z_{k+1} = F_k z_k + g_k with z_N = z_0, shape (N, n, m).

    Raises
    ------
    numpy.linalg.LinAlgError
        The product of the factors has an eigenvalue of exactly one.
    """
    one = reduced(factors, forcing)
    start = np.linalg.solve(one.first + one.last, one.rhs)
    return one.all_from(start, start)[:-1]


def solve_cyclic_adjoint(factors: Array, forcing: Array) -> Array:
    """Return y_0 ... y_{N-1} of y_k = F_k^T y_{k+1} + h_k with y_N = y_0, shape (N, n, m)."""
    # In reversed order with x_j = y_{N-j}: x_{j+1} = F_{N-1-j}' x_j + h_{N-1-j}.
    backward = solve_cyclic(np.swapaxes(factors[::-1], 1, 2), forcing[::-1])
    return np.roll(backward[::-1], 1, axis=0)
