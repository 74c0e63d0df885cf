"""What a machine has to be: its pressures, paths, names and medium, checked together when one is made."""

from typing import TYPE_CHECKING

from ltvpneu._arrays import not_negative, positive
from ltvpneu.models.machine.connections import CHAMBERS, SOURCES, check_ways
from ltvpneu.models.machine.records import MAX_PATHS, MAX_VOLUMES
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.medium import MAX_TABLE, check_process, warn_if_cold
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.valve import RotaryValve

if TYPE_CHECKING:
    from ltvpneu.models.machine.machine import Machine


def check_pressures(machine: "Machine") -> None:
    """Raise unless the pressures are absolute ones that a machine can have."""
    if machine.exhaust_pressure == 0:
        raise ValueError(
            "exhaust_pressure: found 0 Pa, expected a finite number above zero, for pressures are absolute; was "
            "that of the ambient air meant, 0 bar(g)?"
        )
    positive("exhaust_pressure", machine.exhaust_pressure, "Pa")
    not_negative("ambient_pressure", machine.ambient_pressure, "Pa")
    positive("supply_pressure", machine.supply_pressure, "Pa")
    if machine.supply_pressure < machine.exhaust_pressure:
        raise ValueError(
            f"supply_pressure: found {machine.supply_pressure:g} Pa, below the exhaust pressure "
            f"{machine.exhaust_pressure:g} Pa; expected both absolute (a gauge pressure is written with the suffix "
            "(g), as in '3.1 bar(g)')"
        )


def check_connections(machine: "Machine") -> None:
    """Raise unless every path and valve leads somewhere, and every volume is fed."""
    for path in machine.flow_paths:
        if path.valve > len(machine.more_valves):
            raise ValueError(
                f"flow_paths: found a path of valve {path.valve}, expected 0 to {len(machine.more_valves)}, as there "
                f"are {len(machine.more_valves)} more_valves"
            )
        for end in (path.chamber, path.source):
            if end not in (*_places(machine), *(SOURCES if end is path.source else ())):
                raise ValueError(
                    f"flow_paths: found a path to {end!r}, expected one of the cylinder's chambers: "
                    f"{', '.join(machine.cylinder.chambers)}{_tanks(machine)}"
                )
    if machine.collapse != "minimum" and not isinstance(machine.valve, RotaryValve):
        raise ValueError(
            f'collapse: found "{machine.collapse}" of a valve without inner volumes, expected "minimum", or a rotary '
            "valve"
        )
    if isinstance(machine.valve, RotaryValve):
        check_ways(machine.valve, machine.collapse, machine.cylinder.chambers)
    # Raises where the arcs over which a valve is on are not one window.
    for number in {path.valve for path in machine.flow_paths}:
        (machine.valve, *machine.more_valves)[number].on_window()
    fed = {name for ends in machine.ends for name in ends}
    for tank in machine.rigid_volumes:
        if tank.name not in fed:
            raise ValueError(f"flow_paths: no path leads to the rigid volume {tank.name!r}, expected at least one")
    for chamber in machine.cylinder.chambers:
        if chamber not in fed:
            raise ValueError(
                f"flow_paths: no path leads to {chamber}, expected at least one; leave out "
                f"dead_volume_{chamber[-1]} where that side is open to the ambient"
            )


def _places(machine: "Machine") -> tuple[str, ...]:
    """Names of the volumes that flow paths may lead to."""
    return (*machine.cylinder.chambers, *(tank.name for tank in machine.rigid_volumes))


def _tanks(machine: "Machine") -> str:
    """Return the names of the rigid volumes, as the end of a message."""
    names = ", ".join(tank.name for tank in machine.rigid_volumes)
    return f", or of the rigid volumes: {names}" if names else ""


def check_names(machine: "Machine") -> None:
    """Raise unless the rigid volumes have names of their own, which become those of their pressures."""
    taken = [*SOURCES, *CHAMBERS, "1", "2", "valve", *(inner.name for inner in machine.inner_volumes)]
    for number, tank in enumerate(machine.rigid_volumes):
        if tank.name in taken or not tank.name.isidentifier():
            raise ValueError(
                f"rigid_volumes[{number}]: found the name {tank.name!r}, expected a word of its own, such as 'tank'"
            )
        taken.append(tank.name)
    if machine.cylinder.is_absent and not machine.rigid_volumes:
        raise ValueError("rigid_volumes: found none in a machine without a cylinder, expected at least one")


def check_medium(machine: "Machine") -> None:
    """Raise unless the medium suits the pressures, processes and laws of flow."""
    gas, cylinder = machine.gas, machine.cylinder
    warn_if_cold("gas.temperature", gas.temperature)
    processes = [
        *((f"cylinder.polytropic_exponent_{name[-1]}", *cylinder.process(name)) for name in cylinder.chambers),
        *((f"valve.inner_volumes: {v.name}", v.polytropic_exponent, v.energy_balance) for v in machine.inner_volumes),
        *((f"rigid_volumes: {v.name}", v.polytropic_exponent, v.energy_balance) for v in machine.rigid_volumes),
    ]
    for name, exponent, balance in processes:
        check_process(name, exponent, balance, gas)
    for number, path in enumerate(machine.flow_paths):
        if isinstance(gas, Liquid) and path.laws:
            raise ValueError(
                f"flow_paths: found a law of gases in path {number} of a liquid's machine, expected an area and a "
                "discharge coefficient"
            )
    if isinstance(gas, Liquid) and machine.exhaust_pressure <= gas.vapor_pressure:
        raise ValueError(
            f"exhaust_pressure: found {machine.exhaust_pressure:g} Pa, not above the liquid's vapor pressure "
            f"{gas.vapor_pressure:g} Pa: it would cavitate; expected more (pressures are absolute)"
        )
    if isinstance(gas, RealGas):
        gas.expect_inside("supply_pressure", machine.supply_pressure)
        gas.expect_inside("exhaust_pressure", machine.exhaust_pressure)


def check_seals(machine: "Machine") -> None:
    """Raise where dry friction would fall below zero at the exhaust pressure."""
    below = machine.ambient_pressure - machine.exhaust_pressure
    eased = below * (machine.load.friction_area_1 + machine.load.friction_area_2)
    if eased > machine.load.dry_friction:
        raise ValueError(
            f"load.friction_area_1, friction_area_2: found {eased:g} N less friction at the exhaust pressure "
            f"than at the ambient one, more than the dry friction of {machine.load.dry_friction:g} N; expected "
            "smaller areas"
        )


def check_room(machine: "Machine") -> None:
    """Raise unless the machine has room in its record."""
    for what, found, room in (
        ("volumes", len(machine.volumes), MAX_VOLUMES),
        ("flow paths", len(machine.ends), MAX_PATHS),
        ("numbers in the table of its medium", machine.gas.table.size, MAX_TABLE),
    ):
        if found > room:
            raise ValueError(f"machine: found {found} {what}, expected at most {room}")
