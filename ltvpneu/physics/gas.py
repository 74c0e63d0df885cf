r"""Ideal gas in a chamber whose process is polytropic: eqs. (3) and (4) of [Kunt1990]_.

.. math:: p_k = R_g m_k T_k / V_k, \qquad T_k = T_a (p_k / p_a)^{(n_k - 1) / n_k}

The reference state of (4) is ambient: temperature T_a, return pressure p_a. Differentiating (3) with (4) gives

.. math:: \dot p_k = \frac{n_k}{V_k} \left( R_g T_k \dot m_k - p_k \dot V_k \right)

which for n_k = 1 is the isothermal chamber of the paper's section 6.

References
----------
.. [Kunt1990] Kunt, C. and Singh, R., "A Linear Time Varying Model for On-Off Valve Controlled Pneumatic Actuators",
   ASME J. Dyn. Syst. Meas. Control, 1990.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, positive, read_only
from ltvpneu._compiled import compiled, inlined
from ltvpneu._values import Value
from ltvpneu.physics.properties import IDEAL, Properties


class GasConstants(NamedTuple):
    """What the compiled laws need of a gas."""

    heat_capacity_ratio: float
    specific_gas_constant: float
    unchoked: float
    """sqrt(2 gamma / ((gamma - 1) R)) [sqrt(kg K/J)]."""
    choked: float
    """sqrt(gamma / R (2 / (gamma + 1))^((gamma + 1) / (gamma - 1))) [sqrt(kg K/J)]."""
    critical_pressure_ratio: float


NO_TABLE = read_only(np.empty(0))


class GasState(NamedTuple):
    """Pressure [Pa, absolute] and temperature [K] on one side of a restriction."""

    pressure: float
    temperature: float


@final
@dataclass(frozen=True, kw_only=True)
class Gas(Value):
    """An ideal gas at the temperature of its surroundings; by default air at 20 degC.

    Parameters
    ----------
    heat_capacity_ratio : float
        gamma [-], above one.
    specific_gas_constant : float
        R_g [J/(kg K)].
    temperature : float
        T_a, of the supply, the return and the surroundings [K].

    Examples
    --------
    >>> round(Gas().critical_pressure_ratio, 4)
    0.5283
    """

    heat_capacity_ratio: float = 1.4
    specific_gas_constant: float = 287.05
    temperature: float = 293.15

    def __post_init__(self) -> None:
        if finite("heat_capacity_ratio", self.heat_capacity_ratio) <= 1:
            raise ValueError(
                f"heat_capacity_ratio: found {self.heat_capacity_ratio:g}, expected more than 1 (air: 1.4)"
            )
        positive("specific_gas_constant", self.specific_gas_constant, "J/(kg K)")
        positive("temperature", self.temperature, "K")

    @property
    def kind(self) -> int:
        """Which laws the compiled kernels take."""
        return IDEAL

    @property
    def limits(self) -> str:
        """Where the laws hold, in words."""
        return "above zero"

    @property
    def table(self) -> FloatArray:
        """Empty: all that an ideal gas needs are its constants."""
        return NO_TABLE

    @property
    def critical_pressure_ratio(self) -> float:
        """r_c below which the flow is choked [-]; exponent gamma/(gamma-1), printed 1/(gamma-1) (erratum E2)."""
        return self.constants.critical_pressure_ratio

    @cached_property
    def constants(self) -> GasConstants:
        """Constants of the compiled laws."""
        gamma, R = float(self.heat_capacity_ratio), float(self.specific_gas_constant)
        return GasConstants(
            heat_capacity_ratio=gamma,
            specific_gas_constant=R,
            unchoked=math.sqrt(2 * gamma / ((gamma - 1) * R)),
            choked=math.sqrt(gamma / R * (2 / (gamma + 1)) ** ((gamma + 1) / (gamma - 1))),
            critical_pressure_ratio=(2 / (gamma + 1)) ** (gamma / (gamma - 1)),
        )


@inlined
def polytropic_temperature(pressure: float, exponent: float, temperature: float, reference: float) -> float:
    """Temperature of a chamber [K], eq. (4): `temperature` at pressure `reference`."""
    if exponent == 1.0:
        return temperature
    return temperature * (pressure / reference) ** ((exponent - 1.0) / exponent)


@compiled
def ideal_properties(pressure: float, temperature: float, gas: GasConstants) -> Properties:
    """Density p/(R T) and internal energy R T/(gamma - 1), with derivatives."""
    R, T = gas.specific_gas_constant, temperature
    heat = R / (gas.heat_capacity_ratio - 1.0)
    rho_p = 1.0 / (R * T)
    rho = pressure * rho_p
    return Properties(rho, rho_p, -rho / T, 0.0, -rho_p / T, 2.0 * rho / (T * T), heat * T, 0.0, heat, 0.0, 0.0, 0.0)
