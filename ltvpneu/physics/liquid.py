r"""Liquid in a chamber, with entrained gas, and its flow through an orifice.

Density at pressure p, with a share alpha of the volume taken by undissolved gas at the reference pressure p_r:

.. math:: \frac{\rho_r}{\rho(p)} = (1 - \alpha) \left(1 + \frac{K' (p - p_r)}{K_r}\right)^{-1/K'}
          + \alpha \left(\frac{p_r}{p}\right)^{1/n}

The liquid's own bulk modulus K_r + K'(p - p_r) is linear in the pressure [Murnaghan1944]_; the mixture's, rho / rho',
is the effective one, small at low pressure [Merritt1967]_. A chamber written in terms of rho closes its mass balance
whatever K is.

Flow through an orifice is turbulent, C A sqrt(2 rho dp), and goes over to a laminar one, linear in dp, where the
Reynolds number falls to its critical value:

.. math:: \dot m = C A \sqrt{2 \rho} \, \frac{\Delta p}{(\Delta p^2 + p_c^2)^{1/4}}, \qquad
          p_c = \frac{1}{2 \rho_r} \left(\frac{Re_c \, \mu}{D}\right)^2, \quad D = \sqrt{4 C A / \pi}

so, unlike that of a gas, its slope is finite where the pressures meet. Temperature has no part here.

.. [Murnaghan1944] F. D. Murnaghan, "The compressibility of media under extreme pressures", PNAS 30, 1944.
.. [Merritt1967] H. E. Merritt, "Hydraulic control systems", Wiley, 1967.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, not_negative, positive, read_only
from ltvpneu._compiled import compiled
from ltvpneu._values import Value
from ltvpneu.physics.gas import Gas, GasConstants
from ltvpneu.physics.properties import LIQUID, Properties

ATMOSPHERE = 101325.0
# Below, p_c is zero in effect, and the slope of the flow would be infinite where the pressures meet.
LEAST_VISCOSITY = 1e-6


@final
@dataclass(frozen=True, kw_only=True)
class Liquid(Value):
    """A liquid with entrained gas; by default mineral oil, ISO VG 32 at 40 degC.

    Parameters
    ----------
    density : float
        Of the mixture at `reference_pressure` [kg/m^3].
    bulk_modulus : float
        K_r of the liquid itself at `reference_pressure` [Pa].
    bulk_modulus_slope : float
        K', its change over pressure [-], zero or more.
    entrained_gas : float
        Share alpha of the volume that undissolved gas takes at `reference_pressure` [-], 0 to below 1.
    gas_exponent : float
        Polytropic exponent n of that gas [-].
    viscosity : float
        mu, dynamic [Pa s].
    critical_reynolds_number : float
        Re_c, at which flow through an orifice goes over from laminar to turbulent [-].
    vapor_pressure : float
        Pressure below which the liquid cavitates [Pa, absolute].
    reference_pressure : float
        p_r [Pa, absolute].
    temperature : float
        [K]; for the record.

    Examples
    --------
    >>> print(f"{Liquid().effective_bulk_modulus(100e5) / 1e9:.2f} GPa")
    1.47 GPa
    """

    density: float = 860.0
    bulk_modulus: float = 1.4e9
    bulk_modulus_slope: float = 10.0
    entrained_gas: float = 0.005
    gas_exponent: float = 1.4
    viscosity: float = 0.0275
    critical_reynolds_number: float = 150.0
    vapor_pressure: float = 2e3
    reference_pressure: float = ATMOSPHERE
    temperature: float = 313.15

    def __post_init__(self) -> None:
        positive("density", self.density, "kg/m^3")
        positive("bulk_modulus", self.bulk_modulus, "Pa")
        not_negative("bulk_modulus_slope", self.bulk_modulus_slope)
        if not 0 <= finite("entrained_gas", self.entrained_gas) < 1:
            raise ValueError(
                f"entrained_gas: found {self.entrained_gas:g}, expected a share of the volume, 0 to below 1"
            )
        positive("gas_exponent", self.gas_exponent)
        if positive("viscosity", self.viscosity, "Pa s") < LEAST_VISCOSITY:
            raise ValueError(
                f"viscosity: found {self.viscosity:g} Pa s, expected {LEAST_VISCOSITY:g} Pa s or more (water: 1e-3); "
                "is it a kinematic one, in m^2/s? Multiply it by the density"
            )
        positive("critical_reynolds_number", self.critical_reynolds_number)
        positive("vapor_pressure", self.vapor_pressure, "Pa")
        positive("reference_pressure", self.reference_pressure, "Pa")
        positive("temperature", self.temperature, "K")
        if self.bulk_modulus_slope * self.reference_pressure >= self.bulk_modulus:
            raise ValueError(
                f"bulk_modulus_slope: found {self.bulk_modulus_slope:g}, with which the bulk modulus falls to zero "
                "above vacuum; expected less than bulk_modulus / reference_pressure"
            )

    @property
    def kind(self) -> int:
        """Which laws the compiled kernels take."""
        return LIQUID

    @property
    def limits(self) -> str:
        """Where the laws hold, in words."""
        return f"above the vapor pressure {self.vapor_pressure:g} Pa"

    @property
    def constants(self) -> GasConstants:
        """Constants of air, which kernels pass on and no law of a liquid reads."""
        return Gas().constants

    @cached_property
    def table(self) -> FloatArray:
        """Parameters as the compiled laws read them."""
        return read_only(
            np.array(
                [
                    self.density, self.bulk_modulus, self.bulk_modulus_slope, self.entrained_gas,
                    1.0 / self.gas_exponent, self.reference_pressure,
                    self.critical_reynolds_number * self.viscosity, self.vapor_pressure,
                ],
                dtype=np.float64,
            )
        )  # fmt: skip

    def effective_bulk_modulus(self, pressure: float) -> float:
        """Return rho / (d rho / dp) of the mixture [Pa] at a pressure [Pa, absolute]."""
        found = liquid_properties(float(positive("pressure", pressure, "Pa")), self.table)
        return found.rho / found.rho_p


@compiled
def liquid_properties(pressure: float, table: FloatArray) -> Properties:
    """Density and its derivatives over the pressure; all else is zero."""
    density, K, slope, share, inverse, reference = table[0], table[1], table[2], table[3], table[4], table[5]
    rise = pressure - reference
    own = K + slope * rise
    # v_l' / v_l = -1 / K(p), so its second derivative is v_l (1 + K') / K(p)^2.
    murnaghan = (own / K) ** (-1.0 / slope) if slope > 0.0 else math.exp(-rise / K)
    liquid = (1.0 - share) * murnaghan
    gas = share * (reference / pressure) ** inverse
    v = liquid + gas
    v_p = -liquid / own - inverse * gas / pressure
    v_pp = liquid * (1.0 + slope) / (own * own) + inverse * (inverse + 1.0) * gas / (pressure * pressure)
    rho = density / v
    rho_p = -rho * v_p / v
    rho_pp = rho * (2.0 * v_p * v_p / (v * v) - v_pp / v)
    return Properties(rho, rho_p, 0.0, rho_pp, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@compiled
def vapor_pressure(table: FloatArray) -> float:
    """Pressure below which the liquid cavitates [Pa]."""
    return table[7]


@compiled
def liquid_in_range(pressure: float, table: FloatArray) -> bool:
    """Whether a liquid stays one: above its vapor pressure."""
    return pressure > vapor_pressure(table)


@compiled
def liquid_flow_slopes(
    area: float, upstream: float, downstream: float, table: FloatArray
) -> tuple[float, float, float]:
    """Mass flow through an orifice of an effective area [kg/s], and its slopes over both pressures [kg/(s Pa)].

    `upstream` is not below `downstream`; the density is that upstream.
    """
    if area == 0.0:
        return 0.0, 0.0, 0.0
    found = liquid_properties(upstream, table)
    fall = upstream - downstream
    diameter = math.sqrt(4.0 * area / math.pi)
    transition = (table[6] / diameter) ** 2 / (2.0 * table[0])
    size = fall * fall + transition * transition
    root = size**0.25
    factor = area * math.sqrt(2.0 * found.rho)
    flow = factor * fall / root
    by_fall = factor / root * (1.0 - 0.5 * fall * fall / size)
    return flow, by_fall + 0.5 * flow * found.rho_p / found.rho, -by_fall
