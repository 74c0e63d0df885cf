"""Cylinder: what a chamber's volume and push are over the piston position.

V_1 = V_01 + A_p1 x grows with the position, V_2 = V_02 - A_p2 x shrinks; the push is (7b) with erratum E4, F = (A_p1
- C_p) p_1 - (A_p2 + C_p) p_2, where C_p acts as a change of area. A side without a dead volume is not a chamber: it
stands open to the ambient air, and p_k is the ambient pressure p_a there.

The paper leaves out that the ambient air pushes on rods too. A rod of cross-section R_1 leaves through the end of
chamber 1, where the air pushes it towards higher positions, one of R_2 through the other end, so

.. math:: F = (A_{p1} - C_p) p_1 - (A_{p2} + C_p) p_2 + (R_1 - R_2) p_a

Piston and rods are one body that the same pressure all round does not move: A_p1 + R_1 = A_p2 + R_2, both being the
area of the bore. So rods follow from the difference of the piston areas where they are not given.
"""

import math
from dataclasses import dataclass, replace
from typing import final

from ltvpneu._arrays import finite, not_negative, positive
from ltvpneu._values import Value
from ltvpneu.physics.inner_volume import check_one_process
from ltvpneu.physics.thermal import EnergyBalance

ATMOSPHERE = 101325.0
"""One standard atmosphere [Pa]: the ambient pressure where none is given."""
ROUNDED = 0.01
"""Share of a rod's area by which areas of a data sheet may miss each other [-]."""


@final
@dataclass(frozen=True, kw_only=True)
class Cylinder(Value):
    """A cylinder with one or two chambers.

    Parameters
    ----------
    piston_area_1, piston_area_2 : float
        A_p1, A_p2 [m^2].
    dead_volume_1, dead_volume_2 : float or None
        V_01, V_02, the chambers' volumes at position zero [m^3]; None where that side is open to the ambient air.
    seal_friction_area : float
        C_p [m^2], a change of area, either sign.
    polytropic_exponent_1, polytropic_exponent_2 : float
        n_1, n_2 [-]; 1 is isothermal, the heat capacity ratio adiabatic and reversible.
    energy_balance_1, energy_balance_2 : EnergyBalance or None
        Instead of an exponent: the chamber's temperature is a state.
    lower_stop, upper_stop : float
        Positions of the end stops [m], where the piston lands without rebound; infinite where there are none, as in
        the paper.
    rod_area_1, rod_area_2 : float or None
        Cross-sections of the rods that leave through the ends of side 1 and side 2 [m^2]. None is what makes both sides
        of the piston as large with their rods: the difference of the piston areas, and the other rod's where that is
        given (to within a hundredth of it: data sheets round). Given both, they are taken as they are.
    is_absent : bool
        Of a machine of rigid volumes alone: see `Cylinder.absent`.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> cylinder = lp.Cylinder(piston_area_1=8.04e-4, piston_area_2=6.91e-4, dead_volume_1=4e-5, dead_volume_2=4e-5)
    >>> print("{:.3g} {:.3g} m^2".format(*cylinder.rod_areas))
    0 0.000113 m^2
    """

    piston_area_1: float
    piston_area_2: float
    dead_volume_1: float | None
    dead_volume_2: float | None = None
    seal_friction_area: float = 0.0
    polytropic_exponent_1: float = 1.0
    polytropic_exponent_2: float = 1.0
    energy_balance_1: EnergyBalance | None = None
    energy_balance_2: EnergyBalance | None = None
    lower_stop: float = -math.inf
    upper_stop: float = math.inf
    rod_area_1: float | None = None
    rod_area_2: float | None = None
    is_absent: bool = False

    def __post_init__(self) -> None:
        for side in (1, 2):
            positive(f"piston_area_{side}", getattr(self, f"piston_area_{side}"), "m^2")
            volume = getattr(self, f"dead_volume_{side}")
            if volume is not None:
                positive(f"dead_volume_{side}", volume, "m^3")
            exponent, balance = self.process(f"chamber_{side}")
            positive(f"polytropic_exponent_{side}", exponent)
            check_one_process(f"_{side}", exponent, balance)
        finite("seal_friction_area", self.seal_friction_area, "m^2")
        self._check_rods()
        if self.dead_volume_1 is None and self.dead_volume_2 is None and not self.is_absent:
            raise ValueError("dead_volume_1, dead_volume_2: found neither, expected at least one chamber")
        if math.isnan(self.lower_stop) or math.isnan(self.upper_stop) or self.lower_stop >= self.upper_stop:
            raise ValueError(
                f"lower_stop, upper_stop: found {self.lower_stop:g} m and {self.upper_stop:g} m, expected the lower "
                "below the upper"
            )
        self._check_stop_volumes()

    @staticmethod
    def absent() -> "Cylinder":
        """Return what stands for the cylinder in a machine of rigid volumes alone: a piston that nothing moves."""
        return Cylinder(
            piston_area_1=1e-6, piston_area_2=1e-6, dead_volume_1=None, lower_stop=0.0, upper_stop=1e-9, is_absent=True
        )

    def _check_rods(self) -> None:
        for side, given in ((1, self.rod_area_1), (2, self.rod_area_2)):
            if given is None:
                continue
            other = self.rod_areas[2 - side]
            not_negative(f"rod_area_{side}", given, "m^2")
            if other < 0:
                raise ValueError(
                    f"rod_area_{side}: found {given:g} m^2, expected at least {given - other:g} m^2: with its rod this "
                    f"side is smaller than the other side's piston area; or give rod_area_{3 - side} too"
                )

    def _check_stop_volumes(self) -> None:
        if self.dead_volume_1 is not None and math.isfinite(self.lower_stop):
            positive(
                "dead_volume_1 at the lower stop",
                self.dead_volume_1 + self.piston_area_1 * self.lower_stop,
                "m^3",
            )
        if self.dead_volume_2 is not None and math.isfinite(self.upper_stop):
            positive(
                "dead_volume_2 at the upper stop",
                self.dead_volume_2 - self.piston_area_2 * self.upper_stop,
                "m^3",
            )

    @property
    def chambers(self) -> tuple[str, ...]:
        """Names of the sides that are chambers: "chamber_1", "chamber_2"."""
        volumes = (self.dead_volume_1, self.dead_volume_2)
        return tuple(f"chamber_{side}" for side, volume in enumerate(volumes, start=1) if volume is not None)

    def process(self, chamber: str) -> tuple[float, EnergyBalance | None]:
        """Return a chamber's polytropic exponent and its energy balance, of which one counts."""
        side = chamber[-1]
        return getattr(self, f"polytropic_exponent_{side}"), getattr(self, f"energy_balance_{side}")

    def with_process(self, exponent: float, balance: EnergyBalance | None) -> "Cylinder":
        """Return the cylinder with one process in both chambers."""
        return replace(
            self,
            polytropic_exponent_1=exponent,
            polytropic_exponent_2=exponent,
            energy_balance_1=balance,
            energy_balance_2=balance,
        )

    @property
    def rod_areas(self) -> tuple[float, float]:
        """Cross-sections of the rods R_1, R_2 [m^2], given or found from the piston areas."""
        first, second = self.rod_area_1, self.rod_area_2
        excess = self.piston_area_1 - self.piston_area_2
        if first is None:
            first = max(0.0, -excess) if second is None else _other_rod(second, second - excess)
        return first, _other_rod(first, first + excess) if second is None else second

    @property
    def ambient_push_area(self) -> float:
        """Force over the ambient pressure [m^2]: on the rods, and on a side that is no chamber."""
        first, second = self.rod_areas
        open_1 = self.push_area_1 if self.dead_volume_1 is None else 0.0
        open_2 = self.push_area_2 if self.dead_volume_2 is None else 0.0
        return open_1 + open_2 + first - second

    @property
    def push_area_1(self) -> float:
        """Force over pressure 1, A_p1 - C_p [m^2]."""
        return self.piston_area_1 - self.seal_friction_area

    @property
    def push_area_2(self) -> float:
        """Force over pressure 2, -(A_p2 + C_p) [m^2]; printed with the other sign in (7b) (erratum E4)."""
        return -(self.piston_area_2 + self.seal_friction_area)


def _other_rod(given: float, found: float) -> float:
    """Return the rod on the other side, none where the areas of a data sheet leave less than rounding of one."""
    return 0.0 if -ROUNDED * given <= found < 0 else found
