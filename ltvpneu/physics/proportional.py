"""Proportional valve: a spool that follows a command over the turn, so that areas ramp between switching instants."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, finite
from ltvpneu._values import Value
from ltvpneu.physics.profile import SAME_ANGLE, TURN, Profile


@final
@dataclass(frozen=True, kw_only=True)
class Command(Value):
    """A spool's position over the turn, linear between points; from -1 to 1.

    Parameters
    ----------
    angles : tuple of float
        Of the points [rad], rising, from 0 to below 2 pi; two equal angles in turn (to 1e-9 of the turn) make a
        jump. After the last the
        command goes on, linearly, to the first of the next turn.
    openings : tuple of float
        Positions at the points [-]. Above zero they open the "on" paths of the valve, below zero the "off" paths: a
        spool with zero lap.

    Examples
    --------
    >>> triangle = Command(angles=(0.0, TURN / 2), openings=(-1.0, 1.0))
    >>> triangle.profile.mean(0.0, TURN), triangle.complement.profile.at(0.0)
    (0.25, 1.0)
    """

    angles: tuple[float, ...]
    openings: tuple[float, ...]

    def __post_init__(self) -> None:
        angles = tuple(finite(f"angles[{i}]", angle, "rad") for i, angle in enumerate(self.angles))
        openings = tuple(finite(f"openings[{i}]", value) for i, value in enumerate(self.openings))
        if not angles or len(angles) != len(openings):
            raise ValueError(
                f"angles, openings: found {len(angles)} and {len(openings)}, expected as many of one as of the other, "
                "at least one"
            )
        for i, (before, after) in enumerate(pairwise(angles)):
            if after < before:
                raise ValueError(f"angles[{i + 1}]: found {after:g} rad after {before:g} rad, expected rising angles")
        if angles[0] < 0 or angles[-1] >= TURN:
            raise ValueError(f"angles: found {angles[0]:g} to {angles[-1]:g} rad, expected 0 to below 2 pi")
        for i, value in enumerate(openings):
            if not -1 <= value <= 1:
                raise ValueError(f"openings[{i}]: found {value:g}, expected -1 (off paths open) to 1 (on paths open)")
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "openings", openings)

    @property
    def complement(self) -> "Command":
        """The command as the "off" paths see it."""
        return Command(angles=self.angles, openings=tuple(-value for value in self.openings))

    @property
    def width(self) -> float:
        """Angle over which a valve that is either shut or fully open would let as much through [rad]."""
        return TURN * self.profile.mean(0.0, TURN)

    @cached_property
    def profile(self) -> Profile:
        """Opening of the "on" paths over the turn, 0 (shut) to 1 (fully open)."""
        angles, values = self._apart(), np.array(self.openings)
        # Round the turn: from its last point in the turn before to its first in the next.
        angles = np.concatenate([angles[-1:] - TURN, angles, angles[:1] + TURN])
        values = np.concatenate([values[-1:], values, values[:1]])
        left, right = np.maximum(angles[:-1], 0.0), np.minimum(angles[1:], TURN)
        kept = right > left
        left, right = left[kept], right[kept]
        width, first, rise = np.diff(angles)[kept], values[:-1][kept], np.diff(values)[kept]
        # Between points; rounding might go beyond them.
        begin = np.clip(first + rise * (left - angles[:-1][kept]) / width, -1.0, 1.0)
        end = np.clip(first + rise * (right - angles[:-1][kept]) / width, -1.0, 1.0)
        # Cut where the spool passes its middle: there the paths of one side shut.
        crossing = begin * end < 0
        with np.errstate(divide="ignore", invalid="ignore"):
            middles = (left + (right - left) * begin / (begin - end))[crossing]
        whole = Profile(angles=np.append(left, TURN), starts=begin + 1.0, ends=end + 1.0).refined(middles)
        return Profile(
            angles=whole.angles, starts=np.maximum(whole.starts - 1.0, 0.0), ends=np.maximum(whole.ends - 1.0, 0.0)
        )

    def _apart(self) -> FloatArray:
        """Return the angles, those too near to the one before or to the turn's ends put there; (n_points,)."""
        angles = np.array(self.angles)
        angles[angles < SAME_ANGLE] = 0.0
        angles[angles > TURN - SAME_ANGLE] = TURN
        for i in range(1, angles.size):
            if angles[i] - angles[i - 1] < SAME_ANGLE:
                angles[i] = angles[i - 1]
        return angles


@final
@dataclass(frozen=True, kw_only=True)
class ProportionalValve(Value):
    """A valve whose paths open in proportion to a command.

    Parameters
    ----------
    command : Command

    Examples
    --------
    >>> valve = ProportionalValve(command=Command(angles=(0.0, TURN / 2), openings=(0.0, 1.0)))
    >>> round(valve.on_window().width / TURN, 9)
    0.5
    """

    command: Command

    def on_window(self) -> Command:
        """Return the command, which stands for the arcs over which an on-off valve is on."""
        return self.command

    def with_command(self, command: Command) -> "ProportionalValve":
        """Return the valve with another command."""
        return ProportionalValve(command=command)

    def with_duty(self, duty: float) -> "ProportionalValve":
        """Raise: a proportional valve has no duty cycle."""
        raise ValueError(f"duty: found {duty:g} for a proportional valve, which follows its command; use with_command")

    def with_pulses(self, pulses: object) -> "ProportionalValve":
        """Raise: a proportional valve has no pulses."""
        raise ValueError(
            f"pulses: found {pulses!r} for a proportional valve, which follows its command; use with_command"
        )
