r"""Eigenvalues of a long product of matrices, with their logarithms, where the product itself is lost to rounding.

An eigenvalue of F_{N-1} ... F_0 may lie beyond double precision's range and, long before that, below the rounding
error of the product: forming it leaves only the largest. The periodic Schur form (`schur`) reads each off its own
diagonal.

A singular factor makes some eigenvalues zero. Such a factor U V', of lower rank, is taken out first: the eigenvalues
other than zero are those of the smaller product V' ... U.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array, read_only
from ltvpneu.periodic.schur import EPS, orthogonal_iteration, triangularize


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ProductMultipliers:
    """Eigenvalues of a product of matrices, largest first."""

    multipliers: ComplexArray
    """By falling modulus, then falling imaginary part; 0 or inf where beyond double precision; shape (n,)."""
    log_moduli: FloatArray
    """Natural logarithms of their moduli, -inf for zero, shape (n,)."""
    angles: FloatArray
    """Their angles in (-pi, pi], which outlast a modulus beyond double precision, shape (n,)."""

    @property
    def spectral_radius(self) -> float:
        """Largest modulus; inf where it is beyond double precision."""
        return float(_exp(self.log_moduli[:1])[0])


def product_multipliers(factors: Sequence[ArrayLike] | FloatArray) -> ProductMultipliers:
    """Return the eigenvalues of F[-1] @ ... @ F[0], which is not formed.

    Of a discrete-time periodic system z_{k+1} = F_k z_k these are the characteristic multipliers.

    Parameters
    ----------
    factors : sequence of array_like, shape (n, n)

    Returns
    -------
    ProductMultipliers

    Raises
    ------
    ValueError
        No factor, ragged, not square, or with an entry that is not finite.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.product_multipliers([[[2.0, 1.0], [0.0, 1e-9]]] * 100)
    >>> found.log_moduli.round(3)
    array([   69.315, -2072.327])
    """
    stack = finite_array("factors", factors, (None, None, None))
    if stack.shape[0] == 0 or stack.shape[1] != stack.shape[2] or stack.shape[1] == 0:
        raise ValueError(f"factors: found shape {stack.shape}, expected one or more square matrices, (N, n, n)")
    return from_logs(*log_multipliers(stack))


def from_logs(log_moduli: FloatArray, angles: FloatArray) -> ProductMultipliers:
    """Return multipliers from logarithms and angles, put in order."""
    # Moduli equal to rounding count as equal, so that a conjugate pair stands together, upper half first.
    order = np.argsort(-log_moduli, kind="stable")
    log_moduli, angles = log_moduli[order], angles[order]
    for i in range(len(order) - 1):
        if log_moduli[i] == log_moduli[i + 1] and angles[i] == -angles[i + 1] < 0:
            angles[i], angles[i + 1] = angles[i + 1], angles[i]
    moduli = _exp(log_moduli)
    # Part by part: an infinite modulus times a sine of zero is no number.
    with np.errstate(invalid="ignore", under="ignore"):
        real = np.where(np.cos(angles) == 0, 0.0, moduli * np.cos(angles))
        imag = np.where((angles == 0) | (angles == np.pi), 0.0, moduli * np.sin(angles))
    return ProductMultipliers(multipliers=real + 1j * imag, log_moduli=read_only(log_moduli), angles=read_only(angles))


def _exp(logs: FloatArray) -> FloatArray:
    with np.errstate(over="ignore", under="ignore"):
        return np.exp(logs)


def log_multipliers(factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms of the moduli and the angles of the eigenvalues of a product, in no order.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
    """
    n = factors.shape[1]
    sizes = np.max(np.abs(factors), axis=(1, 2), initial=0.0)
    if n == 0 or not sizes.all():
        return np.full(n, -np.inf), np.zeros(n)
    # By powers of two, which round nothing.
    exponents = np.frexp(sizes)[1]
    scaled = np.ascontiguousarray(np.ldexp(factors, -exponents[:, None, None]))
    log_scale = float(np.sum(exponents)) * np.log(2)
    triangles, coupling, cuts = orthogonal_iteration(scaled)
    deficient = _first_deficient(scaled, triangles)
    if deficient is not None:
        smaller = _without_null_space(np.roll(scaled, -deficient, axis=0))
        log_moduli, angles = log_multipliers(smaller)
        zeros = n - smaller.shape[1]
        return np.append(log_moduli + log_scale, np.full(zeros, -np.inf)), np.append(angles, np.zeros(zeros))
    log_moduli, angles = np.empty(n), np.empty(n)
    for start, stop in pairwise(cuts):
        block = slice(start, stop)
        log_moduli[block], angles[block] = _of_block(triangles[:, block, block], coupling[block, block])
    return log_moduli + log_scale, angles


def _of_block(triangles: FloatArray, coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return logarithms and angles of the eigenvalues of coupling @ R_{N-1} @ ... @ R_0."""
    if len(coupling) == 1:
        entries = triangles[:, 0, 0]
        negative = np.count_nonzero(entries < 0) + (coupling[0, 0] < 0)
        return np.sum(np.log(np.abs(entries)), keepdims=True), np.array([np.pi if negative % 2 else 0.0])
    factors = triangles.astype(np.complex128)
    factors[-1] = coupling @ triangles[-1]
    if not triangularize(factors):
        raise np.linalg.LinAlgError(f"the periodic QR iteration did not converge on a block of size {len(coupling)}")
    diagonals = np.diagonal(factors, axis1=1, axis2=2)
    with np.errstate(divide="ignore"):
        log_moduli = np.sum(np.log(np.abs(diagonals)), axis=0)
    directions = np.prod(diagonals / np.where(diagonals == 0, 1.0, np.abs(diagonals)), axis=0)
    return _conjugate_pairs(log_moduli, np.angle(directions))


def _conjugate_pairs(log_moduli: FloatArray, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Make eigenvalues of a real matrix, computed in complex numbers, real or conjugate to the last bit."""
    log_moduli, angles = log_moduli.copy(), angles.copy()
    values = np.exp(log_moduli - np.max(log_moduli, initial=-np.inf, where=np.isfinite(log_moduli)) + 1j * angles)
    left = sorted(range(len(values)), key=lambda i: abs(values[i].imag))
    while left:
        i = left.pop()
        distances = [abs(values[i] - values[j].conjugate()) for j in left]
        if not distances or min(distances) >= 2 * abs(values[i].imag):
            angles[i] = 0.0 if values[i].real >= 0 else np.pi
            continue
        j = left.pop(int(np.argmin(distances)))
        angle = (abs(angles[i]) + abs(angles[j])) / 2
        log_moduli[i] = log_moduli[j] = (log_moduli[i] + log_moduli[j]) / 2
        angles[i], angles[j] = angle, -angle
    return log_moduli, angles


def _first_deficient(factors: FloatArray, triangles: FloatArray) -> int | None:
    """Return the first factor that is singular to rounding however its rows and columns are scaled, or None."""
    n = factors.shape[1]
    diagonals = np.abs(np.diagonal(triangles, axis1=1, axis2=2))
    suspicious = (diagonals <= n * EPS * np.linalg.norm(triangles, axis=1)).any(axis=1)
    for k in np.flatnonzero(suspicious):
        if _rank(factors[k])[0] < n:
            return int(k)
    return None


def _rank(matrix: FloatArray) -> tuple[int, FloatArray, FloatArray]:
    """Return the rank r after equilibration, and U (n, r), V' (r, n) with U V' the matrix."""
    rows, columns = np.ones(len(matrix)), np.ones(len(matrix))
    for _ in range(5):
        scaled = np.abs(rows[:, None] * matrix * columns)
        largest = np.max(scaled, axis=1)
        rows /= np.where(largest > 0, np.sqrt(largest), 1.0)
        largest = np.max(np.abs(rows[:, None] * matrix * columns), axis=0)
        columns /= np.where(largest > 0, np.sqrt(largest), 1.0)
    left, values, right = np.linalg.svd(rows[:, None] * matrix * columns)
    rank = int(np.count_nonzero(values > len(matrix) * EPS * values[0]))
    return rank, left[:, :rank] * values[:rank] / rows[:, None], right[:rank] / columns


def _without_null_space(factors: FloatArray) -> FloatArray:
    """Return factors of the size of the first one's rank, whose product has the same eigenvalues but for zeros."""
    rank, left, right = _rank(factors[0])
    smaller = np.zeros((len(factors), rank, rank))
    if rank == 0:
        return smaller
    basis, smaller[0] = np.linalg.qr(left)
    for k in range(1, len(factors)):
        basis, smaller[k] = np.linalg.qr(factors[k] @ basis)
    smaller[-1] = right @ basis @ smaller[-1]
    return smaller
