r"""Monodromy matrix, Floquet multipliers and modes, and the verdict on stability.

Only the multipliers, the eigenvalues of the map over one period, decide: stability in each step is neither needed
nor enough. They are found from the factors of that map (`product`), not from the map, each step in factors that neither
under- nor overflow (`stiff`).

A mode of exponent mu is z(t) = p(t) e^{mu t} with p periodic; how p is found: `modes`.

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
from ltvpneu.periodic.algebra.product import exp_of, expect_converged, falling, from_logs, product_multipliers, rank_of
from ltvpneu.periodic.algebra.propagate import complex_exponentials
from ltvpneu.periodic.algebra.schur import log_eigenvalues
from ltvpneu.periodic.orbits.modes import Maps, ModeVectors, cyclic_vectors, product_vectors
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.system import GROWTH, PeriodicSystem

JORDAN = 1e-5
"""Distance of logarithms of multipliers within which two may be the same [-]."""
LARGEST_LOG = 700.0
"""Of a factor of an adjoint shape, beyond which it is cut off so as to stay finite [-]."""
TRACE_TOLERANCE = 1e-11
"""Of the sum of the logarithms, relative to the norm of A times the period."""


def monodromy(system: AnyPeriodicSystem) -> FloatArray:
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
    expect_periodic(system)
    n, scales = system.n_states, system.scales
    finer = system
    if isinstance(system, PeriodicSystem) and not system.is_representable:
        finer = system.split(system.fine_pieces)
    product, exponent = np.eye(n), 0
    for factor in finer.maps.maps[:, :n, :n]:
        # By powers of two: growth within the period that comes back again shall not overflow on the way.
        product = factor @ product
        power = int(np.frexp(np.abs(product).max(initial=0.0))[1])
        product, exponent = np.ldexp(product, -power), exponent + power
    with np.errstate(over="ignore"):
        found = np.ldexp(product * (scales[:, None] / scales), min(max(exponent, -5000), 5000))
    if not np.isfinite(found).all():
        raise StepOverflowError(
            f"the monodromy matrix has an entry of about 10^{exponent * math.log10(2):.0f}, more than double precision "
            "holds. Its multipliers can still be had: floquet"
        )
    return read_only(found)


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
    system: AnyPeriodicSystem | None = None
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
    def natural_frequencies(self) -> FloatArray:
        """Moduli of the exponents [rad/s], shape (n,); as of the poles in `control.damp`."""
        return np.hypot(self.exponents.real, self.exponents.imag)

    @property
    def damping_ratios(self) -> FloatArray:
        """Of the exponents, from -1, growing without a swing, to 1, decaying without one [-]; nan for zero; (n,)."""
        ratios = np.full(self.log_moduli.size, np.nan)
        finite = np.isfinite(self.log_moduli)
        np.divide(
            -self.exponents.real, self.natural_frequencies, out=ratios, where=finite & (self.natural_frequencies > 0)
        )
        ratios[~finite] = 1.0
        return ratios

    @property
    def spectral_radius(self) -> float:
        """Largest modulus [-]; infinite where it is beyond double precision, zero without states."""
        if self.log_moduli.size == 0:
            return 0.0
        return math.exp(self.log_moduli[0]) if self.log_moduli[0] < 709 else math.inf

    @cached_property
    def margin(self) -> float:
        """Distance from the unit circle within which a multiplier counts as on it [-].

        Of a system it covers the largest multipliers' own error.
        """
        return max(self.least_margin, 10 * self._relative_error())

    def _relative_error(self) -> float:
        """Bound the rounding error of the multipliers nearest to the unit circle, relative to the largest.

        A simple eigenvalue moves by its condition number times the backward error of each factor; near a defective one,
        where that number has no bound, by the n-th root of the backward error.
        """
        n_pieces, n = self.maps.factors.shape[:2]
        if self.system is None or n == 0 or not np.isfinite(self.log_moduli[0]):
            return 0.0
        backward = np.finfo(float).eps * n * math.sqrt(n_pieces)
        near = np.flatnonzero(self.log_moduli >= self.log_moduli[0] - math.log(2))
        most = backward ** (1.0 / n)
        try:
            conditions = [self._vectors(int(i)).condition for i in near if self.angles[i] >= 0]
        except StepOverflowError:
            return most
        return min(max(conditions) * backward, most)

    @property
    def is_stable(self) -> bool:
        """Whether every perturbation decays: all multipliers inside the unit circle, by the margin."""
        return bool(self.spectral_radius < 1 - self.margin)

    @property
    def is_marginal(self) -> bool:
        """Whether the largest multiplier is within the margin of the unit circle: disturbances do not decay, by it."""
        return bool(abs(self.spectral_radius - 1) <= self.margin)

    @property
    def separation(self) -> float:
        """Smallest distance between two multipliers within the margin of the unit circle [-]; infinite if one is."""
        near = self.multipliers[np.abs(exp_of(self.log_moduli) - 1) <= self.margin]
        distances = np.abs(near[:, None] - near) + np.diag(np.full(near.size, np.inf))
        return float(np.min(distances, initial=np.inf))

    @property
    def is_bounded(self) -> bool:
        """Whether disturbances of a periodic system stay bounded: it is stable, or its largest multipliers are simple.

        On the unit circle, to the margin, a simple multiplier neither grows nor decays, as in a conservative system. A
        double one, whose motions may grow in proportion to time, is split by rounding: simple is what stands apart by
        more than ten roots of the margin. Of an orbit of a nonlinear machine its linearization cannot tell.
        """
        if self.is_stable or not self.is_marginal:
            return self.is_stable
        return self.system is not None and self.separation > 10 * math.sqrt(self.margin)

    @property
    def verdict(self) -> str:
        """One of "stable", "bounded", "marginal", "unstable": disturbances decay; stay; cannot be told; grow."""
        if self.is_stable:
            return "stable"
        if not self.is_marginal:
            return "unstable"
        return "bounded" if self.is_bounded else "marginal"

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
        shapes, _, logs = self._at_starts
        return shapes * exp_of(logs)[:, None, :]

    @cached_property
    def adjoint_shapes(self) -> ComplexArray:
        """Periodic q of each adjoint mode at the start of every step, q^T p constant in time; (n_steps, n, n).

        One a column, so scaled that q^T p = 1 for its own mode.
        """
        shapes, adjoints, logs = self._at_starts
        overlaps = np.sum(adjoints * shapes, axis=1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            return adjoints / overlaps * exp_of(np.minimum(-logs, LARGEST_LOG))[:, None, :]

    @cached_property
    def _at_starts(self) -> tuple[ComplexArray, ComplexArray, FloatArray]:
        """P and q at the start of every step, (n_steps, n, n), and the logarithms that p lacks to be at most one."""
        maps, n = self.maps, self.multipliers.size
        shapes = np.zeros((maps.starts.size, n, n), dtype=np.complex128)
        adjoints, logs = np.zeros_like(shapes), np.zeros((maps.starts.size, n))
        for i in range(n):
            found = self._vectors(i)
            shapes[:, :, i] = found.shapes[maps.starts] * maps.scales
            adjoints[:, :, i] = found.adjoints[maps.starts] / maps.scales
            logs[:, i] = found.logs[maps.starts]
        with np.errstate(divide="ignore"):
            longest = np.max(np.log(np.linalg.norm(shapes, axis=1)) + logs, axis=0)
        return shapes, adjoints, logs - longest

    def mode_shape(self, mode: int, times: FloatArray) -> ComplexArray:
        """Return p(t) of one mode at times within the period [s], shape (n, n_times).

        Raises
        ------
        ValueError
            The multipliers are of an orbit, or in discrete time: modes are known at the starts of steps, `mode_shapes`.
        """
        system, exponent = self.system, self.exponents[mode]
        if not isinstance(system, PeriodicSystem):
            raise ValueError(
                "mode_shape: found the multipliers of an orbit or of a system in discrete time, expected those of a "
                "PeriodicSystem (lp.floquet); other modes are known at the starts of steps, .mode_shapes"
            )
        step, local = system.step_at(times)
        matrices = system.scaled.matrices[step, :-1, :-1] - exponent * np.eye(system.n_states)
        with np.errstate(over="ignore", invalid="ignore"):
            maps = complex_exponentials(matrices * local[:, None, None])
        if not np.abs(maps).max(initial=0.0) <= GROWTH:
            return self._shape_between(system, mode, times)
        scales = system.scaled.scales
        starts = self.mode_shapes[step, :, mode] / scales
        return (scales * (maps @ starts[:, :, None])[:, :, 0]).T

    def _shape_between(self, system: PeriodicSystem, mode: int, times: FloatArray) -> ComplexArray:
        """Return p(t) where what the mode leaves behind would drown it on the way from the start of its step.

        The times become starts of steps.
        """
        cuts = np.union1d(system.switching_times[:-1], times)
        durations = np.diff(np.append(cuts, system.period))
        finer = system.without_empty_steps().cut(cuts + durations / 2, durations)
        shapes = floquet(finer, least_margin=self.least_margin).mode_shapes[:, :, mode]
        # The same mode, up to a factor, which shows where it is longest.
        k = int(np.argmax(np.linalg.norm(self.mode_shapes[:, :, mode], axis=1)))
        there, here = shapes[np.searchsorted(cuts, system.switching_times[k])], self.mode_shapes[k, :, mode]
        return (np.vdot(there, here) / np.vdot(there, there) * shapes[np.searchsorted(cuts, times)]).T

    def _vectors(self, mode: int) -> ModeVectors:
        """Return p and q of a mode at the start of every piece."""
        if self.angles[mode] < 0:
            # The upper half of a pair stands first.
            return self._upper_vectors(mode - 1).conjugate()
        return self._upper_vectors(mode)

    def _upper_vectors(self, mode: int) -> ModeVectors:
        if mode not in self._known_vectors:
            if self.maps.growth is not None and np.isfinite(self.log_moduli[mode]):
                found = self._vectors_of_system(mode)
            else:
                found = product_vectors(self.maps, self.multipliers, self.log_moduli, mode)
            self._known_vectors[mode] = found
        return self._known_vectors[mode]

    @cached_property
    def _known_vectors(self) -> dict[int, ModeVectors]:
        return {}

    def _vectors_of_system(self, mode: int) -> ModeVectors:
        apart = np.abs(self.log_moduli - self.log_moduli[mode]) + np.abs(self.angles - self.angles[mode])
        # Members of one multiple multiplier take the singular vectors in turn.
        member = int(np.count_nonzero(apart[:mode] < 1e-8))
        return cyclic_vectors(self.maps, mode, float(self.log_moduli[mode]), float(self.angles[mode]), member)


def floquet(system: AnyPeriodicSystem, *, least_margin: float = 1e-12) -> Floquet:
    """Return the Floquet multipliers and modes of a periodic system.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    least_margin : float
        Smallest margin of the verdict. It is widened to the rounding error of the largest multipliers, estimated from
        their condition numbers.

    Raises
    ------
    StepOverflowError
        States so stiff and so strongly coupled that the multipliers' logarithms do not sum to the trace of A.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> lp.floquet(model.system).verdict
    'stable'
    """
    expect_periodic(system)
    if isinstance(system, DiscretePeriodicSystem):
        return _of_product(system, system.balanced[0], system.durations, np.arange(system.n_steps), least_margin)
    if system.has_jumps and _jumps_are_singular(system):
        return _of_singular_jumps(system, least_margin)
    factors = system.factors
    found = log_eigenvalues(factors.matrices, factors.row_logs)
    expect_converged(found, len(factors.matrices), system.n_states)
    _expect_trace(system, found.log_moduli)
    order = falling(found.log_moduli, found.angles)
    sorted_ = from_logs(found.log_moduli, found.angles)
    return Floquet(
        period=system.period,
        multipliers=sorted_.multipliers,
        log_moduli=sorted_.log_moduli,
        angles=sorted_.angles,
        least_margin=not_negative("least_margin", least_margin),
        maps=Maps(
            factors=factors.matrices,
            durations=factors.durations,
            starts=factors.starts,
            scales=system.scaled.scales,
            row_logs=factors.row_logs,
            growth=found.growth[:, order],
        ),
        system=system,
    )


def is_exponent(found: Floquet, s: complex) -> bool:
    """Return whether s [1/s] is a characteristic exponent, to multiples of j 2 pi / T.

    A pair with a Jordan block is only good to the root of the rounding error, and counts.
    """
    real, imaginary = found.log_moduli - s.real * found.period, found.angles - s.imag * found.period
    imaginary = imaginary - 2 * np.pi * np.round(imaginary / (2 * np.pi))
    return bool((np.hypot(real, imaginary) <= JORDAN).any())


def _jumps_are_singular(system: PeriodicSystem) -> bool:
    """Return whether a jump forgets some direction of the state, to rounding."""
    return any(rank_of(jump) < system.n_states for jump in system.scaled_jumps[system.jumps_at, :-1, :-1])


def _of_singular_jumps(system: PeriodicSystem, least_margin: float) -> Floquet:
    """Return the multipliers of a system whose jumps make some of them zero: as those of a product of maps."""
    n, N = system.n_states, system.n_steps
    flows, jumps = system.flows.maps[:, :n, :n], system.scaled_jumps[:, :n, :n]
    factors = np.stack([flows, jumps], axis=1).reshape(2 * N, n, n)
    durations = np.stack([system.durations, np.zeros(N)], axis=1).ravel()
    return _of_product(system, factors, durations, 2 * np.arange(N), least_margin)


def _of_product(
    system: AnyPeriodicSystem, factors: FloatArray, durations: FloatArray, starts: IntArray, least_margin: float
) -> Floquet:
    """Return the multipliers of a system whose maps, some perhaps singular, are given."""
    found = product_multipliers(factors)
    return Floquet(
        period=system.period,
        multipliers=found.multipliers,
        log_moduli=found.log_moduli,
        angles=found.angles,
        least_margin=not_negative("least_margin", least_margin),
        maps=Maps(factors=factors, durations=durations, starts=starts, scales=system.scales),
        system=system,
    )


def _expect_trace(system: PeriodicSystem, log_moduli: FloatArray) -> None:
    """Raise `StepOverflowError` unless the logarithms sum to the integral of the trace of A: Liouville's formula.

    Each jump adds the logarithm of its determinant.
    """
    traces = np.einsum("kii->k", system.A) * system.durations
    if system.has_jumps:
        traces = traces + np.linalg.slogdet(system.scaled_jumps)[1]
    size = float((np.abs(system.scaled.matrices[:, :-1, :-1]).max(axis=(1, 2), initial=0.0) * system.durations).sum())
    gap = abs(float(np.sum(log_moduli)) - float(np.sum(traces)))
    if not gap <= TRACE_TOLERANCE * max(size, 1.0) * max(system.n_states, 1):
        raise StepOverflowError(
            f"the logarithms of the multipliers sum to {np.sum(log_moduli):.9g}, and the trace of A over the period is "
            f"{np.sum(traces):.9g}: this system is too stiff, and its states too strongly coupled, for double "
            "precision. Are A and the durations in the same units of time? Else drop the fastest states"
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
