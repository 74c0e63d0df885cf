"""Which volume feeds which, through what opening: flow paths, and the ways through a rotary valve, as data.

A rotary valve's inner volumes are collapsed to points by the smaller effective area (2), collapsed exactly as two
restrictions in series, or kept as chambers of their own ("dynamic").
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np

from ltvpneu._arrays import finite, not_negative
from ltvpneu._values import Value
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
        "supply" or "exhaust", or the other chamber: leakage past the piston, or a bypass.
    chamber : str
        "chamber_1" or "chamber_2".
    area : float
        Area when fully open [m^2].
    discharge_coefficient : float
        C [-], above 0, at most 1.
    opening : {"always", "on", "off"} or Window
        "on" while the valve is on, "off" while it is not, or a window of the turn of its own. Of a proportional valve,
        "on" opens with a command above zero and "off" with one below.
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
        if self.source not in (*SOURCES, *CHAMBERS):
            raise ValueError(f'source: found {self.source!r}, expected "supply", "exhaust" or the other chamber')
        if self.source == self.chamber:
            raise ValueError(f"source: found {self.source!r}, which is the path's own chamber; expected another volume")
        not_negative("area", self.area, "m^2")
        if not 0 < finite("discharge_coefficient", self.discharge_coefficient) <= 1:
            raise ValueError(
                f"discharge_coefficient: found {self.discharge_coefficient:g}, expected above 0, at most 1"
            )
        if not isinstance(self.opening, Window):
            check_phase("opening", self.opening)

    def profile(self, on: Window | Pulses | Command) -> Profile:
        """Return the effective area C A over the turn [m^2], for the arcs over which its valve is on."""
        if isinstance(self.opening, Window):
            opening = self.opening.profile
        elif self.opening == "always":
            opening = Profile.constant(1.0)
        else:
            opening = on.profile if self.opening == "on" else on.complement.profile
        return opening.scaled(self.discharge_coefficient * self.area)


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
