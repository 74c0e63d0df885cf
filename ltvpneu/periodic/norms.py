r"""H2 and Hankel norm of a periodic system, from Gramians; infinite where it is not stable.

The H2 norm is the root mean square of the output under white noise of unit intensity,

.. math:: \|G\|_2^2 = \frac1T \int_0^T \mathrm{tr}\, C P C' \, dt
          = \frac1T \sum_k \left( \mathrm{tr}\, O_k P_k + \int_0^{T_k} (T_k - s) \|C_k e^{A_k s} B_k\|_F^2 ds \right)

where O_k is the observability Gramian of step k alone: what was there at its start, and what came in within it.
The Hankel norm is the largest gain from past inputs to future outputs, over all instants that part the two.
"""

import math
from typing import cast

import numpy as np
from scipy.optimize import minimize_scalar

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.floquet import floquet
from ltvpneu.periodic.gramians import Gramians, balanced_matrices, gramians
from ltvpneu.periodic.lyapunov import step_gramians
from ltvpneu.periodic.system import PeriodicSystem, expect_system


def h2_norm(system: PeriodicSystem) -> float:
    """Return the H2 norm: root mean square output under white noise of unit intensity on every input.

    Returns
    -------
    float
        Infinite if the system is not stable, or where an input reaches an output at once (D not zero).

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.h2_norm(system) ** 2, 12)
    0.5
    """
    expect_system(system)
    if system.D[system.durations > 0].any() or not floquet(system).is_stable:
        return math.inf
    A, B, C = balanced_matrices(system)
    steps = step_gramians(A, B, C, system.durations)
    carried = np.swapaxes(steps.observability, 1, 2) @ gramians(system).balanced_factors[0]
    return math.sqrt((float(np.sum(carried**2)) + float(np.sum(steps.energy))) / system.period)


def hankel_norm(system: PeriodicSystem) -> float:
    """Return the Hankel norm: the largest Hankel singular value over the period.

    Returns
    -------
    float
        Infinite if the system is not stable.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.hankel_norm(system), 12)
    0.5
    """
    expect_system(system)
    if not floquet(system).is_stable:
        return math.inf
    found = gramians(system)
    times = _sample_times(system)
    values = found.hankel_singular_values_at(times)[:, 0]
    best = int(np.argmax(values))
    # The largest value inside a step is smooth; a grid point's neighbours bracket it.
    for left, right in ((best - 1, best), (best, best + 1)):
        if left >= 0 and right < len(times):
            values = np.append(values, _peak(found, times[left], times[right]))
    return float(np.max(values))


def _peak(found: Gramians, left: float, right: float) -> float:
    def negative(time: float) -> float:
        return -float(found.hankel_singular_values_at([time])[0, 0])

    return -cast(
        float, minimize_scalar(negative, bounds=(left, right), method="bounded", options={"xatol": 1e-9 * right}).fun
    )


def _sample_times(system: PeriodicSystem) -> FloatArray:
    """Return times that divide every step evenly, finely enough for its fastest swing."""
    swings = np.max(np.abs(np.linalg.eigvals(system.scaled.matrices[:, :-1, :-1]).imag), axis=1) * system.durations
    parts = 8 + np.minimum(np.ceil(8 * swings / np.pi), 2000).astype(int)
    return np.concatenate(
        [
            start + T * np.arange(n) / n
            for start, T, n in zip(system.switching_times, system.durations, parts, strict=False)
        ]
    )
