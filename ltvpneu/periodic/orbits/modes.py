"""Right and left vectors of a Floquet mode along the period, from the maps of a disturbance.

A mode of exponent mu is z(t) = p(t) e^{mu t} with p periodic. From map to map z solves the cyclic system
z_{k+1} = F_k z_k with z_N = lambda z_0. Every map is divided by what the mode grows there, which the periodic Schur
form knows. The system is then singular just because lambda is a multiplier, and its unknowns are of about one size: the
shape of a mode of a tiny multiplier is as accurate as that of the largest; growth that comes back does not overflow.
"""

from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray, IntArray
from ltvpneu._values import Value
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.algebra.cyclic import Reduced, reduced, reduced_pairs
from ltvpneu.periodic.algebra.product import exp_of

LEAST_SHARE, TINY = -27.0, float(np.finfo(float).tiny)
"""Logarithm of a modulus, over the largest or one, below which the whole map has lost it to rounding [-]."""
LARGEST_RATIO = 300.0
"""Logarithm of sizes beyond which a state is all or nothing beside another [-]."""
MODERATE_SIZE = 5.0
"""Logarithm of sizes up to which they are multiplied as they are [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Maps(Value):
    """Maps of a disturbance whose product, the first one first, is the map over the period, in scaled states."""

    factors: FloatArray
    """(n_maps, n, n); a map is diag(exp(row_logs)) times its factor."""
    durations: FloatArray
    """[s]; zero for what happens at once, as at a stop; (n_maps,)."""
    starts: IntArray
    """Number of the map that each step begins with, (n_steps,)."""
    scales: FloatArray
    """Sizes of the states, (n,)."""
    row_logs: FloatArray | None = None
    """Logarithms of the sizes of the factors' rows, (n_maps, n); zero by default."""
    growth: FloatArray | None = None
    """What each map adds to the logarithm of each multiplier, in their order, where known; (n_maps, n)."""

    @property
    def product(self) -> FloatArray:
        """The map over the period, scaled, (n, n)."""
        whole = np.eye(self.scales.size)
        for k, factor in enumerate(self.factors):
            whole = factor @ whole
            if self.row_logs is not None:
                whole *= exp_of(self.row_logs[k])[:, None]
        return whole


class ModeVectors(NamedTuple):
    """Right and left vectors of a mode at the start of every map, and the logarithms that the right ones lack."""

    shapes: ComplexArray
    """p, but for exp(logs), (n_maps, n)."""
    adjoints: ComplexArray
    """q, but for exp(-logs), (n_maps, n)."""
    logs: FloatArray
    """(n_maps,)"""

    def conjugate(self) -> "ModeVectors":
        """Return those of the conjugate multiplier."""
        return ModeVectors(np.conj(self.shapes), np.conj(self.adjoints), self.logs)

    @property
    def condition(self) -> float:
        """Largest |q| |p| / |q^T p| along the period: how far rounding moves the multiplier [-]."""
        p, q = self.shapes, self.adjoints
        sizes = np.linalg.norm(q, axis=1) * np.linalg.norm(p, axis=1)
        overlap = np.abs(np.sum(q * p, axis=1))
        return float(np.max(np.divide(sizes, overlap, out=np.full(len(p), np.inf), where=overlap > 0)))


def cyclic_vectors(maps: Maps, mode: int, log_modulus: float, angle: float, member: int) -> ModeVectors:
    """Return p and q of a mode whose growth over the maps is known.

    `member` is the number of the mode among those of one multiple multiplier.

    Raises
    ------
    StepOverflowError
        The mode cannot be told from others in double precision.
    """
    period = float(np.sum(maps.durations))
    assert maps.growth is not None
    assert maps.row_logs is not None
    shrink = _evenly(maps.growth[:, mode], maps)
    shrink += (log_modulus - np.sum(shrink)) * maps.durations / period
    sizes = maps.row_logs - shrink[:, None]
    # e^{-i angle} once a period, spread evenly in time.
    phases: ComplexArray = np.exp(-1j * angle * maps.durations / period)
    try:
        shapes, adjoints = _null_trajectories(maps.factors * phases[:, None, None], sizes, member)
    except np.linalg.LinAlgError:
        raise StepOverflowError(
            f"mode {mode + 1} of log modulus {log_modulus:.6g} cannot be told from others that grow and decay too far "
            "within the period for double precision; the multipliers themselves are right"
        ) from None
    elapsed = np.cumsum(maps.durations) - maps.durations
    logs = np.cumsum(shrink) - shrink - log_modulus * elapsed / period
    return ModeVectors(shapes, adjoints, logs)


def _evenly(growth: FloatArray, maps: Maps) -> FloatArray:
    """Return the growth over each step spread evenly over those of its maps that take time."""
    counts = np.diff(np.append(maps.starts, len(growth)))
    takes_time = np.where(np.repeat(counts == 1, counts), 1.0, maps.durations > 0)
    # A step of no duration may have several maps none of which takes time.
    shared = np.repeat(np.add.reduceat(takes_time, maps.starts), counts)
    takes_time = np.where(shared > 0, takes_time, 1.0)
    shared = np.where(shared > 0, shared, np.repeat(counts, counts))
    return np.repeat(np.add.reduceat(growth, maps.starts), counts) * takes_time / shared


def _null_trajectories(factors: ComplexArray, sizes: FloatArray, member: int) -> tuple[ComplexArray, ComplexArray]:
    """Return p and q of p_{k+1} = diag(exp(sizes)) F_k p_k, a singular cyclic system, each (n_maps, n).

    Rows far from one in size are divided on both sides.
    """
    nothing = np.zeros((*factors.shape[:2], 1))
    if np.abs(sizes).max(initial=0.0) <= MODERATE_SIZE:
        whole = np.exp(sizes)[:, :, None] * factors
        backward = _null_trajectory(reduced(np.swapaxes(whole[::-1], 1, 2), nothing), member)
        return _null_trajectory(reduced(whole, nothing), member), np.roll(backward[::-1], 1, axis=0)
    # Cut off, and sooner where rows grow: what decays in one step by more than it grows in another stays at zero.
    left = -np.exp(np.clip(sizes, -2 * LARGEST_RATIO, 0.0))[:, :, None] * factors
    right = np.zeros_like(left)
    np.einsum("kii->ki", right)[:] = np.exp(np.clip(-sizes, -LARGEST_RATIO, 0.0))
    shapes = _null_trajectory(reduced_pairs(left, right, nothing), member)
    # The adjoint equations are the transposed ones, from the end to the start.
    transposed = np.swapaxes(left, 1, 2)
    found = _null_trajectory(reduced_pairs(transposed[::-1], np.roll(right[::-1], -1, axis=0), nothing), member)[::-1]
    return shapes, -(transposed @ found[:, :, None])[:, :, 0]


def _null_trajectory(one: Reduced, member: int) -> ComplexArray:
    """Return the solution of the singular cyclic system along its smallest singular value but `member`, (N, n)."""
    right = np.linalg.svd(one.first + one.last)[2]
    start = np.conj(right[len(right) - 1 - member])[:, None]
    return one.all_from(start, start)[:-1, :, 0]


def product_vectors(maps: Maps, multipliers: ComplexArray, log_moduli: FloatArray, mode: int) -> ModeVectors:
    """Return p and q by the eigenvectors of the whole map, whose factors may be singular, as where a piston stops.

    A multiplier below the rounding of one, or of the largest, is as good as zero: what it belongs to is gone after
    the period.
    """
    least = max(float(log_moduli[0]), 0.0) + LEAST_SHARE
    if log_moduli[mode] > least:
        exponent = complex(log_moduli[mode], np.angle(multipliers[mode])) / float(np.sum(maps.durations))
        p, q = (_eigenvector(matrix, multipliers[mode]) for matrix in (maps.product, maps.product.T))
    else:
        exponent = 0j
        left, values, right = np.linalg.svd(maps.product)
        gone = np.flatnonzero(log_moduli <= least)
        # A chain of them has one direction that is gone after one period.
        n_null = max(int(np.count_nonzero(values <= 1e-12 * max(values[0], TINY))), 1)
        member = min(int(np.count_nonzero(gone > mode)), n_null - 1)
        p, q = right[-1 - member].astype(np.complex128), left[:, -1 - member].astype(np.complex128)
    shrink = np.exp(-exponent * maps.durations)
    forward, backward = [p], [q]
    for factor, share in zip(maps.factors[:-1], shrink[:-1], strict=True):
        forward.append(share * (factor @ forward[-1]))
    for factor, share in zip(maps.factors[:0:-1], shrink[:0:-1], strict=True):
        backward.append(share * (factor.T @ backward[-1]))
    return ModeVectors(np.array(forward), np.roll(np.array(backward[::-1]), 1, axis=0), np.zeros(len(forward)))


def _eigenvector(matrix: FloatArray, eigenvalue: complex) -> ComplexArray:
    """Return the eigenvector of a matrix whose eigenvalue is nearest to the one given."""
    values, vectors = np.linalg.eig(matrix)
    return vectors[:, int(np.argmin(np.abs(values - eigenvalue)))].astype(np.complex128)
