r"""Openings over the valve's cycle: piecewise-linear profiles, rotary valve kinematics (1)-(2), on-off valves.

The angle theta = 2 pi Omega_p t of the valve runs once round per period. A `Profile` is any piecewise-linear
function of it, jumps included. Port m of a rotary valve opens way i into inner volume k by the area a_mk(theta); all
ports of a way add up,

.. math:: A_{ik}(\theta) = \sum_{m=L_i}^{M_i} a_{mk}(\theta) \qquad (1)

and where the inner volumes are collapsed to points, ways i and k are coupled through

.. math:: \bar A_{ik}(\theta) = \sum_m \min\{A_{im}(\theta), A_{mk}(\theta)\} \qquad (2)

With discharge coefficients the smaller C A counts. On-time is set by the offset angle theta_s between stator and
housing: two half-circle windows overlap from max(0, theta_s) to pi + min(0, theta_s).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise
from typing import Any, Literal, cast, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, finite_array, not_negative
from ltvpneu.physics.inner_volume import InnerVolume

TURN = 2 * math.pi
# Two angles nearer than this are the same switching instant; 1e-9 of a turn is 1 ns at 1 Hz.
SAME_ANGLE = 1e-9 * TURN

Phase = Literal["on", "off", "always"]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Profile:
    """A piecewise-linear function of the valve angle over one turn; it may jump between pieces.

    Parameters
    ----------
    angles : ndarray, shape (n_pieces + 1,)
        Ends of the pieces [rad], rising from 0 to 2 pi.
    starts, ends : ndarray, shape (n_pieces,)
        Values at the left and at the right end of each piece, none negative.

    Examples
    --------
    >>> half = Window(start=0.0, width=math.pi).profile
    >>> half.mean(0.0, TURN)
    0.5
    """

    angles: FloatArray
    starts: FloatArray
    ends: FloatArray

    def __post_init__(self) -> None:
        angles = finite_array("angles", self.angles, (None,))
        if angles.size < 2 or angles[0] != 0 or angles[-1] != TURN or (np.diff(angles) <= 0).any():
            raise ValueError(f"angles: found {angles.tolist()}, expected numbers rising from 0 to 2 pi")
        starts = finite_array("starts", self.starts, (angles.size - 1,))
        ends = finite_array("ends", self.ends, (angles.size - 1,))
        if (starts < 0).any() or (ends < 0).any():
            raise ValueError("profile: found a negative opening, expected zero or more")
        for name, array in (("angles", angles), ("starts", starts), ("ends", ends)):
            object.__setattr__(self, name, array)

    @staticmethod
    def constant(value: float) -> "Profile":
        """Return the profile that is `value` all round."""
        level = np.array([value])
        return Profile(angles=np.array([0.0, TURN]), starts=level, ends=level)

    def at(self, angle: float) -> float:
        """Return the value at an angle [rad]; where the profile jumps, the value just after."""
        angle = angle % TURN
        piece = min(int(np.searchsorted(self.angles, angle, side="right")) - 1, self.starts.size - 1)
        share = (angle - self.angles[piece]) / (self.angles[piece + 1] - self.angles[piece])
        return float(self.starts[piece] + share * (self.ends[piece] - self.starts[piece]))

    def mean(self, begin: float, end: float) -> float:
        """Return the exact mean between two angles [rad], 0 <= begin < end <= 2 pi."""
        return (self._integral(end) - self._integral(begin)) / (end - begin)

    def _integral(self, angle: float) -> float:
        """Integral from 0 to an angle, 0 to 2 pi."""
        widths = np.clip(angle - self.angles[:-1], 0.0, np.diff(self.angles))
        slopes = (self.ends - self.starts) / np.diff(self.angles)
        return float(np.sum(widths * (self.starts + slopes * widths / 2)))

    def refined(self, angles: FloatArray) -> "Profile":
        """Return the same function with further piece ends at `angles` [rad]."""
        merged = merge_angles(self.angles, angles)
        if merged.size == self.angles.size:
            return self
        middles = (merged[:-1] + merged[1:]) / 2
        piece = np.clip(np.searchsorted(self.angles, middles) - 1, 0, self.starts.size - 1)
        left, width = self.angles[piece], np.diff(self.angles)[piece]
        rise = self.ends[piece] - self.starts[piece]

        def values(at: FloatArray) -> FloatArray:
            share = np.clip((at - left) / width, 0.0, 1.0)
            return self.starts[piece] + share * rise

        return Profile(angles=merged, starts=values(merged[:-1]), ends=values(merged[1:]))

    def scaled(self, factor: float) -> "Profile":
        """Return the profile times a factor, zero or more."""
        return Profile(angles=self.angles, starts=factor * self.starts, ends=factor * self.ends)

    def plus(self, other: "Profile") -> "Profile":
        """Return the sum of two profiles."""
        a, b = self.refined(other.angles), other.refined(self.angles)
        return Profile(angles=a.angles, starts=a.starts + b.starts, ends=a.ends + b.ends)

    def minimum(self, other: "Profile") -> "Profile":
        """Return the smaller of two profiles, with piece ends where they cross."""
        a, b = self.refined(other.angles), other.refined(self.angles)
        at_start, at_end = a.starts - b.starts, a.ends - b.ends
        crossing = at_start * at_end < 0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = at_start / (at_start - at_end)
        extra = (a.angles[:-1] + share * np.diff(a.angles))[crossing]
        a, b = a.refined(extra), b.refined(extra)
        return Profile(angles=a.angles, starts=np.minimum(a.starts, b.starts), ends=np.minimum(a.ends, b.ends))


def _sum(profiles: Iterable[Profile]) -> Profile:
    found = tuple(profiles)
    return reduce(Profile.plus, found) if found else Profile.constant(0.0)


def merge_angles(*lists: FloatArray) -> FloatArray:
    """Return all angles [rad] sorted from 0 to 2 pi, those closer than `SAME_ANGLE` to one before left out."""
    merged = np.unique(np.concatenate([np.array([0.0, TURN]), *lists]))
    kept = [0.0]
    for angle in merged[1:-1]:
        if angle - kept[-1] > SAME_ANGLE and TURN - angle > SAME_ANGLE:
            kept.append(float(angle))
    return np.array([*kept, TURN])


@final
@dataclass(frozen=True, kw_only=True)
class Window:
    """An opening that is uncovered over one arc of the turn, with linear ramps inside it.

    Parameters
    ----------
    start : float
        Where it begins to open [rad].
    width : float
        Over what arc it is uncovered at all [rad], 0 (never) to 2 pi (always).
    ramp : float
        Arc over which the edge passes the port [rad]; 0 opens and closes at once. A window narrower than two
        ramps does not open fully.
    """

    start: float
    width: float
    ramp: float = 0.0

    def __post_init__(self) -> None:
        finite("start", self.start, "rad")
        if not 0 <= finite("width", self.width, "rad") <= TURN * (1 + 1e-12):
            raise ValueError(f"width: found {self.width:g} rad, expected 0 to 2 pi")
        not_negative("ramp", self.ramp, "rad")

    @property
    def complement(self) -> "Window":
        """The rest of the turn, with the same ramp."""
        return Window(start=self.start + self.width, width=max(TURN - self.width, 0.0), ramp=self.ramp)

    @cached_property
    def profile(self) -> Profile:
        """The opening over the turn, 0 (shut) to 1 (fully open)."""
        return opened([self])

    def opening(self, middle: FloatArray, shift: FloatArray) -> FloatArray:
        """Return the opening at angles since the start [rad] next to others, in the middles of linear pieces."""
        at = middle + shift
        opening = np.ones_like(at)
        # A ramp shorter than what tells two angles apart is a jump.
        if self.ramp > SAME_ANGLE:
            opening = np.minimum(1.0, np.minimum(at, self.width - at) / self.ramp)
        return np.where(middle < self.width, np.maximum(opening, 0.0), 0.0)


def opened(windows: Sequence[Window]) -> Profile:
    """Return the opening of windows that do not overlap, over the turn."""
    if any(window.width >= TURN - SAME_ANGLE for window in windows):
        return Profile.constant(1.0)
    windows = [window for window in windows if window.width > SAME_ANGLE]
    if not windows:
        return Profile.constant(0.0)
    corners: list[float] = []
    for window in windows:
        ramp = min(window.ramp, window.width / 2)
        corners += [window.start, window.start + ramp, window.start + window.width - ramp, window.start + window.width]
    angles = merge_angles(np.array(corners) % TURN)
    middles = (angles[:-1] + angles[1:]) / 2
    half = np.diff(angles) / 2
    starts, ends = np.zeros(middles.size), np.zeros(middles.size)
    for window in windows:
        # Each piece is linear, so its ends follow from its middle without asking on which side of a jump they lie.
        inside = (middles - window.start) % TURN
        starts += window.opening(inside, -half)
        ends += window.opening(inside, half)
    return Profile(angles=angles, starts=starts, ends=ends)


@final
@dataclass(frozen=True, kw_only=True)
class Pulses:
    """Several openings a turn, one after the other.

    Parameters
    ----------
    edges : tuple of float
        Angles of opening and closing in turn [rad], rising; the last at most a turn after the first.
    ramp : float
        As of `Window`.

    Examples
    --------
    >>> Pulses(edges=(0.0, 1.0, 3.0, 4.5)).width
    2.5
    """

    edges: tuple[float, ...]
    ramp: float = 0.0

    def __post_init__(self) -> None:
        edges = tuple(finite(f"edges[{i}]", edge, "rad") for i, edge in enumerate(self.edges))
        if len(edges) < 2 or len(edges) % 2:
            raise ValueError(f"edges: found {len(edges)} angles, expected two a pulse: where it opens, where it closes")
        for i, (before, after) in enumerate(pairwise(edges)):
            if after < before:
                raise ValueError(
                    f"edges[{i + 1}]: found {after:g} rad after {before:g} rad, expected rising angles of opening and "
                    "closing in turn"
                )
        if edges[-1] - edges[0] > TURN * (1 + 1e-12):
            raise ValueError(
                f"edges[{len(edges) - 1}]: found {edges[-1]:g} rad, more than a turn after {edges[0]:g} rad, the first"
            )
        not_negative("ramp", self.ramp, "rad")
        object.__setattr__(self, "edges", edges)

    @property
    def width(self) -> float:
        """Angle over which it is open at all [rad]."""
        return sum(off - on for on, off in zip(self.edges[::2], self.edges[1::2], strict=True))

    @property
    def complement(self) -> "Pulses":
        """The rest of the turn, with the same ramp."""
        return Pulses(edges=(*self.edges[1:], self.edges[0] + TURN), ramp=self.ramp)

    @cached_property
    def profile(self) -> Profile:
        """The opening over the turn, 0 (shut) to 1 (fully open)."""
        pairs = zip(self.edges[::2], self.edges[1::2], strict=True)
        return opened([Window(start=on, width=min(off - on, TURN), ramp=self.ramp) for on, off in pairs])


def check_pulses(pulses: Iterable[tuple[float, float]], ramp: float) -> Pulses:
    """Return pulses given as pairs of angles [rad]: where each opens and where it closes."""
    edges: list[float] = []
    for number, pair in enumerate(pulses):
        angles: Any = pair
        if not isinstance(angles, Sequence) or len(cast(Sequence[Any], angles)) != 2:
            raise ValueError(f"pulses[{number}]: found {pair!r}, expected two angles: where it opens and closes [rad]")
        edges += pair
    return Pulses(edges=tuple(edges), ramp=ramp)


@final
@dataclass(frozen=True, kw_only=True)
class Port:
    """One port of a rotary valve: it opens a flow path ("way") into an inner volume over an arc of the turn.

    Parameters
    ----------
    way : str
        What it leads to: "supply", "exhaust", "chamber_1" or "chamber_2".
    area : float
        Area when fully open [m^2].
    discharge_coefficient : float
        C [-], above 0, at most 1.
    window : Window
        Where it is open at offset angle zero.
    volume : str
        Name of the inner volume that it opens into.
    turns_with_offset : bool
        Whether the offset angle shifts this port.
    phase : {"on", "off", "always"}
        Which part of the turn it gets when a duty cycle overrides the geometry.
    """

    way: str
    area: float
    discharge_coefficient: float
    window: Window
    volume: str = "valve"
    turns_with_offset: bool = False
    phase: Phase = "on"

    def __post_init__(self) -> None:
        not_negative("area", self.area, "m^2")
        if not 0 < finite("discharge_coefficient", self.discharge_coefficient) <= 1:
            raise ValueError(
                f"discharge_coefficient: found {self.discharge_coefficient:g}, expected above 0, at most 1"
            )
        check_phase("phase", self.phase)


@final
@dataclass(frozen=True, kw_only=True)
class RotaryValve:
    """A rotary valve: any number of ports, ways and inner volumes (1)-(2), turning once per period.

    Parameters
    ----------
    ports : tuple of Port
    offset_angle : float
        theta_s between stator and housing [rad], -pi to pi.
    duty : float or None
        Overrides the geometry: ports of phase "on" are open over [0, 2 pi duty], those of phase "off" over the rest.
    pulses : Pulses or None
        Overrides the geometry likewise, by several pulses a turn.
    inner_volumes : tuple of InnerVolume
        Sizes of the inner volumes, for models that keep them as chambers.

    Examples
    --------
    >>> half = Window(start=0.0, width=math.pi)
    >>> ports = (Port(way="supply", area=0.32e-4, discharge_coefficient=0.65, window=half),
    ...          Port(way="chamber_1", area=0.16e-4, discharge_coefficient=0.4, window=half, turns_with_offset=True))
    >>> valve = RotaryValve(ports=ports, offset_angle=math.radians(90))
    >>> round(valve.collapsed_area("supply", "chamber_1").mean(0.0, TURN) / 0.64e-5, 9)
    0.25
    """

    ports: tuple[Port, ...]
    offset_angle: float = 0.0
    duty: float | None = None
    pulses: Pulses | None = None
    inner_volumes: tuple[InnerVolume, ...] = ()

    def __post_init__(self) -> None:
        known = self.volumes
        for i, inner in enumerate(self.inner_volumes):
            if inner.name not in known or inner.name in [other.name for other in self.inner_volumes[:i]]:
                raise ValueError(
                    f"inner_volumes[{i}]: found the name {inner.name!r}, expected each of the ports' volumes once: "
                    f"{', '.join(known)}"
                )
        if not self.ports:
            raise ValueError("ports: found none, expected at least one")
        if self.duty is not None and self.pulses is not None:
            raise ValueError("duty, pulses: found both, expected one of them")
        if abs(finite("offset_angle", self.offset_angle, "rad")) > math.pi:
            raise ValueError(f"offset_angle: found {self.offset_angle:g} rad, expected -pi to pi")
        if self.duty is not None:
            check_duty(self.duty)

    def with_duty(self, duty: float) -> "RotaryValve":
        """Return the valve with the open window [0, 2 pi duty], whatever its geometry."""
        return replace(self, duty=check_duty(duty), pulses=None)

    def with_offset(self, offset_angle: float) -> "RotaryValve":
        """Return the valve with its geometry's windows, shifted by the offset angle theta_s [rad]."""
        return replace(self, offset_angle=offset_angle, duty=None, pulses=None)

    def with_pulses(self, pulses: Iterable[tuple[float, float]]) -> "RotaryValve":
        """Return the valve open from angle to angle [rad], whatever its geometry."""
        return replace(self, duty=None, pulses=check_pulses(pulses, 0.0))

    @property
    def ways(self) -> tuple[str, ...]:
        """Names of the flow paths, in order of appearance."""
        return tuple(dict.fromkeys(port.way for port in self.ports))

    @property
    def volumes(self) -> tuple[str, ...]:
        """Names of the inner volumes, in order of appearance."""
        return tuple(dict.fromkeys(port.volume for port in self.ports))

    def window(self, port: Port) -> Window | Pulses:
        """Return the arcs over which a port is open, at the present offset, duty or pulses."""
        if port.phase == "always":
            return Window(start=0.0, width=TURN)
        if self.pulses is not None:
            pulses = replace(self.pulses, ramp=port.window.ramp)
            return pulses if port.phase == "on" else pulses.complement
        if self.duty is not None:
            on = Window(start=0.0, width=TURN * self.duty, ramp=port.window.ramp)
            return on if port.phase == "on" else on.complement
        shift = self.offset_angle if port.turns_with_offset else 0.0
        return replace(port.window, start=port.window.start + shift)

    def way_area(self, way: str, volume: str) -> Profile:
        """Effective area C A between a way and an inner volume over the turn [m^2], eq. (1)."""
        return _sum(
            self.window(port).profile.scaled(port.discharge_coefficient * port.area)
            for port in self.ports
            if (port.way, port.volume) == (way, volume)
        )

    def collapsed_area(self, way: str, other: str) -> Profile:
        """Effective area between two ways, the inner volumes collapsed to points [m^2], eq. (2)."""
        return _sum(self.way_area(way, volume).minimum(self.way_area(other, volume)) for volume in self.volumes)

    def on_window(self) -> Window | Pulses:
        """Return the arcs over which the ports of phase "on" are all open."""
        if self.pulses is not None:
            return self.pulses
        if self.duty is not None:
            return Window(start=0.0, width=TURN * self.duty)
        overlap = Profile.constant(1.0)
        for port in self.ports:
            if port.phase == "on":
                overlap = overlap.minimum(self.window(port).profile)
        return _support(overlap)


@final
@dataclass(frozen=True, kw_only=True)
class OnOffValve:
    """A valve that is on for a share `duty` of the period, in one piece or in several pulses.

    Parameters
    ----------
    duty : float
        On-time over period [-], 0 to 1.
    ramp : float
        Angle over which its paths open and close [rad].
    start : float
        Angle at which it goes on [rad]: the phase between valves, where there are several.
    pulses : Pulses or None
        Instead of `duty` and `start`, which are then theirs.
    """

    duty: float = 0.5
    ramp: float = 0.0
    start: float = 0.0
    pulses: Pulses | None = None

    def __post_init__(self) -> None:
        not_negative("ramp", self.ramp, "rad")
        finite("start", self.start, "rad")
        if self.pulses is not None:
            object.__setattr__(self, "duty", min(self.pulses.width / TURN, 1.0))
            object.__setattr__(self, "start", self.pulses.edges[0])
        check_duty(self.duty)

    def with_duty(self, duty: float) -> "OnOffValve":
        """Return the valve with another duty cycle, in one piece."""
        return replace(self, duty=check_duty(duty), pulses=None)

    def with_pulses(self, pulses: Iterable[tuple[float, float]]) -> "OnOffValve":
        """Return the valve on from angle to angle [rad]."""
        return replace(self, pulses=check_pulses(pulses, self.ramp))

    def on_window(self) -> Window | Pulses:
        """Return the arcs over which the valve is on."""
        if self.pulses is not None:
            return self.pulses
        return Window(start=self.start, width=TURN * self.duty, ramp=self.ramp)


def check_duty(duty: float, name: str = "duty") -> float:
    """Return the duty cycle if it is a number from 0 to 1."""
    if not 0 <= finite(name, duty) <= 1:
        raise ValueError(f"{name}: found {duty:g}, expected on-time over period, 0 to 1")
    return float(duty)


def check_phase(name: str, phase: str) -> None:
    """Raise unless the phase is "on", "off" or "always"."""
    if phase not in ("on", "off", "always"):
        raise ValueError(f'{name}: found {phase!r}, expected "on", "off" or "always"')


def _support(profile: Profile) -> Window:
    """Return the arc over which a profile is above zero, which must be one arc."""
    open_pieces = np.maximum(profile.starts, profile.ends) > 0
    if open_pieces.all():
        return Window(start=0.0, width=TURN)
    if not open_pieces.any():
        return Window(start=0.0, width=0.0)
    risings = [i for i, (before, now) in enumerate(pairwise([open_pieces[-1], *open_pieces])) if now and not before]
    if len(risings) > 1:
        raise ValueError(
            f'ports: found {len(risings)} arcs on which the "on" ports are all open, expected one; give the flow '
            "path a window of its own instead of a phase"
        )
    width = float(np.sum(np.diff(profile.angles)[open_pieces]))
    return Window(start=float(profile.angles[risings[0]]), width=width)
