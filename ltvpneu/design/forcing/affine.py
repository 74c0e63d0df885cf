r"""The orbit of a periodic system as an affine function of its inputs: one value each, or one a step.

With the steps fixed, (11) and (14) are linear in the forcing f_m = B_m u_m + r_m. Augmented by its forcing, the state
of a step obeys

.. math:: \frac{d}{dt}\begin{pmatrix} z \\ f \end{pmatrix} = \begin{pmatrix} A & I \\ 0 & 0 \end{pmatrix}
          \begin{pmatrix} z \\ f \end{pmatrix}

so a sample is a row of one exponential of that matrix M, and a Fourier coefficient over a step a row of the integral of
exp((M - j omega I) s), itself a block of an exponential: all is a row times the affine (z, f) at the step starts.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.cyclic import solve_cyclic
from ltvpneu.periodic.algebra.propagate import balancing_scales, complex_exponentials, exponentials
from ltvpneu.periodic.orbits.steady import steady_state
from ltvpneu.periodic.systems.signals import signal_index
from ltvpneu.periodic.systems.system import PeriodicSystem


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class AffineOrbit(Value):
    """A system's orbit over its inputs w, one value of every input for every step, (n_steps * m,), step by step.

    Every figure comes as one row: coefficients of w, and a last one that stands for itself.
    """

    system: PeriodicSystem

    def __post_init__(self) -> None:
        # There must be one orbit, whatever the inputs: that is a matter of the matrices alone.
        steady_state(self.system)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the states, then of the outputs that are not states."""
        return (*self.system.states, *(name for name in self.system.outputs if name not in self.system.states))

    @cached_property
    def scales(self) -> FloatArray:
        """Powers of two that balance the states, (n,)."""
        return balancing_scales(self.system.A, self.system.durations)

    @cached_property
    def matrices(self) -> FloatArray:
        """M of every step in balanced coordinates, the forcing times the period, (n_steps, 2 n, 2 n)."""
        system, n = self.system, self.system.n_states
        found = np.zeros((system.n_steps, 2 * n, 2 * n))
        found[:, :n, :n] = system.A * (self.scales / self.scales[:, None])
        found[:, :n, n:] = np.eye(n) / system.period
        return found

    @cached_property
    def forcing(self) -> FloatArray:
        """Balanced forcing times the period over w and one, (n_steps, n, n_steps * m + 1)."""
        system = self.system
        N, n, m = system.B.shape
        found = np.zeros((N, n, N * m + 1))
        for k in range(N):
            found[k, :, k * m : (k + 1) * m] = system.B[k]
            found[k, :, -1] = system.r[k]
        return found * (system.period / self.scales)[:, None]

    @cached_property
    def starts(self) -> FloatArray:
        """Balanced (z, f) at the starts of the steps over w and one, (n_steps, 2 n, n_steps * m + 1)."""
        system, n = self.system, self.system.n_states
        pieces = system.growing_pieces
        counts = np.repeat(np.arange(system.n_steps), pieces)
        maps = exponentials(self.matrices[counts] * (system.durations / pieces)[counts, None, None])
        states = solve_cyclic(maps[:, :n, :n], maps[:, :n, n:] @ self.forcing[counts])
        return np.concatenate([states[np.cumsum(pieces) - pieces], self.forcing], axis=1)

    def sample(self, signal: str | int, times: FloatArray) -> FloatArray:
        """Return rows of a signal at times within the period [s], (n_times, n_steps * m + 1)."""
        step, since = self.system.step_at(times)
        maps = exponentials(self.matrices[step] * since[:, None, None])
        rows, direct = self._rows(signal)
        return np.einsum("ti,tij,tjw->tw", rows[step], maps, self.starts[step]) + direct[step]

    def coefficient(self, signal: str | int, harmonic: int) -> ComplexArray:
        """Return the row of a signal's Fourier coefficient, its mean times e^{-j h omega t}."""
        system, k = self.system, self.matrices.shape[1]
        omega, T = 2 * np.pi * harmonic / system.period, system.durations
        block = np.zeros((system.n_steps, 2 * k, 2 * k), dtype=np.complex128)
        block[:, :k, :k] = (self.matrices - 1j * omega * np.eye(k)) * T[:, None, None]
        block[:, :k, k:] = np.eye(k)
        integrals = complex_exponentials(block)[:, :k, k:] * T[:, None, None]
        rows, direct = self._rows(signal)
        turned = np.exp(-1j * omega * system.switching_times[:-1])
        within = np.einsum("ki,kij,kjw->kw", rows, integrals, self.starts)
        spans = T.astype(np.complex128) if harmonic == 0 else (1 - np.exp(-1j * omega * T)) / (1j * omega)
        return turned @ (within + direct * spans[:, None]) / system.period

    def _rows(self, signal: str | int) -> tuple[FloatArray, FloatArray]:
        """Return a signal over the balanced (z, f) of each step, (n_steps, 2 n), and its direct part over w and one."""
        system, found = self.system, signal_index(self.signals, signal)
        N, n, m = system.B.shape
        rows, direct = np.zeros((N, 2 * n)), np.zeros((N, N * m + 1))
        if found < n:
            rows[:, found] = self.scales[found]
            return rows, direct
        output = system.outputs.index(self.signals[found])
        rows[:, :n] = system.C[:, output] * self.scales
        for k in range(N):
            direct[k, k * m : (k + 1) * m] = system.D[k, output]
            direct[k, -1] = system.q[k, output]
        return rows, direct
