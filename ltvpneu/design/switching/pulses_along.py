"""Pulses along a wanted cycle of the position: a start for `minimize="tracking"`.

The turn is cut into equal slots, with one pulse in the middle of each. The piston is taken to be where it is wanted,
and the volumes are followed, slot after slot. A slot's pulse is as long as it takes for the piston's acceleration by
(7b), at the slot's end, to be the wanted one. So the pulses pass the air that the wanted motion needs.
"""

import math
from functools import partial
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ltvpneu._arrays import FloatArray, finite_array, positive, whole
from ltvpneu.design.switching.duty_variables import LEAST_WIDTH, least_shares
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.dynamics import state_rate
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import OpeningTable

MOST_TURNS, SAME = 30, 1e-3
"""Turns followed at most, and change of every share from one turn to the next at which they repeat [-]."""
LEAST_SHARE = 0.02
RTOL = 1e-5
"""Of the volumes' integration: the answer is a start."""


def pulses_along(
    machine: Machine, frequency: float, angles: ArrayLike, positions: ArrayLike, n_pulses: int
) -> tuple[tuple[float, float], ...]:
    """Return the pulses, from angle to angle [rad], by which the piston nearly follows a wanted cycle.

    Parameters
    ----------
    machine : Machine
        Whose valve switches; what its other valves do, they go on doing.
    frequency : float
        Of the cycle [Hz].
    angles, positions : array_like, shape (n_points,)
        Places of the turn, rising from 0 to below 2 pi [rad], and where the piston is wanted there [m]; three or more.
    n_pulses : int
        Of equal distance.

    Raises
    ------
    ValueError
        The points are too few or do not rise, or a position is beyond a stop.
    LtvpneuError
        The volumes cannot be followed along this cycle.
    """
    speed = 2 * math.pi * positive("frequency", frequency, "Hz")
    whole("n_pulses", n_pulses)
    places = finite_array("angles", np.asarray(angles, dtype=np.float64), (None,))
    wanted = finite_array("positions", np.asarray(positions, dtype=np.float64), places.shape)
    if places.size < 3:
        raise ValueError(f"angles: found {places.size} points of the wanted cycle, expected three or more")
    if (np.diff(places) <= 0).any() or places[0] < 0 or places[-1] >= 2 * math.pi:
        raise ValueError(f"angles: found {places.tolist()} rad, expected rising ones from 0 to below 2 pi")
    low, high = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    if wanted.min() < low or wanted.max() > high:
        raise ValueError(
            f"positions: found {1e3 * wanted.min():g} to {1e3 * wanted.max():g} mm, expected them between the stops, "
            f"{1e3 * low:g} to {1e3 * high:g} mm"
        )
    cycle = CubicSpline(np.append(places, places[0] + 2 * math.pi), np.append(wanted, wanted[0]), bc_type="periodic")
    along = _Along(machine.at(frequency), cycle, speed, n_pulses)
    shares, state = np.full(n_pulses, 0.5), machine.rest_state.copy()
    least_on, least_off = (max(least * n_pulses, LEAST_WIDTH) for least in least_shares(machine.at(frequency)))
    for _ in range(MOST_TURNS):
        before = shares.copy()
        for slot in range(n_pulses):
            shares[slot], state = along.share(slot, state)
        if np.max(np.abs(shares - before)) < SAME:
            break
    width = 2 * math.pi / n_pulses
    halves = np.clip(shares, least_on, max(1 - least_off, least_on)) * width / 2
    return tuple(((i + 0.5) * width - half, (i + 0.5) * width + half) for i, half in enumerate(halves.tolist()))


class _Along:
    """The volumes of a machine whose piston goes as it is wanted to."""

    def __init__(self, machine: Machine, cycle: CubicSpline, speed: float, n_slots: int) -> None:
        self.machine, self._cycle, self._speed = machine, cycle, speed
        self._width = 2 * math.pi / n_slots
        self._tables = [machine.with_duty(duty).openings for duty in (0.0, 1.0)]

    def share(self, slot: int, state: FloatArray) -> tuple[float, FloatArray]:
        """Return the share of a slot for which the valve is on, and the state at the slot's end."""
        asked = float(self._cycle((slot + 1) * self._width, 2)) * self._speed**2

        def missed(share: float) -> float:
            return self._acceleration(slot, self._followed(slot, state, share)) - asked

        ends = missed(LEAST_SHARE), missed(1 - LEAST_SHARE)
        if ends[0] * ends[1] < 0:
            share = cast(float, brentq(missed, LEAST_SHARE, 1 - LEAST_SHARE, xtol=SAME))
        else:
            share = LEAST_SHARE if abs(ends[0]) < abs(ends[1]) else 1 - LEAST_SHARE
        return share, self._followed(slot, state, share)

    def _acceleration(self, slot: int, end: FloatArray) -> float:
        rate = np.empty(end.size)
        state_rate(end, _areas(self._tables[0], (slot + 1) * self._width), self._way(end[1]), self.machine.record, rate)
        return float(rate[1])

    def _followed(self, slot: int, state: FloatArray, share: float) -> FloatArray:
        """Return the state at a slot's end, with the valve on for a share of it, in its middle."""
        begin, volumes = slot * self._width, state[2:]
        edges = begin + self._width * np.array([0.0, 0.5 - share / 2, 0.5 + share / 2, 1.0])
        for table, (first, last) in zip([0, 1, 0], pairwise(edges.tolist()), strict=True):
            found = solve_ivp(
                partial(self._rate, table=self._tables[table]), (first, last), volumes, method="LSODA", rtol=RTOL,
                atol=RTOL * self.machine.state_scales[2:],
            )  # fmt: skip
            if not found.success or not np.isfinite(found.y[:, -1]).all():
                raise LtvpneuError(f"the volumes cannot be followed along the wanted cycle: {found.message}")
            volumes = found.y[:, -1]
        return self._state(begin + self._width, volumes)

    def _state(self, angle: float, volumes: FloatArray) -> FloatArray:
        position, velocity = float(self._cycle(angle)), float(self._cycle(angle, 1)) * self._speed
        return np.array([position, velocity, *volumes])

    def _rate(self, angle: float, volumes: FloatArray, table: OpeningTable) -> FloatArray:
        state, rate = self._state(angle, volumes), np.empty(2 + volumes.size)
        state_rate(state, _areas(table, angle), self._way(state[1]), self.machine.record, rate)
        return rate[2:] / self._speed

    def _way(self, velocity: float) -> int:
        return int(np.sign(velocity))


def _areas(table: OpeningTable, angle: float) -> FloatArray:
    part = np.array(angle / (2 * math.pi) % 1.0)
    return table.areas_at(part, table.pieces_at(part))
