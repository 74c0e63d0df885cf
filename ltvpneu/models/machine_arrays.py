"""A machine as the compiled kernels read it: plain numbers and arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, read_only
from ltvpneu._compiled import inlined
from ltvpneu.models.connections import Connection
from ltvpneu.physics.gas import GasConstants, GasState
from ltvpneu.physics.medium import MediumArrays
from ltvpneu.physics.profile import merge_angles

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


LEAST_JUMP = 1e-9
"""Relative change of an area that counts as a jump [-]; where pieces of a ramp meet, rounding makes smaller ones."""


class OpeningTable(NamedTuple):
    """Effective areas over the turn, linear between switching instants, as the compiled kernels read them."""

    fractions: FloatArray
    """Piece ends as shares of the period, from 0 to 1, shape (n_pieces + 1,)."""
    areas: FloatArray
    """First area at start and end, second at start and end [m^2], per piece and path; (n_pieces, 4, n_paths)."""
    rises: FloatArray
    """Largest change of any area over each piece, relative to that area's maximum [-], shape (n_pieces,)."""
    jumps: FloatArray
    """Shares of the period at which any area jumps; 0 if one does from the end of the turn to its start."""

    @property
    def ramped(self) -> BoolArray:
        """Whether any area changes within the piece, shape (n_pieces,)."""
        return self.rises > 0


def opening_table(connections: Sequence[Connection]) -> OpeningTable:
    """Return the effective areas of all connections on a common set of pieces."""
    profiles = [p for c in connections for p in (c.first, c.second) if p is not None]
    angles = merge_angles(*(profile.angles for profile in profiles))
    areas = np.full((angles.size - 1, 4, len(connections)), np.inf)
    for number, connection in enumerate(connections):
        for row, profile in ((0, connection.first), (2, connection.second)):
            if profile is not None:
                cut = profile.refined(angles)
                areas[:, row, number] = cut.starts
                areas[:, row + 1, number] = cut.ends
    fractions = angles / angles[-1]
    at_start, at_end = areas[:, (0, 2)], areas[:, (1, 3)]
    # An absent second restriction is infinite throughout, a path never open zero throughout: neither changes.
    with np.errstate(invalid="ignore"):
        largest = np.max(areas, axis=0)[(0, 2),]
        rises = np.nan_to_num(np.abs(at_end - at_start) / largest)
        jumps = np.nan_to_num(np.abs(at_start - np.roll(at_end, 1, axis=0)) / largest) > LEAST_JUMP
    return OpeningTable(
        read_only(fractions),
        read_only(areas),
        read_only(np.max(rises, axis=(1, 2))),
        read_only(fractions[:-1][jumps.any(axis=(1, 2))]),
    )
