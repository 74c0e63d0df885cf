"""Which volume feeds which, through what opening: flow paths, and the ways through a rotary valve, as data.

A rotary valve's inner volumes are collapsed to points by the smaller effective area (2), collapsed exactly as two
restrictions in series, or kept as chambers of their own ("dynamic").
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np

from ltvpneu._arrays import finite, not_negative
from ltvpneu._values import Value
from ltvpneu.physics.iso6358 import ISO6358, NOZZLE, PathLaw
from ltvpneu.physics.profile import Profile, merge_angles
from ltvpneu.physics.proportional import Command
from ltvpneu.physics.valve import Phase, RotaryValve, check_phase
from ltvpneu.physics.window import Pulses, Window

Collapse = Literal["minimum", "in_series", "dynamic"]


COLLAPSES: tuple[Collapse, ...] = ("minimum", "in_series", "dynamic")
SOURCES = ("supply", "exhaust")
CHAMBERS = ("chamber_1", "chamber_2")


@final
@dataclass(frozen=True, kw_only=True)
class FlowPath(Value):
    """A restriction between a source and a chamber that is not a port of a rotary valve.

    Parameters
    ----------
    source : str
        "supply" or "exhaust", or another volume: the other chamber for leakage past the piston, a rigid volume.
    chamber : str
        "chamber_1", "chamber_2" or a rigid volume.
    area : float or None
        Area when fully open [m^2], of a nozzle as in the paper or of a liquid's orifice; None where there is a law.
    discharge_coefficient : float
        C [-], above 0, at most 1; of an area.
    law : ISO6358 or None
        Instead of an area: what the data sheet says of the path when fully open.
    law_back : ISO6358 or None
        Of flow from the chamber to the source, where that is another: valves have an in and an out, one-way throttles a
        free direction. A conductance of zero makes a check valve.
    in_series : ISO6358 or None
        A fixed restriction on the side of the source: a silencer, a throttle, a fitting.
    opening : {"always", "on", "off"} or Window
        "on" while the valve is on, "off" while it is not, or a window of the turn of its own. Of a proportional valve,
        "on" opens with a command above zero and "off" with one below.
    valve : int
        Which valve that is: 0 the machine's `valve`, 1 the first of its `more_valves`, and so on.
    """

    source: str
    chamber: str
    area: float | None = None
    discharge_coefficient: float = 1.0
    opening: Phase | Window = "always"
    valve: int = 0
    law: ISO6358 | None = None
    law_back: ISO6358 | None = None
    in_series: ISO6358 | None = None

    def __post_init__(self) -> None:
        if isinstance(self.valve, bool) or not isinstance(self.valve, int) or self.valve < 0:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(f"valve: found {self.valve!r}, expected the number of a valve, from 0")
        for name, end in (("source", self.source), ("chamber", self.chamber)):
            if not isinstance(end, str) or not end:  # pyright: ignore[reportUnnecessaryIsInstance]
                raise ValueError(f"{name}: found {end!r}, expected the name of a volume")
        if self.source == self.chamber:
            raise ValueError(f"source: found {self.source!r}, which is the path's own chamber; expected another volume")
        self._check_law()
        if not isinstance(self.opening, Window):
            check_phase("opening", self.opening)

    def _check_law(self) -> None:
        if (self.area is None) == (self.law is None):
            found = "neither" if self.area is None else "both"
            raise ValueError(f"area, law: found {found}, expected one of them")
        if self.area is not None:
            not_negative("area", self.area, "m^2")
            if self.law_back is not None:
                raise ValueError("law_back: found it beside an area, expected a law for the other direction too")
        if not 0 < finite("discharge_coefficient", self.discharge_coefficient) <= 1:
            raise ValueError(
                f"discharge_coefficient: found {self.discharge_coefficient:g}, expected above 0, at most 1"
            )
        if self.law is not None and self.discharge_coefficient != 1.0:
            raise ValueError(
                f"discharge_coefficient: found {self.discharge_coefficient:g} beside a law, which holds it already"
            )

    @property
    def laws(self) -> tuple[ISO6358, ...]:
        """The ISO 6358 laws among its restrictions."""
        return tuple(law for law in (self.law, self.law_back, self.in_series) if law is not None)

    @property
    def effective_area(self) -> float:
        """Effective area C A of the passage when fully open, of the direction in which it is larger [m^2]."""
        if self.law is None:
            return self.discharge_coefficient * (self.area or 0.0)
        return max(self.law.area, 0.0 if self.law_back is None else self.law_back.area)

    @property
    def law_fields(self) -> PathLaw:
        """The laws of both restrictions and directions, as the compiled kernels read them."""
        there = back = NOZZLE
        if self.law is not None:
            whole = self.effective_area or 1.0
            returning = self.law_back or self.law
            there, back = self.law.fields(self.law.area / whole), returning.fields(returning.area / whole)
        if self.in_series is None:
            return PathLaw(there, NOZZLE, back, NOZZLE)
        fixed = self.in_series.fields(1.0)
        return PathLaw(fixed, there, fixed, back)

    def connection(self, on: Window | Pulses | Command) -> "Connection":
        """Return the path as the models see it, for the arcs over which its valve is on."""
        passage = self.profile(on)
        if self.in_series is None:
            return Connection(source=self.source, chamber=self.chamber, first=passage)
        fixed = Profile.constant(self.in_series.area)
        return Connection(source=self.source, chamber=self.chamber, first=fixed, second=passage)

    def profile(self, on: Window | Pulses | Command) -> Profile:
        """Return the effective area C A of its passage over the turn [m^2], for the arcs over which its valve is on."""
        if isinstance(self.opening, Window):
            opening = self.opening.profile
        elif self.opening == "always":
            opening = Profile.constant(1.0)
        else:
            opening = on.profile if self.opening == "on" else on.complement.profile
        return opening.scaled(self.effective_area)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Connection(Value):
    """One path of flow as the models see it: a source, a volume that it leads to, effective areas C A over the turn.

    The source is "supply", "exhaust" or another volume. `second` is the restriction on the side of the volume where two
    act in series, else None.
    """

    source: str
    chamber: str
    first: Profile
    second: Profile | None = None


class Route(NamedTuple):
    """Where a path through a rotary valve leads from and to, and through which inner volume."""

    source: str
    chamber: str
    inner: str
    """Empty where all inner volumes are collapsed to one path."""


def routes_through(valve: RotaryValve, collapse: Collapse, chambers: tuple[str, ...]) -> tuple[Route, ...]:
    """Return the routes through a rotary valve, whatever its duty: paths that come and go would be another machine."""
    if collapse == "dynamic":
        joined = [(volume, way) for volume in valve.volumes for way in valve.ways if valve.joins(way, volume)]
        return tuple(
            Route(way, volume, volume) if way in SOURCES else Route(volume, way, volume) for volume, way in joined
        )
    known = valve.ways
    pairs = [(source, chamber) for source in SOURCES for chamber in chambers if source in known and chamber in known]
    if collapse == "minimum":
        return tuple(Route(source, chamber, "") for source, chamber in pairs)
    return tuple(
        Route(source, chamber, volume)
        for source, chamber in pairs
        for volume in valve.volumes
        if valve.joins(source, volume) and valve.joins(chamber, volume)
    )


def through_valve(route: Route, valve: RotaryValve, collapse: Collapse) -> Connection:
    """Return the connection that a rotary valve makes along a route."""
    source, chamber, inner = route
    if collapse == "minimum":
        return Connection(source=source, chamber=chamber, first=valve.collapsed_area(source, chamber))
    if collapse == "dynamic":
        way = source if inner == chamber else chamber
        return Connection(source=source, chamber=chamber, first=valve.way_area(way, inner))
    first, second = valve.way_area(source, inner), valve.way_area(chamber, inner)
    return Connection(source=source, chamber=chamber, first=first, second=second)


def check_ways(valve: RotaryValve, collapse: Collapse, chambers: tuple[str, ...]) -> None:
    """Raise unless a rotary valve's ways lead to what there is, and its inner volumes suit the collapse."""
    known = (*SOURCES, *chambers)
    for way in valve.ways:
        if way not in known:
            raise ValueError(f"valve.ports: found way {way!r}, expected one of {', '.join(known)}")
    if collapse == "in_series":
        _check_two_ways_at_once(valve)
    if collapse == "dynamic":
        for name in valve.volumes:
            # A number would read as a chamber's in the names of states.
            if name in (*known, *CHAMBERS, "1", "2"):
                raise ValueError(f"valve.ports: found an inner volume named {name!r}, expected a name of its own")
        sizes = {inner.name for inner in valve.inner_volumes}
        missing = [name for name in valve.volumes if name not in sizes]
        if missing:
            raise ValueError(
                f'collapse: found "dynamic", but no size of the inner volume {missing[0]!r}; expected an entry of '
                "valve.inner_volumes with that name and its volume"
            )


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
                'most two for "in_series"; use "minimum", or "dynamic" with the size of the volume'
            )
