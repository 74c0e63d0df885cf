r"""H2 and Hankel norm of a periodic system, from Gramians; infinite where it is not stable.

The H2 norm is the root mean square of the output under white noise of unit intensity (in discrete time: of unit
covariance, over the steps of a period),

.. math:: \|G\|_2^2 = \frac1T \int_0^T \mathrm{tr}\, C P C' \, dt
          = \frac1T \sum_k \left( \mathrm{tr}\, O_k P_k + \int_0^{T_k} (T_k - s) \|C_k e^{A_k s} B_k\|_F^2 ds \right)

where O_k is the observability Gramian of step k alone: what was there at its start, and what came in within it.
The Hankel norm is the largest gain from past inputs to future outputs, over all instants that part the two.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.analysis.gramians import balanced_matrices, gramians
from ltvpneu.periodic.analysis.lyapunov import step_gramians
from ltvpneu.periodic.orbits.floquet import floquet
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.system import PeriodicSystem

_REFINEMENTS = 14
"""Each narrows the bracket of a peak to a quarter, to 4e-9 of it in all: a flat peak is then right to rounding."""


def h2_norm(system: AnyPeriodicSystem) -> float:
    """Return the H2 norm: root mean square output under white noise of unit intensity on every input.

    Returns
    -------
    float
        Infinite if the system is not stable, or, in continuous time, where an input reaches an output at once (D not
        zero).

    Raises
    ------
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.h2_norm(system) ** 2, 12)
    0.5
    """
    expect_periodic(system)
    if isinstance(system, DiscretePeriodicSystem):
        return _discrete_h2_norm(system) if floquet(system).is_stable else math.inf
    if system.D[system.durations > 0].any() or not floquet(system).is_stable:
        return math.inf
    A, B, C = balanced_matrices(system)
    steps = step_gramians(A, B, C, system.durations)
    carried = np.swapaxes(steps.observability, 1, 2) @ gramians(system).balanced_factors[0]
    return math.sqrt((float(np.sum(carried**2)) + float(np.sum(steps.energy))) / system.period)


def _discrete_h2_norm(system: DiscretePeriodicSystem) -> float:
    """Root of the mean over the steps of tr C P C' + D D'."""
    seen = system.balanced[2] @ gramians(system).balanced_factors[0]
    return math.sqrt((float(np.sum(seen**2)) + float(np.sum(system.D**2))) / system.n_steps)


def hankel_norm(system: AnyPeriodicSystem) -> float:
    """Return the Hankel norm: the largest Hankel singular value over the period.

    Returns
    -------
    float
        Infinite if the system is not stable.

    Raises
    ------
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.hankel_norm(system), 12)
    0.5
    """
    expect_periodic(system)
    if not floquet(system).is_stable:
        return math.inf
    if system.n_states == 0:
        return 0.0
    if isinstance(system, DiscretePeriodicSystem):
        return float(np.max(gramians(system).hankel_singular_values))
    # A step of no duration changes nothing, and would be looked at as closely as any other.
    system = system.without_empty_steps()
    found = gramians(system)

    def largest(times: FloatArray) -> FloatArray:
        return found.hankel_singular_values_at(times)[:, 0]

    times = _sample_times(system)
    values = largest(times)
    # Kinks sit at switching instants, which are samples; between two of them every peak gets refined.
    padded = np.concatenate([[-math.inf], values, [-math.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]) & (values >= 0.5 * np.max(values)))
    left, right = times[np.maximum(peaks - 1, 0)], times[np.minimum(peaks + 1, len(times) - 1)]
    best = float(np.max(values))
    for _ in range(_REFINEMENTS):
        grid = left + (right - left) * np.linspace(0, 1, 9)[:, None]
        refined = largest(grid.ravel()).reshape(grid.shape)
        best = max(best, float(np.max(refined)))
        top, each = np.argmax(refined, axis=0), np.arange(len(peaks))
        left, right = grid[np.maximum(top - 1, 0), each], grid[np.minimum(top + 1, 8), each]
    return best


def _sample_times(system: PeriodicSystem) -> FloatArray:
    """Return times over the period, both ends included: even for a step's swings, closer at its ends for its decays."""
    eigenvalues = np.linalg.eigvals(system.scaled.matrices[:, :-1, :-1]) * system.durations[:, None]
    parts = 8 + np.minimum(np.ceil(8 * np.max(np.abs(eigenvalues.imag), axis=1) / np.pi), 2000).astype(int)
    decades = np.minimum(np.ceil(np.log2(1 + np.max(np.abs(eigenvalues), axis=1))), 60).astype(int)
    return np.concatenate(
        [
            start + T * _graded(int(n), int(k))
            for start, T, n, k in zip(system.switching_times, system.durations, parts, decades, strict=False)
        ]
        + [[system.period]]
    )


def _graded(parts: int, halvings: int) -> FloatArray:
    """Return even parts of [0, 1), and halvings of the first and the last of them."""
    layer = 0.5 ** np.arange(1, halvings + 1) / parts
    return np.unique(np.concatenate([np.arange(parts) / parts, layer, 1 - layer]))
