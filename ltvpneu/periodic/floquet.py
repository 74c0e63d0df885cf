"""Monodromy matrix, Floquet multipliers and the verdict on stability.

Only the multipliers, the eigenvalues of the map over one period, decide: stability in each step is neither needed
nor enough.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import FloatArray, not_negative, read_only
from ltvpneu.periodic.propagate import exponentials
from ltvpneu.periodic.system import PeriodicSystem, expect_system

ComplexArray = NDArray[np.complex128]


def monodromy(system: PeriodicSystem) -> FloatArray:
    """Return the monodromy matrix Phi, z(T) = Phi z(0) + g, shape (n, n).

    Examples
    --------
    >>> import ltvpneu as lp
    >>> import math
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0], [0.0]], [0.5, 0.5])
    >>> math.isclose(lp.monodromy(system)[0, 0], math.exp(-2))
    True
    """
    expect_system(system)
    maps = system.maps
    scales = maps.steps.scales
    return read_only(maps.over_period()[:-1, :-1] * (scales[:, None] / scales))


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Floquet:
    """Multipliers of a periodic system, largest first, and what follows from them."""

    multipliers: ComplexArray
    """Characteristic multipliers [-], shape (n,), by falling modulus, then falling imaginary part."""
    log_moduli: FloatArray
    """Natural logarithms of their moduli, -inf for zero, shape (n,)."""
    modes: ComplexArray
    """Eigenvectors of the monodromy matrix at the start of the period, one a column, of unit length; (n, n)."""
    margin: float
    """Distance from the unit circle within which the verdict is "marginal" [-]; covers the multipliers' own error."""
    period: float
    """[s]"""

    def __repr__(self) -> str:
        return f"<Floquet: {self.verdict}, spectral radius {self.spectral_radius:.6g}, multipliers {self.multipliers}>"

    @property
    def exponents(self) -> ComplexArray:
        """Principal characteristic exponents log(multiplier) / period [1/s], shape (n,)."""
        return (self.log_moduli + 1j * np.angle(self.multipliers)) / self.period

    @property
    def spectral_radius(self) -> float:
        """Largest modulus [-]; infinite where it is beyond double precision."""
        return math.exp(self.log_moduli[0]) if self.log_moduli[0] < 709 else math.inf

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


def floquet(system: PeriodicSystem, *, least_margin: float = 1e-12) -> Floquet:
    """Return the Floquet multipliers and modes of a periodic system.

    Parameters
    ----------
    system : PeriodicSystem
    least_margin : float
        Smallest margin of the verdict. It is widened to the rounding error of the computed multipliers, estimated from
        their condition numbers.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> lp.floquet(model.system).verdict
    'stable'
    """
    expect_system(system)
    not_negative("least_margin", least_margin)
    product, log_scale = _scaled_product(system)
    values, right = np.linalg.eig(product)
    with np.errstate(divide="ignore"):
        log_moduli = np.log(np.abs(values)) + log_scale
    order = np.lexsort((-np.imag(values), -log_moduli))
    values, right, log_moduli = values[order], right[:, order], log_moduli[order]
    angles = np.angle(values)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        moduli = np.exp(log_moduli)
        # Part by part: an infinite modulus times a sine of zero is no number.
        multipliers = moduli * np.cos(angles) + 1j * np.where(angles == 0, 0.0, moduli * np.sin(angles))
    scales = system.scaled.scales
    modes = scales[:, None] * right
    return Floquet(
        multipliers=multipliers,
        log_moduli=read_only(log_moduli),
        modes=modes / np.linalg.norm(modes, axis=0),
        margin=max(least_margin, 10 * _relative_error(product, values, right, system.n_steps)),
        period=system.period,
    )


LARGEST_NORM = 50.0
"""Steps whose matrix times duration is larger are taken as a power of a shorter one, so that nothing overflows."""


def _scaled_product(system: PeriodicSystem) -> tuple[FloatArray, float]:
    """Return the balanced monodromy matrix, divided by a number that keeps it near one in size, and its logarithm."""
    matrices = system.scaled.matrices[:, :-1, :-1] * system.durations[:, None, None]
    norms = np.max(np.sum(np.abs(matrices), axis=1), axis=1)
    steps = system.maps.maps[:, :-1, :-1] if norms.max() <= LARGEST_NORM else None
    product, log_scale = np.eye(system.n_states), 0.0
    for m in range(system.n_steps):
        halvings = max(0, math.ceil(math.log2(norms[m] / LARGEST_NORM))) if norms[m] > 0 else 0
        step = exponentials(matrices[None, m] / 2.0**halvings)[0] if steps is None else steps[m]
        log_step = 0.0
        for _ in range(halvings):
            step, log_size = _normalized(step @ step)
            log_step = 2 * log_step + log_size
        product, log_size = _normalized(step @ product)
        log_scale += log_step + log_size
    return product, log_scale


def _normalized(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return a matrix divided by its largest entry, and the logarithm of that; as it is where that is near one."""
    size = float(np.max(np.abs(matrix)))
    if size == 0.0 or 1e-100 < size < 1e100:
        return matrix, 0.0
    return matrix / size, math.log(size)


def _relative_error(product: FloatArray, values: ComplexArray, vectors: ComplexArray, n_steps: int) -> float:
    """Bound the rounding error of the multipliers nearest to the unit circle, relative to the largest.

    A simple eigenvalue moves by its condition number times the backward error; near a defective one, where that number
    has no bound, by the n-th root of the backward error.
    """
    largest = float(np.abs(values[0]))
    if largest == 0.0:
        return 0.0
    backward = np.finfo(float).eps * values.size * math.sqrt(n_steps) * float(np.linalg.norm(product)) / largest
    defective = backward ** (1.0 / values.size)
    try:
        left = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return defective
    # The eigenvectors have unit length, so the norms of the rows of the inverse are the condition numbers.
    conditions = np.sqrt(np.sum(np.abs(left) ** 2, axis=1))
    near = np.abs(values) >= 0.5 * largest
    return min(float(np.max(conditions[near])) * backward, defective)
