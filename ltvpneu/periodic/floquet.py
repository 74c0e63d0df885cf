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
from ltvpneu.periodic.system import PeriodicSystem

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
    maps = system.maps
    scales = maps.steps.scales
    return read_only(maps.over_period()[:-1, :-1] * (scales[:, None] / scales))


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Floquet:
    """Multipliers of a periodic system, largest first, and what follows from them."""

    multipliers: ComplexArray
    """Characteristic multipliers [-], shape (n,), by falling modulus, then falling imaginary part."""
    log_moduli: FloatArray
    """Natural logarithms of their moduli, -inf for zero, shape (n,)."""
    modes: ComplexArray
    """Eigenvectors of the monodromy matrix at the start of the period, one a column, of unit length; (n, n)."""
    margin: float
    """Distance from the unit circle within which the verdict is "marginal" [-]."""
    period: float
    """[s]"""

    @property
    def exponents(self) -> ComplexArray:
        """Principal characteristic exponents log(multiplier) / period [1/s], shape (n,)."""
        return (self.log_moduli + 1j * np.angle(self.multipliers)) / self.period

    @property
    def spectral_radius(self) -> float:
        """Largest modulus [-]."""
        return float(np.exp(self.log_moduli[0]))

    @property
    def is_stable(self) -> bool:
        """Whether every perturbation decays: all multipliers inside the unit circle, by the margin."""
        return self.spectral_radius < 1 - self.margin

    @property
    def is_marginal(self) -> bool:
        """Whether the largest multiplier is within the margin of the unit circle, so that no verdict is safe."""
        return abs(self.spectral_radius - 1) <= self.margin

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
    not_negative("least_margin", least_margin)
    maps = system.maps
    product = maps.maps[0, :-1, :-1]
    log_scale, growth = 0.0, 1.0
    for step in maps.maps[1:, :-1, :-1]:
        product = step @ product
        # Kept near one in size, so that a long product neither over- nor underflows.
        size = float(np.max(np.abs(product)))
        growth = max(growth, size)
        if size > 0 and not 1e-100 < size < 1e100:
            product = product / size
            log_scale += math.log(size)
    values, right = np.linalg.eig(product)
    with np.errstate(divide="ignore"):
        log_moduli = np.log(np.abs(values)) + log_scale
    order = np.lexsort((-np.imag(values), -log_moduli))
    values, right, log_moduli = values[order], right[:, order], log_moduli[order]
    multipliers = np.exp(log_moduli) * np.exp(1j * np.angle(values))
    scales = maps.steps.scales
    modes = scales[:, None] * right
    backward_error = np.finfo(float).eps * system.n_states * math.sqrt(system.n_steps)
    backward_error *= max(float(np.linalg.norm(product)) * math.exp(log_scale), 1.0)
    return Floquet(
        multipliers=multipliers,
        log_moduli=read_only(log_moduli),
        modes=modes / np.linalg.norm(modes, axis=0),
        margin=max(least_margin, 10 * _eigenvalue_error(right, multipliers, backward_error)),
        period=system.period,
    )


def _eigenvalue_error(vectors: ComplexArray, multipliers: ComplexArray, backward_error: float) -> float:
    """Bound the rounding error of the multipliers near the largest, from their condition numbers.

    A simple eigenvalue moves by its condition number times the backward error; near a defective one, where that
    number has no bound, by the n-th root of the backward error.
    """
    defective = backward_error ** (1.0 / multipliers.size)
    try:
        left = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return defective
    # The eigenvectors have unit length, so the norms of the rows of the inverse are the condition numbers.
    conditions = np.sqrt(np.sum(np.abs(left) ** 2, axis=1))
    near = np.abs(multipliers) >= 0.5 * np.abs(multipliers[0])
    return min(float(np.max(conditions[near])) * backward_error, defective)
