"""Load: moving mass, spring, viscous and dry friction, an external force; M_t x'' = F_e - F_f, (7a) with erratum E3."""

from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import finite, not_negative, positive
from ltvpneu._values import Value


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
        External force on the piston, towards higher positions [N]: weight, preload.
    """

    mass: float
    spring_stiffness: float = 0.0
    viscous_damping: float = 0.0
    dry_friction: float = 0.0
    stiction: float = 0.0
    force: float = 0.0

    def __post_init__(self) -> None:
        positive("mass", self.mass, "kg")
        not_negative("spring_stiffness", self.spring_stiffness, "N/m")
        not_negative("viscous_damping", self.viscous_damping, "N s/m")
        not_negative("dry_friction", self.dry_friction, "N")
        not_negative("stiction", self.stiction, "N")
        finite("force", self.force, "N")
