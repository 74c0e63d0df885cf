"""Openings over the valve's cycle: piecewise-linear functions of its angle, jumps included."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, finite_array, read_only
from ltvpneu._values import Value

TURN = 2 * math.pi
# Two angles nearer than this are the same switching instant; 1e-9 of a turn is 1 ns at 1 Hz.
SAME_ANGLE = 1e-9 * TURN


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Profile(Value):
    """A piecewise-linear function of the valve angle over one turn; it may jump between pieces.

    Parameters
    ----------
    angles : ndarray, shape (n_pieces + 1,)
        Ends of the pieces [rad], rising from 0 to 2 pi.
    starts, ends : ndarray, shape (n_pieces,)
        Values at the left and at the right end of each piece, none negative.

    Examples
    --------
    >>> half = Profile(angles=np.array([0.0, TURN / 2, TURN]), starts=np.array([1.0, 0.0]), ends=np.array([1.0, 0.0]))
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

    @staticmethod
    def _derived(angles: FloatArray, starts: FloatArray, ends: FloatArray) -> "Profile":
        """Return a profile made from others, which were checked: a machine is made of dozens."""
        made = object.__new__(Profile)
        for name, array in (("angles", angles), ("starts", starts), ("ends", ends)):
            object.__setattr__(made, name, read_only(array))
        return made

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
        if np.array_equal(merged, self.angles):
            return self
        middles = (merged[:-1] + merged[1:]) / 2
        piece = np.clip(np.searchsorted(self.angles, middles) - 1, 0, self.starts.size - 1)
        left, width = self.angles[piece], np.diff(self.angles)[piece]
        rise = self.ends[piece] - self.starts[piece]

        def values(at: FloatArray) -> FloatArray:
            share = np.clip((at - left) / width, 0.0, 1.0)
            return self.starts[piece] + share * rise

        return Profile._derived(merged, values(merged[:-1]), values(merged[1:]))

    def scaled(self, factor: float) -> "Profile":
        """Return the profile times a finite factor, zero or more."""
        return Profile._derived(self.angles, factor * self.starts, factor * self.ends)

    def plus(self, other: "Profile") -> "Profile":
        """Return the sum of two profiles."""
        a, b = self.refined(other.angles), other.refined(self.angles)
        return Profile._derived(a.angles, a.starts + b.starts, a.ends + b.ends)

    def minimum(self, other: "Profile") -> "Profile":
        """Return the smaller of two profiles, with piece ends where they cross."""
        a, b = self.refined(other.angles), other.refined(self.angles)
        at_start, at_end = a.starts - b.starts, a.ends - b.ends
        crossing = at_start * at_end < 0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = at_start / (at_start - at_end)
        extra = (a.angles[:-1] + share * np.diff(a.angles))[crossing]
        a, b = a.refined(extra), b.refined(extra)
        return Profile._derived(a.angles, np.minimum(a.starts, b.starts), np.minimum(a.ends, b.ends))


def added(profiles: Iterable[Profile]) -> Profile:
    """Return the sum of profiles; zero if there are none."""
    found = tuple(profiles)
    return reduce(Profile.plus, found) if found else Profile.constant(0.0)


def merge_angles(*lists: FloatArray) -> FloatArray:
    """Return all angles [rad] sorted from 0 to 2 pi, those closer than `SAME_ANGLE` to one before left out."""
    kept = [0.0]
    for angle in sorted({angle for angles in lists for angle in angles.tolist()}):
        if angle - kept[-1] > SAME_ANGLE and TURN - angle > SAME_ANGLE:
            kept.append(angle)
    return np.array([*kept, TURN])
