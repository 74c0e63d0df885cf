r"""Rotary valve kinematics (1)-(2).

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
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, final

from ltvpneu._arrays import finite, not_negative
from ltvpneu._values import Value
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.profile import TURN, Profile, added
from ltvpneu.physics.window import Pulses, Window, check_pulses, support

Phase = Literal["on", "off", "always"]


@final
@dataclass(frozen=True, kw_only=True)
class Port(Value):
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
class RotaryValve(Value):
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

    def joins(self, way: str, volume: str) -> bool:
        """Return whether a way has a port into an inner volume."""
        return any((port.way, port.volume) == (way, volume) for port in self.ports)

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
        return added(
            self.window(port).profile.scaled(port.discharge_coefficient * port.area)
            for port in self.ports
            if (port.way, port.volume) == (way, volume)
        )

    def collapsed_area(self, way: str, other: str) -> Profile:
        """Effective area between two ways, the inner volumes collapsed to points [m^2], eq. (2)."""
        return added(self.way_area(way, volume).minimum(self.way_area(other, volume)) for volume in self.volumes)

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
        return support(overlap)


def check_duty(duty: float, name: str = "duty") -> float:
    """Return the duty cycle if it is a number from 0 to 1."""
    if not 0 <= finite(name, duty) <= 1:
        raise ValueError(f"{name}: found {duty:g}, expected on-time over period, 0 to 1")
    return float(duty)


def check_phase(name: str, phase: str) -> None:
    """Raise unless the phase is "on", "off" or "always"."""
    if phase not in ("on", "off", "always"):
        raise ValueError(f'{name}: found {phase!r}, expected "on", "off" or "always"')
