"""Tube between a valve and a chamber: its volume, and what it lets through."""

import math
from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import positive
from ltvpneu._values import Value
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.iso6358 import ANR_DENSITY, ANR_TEMPERATURE, ISO6358

ENDS = 1.5
"""Loss where the air enters and leaves a tube, in dynamic pressures [-]."""


@final
@dataclass(frozen=True, kw_only=True)
class Tube(Value):
    """A tube, hose or pipe.

    Parameters
    ----------
    length, inner_diameter : float
        [m]
    friction_factor : float
        f of Darcy's law [-]; 0.02 is that of a smooth tube at a Reynolds number of 6e4.

    Examples
    --------
    >>> tube = Tube(length=1.0, inner_diameter=0.004)
    >>> print(f"{tube.volume * 1e6:.1f} cm^3, {tube.law.sonic_conductance * 1e8:.2f} dm^3/(s bar)")
    12.6 cm^3, 1.43 dm^3/(s bar)
    """

    length: float
    inner_diameter: float
    friction_factor: float = 0.02

    def __post_init__(self) -> None:
        positive("length", self.length, "m")
        positive("friction_factor", self.friction_factor)
        if positive("inner_diameter", self.inner_diameter, "m") >= 0.5:
            raise ValueError(
                f"inner_diameter: found {self.inner_diameter:g} m, expected less than 0.5 m (4 mm is 0.004 m)"
            )

    @property
    def volume(self) -> float:
        """What it holds [m^3]."""
        return math.pi / 4 * self.inner_diameter**2 * self.length

    @property
    def law(self) -> ISO6358:
        """The tube as a restriction: isothermal, turbulent flow with a constant friction factor.

        Darcy's law and the losses at its ends give q = A sqrt((p_1^2 - p_2^2) / (R T z)) with z = f L / d + 1.5, which
        is the curve of ISO 6358 with b = 0.
        """
        loss = self.friction_factor * self.length / self.inner_diameter + ENDS
        root = math.sqrt(Gas().specific_gas_constant * ANR_TEMPERATURE * loss)
        area = math.pi / 4 * self.inner_diameter**2
        return ISO6358(sonic_conductance=area / (ANR_DENSITY * root), critical_pressure_ratio=0.0)
