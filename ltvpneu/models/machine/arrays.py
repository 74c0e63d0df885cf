"""A machine as the compiled kernels read it: plain numbers and arrays."""

from typing import NamedTuple

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import inlined
from ltvpneu.physics.gas import GasConstants, GasState
from ltvpneu.physics.medium import MediumArrays

SUPPLY, EXHAUST = -1, -2
"""What feeds a path, where that is no volume; -1 - SUPPLY and -1 - EXHAUST are their columns among the inputs."""
INPUTS = ("supply_pressure", "exhaust_pressure", "load_force", "ambient_pressure")
"""What a machine's linear models are driven by, in the order of their columns."""
N_INPUTS, LOAD_FORCE, AMBIENT = 4, 2, 3
"""Their number, and the columns of those that are no source of a path."""
CONDUCTANCE, WALL_TEMPERATURE, TEMPERATURE_PLACE = 4, 5, 6
"""Columns of a machine's table of volumes beyond the paper's."""


class LoadConstants(NamedTuple):
    """What the compiled kernels need of the load and of the cylinder's other side."""

    mass: float
    spring_stiffness: float
    viscous_damping: float
    dry_friction: float
    stiction: float
    force: float
    ambient_push_area: float
    """Force over the ambient pressure, on rods and on the side that is open to it [m^2]."""
    ambient_pressure: float
    lower_stop: float
    upper_stop: float


class MachineArrays(NamedTuple):
    """A machine as the compiled kernels read it. Volumes are the cylinder's chambers, then those inside a valve."""

    gas: GasConstants
    load: LoadConstants
    supply: GasState
    exhaust: GasState
    chambers: FloatArray
    """Each volume: size at position zero [m^3], its slope over position [m^2], polytropic exponent, push area [m^2],
    conductance to its wall [W/K], the wall's temperature [K], and where in the state its temperature is, -1 where that
    follows from the pressure; shape (n_volumes, 7)."""
    paths: IntArray
    """Volume that each path leads to, and the volume that feeds it, or `SUPPLY` or `EXHAUST`; shape (n_paths, 2)."""
    medium: MediumArrays
    plain: bool
    """Whether all is as in the paper: ideal gas, no temperature a state, no path between volumes."""


@inlined
def temperature_place(k: int, machine: MachineArrays) -> int:
    """Return where in the state the temperature of volume k is; -1 where it follows from the pressure."""
    return int(machine.chambers[k, TEMPERATURE_PLACE])
