r"""Monodromy matrix, Floquet multipliers and modes, and the verdict on stability.

Only the multipliers, the eigenvalues of the map over one period, decide: stability in each step is neither needed
nor enough. They are found from the factors of that map (`product`), not from the map, each step in pieces of moderate
norm, so that single steps may under- or overflow.

A mode of exponent mu is z(t) = p(t) e^{mu t} with p periodic, and p solves the cyclic system of the steps
exp((A_k - mu I) T_k), which is singular just because mu is an exponent. So the shape of a mode of a tiny multiplier is
as accurate as that of the largest.

The margin of the verdict covers what rounding does to each factor: the multiplier lambda of right and left vectors
x_k, y_k along the period moves by [Kato1995]_ (II.2.2)

.. math:: \frac{\delta\lambda}{\lambda} = \sum_k \frac{y_{k+1}^H\,\delta F_k\,x_k}{y_{k+1}^H F_k x_k}

.. [Kato1995] T. Kato, "Perturbation theory for linear operators", Springer 1995, the first-order term of a simple
   eigenvalue.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray, IntArray, not_negative, read_only
from ltvpneu._values import Value
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.cyclic import Reduced, reduced
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.product import from_logs, log_multipliers, product_multipliers
from ltvpneu.periodic.propagate import complex_exponentials, exponentials
from ltvpneu.periodic.system import PeriodicSystem, expect_system

LEAST_SHARE, TINY = -27.0, float(np.finfo(float).tiny)
"""Logarithm of a modulus, over the largest or one, below which the whole map has lost it to rounding [-]."""


def monodromy(system: PeriodicSystem) -> FloatArray:
    """Return the monodromy matrix Phi, z(T) = Phi z(0) + g, shape (n, n).

    Raises
    ------
    StepOverflowError
        An entry is larger than double precision holds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> import math
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0], [0.0]], [0.5, 0.5])
    >>> math.isclose(lp.monodromy(system)[0, 0], math.exp(-2))
    True
    """
    expect_system(system)
    n, scales = system.n_states, system.scaled.scales
    factors = system.maps.maps[:, :n, :n] if system.is_representable else _factors(system)
    product, exponent = np.eye(n), 0
    for factor in factors:
        # By powers of two: growth within the period that comes back again shall not overflow on the way.
        product = factor @ product
        power = int(np.frexp(np.abs(product).max(initial=0.0))[1])
        product, exponent = np.ldexp(product, -power), exponent + power
    with np.errstate(over="ignore"):
        found = np.ldexp(product * (scales[:, None] / scales), min(exponent, 5000))
    if not np.isfinite(found).all():
        raise StepOverflowError(
            f"the monodromy matrix has an entry of about 10^{exponent * math.log10(2):.0f}, more than double precision "
            "holds. Its multipliers can still be had: floquet"
        )
    return read_only(found)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Maps(Value):
    """Maps of a disturbance whose product, the first one first, is the map over the period, in scaled states."""

    factors: FloatArray
    """(n_maps, n, n)"""
    durations: FloatArray
    """[s]; zero for what happens at once, as at a stop; (n_maps,)."""
    starts: IntArray
    """Number of the map that each step begins with, (n_steps,)."""
    scales: FloatArray
    """Sizes of the states, (n,)."""

    @property
    def product(self) -> FloatArray:
        """The map over the period, scaled, (n, n)."""
        whole = np.eye(self.scales.size)
        for factor in self.factors:
            whole = factor @ whole
        return whole


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Floquet(Value):
    """Multipliers of a periodic system, or of an orbit of a machine, largest first, and what follows from them."""

    period: float
    """Of the system, or of the orbit [s]."""
    multipliers: ComplexArray
    """Characteristic multipliers [-], by falling modulus, then falling imaginary part; 0 or inf where beyond double
    precision; shape (n,)."""
    log_moduli: FloatArray
    """Natural logarithms of their moduli, -inf for zero, shape (n,)."""
    angles: FloatArray
    """Their angles in (-pi, pi], shape (n,)."""
    least_margin: float
    maps: Maps
    """What the multipliers are of."""
    system: PeriodicSystem | None = None
    """The periodic system, where they are of one."""
    orbit: Orbit | None = None
    """The orbit, where they are of one: of the nonlinear machine, or of a linear model that follows its cycle."""

    def __repr__(self) -> str:
        about = f", {self.orbit.rest}" if self.orbit is not None and self.orbit.rest else ""
        return (
            f"<Floquet: {self.verdict}, spectral radius {self.spectral_radius:.6g}, multipliers {self.multipliers}"
            f"{about}>"
        )

    @property
    def exponents(self) -> ComplexArray:
        """Principal characteristic exponents log(multiplier) / period [1/s], shape (n,)."""
        found = np.empty(self.log_moduli.size, dtype=np.complex128)
        # Part by part: of a multiplier of zero the real part is minus infinity, and infinity times i is no number.
        found.real, found.imag = self.log_moduli / self.period, self.angles / self.period
        return found

    @property
    def spectral_radius(self) -> float:
        """Largest modulus [-]; infinite where it is beyond double precision."""
        return math.exp(self.log_moduli[0]) if self.log_moduli[0] < 709 else math.inf

    @cached_property
    def margin(self) -> float:
        """Distance from the unit circle within which the verdict is "marginal" [-].

        Of a system it covers the largest multipliers' own error.
        """
        return max(self.least_margin, 10 * self._relative_error())

    def _relative_error(self) -> float:
        """Bound the rounding error of the multipliers nearest to the unit circle, relative to the largest.

        A simple eigenvalue moves by its condition number times the backward error of each factor; near a defective one,
        where that number has no bound, by the n-th root of the backward error.
        """
        n_pieces, n = self.maps.factors.shape[:2]
        if self.system is None or not np.isfinite(self.log_moduli[0]):
            return 0.0
        backward = np.finfo(float).eps * n * math.sqrt(n_pieces)
        near = np.flatnonzero(self.log_moduli >= self.log_moduli[0] - math.log(2))
        conditions = [_condition(*self._vectors(int(i))) for i in near if self.angles[i] >= 0]
        return min(max(conditions) * backward, backward ** (1.0 / n))

    @property
    def is_stable(self) -> bool:
        """Whether every perturbation decays: all multipliers inside the unit circle, by the margin."""
        return bool(self.spectral_radius < 1 - self.margin)

    @property
    def is_marginal(self) -> bool:
        """Whether the largest multiplier is within the margin of the unit circle, so that no verdict is safe."""
        return bool(abs(self.spectral_radius - 1) <= self.margin)

    @property
    def verdict(self) -> str:
        """One of "stable", "marginal", "unstable"."""
        if self.is_stable:
            return "stable"
        return "marginal" if self.is_marginal else "unstable"

    @cached_property
    def monodromy(self) -> FloatArray:
        """Where a disturbance of the initial state goes in one period, in the states' units, (n, n)."""
        if self.system is not None:
            return monodromy(self.system)
        return read_only(self.maps.product * self.maps.scales[:, None] / self.maps.scales)

    @cached_property
    def modes(self) -> ComplexArray:
        """Eigenvectors of the monodromy matrix at the start of the period, one a column, of unit length; (n, n)."""
        modes = self.mode_shapes[0]
        return modes / np.linalg.norm(modes, axis=0)

    @cached_property
    def mode_shapes(self) -> ComplexArray:
        """Periodic p of each mode z(t) = p(t) exp(exponent t) at the start of every step, shape (n_steps, n, n).

        One mode a column, in the order of the multipliers, of unit length where it is longest.
        """
        vectors = np.stack([self._vectors(i)[0] for i in range(self.multipliers.size)], axis=2)
        shapes = vectors[self.maps.starts] * self.maps.scales[:, None]
        return shapes / np.max(np.linalg.norm(shapes, axis=1), axis=0)

    @cached_property
    def adjoint_shapes(self) -> ComplexArray:
        """Periodic q of each adjoint mode at the start of every step, q^T p constant in time; (n_steps, n, n).

        One a column, so scaled that q^T p = 1 for its own mode.
        """
        vectors = np.stack([self._vectors(i)[1] for i in range(self.multipliers.size)], axis=2)
        shapes = vectors[self.maps.starts] / self.maps.scales[:, None]
        return shapes / np.sum(shapes * self.mode_shapes, axis=1, keepdims=True)

    def mode_shape(self, mode: int, times: FloatArray) -> ComplexArray:
        """Return p(t) of one mode at times within the period [s], shape (n, n_times).

        Raises
        ------
        ValueError
            The multipliers are of an orbit, whose modes are known at the starts of its steps: `mode_shapes`.
        """
        system, exponent = self.system, self.exponents[mode]
        if system is None:
            raise ValueError(
                "mode_shape: found the multipliers of an orbit, expected those of a periodic system (lp.floquet); "
                "the modes of an orbit are known at the starts of its steps, .mode_shapes"
            )
        step, local = system.step_at(times)
        matrices = system.scaled.matrices[step, :-1, :-1] - exponent * np.eye(system.n_states)
        maps = complex_exponentials(matrices * local[:, None, None])
        scales = system.scaled.scales
        starts = self.mode_shapes[step, :, mode] / scales
        return (scales * (maps @ starts[:, :, None])[:, :, 0]).T

    def _vectors(self, mode: int) -> tuple[ComplexArray, ComplexArray]:
        """Return balanced p and q of a mode at the start of every piece, shapes (n_pieces, n)."""
        if self.angles[mode] < 0:
            # The upper half of a pair stands first.
            p, q = self._upper_vectors(mode - 1)
            return np.conj(p), np.conj(q)
        return self._upper_vectors(mode)

    def _upper_vectors(self, mode: int) -> tuple[ComplexArray, ComplexArray]:
        if mode not in self._known_vectors:
            of_system = self.system is not None and np.isfinite(self.log_moduli[mode])
            self._known_vectors[mode] = self._vectors_of_system(mode) if of_system else self._vectors_of_product(mode)
        return self._known_vectors[mode]

    def _vectors_of_system(self, mode: int) -> tuple[ComplexArray, ComplexArray]:
        apart = np.abs(self.log_moduli - self.log_moduli[mode]) + np.abs(self.angles - self.angles[mode])
        # Members of one multiple multiplier take the singular vectors in turn.
        member = int(np.count_nonzero(apart[:mode] < 1e-8))
        return self._pieces_of_exponent(complex(self.exponents[mode]), member)

    @cached_property
    def _known_vectors(self) -> dict[int, tuple[ComplexArray, ComplexArray]]:
        return {}

    def _pieces_of_exponent(self, exponent: complex, member: int) -> tuple[ComplexArray, ComplexArray]:
        system = self.system
        assert system is not None
        n, pieces = system.n_states, system.fine_pieces
        matrices = (system.scaled.matrices[:, :n, :n] - exponent * np.eye(n)) * system.durations[:, None, None]
        factors = np.repeat(complex_exponentials(matrices / pieces[:, None, None]), pieces, axis=0)
        nothing = np.zeros((len(factors), factors.shape[1], 1))
        forward = _null_trajectory(reduced(factors, nothing), member)
        transposed = np.swapaxes(factors[::-1], 1, 2)
        backward = _null_trajectory(reduced(transposed, nothing), member)
        return forward, np.roll(backward[::-1], 1, axis=0)

    def _vectors_of_product(self, mode: int) -> tuple[ComplexArray, ComplexArray]:
        """Return p and q by the eigenvectors of the whole map, whose factors may be singular, as where a piston stops.

        A multiplier below the rounding of one, or of the largest, is as good as zero: what it belongs to is gone after
        the period.
        """
        maps, least = self.maps, max(float(self.log_moduli[0]), 0.0) + LEAST_SHARE
        if self.log_moduli[mode] > least:
            exponent = complex(self.exponents[mode])
            p, q = (_eigenvector(matrix, self.multipliers[mode]) for matrix in (maps.product, maps.product.T))
        else:
            exponent = 0j
            left, values, right = np.linalg.svd(maps.product)
            gone = np.flatnonzero(self.log_moduli <= least)
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
        return np.array(forward), np.roll(np.array(backward[::-1]), 1, axis=0)


def _eigenvector(matrix: FloatArray, eigenvalue: complex) -> ComplexArray:
    """Return the eigenvector of a matrix whose eigenvalue is nearest to the one given."""
    values, vectors = np.linalg.eig(matrix)
    return vectors[:, int(np.argmin(np.abs(values - eigenvalue)))].astype(np.complex128)


def _null_trajectory(one: Reduced, member: int) -> ComplexArray:
    """Return the solution of the singular cyclic system along its smallest singular value but `member`, (N, n)."""
    right = np.linalg.svd(one.first + one.last)[2]
    start = np.conj(right[len(right) - 1 - member])[:, None]
    return one.all_from(start, start)[:-1, :, 0]


def floquet(system: PeriodicSystem, *, least_margin: float = 1e-12) -> Floquet:
    """Return the Floquet multipliers and modes of a periodic system.

    Parameters
    ----------
    system : PeriodicSystem
    least_margin : float
        Smallest margin of the verdict. It is widened to the rounding error of the largest multipliers, estimated from
        their condition numbers.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> lp.floquet(model.system).verdict
    'stable'
    """
    expect_system(system)
    pieces = system.fine_pieces
    maps = Maps(
        factors=_factors(system),
        durations=np.repeat(system.durations / pieces, pieces),
        starts=np.cumsum(pieces) - pieces,
        scales=system.scaled.scales,
    )
    found = from_logs(*log_multipliers(maps.factors))
    return Floquet(
        period=system.period,
        multipliers=found.multipliers,
        log_moduli=found.log_moduli,
        angles=found.angles,
        least_margin=not_negative("least_margin", least_margin),
        maps=maps,
        system=system,
    )


def orbit_multipliers(orbit: Orbit, maps: Maps, margin: float) -> Floquet:
    """Return the multipliers of an orbit from the maps of a disturbance over it; `margin` is what they are good to."""
    found = product_multipliers(maps.factors)
    return Floquet(
        period=orbit.period,
        multipliers=found.multipliers,
        log_moduli=found.log_moduli,
        angles=found.angles,
        least_margin=margin,
        maps=maps,
        orbit=orbit,
    )


def _factors(system: PeriodicSystem) -> FloatArray:
    """Return the balanced transition matrices of all pieces, shape (n_pieces, n, n)."""
    pieces, n = system.fine_pieces, system.n_states
    if len(pieces) == np.sum(pieces):
        return system.maps.maps[:, :n, :n]
    matrices = system.scaled.matrices[:, :n, :n] * (system.durations / pieces)[:, None, None]
    return np.repeat(exponentials(matrices), pieces, axis=0)


def _condition(p: ComplexArray, q: ComplexArray) -> float:
    """Return the largest |q| |p| / |q^T p| along the period."""
    overlap = np.abs(np.sum(q * p, axis=1))
    with np.errstate(divide="ignore", over="ignore"):
        return float(np.max(np.linalg.norm(q, axis=1) * np.linalg.norm(p, axis=1) / overlap))
