r"""Transition matrices of steps as factors that neither over- nor underflow, however stiff a step is.

A factor is :math:`\mathrm{diag}(e^{l})\,M` with M of moderate entries and l the logarithms of its rows. A step of
moderate norm is a few equal pieces, l = 0. A stiff one is first taken apart: where the real parts of its eigenvalues
leave a gap, an ordered Schur form and a Sylvester equation [Golub2013]_ give A = X diag(A_1, A_2) X^-1, and

.. math:: e^{A T} = X\, \mathrm{diag}(e^{A_1 T}, e^{A_2 T})\, X^{-1}

in which each block has its mean rate taken out, e^{A_i T} = e^{\mu_i T} e^{(A_i - \mu_i I) T}. So a rate of 1e9 costs
a few times what one of 1 costs, and its logarithm is as exact. Where no gap is left, as in a block that is far from
normal, pieces are all there is.

.. [Golub2013] G. H. Golub, C. F. Van Loan, "Matrix Computations", 4th ed., Johns Hopkins 2013.
"""

import math
from dataclasses import dataclass
from typing import cast, final

import numpy as np
from scipy.linalg import block_diag, schur, solve_sylvester

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials

NORM_OF_A_PIECE = 4.0
"""Norm of A times duration up to which a step is one piece: its small directions keep all but two digits."""
MILD = 256.0
"""Norm of A times duration up to which a step is not taken apart."""
GAP = 80.0
"""Difference of real parts times duration between blocks: what a block leaves in the next is below exp(-80)."""
LARGEST_TRANSFORMATION = 1e7
"""Largest entry of X that costs no accuracy worth naming; a step that needs a larger one is not taken apart."""
MOST_PIECES = 4096
"""Pieces into which a block is split before pieces of a greater norm are taken."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Factors(Value):
    """Factors diag(exp(row_logs)) M of the transition matrices of all steps, the first one first."""

    matrices: FloatArray
    """M, (n_factors, n, n)."""
    row_logs: FloatArray
    """(n_factors, n)"""
    durations: FloatArray
    """[s]; zero for a change of coordinates, (n_factors,)."""
    starts: IntArray
    """Number of the factor that each step begins with, (n_steps,)."""


def step_factors(A: FloatArray, durations: FloatArray) -> Factors:
    """Return the factors of all steps, from A (n_steps, n, n), balanced, and durations (n_steps,)."""
    n = A.shape[1]
    norms = np.abs(A).sum(axis=1).max(axis=1, initial=0.0) * durations
    pieces = np.maximum(np.ceil(np.minimum(norms, MILD) / NORM_OF_A_PIECE), 1).astype(np.int64)
    stiff = norms > MILD
    scaled = np.where(stiff, 0.0, durations / pieces)[:, None, None] * A
    mild = exponentials(scaled)
    parts: list[list[_Factor]] = (
        [
            _stiff_factors(A[k] * durations[k]) if stiff[k] else [(mild[k], np.zeros(n), 1.0)] * pieces[k]
            for k in range(len(A))
        ]
        if stiff.any()
        else []
    )
    if not parts:
        matrices = np.repeat(mild, pieces, axis=0)
        return Factors(
            matrices=matrices,
            row_logs=np.zeros((len(matrices), n)),
            durations=np.repeat(durations / pieces, pieces),
            starts=np.cumsum(pieces) - pieces,
        )
    counts = np.array([len(part) for part in parts])
    shares = np.array([share for part in parts for _, _, share in part])
    n_long = np.repeat([sum(share for _, _, share in part) for part in parts], counts)
    return Factors(
        matrices=np.array([matrix for part in parts for matrix, _, _ in part]),
        row_logs=np.array([logs for part in parts for _, logs, _ in part]),
        durations=np.repeat(durations, counts) * shares / n_long,
        starts=np.cumsum(counts) - counts,
    )


def with_jumps(factors: Factors, jumps: FloatArray, jumps_at: BoolArray) -> Factors:
    """Return the factors with those of jumps (n_steps, n, n) after the steps at whose ends the state jumps."""
    n, ends = jumps.shape[1], np.append(factors.starts[1:], len(factors.matrices))[jumps_at]
    return Factors(
        matrices=np.insert(factors.matrices, ends, jumps[jumps_at], axis=0),
        row_logs=np.insert(factors.row_logs, ends, np.zeros(n), axis=0),
        durations=np.insert(factors.durations, ends, 0.0),
        starts=factors.starts + np.cumsum(jumps_at) - jumps_at,
    )


_Factor = tuple[FloatArray, FloatArray, float]
"""M, the logarithms of its rows, and one, or zero for a change of coordinates, which takes no time."""


def _stiff_factors(matrix: FloatArray) -> list[_Factor]:
    """Return the factors of exp(matrix), the first to act first: X^-1, equal pieces of the blocks, and X."""
    n = len(matrix)
    blocks, inward, outward = _blocks(matrix, np.eye(n), np.eye(n))
    means = [float(np.trace(block)) / len(block) for block in blocks]
    shifted = [block - mean * np.eye(len(block)) for block, mean in zip(blocks, means, strict=True)]
    norm = max(float(np.abs(block).sum(axis=0).max()) for block in shifted)
    pieces = min(max(math.ceil(norm / NORM_OF_A_PIECE), 1), MOST_PIECES)
    together: FloatArray = np.asarray(block_diag(*[exponentials((block / pieces)[None])[0] for block in shifted]))
    logs = np.repeat(np.array(means) / pieces, [len(block) for block in blocks])
    nothing = np.zeros(n)
    return [(inward, nothing, 0.0), *[(together, logs, 1.0)] * pieces, (outward, nothing, 0.0)]


def _blocks(
    matrix: FloatArray, inward: FloatArray, outward: FloatArray
) -> tuple[list[FloatArray], FloatArray, FloatArray]:
    """Return A_1, A_2, ..., and X^-1 and X times what is given of them, taken apart as far as is needed."""
    norm = float(np.abs(matrix - np.trace(matrix) / len(matrix) * np.eye(len(matrix))).sum(axis=0).max())
    apart = _taken_apart(matrix) if norm > MILD else None
    if apart is None:
        return [matrix], inward, outward
    into, slow, fast, out = apart
    inward, outward, k = into @ inward, outward @ out, len(slow)
    slower, inward[:k], outward[:, :k] = _blocks(slow, inward[:k], outward[:, :k])
    faster, inward[k:], outward[:, k:] = _blocks(fast, inward[k:], outward[:, k:])
    return slower + faster, inward, outward


def _taken_apart(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Return X^-1, A_1, A_2 and X at the widest gap of the rates, the slower block first; None where there is none."""
    rates = np.sort(np.linalg.eigvals(matrix).real)[::-1]
    gaps = rates[:-1] - rates[1:]
    widest = int(np.argmax(gaps)) if gaps.size else 0
    if not gaps.size or gaps[widest] < GAP:
        return None
    middle = (rates[widest] + rates[widest + 1]) / 2
    triangle, U, n_slow = cast(
        tuple[FloatArray, FloatArray, int], schur(matrix, output="real", sort=lambda re, im=0.0: re > middle)
    )
    n = len(matrix)
    if n_slow in (0, n):
        return None
    slow, coupling, fast = triangle[:n_slow, :n_slow], triangle[:n_slow, n_slow:], triangle[n_slow:, n_slow:]
    # diag(A_1, A_2) is reached by [[I, Y], [0, I]] with A_1 Y - Y A_2 = coupling.
    Y = solve_sylvester(slow, -fast, coupling)
    if not np.abs(Y).max(initial=0.0) < LARGEST_TRANSFORMATION:
        return None
    inward, outward = U.T.copy(), U.copy()
    inward[:n_slow] += Y @ U.T[n_slow:]
    outward[:, n_slow:] -= U[:, :n_slow] @ Y
    return inward, slow, fast, outward
