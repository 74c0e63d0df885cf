"""A machine: medium, cylinder, load, flow paths and valve, as one checked value.

Which volume feeds which through what opening is data, so single- and double-acting cylinders, 2/2, 3/2 and 5/2 valves,
rotary valves, bleed orifices and leakage past the piston are the same code.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast, final

import numpy as np

from ltvpneu._arrays import FloatArray, positive, read_only
from ltvpneu._values import Value
from ltvpneu.models.machine.checks import (
    check_connections,
    check_medium,
    check_names,
    check_pressures,
    check_room,
    check_seals,
)
from ltvpneu.models.machine.connections import (
    COLLAPSES,
    Collapse,
    Connection,
    FlowPath,
    Route,
    routes_through,
    through_valve,
)
from ltvpneu.models.machine.machine_toml import machine_toml
from ltvpneu.models.machine.openings import OpeningTable, opening_table
from ltvpneu.models.machine.records import (
    EXHAUST,
    GENERAL,
    INPUTS,
    PLAIN,
    SUPPLY,
    LoadFields,
    MachineRecord,
    PathFields,
    VolumeFields,
    filled,
)
from ltvpneu.physics.cylinder import ATMOSPHERE, Cylinder
from ltvpneu.physics.gas import Gas, GasState
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.iso6358 import NOZZLES, PathLaw
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.load import Load
from ltvpneu.physics.medium import LAMINAR, MAX_TABLE, Medium, MediumFields
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import Command, ProportionalValve
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.thermal import EnergyBalance
from ltvpneu.physics.valve import RotaryValve
from ltvpneu.physics.window import Pulses, Window

NO_PISTON_LENGTH = 0.01
"""Scale of the position where there is no piston, which then stays at zero [m]."""
Valve = RotaryValve | OnOffValve | ProportionalValve


@final
@dataclass(frozen=True, kw_only=True)
class Machine(Value):
    """A drive, pneumatic or hydraulic, switched by an on-off valve or moved by a proportional one.

    Parameters
    ----------
    name : str
    supply_pressure, exhaust_pressure : float
        p_3, p_4 [Pa, absolute].
    ambient_pressure : float
        Of the air around the machine [Pa, absolute]. It pushes on rods, and on the side of the piston that is no
        chamber.
    cylinder : Cylinder
    load : Load
    valve : RotaryValve, OnOffValve or ProportionalValve
    flow_paths : tuple of FlowPath
        Paths beside the ports of a rotary valve; all of them where the valve is of another kind.
    gas : Gas, RealGas or Liquid
        The medium.
    more_valves : tuple of OnOffValve
        Further valves, of flow paths that name them by number; all turn at the same frequency.
    collapse : {"minimum", "in_series", "dynamic"}
        How the inner volume of a rotary valve is collapsed to a point: by the smaller effective area (2), or by solving
        for the pressure between two restrictions that pass the same flow. "dynamic" keeps it as a volume of its own,
        with a pressure of its own, of the size that the valve's `inner_volumes` give.
    rigid_volumes : tuple of InnerVolume
        Tanks, grippers, tubes: volumes of a fixed size, by names that flow paths lead to.
    switching_frequency : float or None
        At which its valves switch [Hz]: it turns delays in seconds into angles. Functions that take a frequency set it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990").with_duty(0.3).with_supply_pressure(5e5)
    >>> machine.duty, machine.states
    (0.3, ('position', 'velocity', 'pressure_1'))
    """

    name: str
    supply_pressure: float
    exhaust_pressure: float
    cylinder: Cylinder
    load: Load
    valve: Valve
    flow_paths: tuple[FlowPath, ...] = ()
    gas: Medium = Gas()  # noqa: RUF009 - a frozen value
    more_valves: tuple[OnOffValve | ProportionalValve, ...] = ()
    collapse: Collapse = "minimum"
    ambient_pressure: float = ATMOSPHERE
    rigid_volumes: tuple[InnerVolume, ...] = ()
    switching_frequency: float | None = None

    def __post_init__(self) -> None:
        check_pressures(self)
        if self.collapse not in COLLAPSES:
            raise ValueError(f'collapse: found {self.collapse!r}, expected "minimum", "in_series" or "dynamic"')
        if self.switching_frequency is not None:
            positive("switching_frequency", self.switching_frequency, "Hz")
        check_connections(self)
        check_names(self)
        check_medium(self)
        check_seals(self)
        check_room(self)

    # What a user turns
    # -------------------------------------------------------------------------------------------------

    def with_duty(self, duty: float) -> "Machine":
        """Return the machine with the open window [0, 2 pi duty], 0 <= duty <= 1, whatever the valve's geometry."""
        return replace(self, valve=self.valve.with_duty(duty))

    def at(self, frequency: float) -> "Machine":
        """Return the machine as its valves switch at a frequency [Hz]; without delays in seconds that is itself."""
        if not self.has_switching_times or frequency == self.switching_frequency:
            return self
        return replace(self, switching_frequency=positive("frequency", frequency, "Hz"))

    def open_share(self, frequency: float) -> float:
        """Return the share of the period for which its valve is open at a frequency [Hz]: the duty less the delays."""
        if isinstance(self.valve, OnOffValve):
            return self.valve.open_share(positive("frequency", frequency, "Hz"))
        return self.duty

    def with_offset(self, offset_angle: float) -> "Machine":
        """Return the machine with offset angle theta_s [rad] between the valve's stator and housing.

        Raises
        ------
        ValueError
            The valve is not a rotary one, or the angle lies outside -pi to pi.
        """
        if not isinstance(self.valve, RotaryValve):
            raise ValueError("with_offset: found an on-off valve, expected a rotary valve; use with_duty")
        return replace(self, valve=self.valve.with_offset(offset_angle))

    def with_pulses(self, pulses: Sequence[tuple[float, float]]) -> "Machine":
        """Return the machine with its valve on from angle to angle [rad], once or several times a turn.

        Parameters
        ----------
        pulses : sequence of (float, float)
            Where each pulse opens and closes, rising; the last may close past the end of the turn.

        Raises
        ------
        ValueError
            The angles do not rise, or go round more than once.
        """
        return replace(self, valve=self.valve.with_pulses(pulses))

    def with_supply_pressure(self, pressure: float) -> "Machine":
        """Return the machine at another supply pressure [Pa, absolute]."""
        return replace(self, supply_pressure=pressure)

    def with_command(self, command: Command) -> "Machine":
        """Return the machine with its proportional valve following another command.

        Raises
        ------
        ValueError
            The valve is not a proportional one.
        """
        if not isinstance(self.valve, ProportionalValve):
            raise ValueError("with_command: found a valve that switches, expected a proportional one; use with_duty")
        return replace(self, valve=self.valve.with_command(command))

    def with_gas(self, medium: Medium) -> "Machine":
        """Return the machine with another medium: `Gas`, `RealGas` or `Liquid`."""
        asked: Any = medium
        if not isinstance(asked, Gas | RealGas | Liquid):
            hint = f'; RealGas(fluid="{asked}")?' if isinstance(asked, str) else ""
            raise TypeError(f"medium: found {asked!r}, expected a Gas, a RealGas or a Liquid{hint}")
        return replace(self, gas=medium)

    def with_collapse(self, collapse: Collapse) -> "Machine":
        """Return the machine with its rotary valve's inner volume collapsed in another way, or kept: "dynamic"."""
        return replace(self, collapse=collapse)

    def with_thermal(self, process: str | float | EnergyBalance) -> "Machine":
        """Return the machine with one thermal process in all its volumes.

        Parameters
        ----------
        process : {"isothermal", "adiabatic"}, float or EnergyBalance
            A number is a polytropic exponent. "adiabatic" is the energy balance without heat from the wall.

        Raises
        ------
        ValueError
            Another name.
        """
        if process == "isothermal":
            process = 1.0
        elif process == "adiabatic":
            process = EnergyBalance()
        elif not isinstance(process, int | float | EnergyBalance):
            raise ValueError(
                f'process: found {process!r}, expected "isothermal", "adiabatic", a polytropic exponent or an '
                "EnergyBalance"
            )
        exponent, balance = (1.0, process) if isinstance(process, EnergyBalance) else (float(process), None)
        tanks = tuple(
            replace(tank, polytropic_exponent=exponent, energy_balance=balance) for tank in self.rigid_volumes
        )
        machine = replace(self, cylinder=self.cylinder.with_process(exponent, balance), rigid_volumes=tanks)
        if not isinstance(self.valve, RotaryValve):
            return machine
        inner = tuple(
            replace(volume, polytropic_exponent=exponent, energy_balance=balance) for volume in self.valve.inner_volumes
        )
        return replace(machine, valve=replace(self.valve, inner_volumes=inner))

    def without_dry_friction(self) -> "Machine":
        """Return the machine with neither dry friction nor stiction; viscous damping stays."""
        free = replace(self.load, dry_friction=0.0, stiction=0.0, friction_area_1=0.0, friction_area_2=0.0)
        return replace(self, load=free)

    def to_toml(self) -> str:
        """Return the machine as the text of a machine file, in SI units, which `load_machine` reads as its equal.

        Examples
        --------
        >>> import ltvpneu as lp
        >>> text = lp.load_machine("kunt_singh_1990").with_duty(0.38).to_toml()
        >>> [line for line in text.splitlines() if line.startswith("duty")]
        ['duty = 0.38']
        """
        return machine_toml(self)

    # What the models read
    # ----------------------------------------------------------------------------------------------

    @cached_property
    def identifier(self) -> str:
        """The name as python-control accepts it for a system: letters, digits and underscores."""
        return "".join(c if c.isalnum() else "_" for c in self.name)

    @property
    def duty(self) -> float:
        """Commanded on-time of the valve over the period [-]; `open_share` counts its delays in."""
        return self.valve.on_window().width / (2 * math.pi)

    @property
    def has_dry_friction(self) -> bool:
        """Whether the piston can stick."""
        load = self.load
        return max(load.dry_friction, load.stiction, load.friction_area_1, load.friction_area_2) > 0

    @property
    def has_stops(self) -> bool:
        """Whether the cylinder has an end stop, or two."""
        return math.isfinite(self.cylinder.lower_stop) or math.isfinite(self.cylinder.upper_stop)

    @property
    def inner_volumes(self) -> tuple[InnerVolume, ...]:
        """Volumes inside the valve that are chambers of their own, in the order of its ports."""
        if self.collapse != "dynamic" or not isinstance(self.valve, RotaryValve):
            return ()
        sizes = {inner.name: inner for inner in self.valve.inner_volumes}
        return tuple(sizes[name] for name in self.valve.volumes)

    @cached_property
    def volumes(self) -> tuple[str, ...]:
        """Names of all volumes with a pressure of their own: the cylinder's chambers, the valve's, rigid ones."""
        return (*self.cylinder.chambers, *(fixed.name for fixed in self._fixed_volumes))

    @property
    def _fixed_volumes(self) -> tuple[InnerVolume, ...]:
        return (*self.inner_volumes, *self.rigid_volumes)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states.

        Position [m], velocity [m/s], the volumes' pressures [Pa, absolute], then the temperatures [K] of those with an
        energy balance.
        """
        inner = [volume.name for volume in self.inner_volumes]
        labels = [name[-1] for name in self.cylinder.chambers] + (["valve"] if len(inner) == 1 else inner)
        labels += [tank.name for tank in self.rigid_volumes]
        pressures = [f"pressure_{label}" for label in labels]
        temperatures = [
            f"temperature_{label}" for label, balance in zip(labels, self._balances, strict=True) if balance is not None
        ]
        return ("position", "velocity", *pressures, *temperatures)

    @property
    def n_volumes(self) -> int:
        """Number of volumes with a pressure of their own; their pressures are states 2 to n_volumes + 1."""
        return len(self.volumes)

    @cached_property
    def _balances(self) -> tuple[EnergyBalance | None, ...]:
        cylinder = self.cylinder
        return (
            *(cylinder.process(name)[1] for name in cylinder.chambers),
            *(fixed.energy_balance for fixed in self._fixed_volumes),
        )

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: three pressures [Pa, absolute] and the load force [N], towards higher positions."""
        return INPUTS

    @cached_property
    def levels(self) -> FloatArray:
        """Values of the inputs, shape (4,)."""
        given = (self.supply_pressure, self.exhaust_pressure, self.load.constant_force, self.ambient_pressure)
        return read_only(np.array(given, dtype=np.float64))

    @cached_property
    def _routes(self) -> tuple[Route, ...]:
        if not isinstance(self.valve, RotaryValve):
            return ()
        return routes_through(self.valve, self.collapse, self.cylinder.chambers)

    @cached_property
    def ends(self) -> tuple[tuple[str, str], ...]:
        """Source and volume of each of the connections, which cost a profile each."""
        through = [(route.source, route.chamber) for route in self._routes]
        return (*through, *((path.source, path.chamber) for path in self.flow_paths))

    @cached_property
    def connections(self) -> tuple[Connection, ...]:
        """Every path of flow, with its effective areas over the turn."""
        found = [through_valve(route, cast(RotaryValve, self.valve), self.collapse) for route in self._routes]
        on = [self._open_window(valve) for valve in (self.valve, *self.more_valves)]
        for path in self.flow_paths:
            found.append(path.connection(on[path.valve]))
        return tuple(found)

    @property
    def has_switching_times(self) -> bool:
        """Whether a valve has delays or travel times in seconds."""
        return any(isinstance(valve, OnOffValve) and valve.has_times for valve in (self.valve, *self.more_valves))

    def _open_window(self, valve: Valve) -> Window | Pulses | Command:
        if not isinstance(valve, OnOffValve) or not valve.has_times:
            return valve.on_window()
        if self.switching_frequency is None:
            raise ValueError(
                "valve: found times in seconds, whose angles depend on the switching frequency; expected "
                "machine.at(frequency)"
            )
        return valve.open_window(self.switching_frequency)

    @cached_property
    def openings(self) -> OpeningTable:
        """Effective areas of all connections on a common set of pieces."""
        return opening_table(self.connections)

    @cached_property
    def volume_fields(self) -> tuple[VolumeFields, ...]:
        """What the equations need of each volume, in the order of `volumes`."""
        c, gas = self.cylinder, self.gas
        rows = {
            "chamber_1": (c.dead_volume_1 or 0.0, c.piston_area_1, c.polytropic_exponent_1, c.push_area_1),
            "chamber_2": (c.dead_volume_2 or 0.0, -c.piston_area_2, c.polytropic_exponent_2, c.push_area_2),
        }
        seals = [getattr(self.load, f"friction_area_{name[-1]}") for name in c.chambers]
        each = [rows[name] for name in c.chambers]
        each += [(fixed.volume, 0.0, fixed.polytropic_exponent, 0.0) for fixed in self._fixed_volumes]
        seals += [0.0] * len(self._fixed_volumes)
        place, found = 2 + len(each), list[VolumeFields]()
        for row, balance, seal in zip(each, self._balances, seals, strict=True):
            if balance is None:
                found.append(VolumeFields(*row, 0.0, gas.temperature, -1, seal))
                continue
            wall = gas.temperature if balance.wall_temperature is None else balance.wall_temperature
            found.append(VolumeFields(*row, balance.conductance, wall, place, seal))
            place += 1
        return tuple(found)

    @cached_property
    def path_fields(self) -> tuple[PathFields, ...]:
        """Which volume each of the connections leads to, and from where."""
        known = {"supply": SUPPLY, "exhaust": EXHAUST, **{name: k for k, name in enumerate(self.volumes)}}
        return tuple(PathFields(known[chamber], known[source]) for source, chamber in self.ends)

    @cached_property
    def path_laws(self) -> tuple[PathLaw, ...]:
        """By which laws each of the connections lets through."""
        return (*(NOZZLES for _ in self._routes), *(path.law_fields for path in self.flow_paths))

    @cached_property
    def is_plain(self) -> bool:
        """Whether all is as in the paper: an ideal gas, nozzles, constant friction, pressures the only states."""
        no_temperature = all(volume.temperature_place < 0 for volume in self.volume_fields)
        constant = all(volume.friction_area == 0.0 for volume in self.volume_fields)
        no_law = not any(path.laws for path in self.flow_paths)
        from_outside = all(path.source < 0 for path in self.path_fields)
        return isinstance(self.gas, Gas) and no_temperature and constant and no_law and from_outside

    @cached_property
    def record(self) -> MachineRecord:
        """The machine as the compiled kernels read it: a numpy record of the layout `PLAIN` or `GENERAL`."""
        return self.as_record(PLAIN if self.is_plain else GENERAL)

    def as_record(self, kind: np.dtype[Any]) -> MachineRecord:
        """Return the machine as a record of a layout; every machine fits `GENERAL`."""
        c, load, gas = self.cylinder, self.load, self.gas
        values: dict[str, Any] = {
            "gas": gas.constants,
            "load": LoadFields(
                mass=load.mass,
                spring_stiffness=load.spring_stiffness,
                viscous_damping=load.viscous_damping,
                dry_friction=load.dry_friction,
                stiction=load.stiction,
                force=load.constant_force,
                ambient_push_area=c.ambient_push_area,
                ambient_pressure=self.ambient_pressure,
                lower_stop=c.lower_stop,
                upper_stop=c.upper_stop,
            ),
            "supply": GasState(self.supply_pressure, gas.temperature),
            "exhaust": GasState(self.exhaust_pressure, gas.temperature),
            "volumes": list(self.volume_fields),
            "paths": list(self.path_fields),
        }
        if kind == GENERAL:
            table = np.zeros(MAX_TABLE)
            table[: gas.table.size] = gas.table
            laminar = 0.0 if self.is_plain else LAMINAR
            values["laws"] = list(self.path_laws)
            values["medium"] = MediumFields(gas.kind, laminar, gas.constants, table)
        return filled(kind, values)

    @cached_property
    def has_infinite_slopes(self) -> bool:
        """Whether a flow's slope is infinite where pressures meet; a liquid's is not, being laminar there."""
        return not isinstance(self.gas, Liquid)

    @cached_property
    def is_isothermal(self) -> bool:
        """Whether all is an ideal gas of constant temperature: its pressures' rates are homogeneous, and superpose."""
        constant = len(self.states) == 2 + self.n_volumes and all(
            volume.polytropic_exponent == 1.0 for volume in self.volume_fields
        )
        checks = any(law.cracking_pressure for path in self.flow_paths for law in path.laws)
        return constant and not checks and isinstance(self.gas, Gas)

    @cached_property
    def state_scales(self) -> FloatArray:
        """Sizes by which errors of the states are judged.

        Dead length, that times a frequency of the piston on its chambers, supply pressure, temperature of the medium.
        """
        chambers = self.volume_fields[: len(self.cylinder.chambers)]
        volume, slope = np.array([chamber.size for chamber in chambers]), np.array([c.slope for c in chambers])
        length = float(np.max(np.abs(volume / slope))) if chambers else NO_PISTON_LENGTH
        modulus = self.exhaust_pressure
        if isinstance(self.gas, Liquid):
            modulus = self.gas.effective_bulk_modulus(self.supply_pressure)
        stiffness = self.load.spring_stiffness + float(np.sum(modulus * slope**2 / volume))
        speed = length * math.sqrt(stiffness / self.load.mass)
        n_temperatures = len(self.states) - 2 - self.n_volumes
        scales = [length, speed, *[self.supply_pressure] * self.n_volumes, *[self.gas.temperature] * n_temperatures]
        return read_only(np.array(scales))

    @cached_property
    def rest_state(self) -> FloatArray:
        """Piston at rest at zero, or at the stop nearest to it, every volume as the exhaust is; (n_states,)."""
        position = min(max(0.0, self.cylinder.lower_stop), self.cylinder.upper_stop)
        n_temperatures = len(self.states) - 2 - self.n_volumes
        pressures, temperatures = [self.exhaust_pressure] * self.n_volumes, [self.gas.temperature] * n_temperatures
        return read_only(np.array([position, 0.0, *pressures, *temperatures]))


def expect_machine(machine: object) -> None:
    """Raise `TypeError` unless given a `Machine`; a model that carries one, or a name, is told what to give."""
    if isinstance(machine, Machine):
        return
    if isinstance(machine, str | Path):
        hint = f"; lp.load_machine({str(machine)!r}) reads one"
    else:
        hint = "; give its .machine" if isinstance(getattr(machine, "machine", None), Machine) else ""
    raise TypeError(f"machine: found {type(machine).__name__}, expected a Machine{hint}")
