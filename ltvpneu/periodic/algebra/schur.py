r"""Eigenvalues of a product of matrices from its periodic Schur form, without forming the product.

Orthogonal Q_k with Q_N = Q_0 turn each factor F_k into the upper triangular :math:`Q_{k+1}^H F_k Q_k`, and an
eigenvalue of F_{N-1} ... F_0 is a product of diagonal entries, whose logarithms are summed. Two stages:

1. *orthogonal iteration*: F_k Q_k = Q_{k+1} R_k, round and round. Eigenvalues of well separated moduli, which are the
   rule in long products, separate at once, the largest first, and the grading keeps the small ones accurate. Each
   row carries the logarithm of its size, and plane rotations form ratios of sizes only, so that a factor may hold
   rows of any sizes, e^{-1e9} beside one;
2. *shifted periodic QR* [Bojanczyk1992]_ on each diagonal block that does not separate (pairs, close moduli), in
   complex arithmetic with one implicit shift.

.. [Bojanczyk1992] A. Bojanczyk, G. Golub, P. Van Dooren, "The periodic Schur decomposition. Algorithms and
   applications", Proc. SPIE 1770, 1992.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np

from ltvpneu._arrays import BoolArray, ComplexArray, FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu._values import Value
from ltvpneu.errors import StepOverflowError

EPS = float(np.finfo(float).eps)
MOST_SWEEPS = 12
MOST_ITERATIONS = 60
"""Shifted steps for one eigenvalue before giving up; three are usual."""
SMALLEST_PIVOT = 1e-250
"""Against a row's largest entry: what is smaller counts as zero."""
LARGEST_LOG = 300.0
"""Of the ratio of two rows' sizes, beyond which the smaller says nothing."""
SUSPICIOUS = 100.0
"""Units of rounding below which a diagonal entry may be a zero that rounding hides."""
LARGEST_RANGE = 200.0
"""Difference of the logarithms of a block's rows up to which its factors are formed as they stand."""


@inlined
def _rotate_graded(rows: FloatArray, logs: FloatArray, basis: FloatArray, i: int, j: int) -> None:
    """Turn rows i and j of diag(exp(logs)) rows, in place, so that entry (j, i) vanishes; `basis` likewise.

    Only ratios of the rows' sizes are formed. The smaller row loses its part along the larger one as in an elimination,
    to its own last bit, however much smaller it is.
    """
    n = rows.shape[1]
    if logs[j] > logs[i] or abs(rows[i, i]) < SMALLEST_PIVOT:
        for k in range(n):
            rows[i, k], rows[j, k] = rows[j, k], rows[i, k]
            basis[i, k], basis[j, k] = basis[j, k], basis[i, k]
        logs[i], logs[j] = logs[j], logs[i]
        if abs(rows[j, i]) < SMALLEST_PIVOT:
            rows[j, i] = 0.0
            return
    ratio = math.exp(min(logs[j] - logs[i], LARGEST_LOG))
    size = math.hypot(rows[i, i], rows[j, i] * ratio)
    c, s, share = rows[i, i] / size, rows[j, i] * ratio / size, rows[j, i] / size
    for k in range(n):
        upper, lower = rows[i, k], rows[j, k]
        rows[i, k] = c * upper + s * ratio * lower
        rows[j, k] = c * lower - share * upper
        upper, lower = basis[i, k], basis[j, k]
        basis[i, k] = c * upper + s * lower
        basis[j, k] = c * lower - s * upper
    rows[j, i] = 0.0


@inlined
def _even_out(row: FloatArray) -> float:
    """Divide a row by its largest entry where that is far from one, in place, and return the logarithm of it."""
    largest = 0.0
    for k in range(row.size):
        largest = max(largest, abs(row[k]))
    if largest == 0.0 or 1e-60 < largest < 1e60:
        return 0.0
    for k in range(row.size):
        row[k] /= largest
    return math.log(largest)


@compiled
def _orthogonal_sweep(
    factors: FloatArray, row_logs: FloatArray, basis: FloatArray, triangles: FloatArray, logs: FloatArray
) -> FloatArray:
    """Write R_k and the logarithms of its rows, of F_k Q_k = Q_{k+1} R_k, and return Q_N.

    F_k = diag(exp(row_logs)) factors[k] and R_k = diag(exp(logs)) triangles[k]; shapes (N, n, n), (N, n).
    """
    n = basis.shape[0]
    for k in range(factors.shape[0]):
        triangle, own = triangles[k], logs[k]
        triangle[:] = np.dot(factors[k], basis)
        own[:] = row_logs[k]
        turned = np.eye(n)
        for i in range(n):
            own[i] += _even_out(triangle[i])
        for i in range(n):
            for j in range(i + 1, n):
                if triangle[j, i] != 0.0:
                    _rotate_graded(triangle, own, turned, i, j)
                    own[i] += _even_out(triangle[i])
                    own[j] += _even_out(triangle[j])
        basis = np.ascontiguousarray(turned.T)
    return basis


@compiled
def _splits(coupling: FloatArray) -> BoolArray:
    """Return where Q_0' Q_N is block upper triangular to rounding: whether a diagonal block starts, (n + 1,)."""
    n = coupling.shape[0]
    cuts = np.ones(n + 1, dtype=np.bool_)
    for cut in range(1, n):
        cuts[cut] = np.max(np.abs(coupling[cut:, :cut])) <= 4 * n * EPS
    return cuts


@compiled
def _orthogonal_iteration(
    factors: FloatArray, row_logs: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return R_k (N, n, n), the logarithms of its rows (N, n), the coupling Q_0' Q_N (n, n), and where blocks start."""
    n = factors.shape[1]
    basis, triangles, logs = np.eye(n), np.empty_like(factors), np.empty_like(row_logs)
    coupling, cuts, unchanged = np.eye(n), np.zeros(n + 1, dtype=np.bool_), 0
    for _ in range(MOST_SWEEPS):
        following = _orthogonal_sweep(factors, row_logs, basis, triangles, logs)
        coupling = np.dot(np.ascontiguousarray(basis.T), following)
        found = _splits(coupling)
        unchanged = unchanged + 1 if np.all(found == cuts) else 0
        cuts = found
        if np.all(cuts) or unchanged == 2:
            break
        basis = following
    return triangles, logs, coupling, cuts


@compiled
def _rotation(a: complex, b: complex) -> tuple[float, complex]:
    """Return c, s of the rotation [[c, s], [-conj(s), c]] that turns (a, b) into (r, 0)."""
    if b == 0:
        return 1.0, 0j
    if a == 0:
        return 0.0, b.conjugate() / abs(b)
    size = math.hypot(abs(a), abs(b))
    return abs(a) / size, a / abs(a) * b.conjugate() / size


@compiled
def _rotate_rows(matrix: ComplexArray, i: int, columns: tuple[int, int], c: float, s: complex) -> None:
    for j in range(columns[0], columns[1] + 1):
        upper, lower = matrix[i, j], matrix[i + 1, j]
        matrix[i, j] = c * upper + s * lower
        matrix[i + 1, j] = c * lower - s.conjugate() * upper


@compiled
def _rotate_columns(matrix: ComplexArray, i: int, rows: tuple[int, int], c: float, s: complex) -> None:
    """Multiply by the inverse of the rotation from the right."""
    for j in range(rows[0], rows[1] + 1):
        left, right = matrix[j, i], matrix[j, i + 1]
        matrix[j, i] = c * left + s.conjugate() * right
        matrix[j, i + 1] = c * right - s * left


@compiled
def _rotate_round(factors: ComplexArray, i: int, window: tuple[int, int, int], c: float, s: complex) -> None:
    """Change Q_0 in the plane (i, i + 1) and carry the change round all factors; the triangles stay triangular.

    window: first and last index of the active block, and the last row of the Hessenberg factor to reach.
    """
    first, last, lowest = window
    N = factors.shape[0]
    _rotate_rows(factors[N - 1], i, (first, last), c, s)
    for k in range(N - 1):
        triangle = factors[k]
        _rotate_columns(triangle, i, (first, i + 1), c, s)
        c, s = _rotation(triangle[i, i], triangle[i + 1, i])
        _rotate_rows(triangle, i, (i, last), c, s)
        triangle[i + 1, i] = 0
    _rotate_columns(factors[N - 1], i, (first, lowest), c, s)


@compiled
def _trailing_shift(factors: ComplexArray, last: int) -> tuple[complex, float]:
    """Return the eigenvalue of the product's last 2 x 2 block nearest to its corner, as a number times exp(log)."""
    a, b, d, log = 1 + 0j, 0j, 1 + 0j, 0.0
    for k in range(factors.shape[0] - 1):
        triangle = factors[k]
        b = triangle[last - 1, last - 1] * b + triangle[last - 1, last] * d
        a *= triangle[last - 1, last - 1]
        d *= triangle[last, last]
        size = max(abs(a), abs(b), abs(d))
        if size == 0.0:
            return 0j, 0.0
        a, b, d, log = a / size, b / size, d / size, log + math.log(size)
    H = factors[-1][last - 1 : last + 1, last - 1 : last + 1]
    k11, k12 = a * H[0, 0] + b * H[1, 0], a * H[0, 1] + b * H[1, 1]
    k21, k22 = d * H[1, 0], d * H[1, 1]
    half = (k11 - k22) / 2
    root = np.sqrt(half * half + k12 * k21)
    if (half * root.conjugate()).real < 0:
        root = -root
    denominator = half + root
    return (k22 if denominator == 0 else k22 - k12 * k21 / denominator), log


@compiled
def _leading_product(factors: ComplexArray, first: int) -> tuple[complex, float]:
    """Return the product of the triangles' entries at (first, first), as a number times exp(log)."""
    value, log = 1 + 0j, 0.0
    for k in range(factors.shape[0] - 1):
        value *= factors[k, first, first]
        size = abs(value)
        if size == 0.0:
            return 0j, 0.0
        value, log = value / size, log + math.log(size)
    return value, log


@compiled
def _make_hessenberg(factors: ComplexArray) -> None:
    N, n = factors.shape[0], factors.shape[1]
    for j in range(n - 2):
        for i in range(n - 2, j, -1):
            c, s = _rotation(factors[N - 1, i, j], factors[N - 1, i + 1, j])
            _rotate_round(factors, i, (0, n - 1, n - 1), c, s)
            factors[N - 1, i + 1, j] = 0


@compiled
def _shifted_step(factors: ComplexArray, first: int, last: int, exceptional: bool) -> None:
    """One implicit QR step with one shift on the active block."""
    H = factors[-1]
    shift, log_shift = _trailing_shift(factors, last)
    if exceptional:
        shift *= 0.75 + 0.4j
    value, log_value = _leading_product(factors, first)
    top = max(log_value, log_shift)
    value *= math.exp(log_value - top)
    c, s = _rotation(value * H[first, first] - shift * math.exp(log_shift - top), value * H[first + 1, first])
    for i in range(first, last):
        if i > first:
            c, s = _rotation(H[i, i - 1], H[i + 1, i - 1])
        _rotate_round(factors, i, (first, last, min(i + 2, last)), c, s)
        if i > first:
            H[i + 1, i - 1] = 0


@compiled
def _triangularize(factors: ComplexArray) -> bool:
    """Make all factors upper triangular in place, as far as their diagonals go; False if that does not converge.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
        All but the last upper triangular.
    """
    _make_hessenberg(factors)
    H = factors[-1]
    last, iterations = factors.shape[1] - 1, 0
    while last > 0:
        first = last
        while first > 0:
            if abs(H[first, first - 1]) <= EPS * (abs(H[first, first]) + abs(H[first - 1, first - 1])):
                H[first, first - 1] = 0
                break
            first -= 1
        if first == last:
            last, iterations = last - 1, 0
            continue
        iterations += 1
        if iterations > MOST_ITERATIONS:
            return False
        _shifted_step(factors, first, last, iterations % 10 == 0)
    return True


def _pair_conjugates(log_moduli: FloatArray, angles: FloatArray) -> None:
    """Make eigenvalues of a real matrix, computed in complex numbers, real or conjugate to the last bit, in place."""
    largest = float(np.max(log_moduli))
    if math.isinf(largest):
        # All of them zero.
        angles[:] = 0.0
        return
    values: ComplexArray = np.exp(log_moduli - largest) * np.exp(1j * angles)
    left = np.ones(len(values), dtype=np.bool_)
    while np.any(left):
        i = int(np.argmax(np.where(left, np.abs(values.imag), -1.0)))
        left[i] = False
        apart = np.where(left, np.abs(values[i] - values.conj()), np.inf)
        partner = int(np.argmin(apart))
        # Its own mirror image is as near as the real axis is.
        if not apart[partner] < 2 * abs(values[i].imag):
            angles[i] = 0.0 if values[i].real >= 0 else np.pi
            continue
        left[partner] = False
        angle = (abs(angles[i]) + abs(angles[partner])) / 2
        angles[i], angles[partner] = angle, -angle
        log_moduli[i] = log_moduli[partner] = (log_moduli[i] + log_moduli[partner]) / 2


def _of_block(triangles: FloatArray, coupling: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return logarithms and angles of the eigenvalues of coupling @ R_{N-1} @ ... @ R_0, and convergence."""
    factors = triangles.astype(np.complex128)
    factors[-1] = coupling @ triangles[-1]
    converged = _triangularize(factors)
    entries = np.diagonal(factors, axis1=1, axis2=2)
    sizes = np.abs(entries)
    with np.errstate(divide="ignore"):
        log_moduli = np.log(sizes).sum(axis=0)
    angles: FloatArray = np.angle(np.prod(np.where(sizes > 0, entries / np.where(sizes > 0, sizes, 1), 1), axis=0))
    _pair_conjugates(log_moduli, angles)
    return log_moduli, angles, converged


def _suspicious(triangles: FloatArray) -> BoolArray:
    """Return which R_k have a diagonal entry that may be rounding: small against its column, or against its row."""
    diagonals = np.abs(np.diagonal(triangles, axis1=1, axis2=2))
    sizes = np.maximum(np.sqrt((triangles**2).sum(axis=1)), np.sqrt((triangles**2).sum(axis=2)))
    return (diagonals <= SUSPICIOUS * triangles.shape[1] * EPS * sizes).any(axis=1)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class LogEigenvalues(Value):
    """Eigenvalues of a product of factors, in the order of its periodic Schur form."""

    log_moduli: FloatArray
    """-inf for zero, (n,)."""
    angles: FloatArray
    """(n,)"""
    growth: FloatArray
    """What each factor adds to each logarithm, (N, n)."""
    suspicious: BoolArray
    """Which factors may be singular, (N,)."""
    has_converged: bool


def log_eigenvalues(factors: FloatArray, row_logs: FloatArray) -> LogEigenvalues:
    """Return logarithms and angles of the eigenvalues of F_{N-1} ... F_0.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
    row_logs : ndarray, shape (N, n)
        F_k = diag(exp(row_logs[k])) factors[k], so that no size is too large or too small.
    """
    triangles, logs, coupling, cuts = _orthogonal_iteration(np.array(factors, order="C"), np.array(row_logs, order="C"))
    entries, converged = np.diagonal(triangles, axis1=1, axis2=2), True
    # Of blocks of one, which are the rule, the product of the diagonals.
    with np.errstate(divide="ignore"):
        growth = np.log(np.abs(entries)) + logs
    log_moduli = growth.sum(axis=0)
    negative = (entries < 0).sum(axis=0) + (np.diagonal(coupling) < 0)
    angles = np.where(negative % 2 == 1, np.pi, 0.0)
    starts = np.flatnonzero(cuts)
    for start, stop in pairwise(starts):
        if stop - start > 1:
            block = slice(start, stop)
            common = np.max(logs[:, block], axis=1)
            evened, taken_out = _evened(triangles[:, block, block], logs[:, block] - common[:, None])
            found = _of_block(evened, coupling[block, block])
            log_moduli[block], angles[block] = found[0] + np.sum(common) + taken_out, found[1]
            converged = converged and found[2]
            growth[:, block] = np.mean(growth[:, block], axis=1)[:, None]
    return LogEigenvalues(
        log_moduli=log_moduli,
        angles=angles,
        growth=growth,
        suspicious=_suspicious(triangles),
        has_converged=converged,
    )


def _evened(triangles: FloatArray, logs: FloatArray) -> tuple[FloatArray, float]:
    """Return moderate triangles and a logarithm for diag(exp(logs)) triangles, the logs at most zero.

    The eigenvalues of the one product are those of the other times the exponential of that logarithm.

    Where a row is smaller than double precision holds, the states between factors change their scales.

    Raises
    ------
    StepOverflowError
        Rows so coupled that no scales make all entries moderate.
    """
    if np.min(logs) > -LARGEST_RANGE:
        return triangles * np.exp(logs)[:, :, None], 0.0
    sizes = np.abs(np.diagonal(triangles, axis1=1, axis2=2))
    growth = np.log(np.where(sizes > 0, sizes, 1.0)) + logs
    mean = np.mean(growth, axis=1)
    scales = np.concatenate([np.zeros((1, logs.shape[1])), np.cumsum(growth - mean[:, None], axis=0)])
    # Back to the first scales after the last factor, whatever is left of them by then.
    scales[-1] = 0.0
    exponents = (logs - mean[:, None])[:, :, None] + scales[:-1, None, :] - scales[1:, :, None]
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.where(triangles != 0, triangles * np.exp(exponents), 0.0)
    if not np.isfinite(found).all():
        raise StepOverflowError(
            "multipliers of close moduli belong to states that grow and decay further, within the period, than double "
            "precision holds, and back. Are A and the durations in the same units of time?"
        )
    return found, float(np.sum(mean))
