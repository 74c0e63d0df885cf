"""A machine: gas, cylinder, load, flow paths and valve, as one checked value.

Which volume feeds which chamber through what opening is data, so single- and double-acting cylinders, 2/2, 3/2 and
5/2 valves, rotary valves and bleed orifices are the same code.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, final

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, finite, not_negative, positive, read_only
from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.gas import Gas, GasConstants, GasState
from ltvpneu.physics.load import Load
from ltvpneu.physics.valve import OnOffValve, Phase, Profile, Pulses, RotaryValve, Window, check_phase, merge_angles

Collapse = Literal["minimum", "in_series"]
SOURCES = ("supply", "exhaust")


@final
@dataclass(frozen=True, kw_only=True)
class FlowPath:
    """A restriction between a source and a chamber that is not a port of a rotary valve.

    Parameters
    ----------
    source : str
        "supply" or "exhaust".
    chamber : str
        "chamber_1" or "chamber_2".
    area : float
        Area when fully open [m^2].
    discharge_coefficient : float
        C [-], above 0, at most 1.
    opening : {"always", "on", "off"} or Window
        "on" while the valve is on, "off" while it is not, or a window of the turn of its own.
    valve : int
        Which valve that is: 0 the machine's `valve`, 1 the first of its `more_valves`, and so on.
    """

    source: str
    chamber: str
    area: float
    discharge_coefficient: float = 1.0
    opening: Phase | Window = "always"
    valve: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.valve, bool) or not isinstance(self.valve, int) or self.valve < 0:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(f"valve: found {self.valve!r}, expected the number of a valve, from 0")
        if self.source not in SOURCES:
            raise ValueError(f'source: found {self.source!r}, expected "supply" or "exhaust"')
        not_negative("area", self.area, "m^2")
        if not 0 < finite("discharge_coefficient", self.discharge_coefficient) <= 1:
            raise ValueError(
                f"discharge_coefficient: found {self.discharge_coefficient:g}, expected above 0, at most 1"
            )
        if not isinstance(self.opening, Window):
            check_phase("opening", self.opening)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Connection:
    """One path of flow as the models see it: a source, a chamber, and effective areas C A over the turn.

    `second` is the restriction on the chamber's side where two act in series, else None.
    """

    source: str
    chamber: str
    first: Profile
    second: Profile | None = None


class LoadConstants(NamedTuple):
    """What the compiled kernels need of the load and of the cylinder's other side."""

    mass: float
    spring_stiffness: float
    viscous_damping: float
    dry_friction: float
    stiction: float
    force: float
    open_push_area: float
    """Force over the exhaust pressure on the side that is open to it [m^2]."""
    lower_stop: float
    upper_stop: float


class MachineArrays(NamedTuple):
    """A machine as the compiled kernels read it."""

    gas: GasConstants
    load: LoadConstants
    supply: GasState
    exhaust: GasState
    chambers: FloatArray
    """Each: dead volume [m^3], its slope over position [m^2], polytropic exponent, push area [m^2]; shape (n_c, 4)."""
    path_from_supply: BoolArray
    """Whether the supply feeds each path, else the exhaust; shape (n_paths,)."""
    path_chamber: IntArray
    """Chamber that each path leads to, shape (n_paths,)."""


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


@final
@dataclass(frozen=True, kw_only=True)
class Machine:
    """A pneumatic drive switched by an on-off valve.

    Parameters
    ----------
    name : str
    supply_pressure, exhaust_pressure : float
        p_3, p_4 [Pa, absolute].
    cylinder : Cylinder
    load : Load
    valve : RotaryValve or OnOffValve
    flow_paths : tuple of FlowPath
        Paths beside the ports of a rotary valve; all of them where the valve is an `OnOffValve`.
    gas : Gas
    more_valves : tuple of OnOffValve
        Further valves, of flow paths that name them by number; all turn at the same frequency.
    collapse : {"minimum", "in_series"}
        How the inner volume of a rotary valve is collapsed to a point: by the smaller effective area (2), or by solving
        for the pressure between two restrictions that pass the same flow.

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
    valve: RotaryValve | OnOffValve
    flow_paths: tuple[FlowPath, ...] = ()
    gas: Gas = Gas()  # noqa: RUF009 - a frozen value
    more_valves: tuple[OnOffValve, ...] = ()
    collapse: Collapse = "minimum"

    def __post_init__(self) -> None:
        positive("exhaust_pressure", self.exhaust_pressure, "Pa")
        positive("supply_pressure", self.supply_pressure, "Pa")
        if self.supply_pressure < self.exhaust_pressure:
            raise ValueError(
                f"supply_pressure: found {self.supply_pressure:g} Pa, below the exhaust pressure "
                f"{self.exhaust_pressure:g} Pa; expected both absolute (a gauge pressure is written with the suffix "
                "(g), as in '3.1 bar(g)')"
            )
        if self.collapse not in ("minimum", "in_series"):
            raise ValueError(f'collapse: found {self.collapse!r}, expected "minimum" or "in_series"')
        self._check_connections()

    def _check_connections(self) -> None:
        for path in self.flow_paths:
            if path.valve > len(self.more_valves):
                raise ValueError(
                    f"flow_paths: found a path of valve {path.valve}, expected 0 to {len(self.more_valves)}, as there "
                    f"are {len(self.more_valves)} more_valves"
                )
            if path.chamber not in self.cylinder.chambers:
                raise ValueError(
                    f"flow_paths: found a path to {path.chamber!r}, expected one of the cylinder's chambers: "
                    f"{', '.join(self.cylinder.chambers)}"
                )
        if isinstance(self.valve, RotaryValve):
            known = (*SOURCES, *self.cylinder.chambers)
            for way in self.valve.ways:
                if way not in known:
                    raise ValueError(f"valve.ports: found way {way!r}, expected one of {', '.join(known)}")
            if self.collapse == "in_series":
                _check_two_ways_at_once(self.valve)
        fed = {connection.chamber for connection in self.connections}
        for chamber in self.cylinder.chambers:
            if chamber not in fed:
                raise ValueError(
                    f"flow_paths: no path leads to {chamber}, expected at least one; leave out "
                    f"dead_volume_{chamber[-1]} where that side is open to the return"
                )

    # What a user turns
    # -------------------------------------------------------------------------------------------------

    def with_duty(self, duty: float) -> "Machine":
        """Return the machine with the open window [0, 2 pi duty], 0 <= duty <= 1, whatever the valve's geometry."""
        return replace(self, valve=self.valve.with_duty(duty))

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

    def without_dry_friction(self) -> "Machine":
        """Return the machine with neither dry friction nor stiction; viscous damping stays."""
        return replace(self, load=replace(self.load, dry_friction=0.0, stiction=0.0))

    # What the models read
    # ----------------------------------------------------------------------------------------------

    @cached_property
    def identifier(self) -> str:
        """The name as python-control accepts it for a system: letters, digits and underscores."""
        return "".join(c if c.isalnum() else "_" for c in self.name)

    @property
    def duty(self) -> float:
        """On-time of the valve over the period [-]."""
        return self.valve.on_window().width / (2 * math.pi)

    @property
    def has_dry_friction(self) -> bool:
        """Whether the piston can stick."""
        return self.load.dry_friction > 0 or self.load.stiction > 0

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states: position [m], velocity [m/s], then the chambers' pressures [Pa, absolute]."""
        return ("position", "velocity", *(f"pressure_{name[-1]}" for name in self.cylinder.chambers))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs: two pressures [Pa, absolute] and the external force [N] towards higher positions."""
        return ("supply_pressure", "exhaust_pressure", "load_force")

    @cached_property
    def levels(self) -> FloatArray:
        """Values of the inputs, shape (3,)."""
        return read_only(np.array([self.supply_pressure, self.exhaust_pressure, self.load.force]))

    @cached_property
    def connections(self) -> tuple[Connection, ...]:
        """Every path of flow, with its effective areas over the turn."""
        found: list[Connection] = []
        if isinstance(self.valve, RotaryValve):
            found += _through_valve(self.valve, self.collapse, self.cylinder.chambers)
        on = [valve.on_window() for valve in (self.valve, *self.more_valves)]
        for path in self.flow_paths:
            opening = _opening(path, on[path.valve]).scaled(path.discharge_coefficient * path.area)
            found.append(Connection(source=path.source, chamber=path.chamber, first=opening))
        return tuple(found)

    @cached_property
    def openings(self) -> OpeningTable:
        """Effective areas of all connections on a common set of pieces."""
        profiles = [p for c in self.connections for p in (c.first, c.second) if p is not None]
        angles = merge_angles(*(profile.angles for profile in profiles))
        areas = np.full((angles.size - 1, 4, len(self.connections)), np.inf)
        for number, connection in enumerate(self.connections):
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

    @cached_property
    def arrays(self) -> MachineArrays:
        """The machine as the compiled kernels read it."""
        cylinder, load = self.cylinder, self.load
        c = cylinder
        rows = {
            "chamber_1": (c.dead_volume_1, c.piston_area_1, c.polytropic_exponent_1, c.push_area_1),
            "chamber_2": (c.dead_volume_2, -c.piston_area_2, c.polytropic_exponent_2, c.push_area_2),
        }
        chambers = cylinder.chambers
        open_side = sum(row[3] for name, row in rows.items() if name not in chambers)
        return MachineArrays(
            gas=self.gas.constants,
            load=LoadConstants(
                mass=float(load.mass),
                spring_stiffness=float(load.spring_stiffness),
                viscous_damping=float(load.viscous_damping),
                dry_friction=float(load.dry_friction),
                stiction=float(load.stiction),
                force=float(load.force),
                open_push_area=float(open_side),
                lower_stop=float(cylinder.lower_stop),
                upper_stop=float(cylinder.upper_stop),
            ),
            supply=GasState(float(self.supply_pressure), float(self.gas.temperature)),
            exhaust=GasState(float(self.exhaust_pressure), float(self.gas.temperature)),
            chambers=np.array([rows[name] for name in chambers], dtype=np.float64),
            path_from_supply=np.array([c.source == "supply" for c in self.connections]),
            path_chamber=np.array([chambers.index(c.chamber) for c in self.connections], dtype=np.int64),
        )

    @cached_property
    def state_scales(self) -> FloatArray:
        """Sizes by which errors of the states are judged: dead length, that times a pneumatic frequency, supply."""
        arrays = self.arrays
        volume, slope = arrays.chambers[:, 0], arrays.chambers[:, 1]
        length = float(np.max(np.abs(volume / slope)))
        stiffness = self.load.spring_stiffness + float(np.sum(self.exhaust_pressure * slope**2 / volume))
        speed = length * math.sqrt(stiffness / self.load.mass)
        return read_only(np.array([length, speed] + [self.supply_pressure] * len(volume)))

    @cached_property
    def rest_state(self) -> FloatArray:
        """Piston at rest at zero, or at the stop nearest to it, every chamber at exhaust pressure; (n_states,)."""
        position = min(max(0.0, self.cylinder.lower_stop), self.cylinder.upper_stop)
        return read_only(np.array([position, 0.0] + [self.exhaust_pressure] * len(self.cylinder.chambers)))


def _through_valve(valve: RotaryValve, collapse: Collapse, chambers: tuple[str, ...]) -> list[Connection]:
    found: list[Connection] = []
    for source in SOURCES:
        for chamber in chambers:
            if source not in valve.ways or chamber not in valve.ways:
                continue
            if collapse == "minimum":
                area = valve.collapsed_area(source, chamber)
                found.append(Connection(source=source, chamber=chamber, first=area))
                continue
            for volume in valve.volumes:
                first, second = valve.way_area(source, volume), valve.way_area(chamber, volume)
                if first.minimum(second).ends.any() or first.minimum(second).starts.any():
                    found.append(Connection(source=source, chamber=chamber, first=first, second=second))
    return found


def _opening(path: FlowPath, on: Window | Pulses) -> Profile:
    if isinstance(path.opening, Window):
        return path.opening.profile
    if path.opening == "always":
        return Profile.constant(1.0)
    return on.profile if path.opening == "on" else on.complement.profile


def _check_two_ways_at_once(valve: RotaryValve) -> None:
    """Two restrictions in series are exact only while an inner volume joins two ways, not three."""
    for volume in valve.volumes:
        profiles = [valve.way_area(way, volume) for way in valve.ways]
        angles = merge_angles(*(profile.angles for profile in profiles))
        open_ways = np.zeros(angles.size - 1)
        for profile in profiles:
            cut = profile.refined(angles)
            open_ways += np.maximum(cut.starts, cut.ends) > 0
        if open_ways.max() > 2:
            raise ValueError(
                f"collapse: found {int(open_ways.max())} ways open to the inner volume {volume!r} at once, expected at "
                'most two for "in_series"; use "minimum"'
            )
