r"""Eigenvalues of a long product of matrices, with their logarithms, where the product itself is lost to rounding.

An eigenvalue of F_{N-1} ... F_0 may lie beyond double precision's range and, long before that, below the rounding
error of the product: forming it leaves only the largest. The periodic Schur form (`schur`) reads each off its own
diagonal.

A singular factor makes some eigenvalues zero. Such a factor U V', of lower rank, is taken out first: the eigenvalues
other than zero are those of the smaller product V' ... U.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import BoolArray, ComplexArray, FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.periodic.schur import EPS, log_eigenvalues


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ProductMultipliers(Value):
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
    """Return multipliers from logarithms and angles, put in order; pairs have equal logarithms and opposite angles."""
    order = np.lexsort((-np.sin(angles), -log_moduli))
    log_moduli, angles = log_moduli[order], angles[order]
    moduli, sines = _exp(log_moduli), np.sin(angles)
    # A real one exactly so; and part by part, since an infinite modulus times zero is no number.
    sines[angles == np.pi] = 0.0
    multipliers = np.zeros(len(order), dtype=np.complex128)
    np.multiply(moduli, np.cos(angles), out=multipliers.real)
    np.multiply(moduli, sines, out=multipliers.imag, where=sines != 0)
    return ProductMultipliers(
        multipliers=read_only(multipliers), log_moduli=read_only(log_moduli), angles=read_only(angles)
    )


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
    log_moduli, angles, suspicious, converged = log_eigenvalues(scaled)
    deficient = _first_deficient(scaled, suspicious) if suspicious.any() else None
    if deficient is not None:
        smaller = _without_null_space(np.roll(scaled, -deficient, axis=0))
        log_moduli, angles = log_multipliers(smaller)
        zeros = n - smaller.shape[1]
        return np.append(log_moduli + log_scale, np.full(zeros, -np.inf)), np.append(angles, np.zeros(zeros))
    if not converged:
        raise np.linalg.LinAlgError(f"the periodic QR iteration did not converge on {len(factors)} factors of size {n}")
    return log_moduli + log_scale, angles


def _first_deficient(factors: FloatArray, suspicious: BoolArray) -> int | None:
    """Return the first factor that is singular to rounding however its rows and columns are scaled, or None."""
    for k in np.flatnonzero(suspicious):
        if _rank(factors[k])[0] < factors.shape[1]:
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
