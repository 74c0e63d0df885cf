"""Arcs of the turn over which something is open: one window with ramps, or several pulses."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, cast, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, not_negative
from ltvpneu._values import Value
from ltvpneu.physics.profile import SAME_ANGLE, TURN, Profile, merge_angles


@final
@dataclass(frozen=True, kw_only=True)
class Window(Value):
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
    closing_ramp : float or None
        Of closing, where that is another [rad].
    """

    start: float
    width: float
    ramp: float = 0.0
    closing_ramp: float | None = None

    def __post_init__(self) -> None:
        finite("start", self.start, "rad")
        if not 0 <= finite("width", self.width, "rad") <= TURN * (1 + 1e-12):
            raise ValueError(f"width: found {self.width:g} rad, expected 0 to 2 pi")
        not_negative("ramp", self.ramp, "rad")
        not_negative("closing_ramp", self.ramps[1], "rad")

    @property
    def ramps(self) -> tuple[float, float]:
        """Arcs of opening and of closing [rad]."""
        return self.ramp, self.ramp if self.closing_ramp is None else self.closing_ramp

    @property
    def complement(self) -> "Window":
        """The rest of the turn, which opens as this one closes and closes as it opens."""
        width = max(TURN - self.width, 0.0)
        if self.closing_ramp is None:
            return Window(start=self.start + self.width, width=width, ramp=self.ramp)
        return Window(start=self.start + self.width, width=width, ramp=self.closing_ramp, closing_ramp=self.ramp)

    @cached_property
    def profile(self) -> Profile:
        """The opening over the turn, 0 (shut) to 1 (fully open)."""
        return opened([self])

    def opening(self, middle: FloatArray, shift: FloatArray) -> FloatArray:
        """Return the opening at angles since the start [rad] next to others, in the middles of linear pieces."""
        at = middle + shift
        opening = np.ones_like(at)
        # A ramp shorter than what tells two angles apart is a jump.
        for ramp, way in zip(self.ramps, (at, self.width - at), strict=True):
            if ramp > SAME_ANGLE:
                opening = np.minimum(opening, way / ramp)
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
        rise, fall = window.ramps
        if rise + fall > window.width:
            # So narrow that it begins to close before it has opened, where both ramps are as far open.
            rise, fall = window.width * rise / (rise + fall), window.width * fall / (rise + fall)
        corners += [window.start, window.start + rise, window.start + window.width - fall, window.start + window.width]
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
class Pulses(Value):
    """Several openings a turn, one after the other.

    Parameters
    ----------
    edges : tuple of float
        Angles of opening and closing in turn [rad], rising; the last at most a turn after the first.
    ramp, closing_ramp : float
        As of `Window`.

    Examples
    --------
    >>> Pulses(edges=(0.0, 1.0, 3.0, 4.5)).width
    2.5
    """

    edges: tuple[float, ...]
    ramp: float = 0.0
    closing_ramp: float | None = None

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
        """The rest of the turn, which opens as this closes and closes as it opens."""
        edges = (*self.edges[1:], self.edges[0] + TURN)
        if self.closing_ramp is None:
            return Pulses(edges=edges, ramp=self.ramp)
        return Pulses(edges=edges, ramp=self.closing_ramp, closing_ramp=self.ramp)

    @cached_property
    def profile(self) -> Profile:
        """The opening over the turn, 0 (shut) to 1 (fully open)."""
        pairs = zip(self.edges[::2], self.edges[1::2], strict=True)
        return opened(
            [
                Window(start=on, width=min(off - on, TURN), ramp=self.ramp, closing_ramp=self.closing_ramp)
                for on, off in pairs
            ]
        )


def check_pulses(pulses: Iterable[tuple[float, float]], ramp: float) -> Pulses:
    """Return pulses given as pairs of angles [rad]: where each opens and where it closes."""
    edges: list[float] = []
    for number, pair in enumerate(pulses):
        angles: Any = pair
        if not isinstance(angles, Sequence) or len(cast(Sequence[Any], angles)) != 2:
            raise ValueError(f"pulses[{number}]: found {pair!r}, expected two angles: where it opens and closes [rad]")
        edges += pair
    return Pulses(edges=tuple(edges), ramp=ramp)


def support(profile: Profile) -> Window:
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
