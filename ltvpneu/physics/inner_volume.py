"""Inner volume of a valve as a chamber of its own: V_2 in Table 1 of [Kunt1990]_, one of the paper's N_c volumes."""

from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import positive
from ltvpneu._values import Value
from ltvpneu.physics.thermal import EnergyBalance


@final
@dataclass(frozen=True, kw_only=True)
class InnerVolume(Value):
    """A volume inside a rotary valve, into which its ports open.

    Parameters
    ----------
    volume : float
        [m^3]
    name : str
        As its ports name it.
    polytropic_exponent : float
        n [-]; 1 is isothermal.
    energy_balance : EnergyBalance or None
        Instead of an exponent: the temperature is a state.
    """

    volume: float
    name: str = "valve"
    polytropic_exponent: float = 1.0
    energy_balance: EnergyBalance | None = None

    def __post_init__(self) -> None:
        positive("volume", self.volume, "m^3")
        positive("polytropic_exponent", self.polytropic_exponent)
        check_one_process("", self.polytropic_exponent, self.energy_balance)


def check_one_process(suffix: str, exponent: float, balance: EnergyBalance | None) -> None:
    """Raise where a volume has both a polytropic exponent and an energy balance."""
    if balance is not None and exponent != 1.0:
        raise ValueError(
            f"polytropic_exponent{suffix}: found {exponent:g} beside energy_balance{suffix}, expected one of them: "
            "either the exponent ties the temperature to the pressure, or the energy balance says what it is"
        )
