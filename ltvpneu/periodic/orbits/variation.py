r"""How a periodic orbit changes along one direction of its parameters, to first order: the forward derivative.

With delta for the derivative along the direction, delta z' = A delta z + (delta A z + delta f): next to the orbit
itself in one block matrix, whose exponential gives both at any time of a step. Times run with the switches: "the same
instant" is the same time since the start of its step.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.cyclic import solve_cyclic
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory, Extreme, step_integrals
from ltvpneu.periodic.systems.signals import signal_index


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Variation(Value):
    """Derivative of an orbit, and of what is read off it, along one direction."""

    trajectory: ExponentialTrajectory
    blocks: FloatArray
    """[[A, delta A], [0, A]] of the balanced augmented states, (N, 2 (n + 1), 2 (n + 1))."""
    durations: FloatArray
    """Change of each duration, (N,)."""
    levels: FloatArray
    """Change of the input levels, (m,)."""
    starts: FloatArray
    """Balanced augmented (delta z, z) at the start of each step, (N, 2 (n + 1))."""

    def __repr__(self) -> str:
        return f"<Variation of the orbit of {self.trajectory.system.name}>"

    @property
    def initial_state(self) -> FloatArray:
        """Of the state at the start of the period, (n,)."""
        return self.step_states[0]

    @cached_property
    def step_states(self) -> FloatArray:
        """Of the states at the starts of the steps, (n_steps, n)."""
        n = self.trajectory.system.n_states
        return self.starts[:, :n] * self.trajectory.system.scaled.scales

    def mean(self, signal: str | int) -> float:
        """Of a signal's mean."""
        row = self._row(signal)
        system, rows = self.trajectory.system, self.trajectory.rows[:, row]
        k = rows.shape[1]
        sums = (step_integrals(self.blocks, system.durations) @ self.starts[:, :, None])[:, :k, 0]
        ends = self.trajectory.ends
        total = np.sum(rows * sums) + np.sum(rows * ends, axis=1) @ self.durations
        total += system.durations @ self._feedthrough(row)
        return float((total - self.trajectory.means()[row] * np.sum(self.durations)) / system.period)

    def minimum(self, signal: str | int) -> float:
        """Of a signal's least value."""
        return self._at(self._row(signal), self.trajectory.extreme_points(self._row(signal))[0])

    def maximum(self, signal: str | int) -> float:
        """Of a signal's greatest value."""
        return self._at(self._row(signal), self.trajectory.extreme_points(self._row(signal))[1])

    def amplitude(self, signal: str | int) -> float:
        """Of half a signal's peak-to-peak."""
        return (self.maximum(signal) - self.minimum(signal)) / 2

    def _at(self, row: int, place: Extreme) -> float:
        system, rows = self.trajectory.system, self.trajectory.rows[place.step, row]
        k = len(rows)
        both = exponentials(self.blocks[None, place.step] * place.time)[0] @ self.starts[place.step]
        change = float(rows @ both[:k]) + float(self._feedthrough(row)[place.step])
        if place.time == system.durations[place.step]:
            change += float(rows @ system.scaled.matrices[place.step] @ both[k:]) * float(self.durations[place.step])
        return change

    def _row(self, signal: str | int) -> int:
        system = self.trajectory.system
        return signal_index((*system.states, *(x for x in system.outputs if x not in system.states)), signal)

    def _feedthrough(self, row: int) -> FloatArray:
        system = self.trajectory.system
        extra = [i for i, name in enumerate(system.outputs) if name not in system.states]
        if row < system.n_states:
            return np.zeros(system.n_steps)
        return system.D[:, extra[row - system.n_states]] @ self.levels


def varied(
    trajectory: ExponentialTrajectory, *, durations: FloatArray, f: FloatArray, A: FloatArray, levels: FloatArray
) -> Variation:
    """Return the variation of an orbit along changes of durations (N,), f (N, n), A (N, n, n) and levels (m,)."""
    system = trajectory.system
    scaled, n, N = system.scaled, system.n_states, system.n_steps
    k = n + 1
    blocks = np.zeros((N, 2 * k, 2 * k))
    blocks[:, :k, :k] = blocks[:, k:, k:] = scaled.matrices
    blocks[:, :n, k : k + n] = A * (scaled.scales / scaled.scales[:, None])
    blocks[:, :n, -1] = f / (scaled.scales * scaled.unit)
    maps = exponentials(blocks * system.durations[:, None, None])
    jumps = system.scaled_jumps[:, :n, :n]
    rates = (scaled.matrices @ trajectory.ends[:, :, None])[:, :n, 0]
    added = (maps[:, :n, k:] @ trajectory.starts[:, :, None])[:, :, 0] + rates * durations[:, None]
    changes = solve_cyclic(jumps @ maps[:, :n, :n], jumps @ added[:, :, None])[:, :, 0]
    starts = np.concatenate([changes, np.zeros((N, 1)), trajectory.starts], axis=1)
    return Variation(trajectory=trajectory, blocks=blocks, durations=durations, levels=levels, starts=starts)
