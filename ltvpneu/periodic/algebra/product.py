r"""Eigenvalues of a long product of matrices, with their logarithms, where the product itself is lost to rounding.

An eigenvalue of F_{N-1} ... F_0 may lie beyond double precision's range and, long before that, below the rounding
error of the product: forming it leaves only the largest. The periodic Schur form (`schur`) reads each off its own
diagonal.

A singular factor makes some eigenvalues zero. Such a factor U V', of lower rank, is taken out first: the eigenvalues
other than zero are those of the smaller product V' ... U. Rounding hides zeros there, and in factors that are singular
in exact arithmetic only, so they are counted in exact arithmetic, modulo a prime.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import BoolArray, ComplexArray, FloatArray, IntArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.errors import NotConvergedError
from ltvpneu.periodic.algebra.schur import EPS, MOST_ITERATIONS, LogEigenvalues, log_eigenvalues

EVEN = 20
"""Powers of two by which rows or columns of a factor may differ without being scaled."""
PRIMES = 2147483647, 2147483629


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
        return float(exp_of(self.log_moduli[:1])[0])


def product_multipliers(factors: Sequence[ArrayLike] | FloatArray) -> ProductMultipliers:
    """Return the eigenvalues of F[-1] @ ... @ F[0], which is not formed.

    Of a discrete-time periodic system z_{k+1} = F_k z_k these are the characteristic multipliers.

    Parameters
    ----------
    factors : sequence of array_like, shape (n_{k+1}, n_k)
        Square, or such that each takes what the one before gives and the first what the last gives.

    Returns
    -------
    ProductMultipliers
        As many as the first factor has columns.

    Raises
    ------
    ValueError
        No factor, an entry that is not finite, or shapes that do not follow each other.
    NotConvergedError
        The iteration for eigenvalues of close moduli gave up.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.product_multipliers([[[2.0, 1.0], [0.0, 1e-9]]] * 100)
    >>> found.log_moduli.round(3)
    array([   69.315, -2072.327])

    A state that is dropped and a new one that is taken in:

    >>> lp.product_multipliers([[[1.0, 2.0]], [[3.0], [0.5]]]).multipliers.real
    array([4., 0.])
    """
    arrays = _chained(factors)
    sizes = [array.shape[1] for array in arrays]
    n, least = sizes[0], int(np.argmin(sizes))
    # The eigenvalues other than zero do not depend on where the period starts: at the fewest states.
    turned, n_lost = arrays[least:] + arrays[:least], n - sizes[least]
    is_square = max(sizes) == min(sizes)
    log_moduli, angles, is_suspicious = _logs(np.array(turned) if is_square else _of_fewest_states(turned))
    n_zero = _n_exact_zeros(turned) if is_suspicious or not is_square else 0
    return from_logs(*_with_zeros(log_moduli, angles, n_zero, n_lost))


def _chained(factors: Sequence[ArrayLike] | FloatArray) -> list[FloatArray]:
    """Return the factors as matrices, after checking that they can be multiplied round the period."""
    given = cast(Sequence[Any], factors)
    shapes = {np.shape(factor) for factor in given}
    if len(shapes) != 1:
        arrays = [finite_array(f"factors[{k}]", factor, (None, None)) for k, factor in enumerate(factors)]
    else:
        arrays = list(finite_array("factors", factors, (None, None, None)))
    if not arrays or (len(shapes) == 1 and arrays[0].shape[0] != arrays[0].shape[1]):
        raise ValueError(
            f"factors: found shape {np.shape(cast(Any, factors))}, expected one or more square matrices, (N, n, n)"
        )
    for k, array in enumerate(arrays):
        after = arrays[(k + 1) % len(arrays)]
        if after.shape[1] != array.shape[0]:
            following = "the first one" if k + 1 == len(arrays) else f"factors[{k + 1}]"
            raise ValueError(
                f"factors: found shape {array.shape} of factors[{k}] and {after.shape} of {following}, which takes what"
                f" it gives; expected {array.shape[0]} columns there"
            )
    return arrays


def _of_fewest_states(factors: list[FloatArray]) -> FloatArray:
    """Return square factors with the product of rectangular ones, of which the first has the fewest columns."""
    n = factors[0].shape[1]
    basis, found = np.eye(n), np.empty((len(factors), n, n))
    for k, factor in enumerate(factors[:-1]):
        basis, found[k] = np.linalg.qr(factor @ basis)
    found[-1] = factors[-1] @ basis
    return found


def _with_zeros(log_moduli: FloatArray, angles: FloatArray, n_zero: int, n_lost: int) -> tuple[FloatArray, FloatArray]:
    """Return the same with the smallest `n_zero` set to zero, and `n_lost` more of zero."""
    smallest = np.argsort(log_moduli)[:n_zero]
    log_moduli[smallest], angles[smallest] = -np.inf, 0.0
    return np.append(log_moduli, np.full(n_lost, -np.inf)), np.append(angles, np.zeros(n_lost))


def from_logs(log_moduli: FloatArray, angles: FloatArray) -> ProductMultipliers:
    """Return multipliers from logarithms and angles, put in order; pairs have equal logarithms and opposite angles."""
    order = falling(log_moduli, angles)
    log_moduli, angles = log_moduli[order], angles[order]
    moduli, sines = exp_of(log_moduli), np.sin(angles)
    # A real one exactly so; and part by part, since an infinite modulus times zero is no number.
    sines[angles == np.pi] = 0.0
    multipliers = np.zeros(len(order), dtype=np.complex128)
    np.multiply(moduli, np.cos(angles), out=multipliers.real)
    np.multiply(moduli, sines, out=multipliers.imag, where=sines != 0)
    return ProductMultipliers(
        multipliers=read_only(multipliers), log_moduli=read_only(log_moduli), angles=read_only(angles)
    )


def falling(log_moduli: FloatArray, angles: FloatArray) -> IntArray:
    """Return the order of multipliers: by falling modulus, then falling imaginary part."""
    return np.lexsort((-np.sin(angles), -log_moduli))


def exp_of(logs: FloatArray) -> FloatArray:
    """Exponentials, which may be zero or infinite."""
    with np.errstate(over="ignore", under="ignore"):
        return np.exp(logs)


def log_multipliers(factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the logarithms of the moduli and the angles of the eigenvalues of a product, in no order.

    Parameters
    ----------
    factors : ndarray, shape (N, n, n)
    """
    log_moduli, angles, _ = _logs(factors)
    return log_moduli, angles


def _logs(factors: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return the same, and whether a factor is singular or so close to it that only exact arithmetic can tell."""
    n = factors.shape[1]
    if n == 0 or not np.abs(factors).max(axis=(1, 2), initial=0.0).all():
        return np.full(n, -np.inf), np.zeros(n), False
    scaled, row_logs = _equilibrated(factors)
    found = log_eigenvalues(scaled, row_logs)
    deficient = _first_deficient(scaled, found.suspicious) if found.suspicious.any() else None
    if deficient is not None:
        turned, logs = np.roll(scaled, -deficient, axis=0), np.roll(row_logs, -deficient, axis=0)
        common = np.max(logs, axis=1)
        smaller = _without_null_space(turned * np.exp(logs - common[:, None])[:, :, None])
        log_moduli, angles, _ = _logs(smaller)
        zeros = n - smaller.shape[1]
        log_moduli = log_moduli + float(np.sum(common))
        return np.append(log_moduli, np.full(zeros, -np.inf)), np.append(angles, np.zeros(zeros)), True
    expect_converged(found, len(factors), n)
    return found.log_moduli, found.angles, bool(found.suspicious.any())


def expect_converged(found: LogEigenvalues, n_factors: int, n: int) -> None:
    """Raise `NotConvergedError` if the iteration gave up."""
    if not found.has_converged:
        raise NotConvergedError(
            f"the periodic QR iteration for the multipliers did not converge on {n_factors} factors of size {n} x {n}: "
            f"{MOST_ITERATIONS} steps for one of them were not enough",
            residual=np.inf,
            iterations=MOST_ITERATIONS,
        )


def _equilibrated(factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return factors with entries of about one, and the logarithms of their rows' sizes.

    The sizes of its columns become sizes of the rows of the factor before. By powers of two, which round nothing.
    """
    N, n, _ = factors.shape
    mantissas, powers = np.frexp(factors)
    # Of a zero there is no size.
    sizes = np.where(mantissas != 0, powers, -(1 << 20))
    rows, columns = np.zeros((N, n), dtype=np.int64), np.zeros((N, n), dtype=np.int64)
    largest = sizes.max(axis=(1, 2))
    if (sizes.max(axis=2).min(axis=1) < largest - EVEN).any() or (sizes.max(axis=1).min(axis=1) < largest - EVEN).any():
        for _ in range(5):
            rest = sizes - rows[:, :, None] - columns[:, None, :]
            rows += np.where(sizes.max(axis=2) > -(1 << 20), rest.max(axis=2) // 2, 0)
            rest = sizes - rows[:, :, None] - columns[:, None, :]
            columns += np.where(sizes.max(axis=1) > -(1 << 20), rest.max(axis=1) // 2, 0)
    rest = np.where(mantissas != 0, sizes - rows[:, :, None] - columns[:, None, :], -(1 << 20))
    rows += rest.max(axis=(1, 2))[:, None]
    scaled = np.ldexp(mantissas, powers - rows[:, :, None] - columns[:, None, :])
    return np.ascontiguousarray(scaled), (rows + np.roll(columns, -1, axis=0)) * np.log(2)


def _first_deficient(factors: FloatArray, suspicious: BoolArray) -> int | None:
    """Return the first factor that is singular to rounding however its rows and columns are scaled, or None."""
    for k in np.flatnonzero(suspicious):
        if rank_of(factors[k]) < factors.shape[1]:
            return int(k)
    return None


def _n_exact_zeros(factors: Sequence[FloatArray]) -> int:
    """Return how many eigenvalues of the product are zero in exact arithmetic.

    Doubles are whole numbers but for a power of two, so the product can be formed modulo a prime, in which its n-th
    power has the rank that it has, unless the prime divides what is not zero: two primes are asked.
    """
    return min(_n_zeros_modulo(factors, prime) for prime in PRIMES)


def _n_zeros_modulo(factors: Sequence[FloatArray], prime: int) -> int:
    n = factors[0].shape[1]
    product = np.eye(n, dtype=np.int64)
    for factor in factors:
        mantissas, powers = np.frexp(factor)
        least = int(powers.min())
        whole = [
            [int(m * (1 << 53)) * pow(2, int(p) - least, prime) % prime for m, p in zip(*row, strict=True)]
            for row in zip(mantissas.tolist(), powers.tolist(), strict=True)
        ]
        product = _multiplied(np.array(whole, dtype=np.int64), product, prime)
    power = product
    for _ in range(max(n - 1, 1).bit_length()):
        power = _multiplied(power, power, prime)
    return n - _rank_modulo(power, prime)


def _multiplied(a: IntArray, b: IntArray, prime: int) -> IntArray:
    # Products stay below 2^62, their sums would not.
    return (a[:, :, None] * b[None] % prime).sum(axis=1) % prime


def _rank_modulo(matrix: IntArray, prime: int) -> int:
    left, rank = matrix.copy(), 0
    for column in range(left.shape[1]):
        pivots = np.flatnonzero(left[rank:, column])
        if not pivots.size:
            continue
        left[[rank, rank + pivots[0]]] = left[[rank + pivots[0], rank]]
        left[rank] = left[rank] * pow(int(left[rank, column]), -1, prime) % prime
        below = left[rank + 1 :, column].copy()
        left[rank + 1 :] = (left[rank + 1 :] - below[:, None] * left[rank] % prime) % prime
        rank += 1
    return rank


def rank_of(matrix: FloatArray) -> int:
    """Return the rank, to rounding, however rows and columns are scaled."""
    return _rank(matrix)[0]


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
