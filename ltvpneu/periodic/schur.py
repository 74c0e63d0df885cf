r"""Eigenvalues of a product of matrices from its periodic Schur form, without forming the product.

Orthogonal Q_k with Q_N = Q_0 turn each factor F_k into the upper triangular :math:`Q_{k+1}^H F_k Q_k`, and an
eigenvalue of F_{N-1} ... F_0 is a product of diagonal entries, whose logarithms are summed. Two stages:

1. *orthogonal iteration*: F_k Q_k = Q_{k+1} R_k, round and round. Eigenvalues of well separated moduli, which are the
   rule in long products, separate at once, the largest first, and the grading keeps the small ones accurate;
2. *shifted periodic QR* [Bojanczyk1992]_ on each diagonal block that does not separate (pairs, close moduli), in
   complex arithmetic with one implicit shift.

.. [Bojanczyk1992] A. Bojanczyk, G. Golub, P. Van Dooren, "The periodic Schur decomposition. Algorithms and
   applications", Proc. SPIE 1770, 1992.
"""

import math
from itertools import pairwise

import numpy as np

from ltvpneu._arrays import BoolArray, ComplexArray, FloatArray
from ltvpneu._compiled import compiled

EPS = float(np.finfo(float).eps)
MOST_SWEEPS = 12
MOST_ITERATIONS = 60
"""Shifted steps for one eigenvalue before giving up; three are usual."""


@compiled
def _orthogonal_sweep(factors: FloatArray, basis: FloatArray, triangles: FloatArray) -> FloatArray:
    """Write R_k of F_k Q_k = Q_{k+1} R_k into `triangles` and return Q_N; shapes (N, n, n), (n, n)."""
    for k in range(factors.shape[0]):
        orthogonal, triangles[k] = np.linalg.qr(np.dot(factors[k], basis))
        basis = np.ascontiguousarray(orthogonal)
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
def _orthogonal_iteration(factors: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return R_k (N, n, n), the coupling Q_0' Q_N (n, n), and where the blocks that have separated start."""
    n = factors.shape[1]
    basis, triangles = np.eye(n), np.empty_like(factors)
    coupling, cuts, unchanged = np.eye(n), np.zeros(n + 1, dtype=np.bool_), 0
    for _ in range(MOST_SWEEPS):
        following = _orthogonal_sweep(factors, basis, triangles)
        coupling = np.dot(np.ascontiguousarray(basis.T), following)
        found = _splits(coupling)
        unchanged = unchanged + 1 if np.all(found == cuts) else 0
        cuts = found
        if np.all(cuts) or unchanged == 2:
            break
        basis = following
    return triangles, coupling, cuts


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
    values: ComplexArray = np.exp(log_moduli - np.max(log_moduli) + 1j * angles)
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
    """Return which R_k have a diagonal entry that may be rounding: small against its column."""
    diagonals = np.abs(np.diagonal(triangles, axis1=1, axis2=2))
    return (diagonals <= triangles.shape[1] * EPS * np.sqrt((triangles**2).sum(axis=1))).any(axis=1)


def log_eigenvalues(factors: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray, bool]:
    """Return logarithms and angles of the eigenvalues of F_{N-1} ... F_0, maybe singular factors, and convergence.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
        Contiguous, entries about one in size.
    """
    triangles, coupling, cuts = _orthogonal_iteration(np.array(factors, order="C"))
    entries, converged = np.diagonal(triangles, axis1=1, axis2=2), True
    # Of blocks of one, which are the rule, the product of the diagonals.
    with np.errstate(divide="ignore"):
        log_moduli = np.log(np.abs(entries)).sum(axis=0)
    negative = (entries < 0).sum(axis=0) + (np.diagonal(coupling) < 0)
    angles = np.where(negative % 2 == 1, np.pi, 0.0)
    starts = np.flatnonzero(cuts)
    for start, stop in pairwise(starts):
        if stop - start > 1:
            block = slice(start, stop)
            found = _of_block(triangles[:, block, block], coupling[block, block])
            log_moduli[block], angles[block], converged = found[0], found[1], converged and found[2]
    return log_moduli, angles, _suspicious(triangles), converged
