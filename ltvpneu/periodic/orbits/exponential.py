r"""A trajectory of a piecewise-constant system: on each step a sum of exponentials, exact at every time.

The mean over a step comes from the exponential with the start as one more column,

.. math:: \exp\begin{bmatrix} M T & z \\ 0 & 0 \end{bmatrix}
          = \begin{bmatrix} e^{M T} & \int_0^1 e^{M T s} z\, ds \\ 0 & 1 \end{bmatrix}

which is the start itself for a step of no duration. Extremes lie at step boundaries or at roots of a signal's
derivative, which are bracketed on a grid fine enough for the step's fastest oscillation and decay, and then solved for.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials, forced_exponentials
from ltvpneu.periodic.algebra.small import root_time, sampled
from ltvpneu.periodic.systems.system import PeriodicSystem


class Extreme(NamedTuple):
    """A signal's least or greatest value, the step it falls in, and how long after that step's start [s]."""

    value: float
    step: int
    time: float


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ExponentialTrajectory(Value):
    """One period of a solution of a periodic system."""

    system: PeriodicSystem
    step_states: FloatArray
    """State at the start of each step, shape (n_steps, n)."""

    @cached_property
    def starts(self) -> FloatArray:
        """Balanced augmented states at the starts of the steps, shape (n_steps, n + 1)."""
        return self.system.scaled.augmented(self.step_states)

    @cached_property
    def ends(self) -> FloatArray:
        """Balanced augmented states at the ends of the steps, before any jump, shape (n_steps, n + 1)."""
        if self.system.has_jumps:
            return (self.system.flows.maps @ self.starts[:, :, None])[:, :, 0]
        return np.roll(self.starts, -1, axis=0)

    @cached_property
    def rows(self) -> FloatArray:
        """Signals over the balanced augmented state, shape (n_steps, n_signals, n + 1)."""
        system, scales = self.system, self.system.scaled.scales
        n = system.n_states
        extra = [i for i, name in enumerate(system.outputs) if name not in system.states]
        rows = np.zeros((system.n_steps, n + len(extra), n + 1))
        rows[:, :n, :n] = np.diag(scales)
        rows[:, n:, :n] = system.C[:, extra] * scales
        rows[:, n:, n] = system.output_bias[:, extra] / self.system.scaled.unit
        return rows

    def at(self, times: FloatArray) -> FloatArray:
        """Return the signals at times within the period, shape (n_signals, n_times); at a switch, just after it."""
        step, local = self.system.step_at(times)
        maps = forced_exponentials(self.system.scaled.matrices[step] * local[:, None, None], self.system.n_states)
        states = np.einsum("tij,tj->ti", maps, self.starts[step])
        return np.einsum("tsi,ti->st", self.rows[step], states)

    def step_means(self) -> FloatArray:
        """Return the mean of every signal over every step, shape (n_steps, n_signals); (17) with erratum E10."""
        return (self.rows @ self._mean_states[:, :, None])[:, :, 0]

    def step_state_means(self) -> FloatArray:
        """Return the mean of every state over every step, shape (n_steps, n)."""
        return self.system.scaled.physical(self._mean_states)

    @cached_property
    def _mean_states(self) -> FloatArray:
        """Means over the steps of the balanced augmented state, shape (n_steps, n + 1)."""
        durations, starts = self.system.durations, self.starts
        N, k = starts.shape
        # The start as one more column, of about the size of one, so that it does not spoil the scaling.
        size = float(np.abs(starts).max())
        block = np.zeros((N, k + 1, k + 1))
        block[:, :k, :k] = self.system.scaled.matrices * durations[:, None, None]
        block[:, :k, k] = starts / size
        return exponentials(block)[:, :k, k] * size

    @cached_property
    def _means(self) -> FloatArray:
        weights = self.system.durations / self.system.period
        return weights @ self.step_means()

    def means(self) -> FloatArray:
        """Return the time means of the signals, shape (n_signals,)."""
        return self._means

    def extremes(self, signal: int) -> tuple[float, float]:
        """Return the least and the greatest value of a signal."""
        low, high = self.extreme_points(signal)
        return low.value, high.value

    def extreme_points(self, signal: int) -> tuple[Extreme, Extreme]:
        """Return where a signal is least and greatest."""
        steps = self.step_extremes(signal)
        lows, highs = [low for low, _ in steps], [high for _, high in steps]
        return min(lows, key=lambda place: place.value), max(highs, key=lambda place: place.value)

    def step_extremes(self, signal: int) -> list[tuple[Extreme, Extreme]]:
        """Return where a signal is least and greatest on each step, its ends included."""
        sampled = self._samples[:, :, signal]
        steps = range(sampled.shape[0])
        times = self.system.durations[:, None] * self._shares
        least, greatest = np.argmin(sampled, axis=1), np.argmax(sampled, axis=1)
        low = [Extreme(float(sampled[m, least[m]]), m, float(times[m, least[m]])) for m in steps]
        high = [Extreme(float(sampled[m, greatest[m]]), m, float(times[m, greatest[m]])) for m in steps]
        slopes = self._slope_rows(signal)
        changed = np.einsum("mi,mji->mj", slopes, self._sampled_states)
        for step, left in np.argwhere(changed[:, :-1] * changed[:, 1:] < 0).tolist():
            place = self._at_root(step, left, signal, slopes[step])
            low[step] = place if place.value < low[step].value else low[step]
            high[step] = place if place.value > high[step].value else high[step]
        return list(zip(low, high, strict=True))

    def _slope_rows(self, signal: int) -> FloatArray:
        return np.einsum("mi,mij->mj", self.rows[:, signal], self.system.scaled.matrices)

    def _at_root(self, step: int, left: int, signal: int, slope: FloatArray) -> Extreme:
        matrix, duration = self.system.scaled.matrices[step], self.system.durations[step]
        start = self._sampled_states[step, left]
        since = float(duration * self._shares[left])
        after = root_time(matrix, start, slope, float(duration * (self._shares[left + 1] - self._shares[left])))
        # The sample beyond was computed another way: at a root on the boundary rounding may leave no change of sign.
        if math.isnan(after):
            return Extreme(float(self.rows[step, signal] @ start), step, since)
        state = sampled(matrix[None], np.array([[after]]), start[None])[0, 0]
        return Extreme(float(self.rows[step, signal] @ state), step, since + after)

    @cached_property
    def _shares(self) -> FloatArray:
        """Shares of a step at which its states are sampled: evenly for oscillation, halving to 0 for decay."""
        eigenvalues = np.linalg.eigvals(self.system.scaled.matrices[:, :-1, :-1]) * self.system.durations[:, None]
        decay = float(np.max(np.abs(eigenvalues), initial=0.0))
        # A swing that decays is below rounding when its exponent reaches 40: beyond, nothing oscillates any more.
        swinging = np.abs(eigenvalues.imag) > 0
        with np.errstate(divide="ignore"):
            lasts = np.where(eigenvalues.real < 0, np.minimum(40.0 / np.abs(eigenvalues.real), 1.0), 1.0)
        until = float(np.max(lasts, where=swinging, initial=0.0))
        swings = float(np.max(np.abs(eigenvalues.imag), initial=0.0)) * until
        even = np.union1d(np.linspace(0.0, until, 1 + int(np.ceil(4 * swings / np.pi))), np.linspace(0.0, 1.0, 5))
        halvings = 2.0 ** -np.arange(1, 2 + max(0, int(np.ceil(np.log2(max(decay, 1.0))))))
        return np.asarray(np.union1d(even, halvings), dtype=np.float64)

    @cached_property
    def _sampled_states(self) -> FloatArray:
        """Balanced augmented states at the sampled shares of all steps, shape (n_steps, n_shares, n + 1)."""
        return sampled(self.system.scaled.matrices, self.system.durations[:, None] * self._shares, self.starts)

    @cached_property
    def _samples(self) -> FloatArray:
        return np.einsum("msi,mji->mjs", self.rows, self._sampled_states)


def step_integrals(matrices: FloatArray, durations: FloatArray) -> FloatArray:
    """Integrals of exp(M t) over each step, shapes (n_steps, k, k) and (n_steps,) to (n_steps, k, k)."""
    N, k = matrices.shape[:2]
    block = np.zeros((N, 2 * k, 2 * k))
    block[:, :k, :k] = matrices
    block[:, :k, k:] = np.eye(k)
    return exponentials(block * durations[:, None, None])[:, :k, k:]
