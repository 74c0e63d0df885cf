"""A machine as the compiled kernels read it: one record of named numbers.

Kernels are compiled once for each type of their arguments. A record's type is its layout, so there are two types of
machine: the paper's, and the general one, whose record has a medium beside. What only the general machine needs is
compiled when one is used.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple, cast

import numpy as np

from ltvpneu._arrays import layout
from ltvpneu._compiled import by_field, inlined
from ltvpneu.physics.gas import GasConstants, GasState
from ltvpneu.physics.iso6358 import PathLaw
from ltvpneu.physics.medium import MediumFields
from ltvpneu.physics.properties import LIQUID

MAX_VOLUMES, MAX_PATHS = 8, 16
"""Most volumes and flow paths that a machine may have: the room in its record."""
MAX_STATES = 2 + 2 * MAX_VOLUMES
"""Position, velocity, and a pressure and a temperature for each volume."""

SUPPLY, EXHAUST = -1, -2
"""What feeds a path, where that is no volume; -1 - SUPPLY and -1 - EXHAUST are their columns among the inputs."""
INPUTS = ("supply_pressure", "exhaust_pressure", "load_force", "ambient_pressure")
"""What a machine's linear models are driven by, in the order of their columns."""
N_INPUTS, LOAD_FORCE, AMBIENT = 4, 2, 3
"""Their number, and the columns of those that are no source of a path."""


class LoadFields(NamedTuple):
    """The load, and the cylinder's other side."""

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


class VolumeFields(NamedTuple):
    """A volume: one of the cylinder's chambers, or one inside a valve."""

    size: float
    """At position zero [m^3]."""
    slope: float
    """Of the size over the position [m^2]."""
    polytropic_exponent: float
    push_area: float
    """Force on the piston over the pressure [m^2]."""
    conductance: float
    """To its wall [W/K]."""
    wall_temperature: float
    temperature_place: int
    """Where in the state its temperature is; -1 where that follows from the pressure."""
    friction_area: float
    """Dry friction of the seals over the pressure's excess over the ambient one [m^2]."""


class PathFields(NamedTuple):
    """A flow path."""

    volume: int
    """Volume that it leads to."""
    source: int
    """Volume that feeds it, or `SUPPLY` or `EXHAUST`."""


class MachineRecord:
    """A machine of the paper: ideal gas, no temperature a state, no path between volumes."""

    load: LoadFields
    gas: GasConstants
    supply: GasState
    exhaust: GasState
    n_volumes: int
    n_paths: int
    volumes: Annotated[Sequence[VolumeFields], MAX_VOLUMES]
    """The cylinder's chambers, then volumes inside a valve."""
    paths: Annotated[Sequence[PathFields], MAX_PATHS]


class GeneralRecord(MachineRecord):
    """Any machine."""

    medium: MediumFields
    laws: Annotated[Sequence[PathLaw], MAX_PATHS]
    """Of the paths."""


PLAIN, GENERAL = layout(MachineRecord), layout(GeneralRecord)


def filled(kind: np.dtype[Any], values: Mapping[str, Any]) -> MachineRecord:
    """Return a record of a layout, with values by name; of arrays, as many as there are, and their number."""
    found = np.zeros(1, kind)
    for name, value in values.items():
        if isinstance(value, list):
            items: list[Any] = value
            if f"n_{name}" in (kind.names or ()):
                found[f"n_{name}"] = len(items)
            found[name][0, : len(items)] = items
        else:
            found[name] = value
    found.setflags(write=False)
    # The type is that which kernels see; from Python its fields are read by their names in brackets.
    return cast(MachineRecord, found[0])


def _general_place(k: int, machine: GeneralRecord) -> int:
    return machine.volumes[k].temperature_place


def _no_place(k: int, machine: MachineRecord) -> int:
    return -1


temperature_place = by_field("medium", "machine", _general_place, _no_place)
"""Where in the state the temperature of volume k is; -1 where it follows from the pressure."""


def _may_be_liquid(machine: GeneralRecord) -> bool:
    return machine.medium.kind == LIQUID


def _is_gas(machine: MachineRecord) -> bool:
    return False


is_liquid = by_field("medium", "machine", _may_be_liquid, _is_gas)
"""Whether the machine is driven by a liquid."""


@inlined
def source_state(source: int, machine: MachineRecord) -> GasState:
    """Return pressure [Pa] and temperature [K] of the supply or of the exhaust."""
    if source == SUPPLY:
        return GasState(machine.supply.pressure, machine.supply.temperature)
    return GasState(machine.exhaust.pressure, machine.exhaust.temperature)
