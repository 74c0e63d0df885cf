"""The whole interval of positions at which stiction holds the piston while the valve switches.

With the piston held at x its chambers' pressures settle on cycles of their own, and the external force swings between
F_min(x) and F_max(x). It stays where F_max <= F_s and F_min >= -F_s; both fall as x grows, on a spring, so each sets
one end of the interval.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast, final

import numpy as np
from scipy.optimize import brentq

from ltvpneu._arrays import positive
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.piston import hold_of
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.rest import positions_of_rest

SAMPLES = 400


@final
@dataclass(frozen=True, kw_only=True)
class StictionBand(Value):
    """Positions at which the piston stays at rest; none where `lowest` is above `highest`.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> band = lp.stiction_band(lp.load_machine("kunt_singh_1990").with_duty(0.7), 20.0)
    >>> print(f"{1e3 * band.lowest:.1f} to {1e3 * band.highest:.1f} mm")
    68.7 to 71.3 mm
    """

    frequency: float
    """[Hz]"""
    lowest: float
    """Position below which the piston is pushed up [m]."""
    highest: float
    """Position above which the piston is pushed down [m]."""

    def __repr__(self) -> str:
        if not self.exists:
            return f"<StictionBand at {self.frequency:g} Hz: none, stiction holds the piston nowhere>"
        return f"<StictionBand at {self.frequency:g} Hz: {self.lowest:.6g} to {self.highest:.6g} m>"

    @property
    def width(self) -> float:
        """Length of the interval [m]; zero where there is none."""
        return max(self.highest - self.lowest, 0.0)

    @property
    def exists(self) -> bool:
        """Whether the piston rests anywhere."""
        return self.highest >= self.lowest


def stiction_band(machine: Machine, frequency: float) -> StictionBand:
    """Return the interval of positions where stiction holds the piston through whole valve periods.

    Parameters
    ----------
    machine : Machine
        With a spring or both end stops.
    frequency : float
        Switching frequency [Hz].

    Raises
    ------
    ValueError
        Neither a spring nor end stops bound the interval.
    """
    expect_machine(machine)
    positive("frequency", frequency, "Hz")
    load = machine.load
    machine = machine.at(frequency)
    held = replace(machine, load=replace(load, stiction=1e12))

    def forces(position: float) -> tuple[float, float]:
        start = np.array(machine.rest_state)
        start[0] = position
        orbit = nonlinear_orbit(held, frequency, start)
        times = np.union1d(np.linspace(0.0, orbit.period, SAMPLES), orbit.step_times)
        states, record = orbit.at(times).T.copy(), machine.record
        pushes, seals = np.array([(external_force(z, record), hold_of(z, record)) for z in states]).T
        # What is left of the push beyond what holds at its pressures, down and up.
        return float((pushes + seals).min()), float((pushes - seals).max())

    low, high = _bracket(machine)

    def pushed_up(position: float) -> float:
        return forces(position)[1]

    def pushed_down(position: float) -> float:
        return forces(position)[0]

    lowest = _edge(pushed_up, low, high)
    highest = _edge(pushed_down, low, high)
    return StictionBand(frequency=float(frequency), lowest=lowest, highest=highest)


def _edge(force: Callable[[float], float], low: float, high: float) -> float:
    """Return where a force that falls with the position passes zero; an end of the range where it does not."""
    if force(low) <= 0:
        return low
    if force(high) >= 0:
        return high
    return cast(float, brentq(force, low, high, xtol=1e-9 * (high - low)))


def _bracket(machine: Machine) -> tuple[float, float]:
    """Return positions beyond which no pressure between the sources' holds the piston, within stops and volumes."""
    lower, upper = positions_of_rest(machine)
    if not (math.isfinite(lower) and math.isfinite(upper)):
        raise ValueError(
            "load.spring_stiffness: found none, and no two end stops; expected a spring, or cylinder.lower_stop and "
            "upper_stop: nothing else bounds the positions of rest"
        )
    return lower, upper
