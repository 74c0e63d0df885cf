r"""Energy balance of a chamber, whose temperature is then a state.

With the enthalpy flow H into the volume V (each flow carries that of the side it comes from), the mass flow M, and
the heat Q from the wall,

.. math:: \frac{d(\rho V)}{dt} = M, \qquad \frac{d(\rho u V)}{dt} = H + Q - p \dot V, \qquad Q = h A_w (T_w - T)

which for an ideal gas is p' = ((gamma - 1)(H + Q) - gamma p V') / V: an adiabatic tank fills at gamma R T m'/V, an
isothermal one at R T m'/V. The polytropic chamber (3)-(4) of [Kunt1990]_ leaves this balance out and ties the
temperature to the pressure instead.
"""

from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import not_negative, positive
from ltvpneu._values import Value


@final
@dataclass(frozen=True, kw_only=True)
class EnergyBalance(Value):
    """First law for a chamber: adiabatic as it stands, or with heat transfer to a wall.

    Parameters
    ----------
    heat_transfer_coefficient : float
        h [W/(m^2 K)]; 0 is adiabatic.
    wall_area : float
        A_w [m^2].
    wall_temperature : float or None
        T_w [K]; needed where heat is transferred.

    Examples
    --------
    >>> EnergyBalance(heat_transfer_coefficient=60.0, wall_area=0.01, wall_temperature=293.15).conductance
    0.6
    """

    heat_transfer_coefficient: float = 0.0
    wall_area: float = 0.0
    wall_temperature: float | None = None

    def __post_init__(self) -> None:
        not_negative("heat_transfer_coefficient", self.heat_transfer_coefficient, "W/(m^2 K)")
        not_negative("wall_area", self.wall_area, "m^2")
        if self.wall_temperature is not None:
            positive("wall_temperature", self.wall_temperature, "K")
        given = self.heat_transfer_coefficient > 0, self.wall_area > 0, self.wall_temperature is not None
        if any(given) and not all(given):
            names = ("heat_transfer_coefficient", "wall_area", "wall_temperature")
            there = ", ".join(name for name, found in zip(names, given, strict=True) if found)
            missing = ", ".join(name for name, found in zip(names, given, strict=True) if not found)
            raise ValueError(
                f"{missing}: found none beside {there}; heat transfer to a wall needs a coefficient, an area and a "
                "wall temperature, an adiabatic chamber none of them"
            )

    @property
    def conductance(self) -> float:
        """Heat flow over temperature difference, h A_w [W/K]."""
        return self.heat_transfer_coefficient * self.wall_area
