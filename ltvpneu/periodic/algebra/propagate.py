r"""Step maps z -> W_m z + g_m from the exponential of the augmented matrix.

.. math:: \exp\left(\begin{bmatrix} A & f \\ 0 & 0 \end{bmatrix} T\right) = \begin{bmatrix} W & g \\ 0 & 1 \end{bmatrix}

No inverse of A is needed, so a singular step (a shut chamber, erratum E8) is like any other. The states are balanced
and the forcing scaled before exponentiating: in SI units the entries span nine decades.
"""

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from typing import final

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dgebal  # pyright: ignore[reportAttributeAccessIssue] - made at build time
from threadpoolctl import ThreadpoolController

from ltvpneu._arrays import ComplexArray, FloatArray
from ltvpneu._values import Value


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()


def one_blas_thread(stack: int) -> AbstractContextManager[object]:
    """Return a context in which work on a stack of tiny matrices, of that length, goes on one BLAS thread.

    On tiny matrices more threads cost five to twenty times as much on a busy machine. For short stacks asking for that
    would cost more than it saves.
    """
    return nullcontext() if stack < 64 else _blas().limit(limits=1, user_api="blas")


def exponentials(matrices: FloatArray) -> FloatArray:
    """Exponentials of a stack of small matrices, shape (..., k, k)."""
    if matrices.size == 0:
        return np.zeros(matrices.shape)
    with one_blas_thread(matrices.shape[0]):
        return np.asarray(expm(matrices), dtype=np.float64)


def complex_exponentials(matrices: ComplexArray) -> ComplexArray:
    """Exponentials of a stack of small complex matrices, shape (..., k, k)."""
    if matrices.size == 0:
        return np.zeros(matrices.shape, dtype=np.complex128)
    with one_blas_thread(matrices.shape[0]):
        return np.asarray(expm(matrices), dtype=np.complex128)


FAINT = 2.0**-64
"""By which forcing is scaled down beside the states: then it has no say in how the exponential is computed."""


def forced_exponentials(matrices: FloatArray, n: int) -> FloatArray:
    """Exponentials of a stack of [[A, F], [0, 0]] with A (n, n), of which A's own do not depend on F.

    A nilpotent A loses digits as soon as a forcing of its own size stands beside it.
    """
    faint = matrices.copy()
    faint[..., :n, n:] *= FAINT
    found = exponentials(faint)
    found[..., :n, n:] /= FAINT
    return found


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ScaledSteps(Value):
    """A system's augmented matrices in balanced coordinates: states divided by `scales`, the forcing by `unit`.

    In these coordinates the augmented state is (z / scales, unit), and `matrices` holds [[A, f], [0, 0]] of each step.
    """

    matrices: FloatArray
    """(n_steps, n + 1, n + 1) [1/s]"""
    scales: FloatArray
    """(n,)"""
    unit: float

    def augmented(self, states: FloatArray) -> FloatArray:
        """Return states (..., n) as balanced augmented ones (..., n + 1)."""
        unit = np.full((*states.shape[:-1], 1), self.unit)
        return np.concatenate([states / self.scales, unit], axis=-1)

    def physical(self, augmented: FloatArray) -> FloatArray:
        """Return balanced augmented states (..., n + 1) as states (..., n)."""
        return augmented[..., :-1] * self.scales


def balancing_scales(A: FloatArray, durations: FloatArray) -> FloatArray:
    """Powers of two by which to divide the states so that all steps together are balanced, shape (n,)."""
    N, n = A.shape[:2]
    if n == 0:
        return np.ones(0)
    together = (durations @ np.abs(A).reshape(N, n * n)).reshape(n, n)
    scales: FloatArray = dgebal(together, scale=1, permute=0)[3]
    return scales


def scaled_steps(A: FloatArray, f: FloatArray, durations: FloatArray) -> ScaledSteps:
    """Return augmented matrices in balanced coordinates from A (N, n, n), f (N, n) and durations (N,)."""
    scales, (N, n) = balancing_scales(A, durations), f.shape
    scaled = f / scales
    # The largest forcing over a step becomes about one, so that it does not spoil the scaling of the exponential.
    largest = float(np.max(np.abs(scaled) * durations[:, None], initial=0.0))
    unit = 2.0 ** round(math.log2(largest)) if largest > 0 else 1.0
    matrices = np.zeros((N, n + 1, n + 1))
    matrices[:, :n, :n] = A * (scales / scales[:, None])
    matrices[:, :n, n] = scaled / unit
    return ScaledSteps(matrices=matrices, scales=scales, unit=unit)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class StepMaps(Value):
    """Maps of the balanced augmented state over each step, and the coordinates they are in."""

    maps: FloatArray
    """(n_steps, n + 1, n + 1)"""
    steps: ScaledSteps


def step_maps(steps: ScaledSteps, durations: FloatArray) -> StepMaps:
    """Return the maps over all steps, (11) without its inverse."""
    maps = forced_exponentials(steps.matrices * durations[:, None, None], len(steps.scales))
    return StepMaps(maps=maps, steps=steps)
