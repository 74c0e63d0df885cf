"""Matrices given once, or once for each step."""

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array


def each_step(name: str, values: ArrayLike, N: int, n: int) -> FloatArray:
    """Return a matrix with n rows, or one a step, as a stack (N, n, m)."""
    array = finite_array(name, values)
    if array.ndim == 2:
        array = np.broadcast_to(array, (N, *array.shape))
    return finite_array(name, array, (N, n, None))


def symmetric(name: str, values: ArrayLike, N: int, n: int) -> FloatArray:
    """Return a symmetric matrix, or one a step, as a stack (N, n, n).

    Raises
    ------
    ValueError
        Of another shape, or not symmetric.
    """
    stack = finite_array(name, each_step(name, values, N, n), (N, n, n))
    gap = np.max(np.abs(stack - np.swapaxes(stack, 1, 2)), initial=0.0)
    if gap > 1e-12 * np.max(np.abs(stack), initial=0.0):
        raise ValueError(f"{name}: found a difference of {gap:.3g} from its transpose, expected a symmetric matrix")
    return (stack + np.swapaxes(stack, 1, 2)) / 2
