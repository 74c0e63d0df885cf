r"""Two-point (scattering) form of Riccati steps: what joins state and costate across a step without ever growing.

A linear-quadratic step relates the states x and costates p = X x at its ends by

    x_1 = E x_0 - G p_1,    p_0 = H x_0 + E' p_1        G, H symmetric, positive semidefinite

and steps in sequence combine by the star product [Redheffer1962]_. The Hamiltonian's exponential holds the same in
growing and decaying parts, which long or stiff steps tear apart; here nothing grows. Equal steps combine by doubling,
both within a step and over infinitely many periods, where H tends to the periodic solution X quadratically
[Chu2004]_. Composed over a horizon, X_0 = H + E' X_1 (I + G X_1)^-1 E.

.. [Redheffer1962] R. Redheffer, "On the relation of transmission-line theory to scattering and transfer", J. Math.
   Phys. 41, 1962.
.. [Chu2004] E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic discrete-time
   algebraic Riccati equations", Int. J. Control 77(8), 2004.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, solved
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials

HAMILTONIAN_STEP = 0.5
"""Norm of the Hamiltonian times duration over which its exponential is taken apart directly."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Scattering(Value):
    """E, G, H of one step, or of a stack of steps, each (..., n, n)."""

    E: FloatArray
    G: FloatArray
    H: FloatArray

    def then(self, later: "Scattering") -> "Scattering":
        """Return both in sequence, the star product."""
        n = self.E.shape[-1]
        weakened: FloatArray = np.asarray(np.linalg.inv(np.eye(n) + self.G @ later.H), dtype=np.float64)
        through = weakened @ self.E
        return Scattering(
            E=later.E @ through,
            G=_even(later.G + later.E @ weakened @ self.G @ _transposed(later.E)),
            H=_even(self.H + _transposed(self.E) @ later.H @ through),
        )

    def pairs(self) -> "tuple[Scattering, Scattering, Scattering]":
        """Return, of a stack, every first and every second of two neighbours, and the one left over if any."""
        even = len(self.E) // 2 * 2
        parts = slice(0, even, 2), slice(1, even, 2), slice(even, None)
        earlier, later, odd = (Scattering(E=self.E[part], G=self.G[part], H=self.H[part]) for part in parts)
        return earlier, later, odd

    def followed_by(self, rest: "Scattering") -> "Scattering":
        """Return two stacks as one."""
        E, G, H = (np.concatenate(both) for both in ((self.E, rest.E), (self.G, rest.G), (self.H, rest.H)))
        return Scattering(E=E, G=G, H=H)

    def is_bounded_with(self, later: "Scattering") -> bool:
        """Return whether both in sequence stay finite where G is negative: I + G H has positive eigenvalues only."""
        product = self.G @ later.H
        # Similar to a symmetric matrix, so its eigenvalues are real.
        return bool(np.isfinite(product).all() and (np.linalg.eigvals(product).real > -1).all())

    def closed_loop(self, X: FloatArray) -> FloatArray:
        """Return the map of the state under the optimal control that costs X after the end."""
        return solved(np.eye(self.E.shape[-1]) + self.G @ X, self.E)

    def cost_before(self, X: FloatArray) -> FloatArray:
        """Return the optimal cost at the start from that at the end."""
        return _even(self.H + _transposed(self.E) @ X @ self.closed_loop(X))


def free_steps(maps: FloatArray) -> Scattering:
    """Return steps that map the state, (N, n, n), and cost nothing: jumps."""
    return Scattering(E=maps, G=np.zeros_like(maps), H=np.zeros_like(maps))


def continuous_steps(A: FloatArray, G: FloatArray, Q: FloatArray, durations: FloatArray) -> Scattering:
    """Return the steps of x' = A x - G p, -p' = Q x + A' p, exactly.

    Parameters
    ----------
    A, G, Q : ndarray, shape (N, n, n)
    durations : ndarray, shape (N,)
    """
    steps, doublings = _short_steps(A, G, Q, durations)
    for _ in range(doublings):
        steps = steps.then(steps)
    return steps


def bounded_steps(A: FloatArray, G: FloatArray, Q: FloatArray, durations: FloatArray) -> Scattering | None:
    """Return the same for G negative semidefinite, or None if a step is longer than the costs stay finite."""
    steps, doublings = _short_steps(A, G, Q, durations)
    for _ in range(doublings):
        if not steps.is_bounded_with(steps):
            return None
        steps = steps.then(steps)
    return steps


def _short_steps(A: FloatArray, G: FloatArray, Q: FloatArray, durations: FloatArray) -> tuple[Scattering, int]:
    """Return a 2^k-th of each step, short enough to be taken apart directly, and k."""
    n = A.shape[1]
    # Costates in a unit that makes both couplings alike.
    unit = math.sqrt(float(np.max(np.abs(Q))) / float(np.max(np.abs(G)))) if np.any(G) and np.any(Q) else 1.0
    H = np.concatenate(
        [np.concatenate([A, -unit * G], axis=2), np.concatenate([-Q / unit, -_transposed(A)], axis=2)], axis=1
    )
    largest = float(np.max(np.max(np.sum(np.abs(H), axis=1), axis=1, initial=0.0) * durations))
    doublings = max(0, math.ceil(math.log2(largest / HAMILTONIAN_STEP))) if largest > 0 else 0
    maps = exponentials(H * (durations / 2.0**doublings)[:, None, None])
    onward: FloatArray = np.asarray(np.linalg.inv(maps[:, n:, n:]), dtype=np.float64)
    steps = Scattering(
        E=_transposed(onward),
        G=_even(-maps[:, :n, n:] @ onward) / unit,
        H=_even(-onward @ maps[:, n:, :n]) * unit,
    )
    return steps, doublings


def over_period(steps: Scattering) -> Scattering:
    """Return all steps in sequence; neighbours combine in pairs, all pairs at once."""
    while len(steps.E) > 1:
        earlier, later, odd = steps.pairs()
        steps = earlier.then(later).followed_by(odd)
    return Scattering(E=steps.E[0], G=steps.G[0], H=steps.H[0])


def bounded_period(steps: Scattering) -> Scattering | None:
    """Return the same for G negative semidefinite, or None if a period is longer than the costs stay finite."""
    while len(steps.E) > 1:
        earlier, later, odd = steps.pairs()
        if not earlier.is_bounded_with(later):
            return None
        steps = earlier.then(later).followed_by(odd)
    return Scattering(E=steps.E[0], G=steps.G[0], H=steps.H[0])


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)


def _even(matrices: FloatArray) -> FloatArray:
    return (matrices + _transposed(matrices)) / 2
