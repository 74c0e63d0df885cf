"""What the equations of a chamber ask of a medium: density and internal energy over pressure and temperature."""

from typing import NamedTuple

IDEAL, REAL, LIQUID = 0, 1, 2
"""Kinds of media, as the compiled kernels tell them apart."""


class Properties(NamedTuple):
    """Density [kg/m^3] and specific internal energy [J/kg], with derivatives over pressure [Pa] and temperature [K]."""

    rho: float
    rho_p: float
    rho_T: float
    rho_pp: float
    rho_pT: float
    rho_TT: float
    u: float
    u_p: float
    u_T: float
    u_pp: float
    u_pT: float
    u_TT: float
