"""Maps of the state over steps through which the inputs are held."""

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.algebra.propagate import forced_exponentials
from ltvpneu.periodic.systems.system import PeriodicSystem


def held_maps(system: PeriodicSystem) -> FloatArray:
    """Return [W, Gamma, g] of each step, z -> W z + Gamma u + g, shape (n_steps, n, n + m + 1)."""
    N, n, m = system.B.shape
    scales = system.scaled.scales
    forced = np.concatenate([system.B, system.r[:, :, None]], axis=2) / scales[:, None]
    largest = np.max(np.abs(forced), axis=(0, 1), initial=0.0) * system.period
    units = np.exp2(-np.round(np.log2(np.where(largest > 0, largest, 1.0))))
    matrices = np.zeros((N, n + m + 1, n + m + 1))
    matrices[:, :n, :n], matrices[:, :n, n:] = system.scaled.matrices[:, :n, :n], forced * units
    # Raises where a step overflows.
    _ = system.flows
    maps = forced_exponentials(matrices * system.durations[:, None, None], n)[:, :n]
    maps = maps * scales[:, None] / np.concatenate([scales, units])
    if system.J is not None and system.j is not None:
        maps = system.J @ maps
        maps[:, :, -1] += system.j
    return maps
