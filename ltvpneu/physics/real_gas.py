r"""A real gas: density, energy and nozzle flow of CoolProp's equations of state, tabulated for compiled laws.

The equations are the reference ones, Helmholtz energies over density and temperature: air [Lemmon2000]_, nitrogen
[Span2000]_, carbon dioxide [SpanWagner1996]_, helium [OrtizVega2019]_ and the other fluids of CoolProp [Bell2014]_. Too
slow for a model's inner loop, they are interpolated once:

.. math:: \rho = \frac{p}{R T} D(p, T), \qquad u = R\,U(p, T)

The flow is that of an isentropic nozzle, as the ideal gas's: from rest at (p, T), with enthalpy h_0 and entropy s_0,

.. math:: M_f = \max_{p_t \ge p_k} \rho \sqrt{2 (h_0 - h)}, \quad s = s_0

It is choked, M_f = M_c, where p_k is at most r_c p: the throat then runs at the speed of sound. Two series hold
r_c(p, T) and psi = M_c sqrt(R T) / p. Between r_c and one, with phi = (p_k / p - r_c) / (1 - r_c),

.. math:: (M_f / M_c)^2 = 1 - \varphi^2 + (1 - \varphi) \varphi^2 w(p, T, \varphi)

which, whatever w is, meets the choked flow with its slope and ends in zero at equal pressures. w = 0 is an ellipse; w
is below 0.1 for the four gases above at room temperature, so that a short series gives many digits.

References
----------
.. [Lemmon2000] Lemmon, E. W. et al., J. Phys. Chem. Ref. Data, 2000.
.. [Span2000] Span, R. et al., J. Phys. Chem. Ref. Data, 2000.
.. [SpanWagner1996] Span, R. and Wagner, W., J. Phys. Chem. Ref. Data, 1996.
.. [OrtizVega2019] Ortiz Vega, D. O. et al., J. Phys. Chem. Ref. Data, 2019.
.. [Bell2014] Bell, I. H., Wronski, J., Quoilin, S. and Lemort, V., "Pure and Pseudo-pure Fluid Thermophysical Property
   Evaluation and the Open-Source Thermophysical Property Library CoolProp", Ind. Eng. Chem. Res. 53, 2014, 2498-2508.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, positive
from ltvpneu._values import Value
from ltvpneu.errors import GasRangeError
from ltvpneu.physics.equation_of_state import STANDARD_PRESSURE, EquationOfState, Range, limits, ratios
from ltvpneu.physics.gas import Gas, GasConstants, GasState
from ltvpneu.physics.gas_table import R_GAS, gas_table, real_critical_ratio, real_flux, real_properties
from ltvpneu.physics.properties import REAL


class InterpolationError(NamedTuple):
    """Largest differences found between a table and its equation of state [-]."""

    density: float
    """Relative."""
    energy: float
    """Of the internal energy, over R T."""
    flux: float
    """Relative, choked and unchoked."""
    critical_ratio: float
    """Relative."""


@final
@dataclass(frozen=True, kw_only=True)
class RealGas(Value):
    """A real gas at the temperature of its surroundings, tabulated over pressure and temperature.

    Only the gas at rest has to be inside the ranges: in the throat of a nozzle it is colder and at a lower pressure.

    Parameters
    ----------
    fluid : str
        CoolProp's name of a pure fluid, or "Air".
    temperature : float
        Of the supply, the return and the surroundings [K].
    pressure_range : tuple of float
        Lowest and highest absolute pressure [Pa].
    temperature_range : tuple of float, optional
        Lowest and highest temperature [K]. By default 0.6 to 1.8 times `temperature`, or less where the gas would
        condense in a nozzle or the equation of state ends: see `temperature_limits`.

    Raises
    ------
    ImportError
        CoolProp is not installed.
    ValueError
        A fluid that CoolProp does not know, or a range that does not rise from above zero.
    GasRangeError
        In the ranges, or in a nozzle fed from them, the fluid is not a gas; or `temperature` is outside.
    """

    fluid: str
    temperature: float = 293.15
    pressure_range: Range = (0.2e5, 20e5)
    temperature_range: Range | None = None

    def __post_init__(self) -> None:
        positive("temperature", self.temperature, "K")
        object.__setattr__(self, "pressure_range", _rising("pressure_range", self.pressure_range, "Pa"))
        if self.temperature_range is not None:
            object.__setattr__(self, "temperature_range", _rising("temperature_range", self.temperature_range, "K"))
        coldest, hottest = self.temperature_limits
        if not coldest <= self.temperature <= hottest:
            raise GasRangeError(
                f"temperature: found {self.temperature:g} K, expected {coldest:g} to {hottest:g} K, the range of the "
                "table. The gas of the supply and of the surroundings must be inside: widen temperature_range.",
                pressure=self.pressure_range[1],
                temperature=self.temperature,
            )

    @property
    def kind(self) -> int:
        """Which laws the compiled kernels take."""
        return REAL

    @property
    def limits(self) -> str:
        """Where the laws hold, in words."""
        (low, high), (cold, warm) = self.pressure_range, self.temperature_limits
        return f"{low:g} to {high:g} Pa and {cold:g} to {warm:g} K, the ranges of {self.fluid}"

    @property
    def constants(self) -> GasConstants:
        """Constants of the ideal gas that is like it at `reference_pressure`."""
        like = Gas(
            heat_capacity_ratio=self.heat_capacity_ratio,
            specific_gas_constant=self.specific_gas_constant,
            temperature=self.temperature,
        )
        return like.constants

    def expect_inside(self, name: str, pressure: float) -> None:
        """Raise `GasRangeError` unless a pressure [Pa] lies in the table's range; `name` is whose it is."""
        low, high = self.pressure_range
        if not low <= pressure <= high:
            raise GasRangeError(
                f"{name}: found {pressure:g} Pa, expected {low:g} to {high:g} Pa, the pressure_range of {self.fluid}. "
                "Give RealGas a wider one, with room for what chambers reach beyond their sources.",
                pressure=pressure,
                temperature=self.temperature,
            )

    def room(self, here: GasState) -> float:
        """Return how far a state is inside the ranges, relative to their nearest end [-]; below zero outside."""
        pairs = ((here.pressure, self.pressure_range), (here.temperature, self.temperature_limits))
        return min(min(value / low - 1, 1 - value / high) for value, (low, high) in pairs)

    @property
    def temperature_limits(self) -> Range:
        """Lowest and highest temperature of the table [K]: `temperature_range`, or its default."""
        return limits(self.fluid, self.temperature, self.pressure_range, self.temperature_range)

    @property
    def specific_gas_constant(self) -> float:
        """R_g of the equation of state [J/(kg K)]."""
        return float(self.table[R_GAS])

    @property
    def reference_pressure(self) -> float:
        """1.01325 bar, or what is nearest to it in `pressure_range` [Pa]."""
        low, high = self.pressure_range
        return min(max(STANDARD_PRESSURE, low), high)

    @property
    def heat_capacity_ratio(self) -> float:
        """c_p / c_v at `temperature` and `reference_pressure` [-]."""
        return ratios(self.fluid, self.temperature, self.reference_pressure)[0]

    @property
    def critical_pressure_ratio(self) -> float:
        """r_c below which the flow from `temperature` and `reference_pressure` is choked [-]."""
        return ratios(self.fluid, self.temperature, self.reference_pressure)[1]

    @property
    def table(self) -> FloatArray:
        """What the compiled laws need, shape (n,), read-only; equal gases share it."""
        return gas_table(self.fluid, self.pressure_range, self.temperature_limits)

    @property
    def interpolation_error(self) -> InterpolationError:
        """Largest errors of `table` against the equation of state, measured at 400 states off its nodes."""
        return _interpolation_error(self.fluid, self.pressure_range, self.temperature_limits)


def _rising(name: str, ends: Any, unit: str) -> Range:
    try:
        low, high = (finite(name, end, unit) for end in ends)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: found {ends!r}, expected two numbers, lowest and highest ({error})") from None
    if not 0 < low < high:
        raise ValueError(
            f"{name}: found {low:g} to {high:g} {unit}, expected a range that rises from above zero. "
            "Absolute values are meant, the lower end first."
        )
    return low, high


@lru_cache(maxsize=32)
def _interpolation_error(fluid: str, pressures: Range, temperatures: Range) -> InterpolationError:
    equation, table = EquationOfState(fluid), gas_table(fluid, pressures, temperatures)
    ranges = (pressures, temperatures, (0.0, 1.0))
    worst = np.zeros(4)
    # More states near the edges of the table, and near choking and equal pressures: there interpolants are worst.
    for shares in 0.5 - 0.5 * np.cos(np.pi * np.random.default_rng(0).random((400, 3))):
        p, T, phi = (low + (high - low) * float(share) for share, (low, high) in zip(shares, ranges, strict=True))
        rest = equation.at_rest(p, T)
        choked = equation.throat(rest, T)
        r_c = choked.pressure / p
        downstream = p * (r_c + (1 - r_c) * phi)
        flux = equation.throat(rest, T, downstream).flux
        found = real_properties(p, T, table)
        errors = (
            found.rho / rest.density - 1,
            (found.u - rest.energy) / (equation.R * T),
            max(abs(real_flux(p, downstream, T, table) / flux - 1), abs(real_flux(p, 0.0, T, table) / choked.flux - 1)),
            real_critical_ratio(p, T, table) / r_c - 1,
        )
        worst = np.maximum(worst, np.abs(errors))
    return InterpolationError(*worst.tolist())
