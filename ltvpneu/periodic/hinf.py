r"""Hinf norm, the L2-induced gain, of a periodic system from the multipliers of its Hamiltonian.

For gamma above every sigma(D), gamma exceeds the norm of a stable system just when no multiplier of z' = H z with

.. math:: H = \begin{bmatrix} A + B R^{-1} D' C & \gamma B R^{-1} B' \\ -\gamma C' (I - D D'/\gamma^2)^{-1} C / \gamma^2
          & -(A + B R^{-1} D' C)' \end{bmatrix}, \qquad R = \gamma^2 I - D' D

lies on the unit circle [Colaneri2000]_: bisection. At the norm two multipliers meet on the circle, where each alone is
only good to the root of the rounding error; but half their logarithms' difference, squared, passes through zero with a
slope, positive (off the circle) above and negative (on it) below, and its root is the norm to full accuracy.

.. [Colaneri2000] P. Colaneri, "Continuous-time periodic systems in H2 and Hinf", Kybernetika 36, 2000.
"""

import math
from dataclasses import dataclass
from typing import cast, final

import numpy as np
from scipy.optimize import brentq

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.floquet import floquet
from ltvpneu.periodic.gramians import balanced_matrices, gramians
from ltvpneu.periodic.product import log_multipliers
from ltvpneu.periodic.propagate import balancing_scales, exponentials
from ltvpneu.periodic.system import NORM_OF_A_PIECE, PeriodicSystem, expect_system

ON_CIRCLE = 1e-7
"""Logarithm of a multiplier's modulus below which it may be on the unit circle: the root of the rounding error."""


def hinf_norm(system: PeriodicSystem, *, rtol: float = 1e-13) -> float:
    """Return the Hinf norm: the largest ratio of the output's to the input's energy, square root taken.

    Parameters
    ----------
    system : PeriodicSystem
    rtol : float
        Relative width of the last bracket.

    Returns
    -------
    float
        Infinite if the system is not stable.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-2.0]], [[-2.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.hinf_norm(system), 12)
    0.5
    """
    expect_system(system)
    if not floquet(system).is_stable:
        return math.inf
    feedthrough = (
        float(np.max(np.linalg.norm(system.D, ord=2, axis=(1, 2)), initial=0.0, where=system.durations > 0))
        if min(system.D.shape) > 0
        else 0.0
    )
    low = max(feedthrough * (1 + 1e-12), float(np.max(gramians(system).hankel_singular_values, initial=0.0)))
    if low == 0.0:
        return 0.0
    hamiltonian = _Hamiltonian(system=system)
    high = 2 * low
    while hamiltonian.meeting(high) < 0:
        low, high = high, 2 * high
    return _refined(hamiltonian, low, high, rtol)


def _refined(hamiltonian: "_Hamiltonian", low: float, high: float, rtol: float) -> float:
    """Return the norm, between low (at most it) and high (above it)."""
    while high / low - 1 > rtol:
        if high / low - 1 < 1e-3:
            below, above = hamiltonian.meeting(low), hamiltonian.meeting(high)
            if below < 0 < above:
                root = cast(float, brentq(hamiltonian.meeting, low, high, xtol=rtol * low))
                # One peak may hide another until the bracket is narrow: the root must part what lies beside it.
                step = max(rtol, 1e-10)
                if hamiltonian.meeting(root * (1 - step)) < 0 < hamiltonian.meeting(root * (1 + step)):
                    return root
        middle = math.sqrt(low * high)
        if hamiltonian.meeting(middle) < 0:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class _Hamiltonian:
    system: PeriodicSystem

    def matrices(self, gamma: float) -> FloatArray:
        """Return H of each step at a gain, (n_steps, 2 n, 2 n)."""
        A, B, C = balanced_matrices(self.system)
        D = self.system.D / gamma
        Dt, Bt, Ct = (np.swapaxes(part, 1, 2) for part in (D, B, C))
        inverse = np.linalg.inv(np.eye(D.shape[2]) - Dt @ D)
        other = np.linalg.inv(np.eye(D.shape[1]) - D @ Dt)
        closed = A + B @ inverse @ Dt @ C / gamma
        return np.concatenate(
            [
                np.concatenate([closed, B @ inverse @ Bt / gamma], axis=2),
                np.concatenate([-Ct @ other @ C / gamma, -np.swapaxes(closed, 1, 2)], axis=2),
            ],
            axis=1,
        )

    def meeting(self, gamma: float) -> float:
        """Return the squared half-difference of the logarithms of the pair of multipliers that meets at the norm.

        Negative where multipliers lie on the unit circle, that is below the norm.
        """
        matrices, durations = self.matrices(gamma), self.system.durations
        scales = balancing_scales(matrices, durations)
        matrices = matrices * (scales / scales[:, None]) * durations[:, None, None]
        pieces = np.maximum(np.ceil(np.max(np.sum(np.abs(matrices), axis=1), axis=1) / NORM_OF_A_PIECE), 1).astype(int)
        logs, angles = log_multipliers(np.repeat(exponentials(matrices / pieces[:, None, None]), pieces, axis=0))
        on_circle = np.abs(logs) < ON_CIRCLE
        if not on_circle.any():
            return float(np.min(np.abs(logs))) ** 2
        return _widest(np.sort(angles[on_circle]))


def _widest(angles: FloatArray) -> float:
    """Return minus the square of half the widest interval of frequencies whose gain is above gamma.

    The angles on the circle are the ends of such intervals; near the norm these are narrow and what lies between them
    is wide.
    """
    if len(angles) < 2:
        return -0.0
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    either = gaps[0::2], gaps[1::2]
    intervals = min(either, key=lambda some: float(np.sum(some)) if len(some) else math.inf)
    return -(float(np.max(intervals) / 2) ** 2)
