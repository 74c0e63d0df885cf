"""Load: moving mass, spring, viscous and dry friction, an external force; M_t x'' = F_e - F_f, (7a) with erratum E3."""

import math
import warnings
from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import finite, not_negative, positive
from ltvpneu._values import Value

GRAVITY = 9.80665
"""Standard acceleration of free fall [m/s^2]."""


@final
@dataclass(frozen=True, kw_only=True)
class Load(Value):
    """What the piston moves.

    Parameters
    ----------
    mass : float
        M_t [kg].
    spring_stiffness : float
        K_s [N/m]; zero where there is no spring.
    viscous_damping : float
        C_v [N s/m].
    dry_friction, stiction : float
        F_d, F_s [N]; F_s at least F_d in any real seal.
    force : float
        External force on the piston, towards higher positions [N].
    mounting : float
        Angle of the way to higher positions above the horizontal [rad]: the weight of the mass acts along it, pi / 2
        where the piston goes up. The paper's rig lies flat.
    friction_area_1, friction_area_2 : float
        a_1, a_2 [m^2]: dry friction and stiction grow with the pressures that press the seals on, F_d + a_1 (p_1 - p_a)
        + a_2 (p_2 - p_a), p_a being the ambient pressure. Measured on seals of 25 mm: 0.5 to 1.6 N a bar, which is 5 to
        16 mm^2.
    spring_preload : float
        Force of the spring at position zero, towards lower positions [N]; negative where it pushes the other way.
    """

    mass: float
    spring_stiffness: float = 0.0
    viscous_damping: float = 0.0
    dry_friction: float = 0.0
    stiction: float = 0.0
    force: float = 0.0
    mounting: float = 0.0
    spring_preload: float = 0.0
    friction_area_1: float = 0.0
    friction_area_2: float = 0.0

    def __post_init__(self) -> None:
        positive("mass", self.mass, "kg")
        not_negative("spring_stiffness", self.spring_stiffness, "N/m")
        not_negative("viscous_damping", self.viscous_damping, "N s/m")
        not_negative("dry_friction", self.dry_friction, "N")
        not_negative("stiction", self.stiction, "N")
        finite("force", self.force, "N")
        finite("spring_preload", self.spring_preload, "N")
        not_negative("friction_area_1", self.friction_area_1, "m^2")
        not_negative("friction_area_2", self.friction_area_2, "m^2")
        if abs(finite("mounting", self.mounting, "rad")) > math.pi:
            raise ValueError(
                f"mounting: found {self.mounting:g} rad, expected -pi to pi (90 degrees is {math.pi / 2:.4g} rad)"
            )
        if 0 < self.stiction < self.dry_friction:
            warnings.warn(
                f"stiction: found {self.stiction:g} N below the dry friction of {self.dry_friction:g} N; a seal holds "
                "with more than it slides: were the two exchanged?",
                stacklevel=4,
            )

    @staticmethod
    def absent() -> "Load":
        """Return what stands for the load in a machine without a piston: it is pressed on the cylinder's lower stop."""
        return Load(mass=1.0, spring_stiffness=1e4, viscous_damping=200.0, force=-1.0)

    @property
    def constant_force(self) -> float:
        """Force on the piston that depends on nothing, towards higher positions [N]: external, weight, preload."""
        return self.force - self.mass * GRAVITY * math.sin(self.mounting) - self.spring_preload
