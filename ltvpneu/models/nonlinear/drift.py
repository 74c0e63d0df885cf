"""Volumes that fill or empty slowly beside whatever else goes on.

However the piston moves, the mass in a volume that only leaks changes by little in a period, and always the same way.
So such a volume is carried on by the change of many periods at once, and the rest of the machine follows by itself.
"""

import math

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu._compiled import compiled
from ltvpneu.models.machine.dynamics import chamber_volume, gas_in_volume, properties_of
from ltvpneu.models.machine.records import MachineRecord
from ltvpneu.models.nonlinear.integrator import POLYNOMIAL
from ltvpneu.models.nonlinear.periods import March

WINDOW, DRIFTS = 32, 16
"""Periods to wait for fast motions to die down, and of them the last, by which a drift is known."""
SLOW_SHARE = 2e-3
"""Share of a volume's mass that comes and goes in a period, below which the volume is slow [-]."""
SHARE_AT_ONCE = 0.05
"""By which a slow volume is carried on at once; the piston follows by itself [-]."""
BOLDER = 1.3
"""Growth of that share, which is halved where a volume turns back."""
ONE_WAY = 0.99
"""Share of a path that its ends are apart at least if it leads one way [-]."""
DIFFERENCE = 1e-6
"""Share of a pressure over which a volume's mass is differenced [-]."""


class Drift:
    """How volumes drift, and how far they are carried on at once."""

    def __init__(self, n_volumes: int) -> None:
        self.way, self.caution = np.zeros(n_volumes), 1.0
        """Changes of masses by which volumes were last carried on, as shares, and how much less far they are now."""

    def carried_on(self, march: March) -> FloatArray | None:
        """Return the state of a march after many periods; None where no volume is slow enough."""
        machine = march.machine
        masses = np.array(
            [[_mass_in(k, z, machine) for k in range(self.way.size)] for z in march.last_states(DRIFTS + 1)]
        )
        shares = np.diff(masses, axis=0) / masses[-1]
        slow = (_breaths(march.log, machine) < SLOW_SHARE) & _is_one_way(shares)
        if not slow.any():
            return None
        way = np.where(slow, shares.mean(axis=0), 0.0)
        self.caution = 0.5 * self.caution if bool((way * self.way < 0.0).any()) else min(1.0, BOLDER * self.caution)
        self.way = way
        n_periods = SHARE_AT_ONCE * self.caution / float(np.abs(way).max())
        if n_periods <= WINDOW:
            return None
        reached = march.state.copy()
        for k in slow.nonzero()[0].tolist():
            more = reached.copy()
            more[2 + k] *= 1.0 + DIFFERENCE
            here, there = _mass_in(k, reached, machine), _mass_in(k, more, machine)
            wanted = masses[-1, k] * (1.0 + n_periods * way[k])
            reached[2 + k] += (wanted - here) / (there - here) * (more[2 + k] - reached[2 + k])
        return within_sources(march.state, reached, machine)


def _is_one_way(moves: FloatArray) -> BoolArray:
    """Return whether moves, (n_periods, ...), all go the same way."""
    whole = np.abs(moves).sum(axis=0)
    return (whole > 0.0) & (np.abs(moves.sum(axis=0)) > ONE_WAY * whole)


@compiled
def within_sources(state: FloatArray, reached: FloatArray, machine: MachineRecord) -> FloatArray:
    """Return a state reached from another where no pressure has passed that of a source: a slow flow ends there."""
    found = reached.copy()
    for k in range(2, 2 + machine.n_volumes):
        for source in (machine.supply.pressure, machine.exhaust.pressure):
            if (state[k] - source) * (found[k] - source) < 0.0:
                found[k] = source
    return found


@compiled
def _mass_in(k: int, state: FloatArray, machine: MachineRecord) -> float:
    """Return the mass in a volume [kg]."""
    inside = gas_in_volume(k, state, machine)
    return properties_of(inside, machine).rho * chamber_volume(k, state[0], machine)


@compiled
def _breaths(log: FloatArray, machine: MachineRecord) -> FloatArray:
    """Return by how much the mass in each volume varies over a period, as a share of it, (n_volumes,)."""
    n_volumes, n = machine.n_volumes, (log.shape[1] - POLYNOMIAL) // 5
    low, high, state = np.full(n_volumes, math.inf), np.zeros(n_volumes), np.empty(n)
    for row in range(log.shape[0]):
        for i in range(n):
            state[i] = log[row, POLYNOMIAL + i]
        for k in range(n_volumes):
            mass = _mass_in(k, state, machine)
            low[k], high[k] = min(low[k], mass), max(high[k], mass)
    return (high - low) / high
