r"""Derivatives of a periodic orbit and of its multipliers, exact, forward and adjoint.

*Adjoint*, one functional with respect to everything: costates solve p_k = F_k' p_{k+1} + h_k round the period, where
h_k is what the functional takes from step k directly, and within a step the costate w(s) runs backward from p_{k+1}.
Then

.. math:: d\phi = \sum_k \int_0^{T_k} w' (dA_k\, z + df_k)\, ds + p_{k+1}' \dot z(T_k)\, dT_k + \text{direct parts}

and the integrals over a step are a block of one exponential [VanLoan1978]_. *Forward*, everything along one direction:
`variation`. A multiplier of right and left modes p, q with q' p = 1 changes by

.. math:: d \log\lambda = \sum_k \int_0^{T_k} q' dA_k\, p\, ds + q_{k+1}' A_k p_{k+1}\, dT_k

which no more needs the multiplier itself than its logarithm did. Extremes move with the signal at their instant: where
that instant lies changes nothing at first order, unless two are equal.

.. [VanLoan1978] C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Autom. Control 23,
   1978.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.cyclic import solve_cyclic_adjoint
from ltvpneu.periodic.algebra.propagate import complex_exponentials, exponentials
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory, Extreme
from ltvpneu.periodic.orbits.floquet import Floquet, floquet
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.orbits.steady import periodic_states, steady_state
from ltvpneu.periodic.orbits.variation import Variation, varied
from ltvpneu.periodic.systems.signals import signal_index
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Gradient(Value):
    """Derivatives of one quantity; complex where the quantity is."""

    by_duration: NDArray[Any]
    """With respect to each step's duration, the others kept (so the period changes), [1/s], (n_steps,)."""
    by_forcing: NDArray[Any]
    """With respect to the forcing f (or r) of each step, (n_steps, n)."""
    by_level: NDArray[Any]
    """With respect to the levels of the inputs, (m,)."""
    by_matrix: NDArray[Any]
    """With respect to the entries of A of each step, (n_steps, n, n)."""

    def minus(self, other: "Gradient", factor: float = 1.0) -> "Gradient":
        """Return factor times the difference of two gradients."""
        return Gradient(
            by_duration=factor * (self.by_duration - other.by_duration),
            by_forcing=factor * (self.by_forcing - other.by_forcing),
            by_level=factor * (self.by_level - other.by_level),
            by_matrix=factor * (self.by_matrix - other.by_matrix),
        )


class _Functional(NamedTuple):
    """A linear functional of the orbit, in balanced coordinates."""

    seeds: FloatArray
    """What it takes from the states at the starts of the steps, (N, n)."""
    density: FloatArray
    """What it takes from the states per unit of time within the steps, (N, n)."""
    durations: FloatArray
    """Its direct dependence on the durations, (N,)."""
    levels: FloatArray
    """Its direct dependence on the input levels, (m,)."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Sensitivity(Value):
    """Derivatives of the periodic steady state of a system; each is computed when first asked for.

    Examples
    --------
    How the mean of an RC circuit's voltage moves with the on-time, the period kept:

    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[1.0], [0.0]], [0.25, 0.75])
    >>> on, off = lp.sensitivity(system).of_mean("z1").by_duration
    >>> print(round(on - off, 12))
    1.0
    """

    system: PeriodicSystem

    def __repr__(self) -> str:
        return f"<Sensitivity of the orbit of {self.system.name}>"

    @cached_property
    def orbit(self) -> Orbit:
        """The periodic steady state."""
        return steady_state(self.system)

    @cached_property
    def floquet(self) -> Floquet:
        """Multipliers and modes."""
        return floquet(self.system)

    @cached_property
    def initial_state_by_duration(self) -> FloatArray:
        """(n, n_steps): of the initial state, with respect to each duration on its own [1/s]."""
        return read_only(np.array([gradient.by_duration for gradient in self._of_initial_state]))

    @cached_property
    def initial_state_by_forcing(self) -> FloatArray:
        """(n, n_steps, n)."""
        return read_only(np.array([gradient.by_forcing for gradient in self._of_initial_state]))

    @cached_property
    def initial_state_by_level(self) -> FloatArray:
        """(n, m)."""
        return read_only(np.array([gradient.by_level for gradient in self._of_initial_state]))

    @cached_property
    def initial_state_by_matrix(self) -> FloatArray:
        """(n, n_steps, n, n)."""
        return read_only(np.array([gradient.by_matrix for gradient in self._of_initial_state]))

    @cached_property
    def log_multipliers_by_duration(self) -> ComplexArray:
        """(n, n_steps) [1/s]: of the logarithm of each multiplier; real part log modulus, imaginary part angle."""
        return np.array([self.of_log_multiplier(i).by_duration for i in range(self.system.n_states)])

    @cached_property
    def multipliers_by_duration(self) -> ComplexArray:
        """(n, n_steps) [1/s]."""
        return self.floquet.multipliers[:, None] * self.log_multipliers_by_duration

    def of_initial_state(self, state: str | int) -> Gradient:
        """Return the derivatives of one component of the initial state."""
        return self._of_initial_state[signal_index(self.system.states, state)]

    def of_mean(self, signal: str | int) -> Gradient:
        """Return the derivatives of a signal's mean over the period."""
        system, row = self.system, signal_index(self.orbit.signals, signal)
        rows = self._trajectory.rows[:, row]
        ends = np.sum(rows * self._ends, axis=1)
        mean = float(self._trajectory.means()[row])
        weights = system.durations / system.period
        functional = _Functional(
            seeds=np.zeros((system.n_steps, system.n_states)),
            density=rows[:, :-1] / system.period,
            durations=(ends - mean) / system.period,
            levels=weights @ self._feedthrough(row),
        )
        return self._gradient(functional)

    def of_minimum(self, signal: str | int) -> Gradient:
        """Return the derivatives of a signal's least value."""
        row = signal_index(self.orbit.signals, signal)
        return self._of_extreme(row, self._trajectory.extreme_points(row)[0])

    def of_maximum(self, signal: str | int) -> Gradient:
        """Return the derivatives of a signal's greatest value."""
        row = signal_index(self.orbit.signals, signal)
        return self._of_extreme(row, self._trajectory.extreme_points(row)[1])

    def of_amplitude(self, signal: str | int) -> Gradient:
        """Return the derivatives of half a signal's peak-to-peak."""
        return self.of_maximum(signal).minus(self.of_minimum(signal), factor=0.5)

    def of_log_multiplier(self, i: int) -> Gradient:
        """Return the derivatives of the logarithm of a multiplier (complex: log modulus + j angle).

        Of the logarithm, since a multiplier itself may be beyond double precision. A multiple one has none.
        """
        system, found = self.system, self.floquet
        n, scales = system.n_states, system.scaled.scales
        p = found.mode_shapes[:, :, i] / scales
        q = found.adjoint_shapes[:, :, i] * scales
        after = self._mode_at_ends(p, i), self._before_jumps(np.roll(q, -1, axis=0))
        A = system.scaled.matrices[:, :n, :n]
        shifted = np.swapaxes(A - found.exponents[i] * np.eye(n), 1, 2)
        integrals = _products((shifted, shifted), (after[1], p), system.durations)
        return Gradient(
            by_duration=np.einsum("ki,kij,kj->k", after[1], A, after[0]),
            by_forcing=np.zeros((system.n_steps, n)),
            by_level=np.zeros(len(system.inputs)),
            by_matrix=integrals * scales / scales[:, None],
        )

    def along(
        self,
        *,
        durations: ArrayLike | None = None,
        forcing: ArrayLike | None = None,
        levels: ArrayLike | None = None,
        A: ArrayLike | None = None,
    ) -> Variation:
        """Return the derivative of the whole orbit along one direction: forward, one linear solve.

        Parameters
        ----------
        durations : array_like, shape (n_steps,), optional
            Change of each duration per unit of the parameter [s]; (T, -T) is a duty cycle's. Zero by default, as below.
        forcing : array_like, shape (n_steps, n), optional
        levels : array_like, shape (m,), optional
        A : array_like, shape (n_steps, n, n), optional
        """
        system = self.system
        N, n, m = system.B.shape
        by_levels = np.zeros(m) if levels is None else finite_array("levels", levels, (m,))
        forced = np.zeros((N, n)) if forcing is None else finite_array("forcing", forcing, (N, n))
        return varied(
            self._trajectory,
            durations=np.zeros(N) if durations is None else finite_array("durations", durations, (N,)),
            f=forced + system.B @ by_levels,
            A=np.zeros((N, n, n)) if A is None else finite_array("A", A, (N, n, n)),
            levels=by_levels,
        )

    @cached_property
    def _trajectory(self) -> ExponentialTrajectory:
        return ExponentialTrajectory(system=self.system, step_states=periodic_states(self.system))

    @cached_property
    def _ends(self) -> FloatArray:
        """Balanced augmented states at the ends of the steps, before any jump, (N, n + 1)."""
        return self._trajectory.ends

    def _before_jumps(self, after: NDArray[Any]) -> NDArray[Any]:
        """Return costates at the ends of the steps from those after the jumps there, (N, n)."""
        jumps = self.system.scaled_jumps[:, :-1, :-1]
        return np.einsum("kji,kj->ki", jumps, after) if self.system.has_jumps else after

    def _mode_at_ends(self, p: ComplexArray, i: int) -> ComplexArray:
        """Return the shape of a mode at the ends of the steps, before any jump, (N, n), in balanced coordinates."""
        system = self.system
        if not system.has_jumps:
            return np.roll(p, -1, axis=0)
        flows = system.flows.maps[:, :-1, :-1] * np.exp(-self.floquet.exponents[i] * system.durations)[:, None, None]
        return (flows @ p[:, :, None])[:, :, 0]

    def _feedthrough(self, row: int) -> FloatArray:
        """Return how a signal depends on the input levels directly, (N, m)."""
        name = self.orbit.signals[row]
        if name in self.system.states:
            return np.zeros((self.system.n_steps, len(self.system.inputs)))
        return self.system.D[:, self.system.outputs.index(name)]

    @cached_property
    def _of_initial_state(self) -> list[Gradient]:
        system = self.system
        N, n = system.n_steps, system.n_states
        found: list[Gradient] = []
        for i in range(n):
            seeds = np.zeros((N, n))
            seeds[0, i] = system.scaled.scales[i]
            found.append(
                self._gradient(
                    _Functional(
                        seeds=seeds,
                        density=np.zeros((N, n)),
                        durations=np.zeros(N),
                        levels=np.zeros(len(system.inputs)),
                    )
                )
            )
        return found

    def _of_extreme(self, row: int, place: Extreme) -> Gradient:
        """Return the derivatives of a signal at an instant of the orbit, local to its step."""
        system, trajectory = self.system, self._trajectory
        k, n = place.step, system.n_states
        rows, matrix = trajectory.rows[k, row], system.scaled.matrices[k]
        reached = exponentials(matrix[None] * place.time)[0]
        seeds, durations = np.zeros((system.n_steps, n)), np.zeros(system.n_steps)
        seeds[k] = rows[:n] @ reached[:n, :n]
        if place.time == system.durations[k]:
            # At the end of its step it moves with the end.
            durations[k] = rows @ matrix @ self._ends[k]
        functional = _Functional(
            seeds=seeds,
            density=np.zeros((system.n_steps, n)),
            durations=durations,
            levels=self._feedthrough(row)[k],
        )
        found = self._gradient(functional)
        # What happens within the step up to the instant.
        up_to = _products(
            (np.swapaxes(matrix[None, :n, :n], 1, 2), np.swapaxes(matrix[None], 1, 2)),
            (rows[None, :n], trajectory.starts[None, k]),
            np.array([place.time]),
        )
        return self._with_step(found, k, up_to[0])

    def _with_step(self, gradient: Gradient, k: int, integrals: FloatArray) -> Gradient:
        by_matrix, by_forcing = self._physical(integrals[None])
        matrices, forcing = gradient.by_matrix.copy(), gradient.by_forcing.copy()
        matrices[k] += by_matrix[0]
        forcing[k] += by_forcing[0]
        return Gradient(
            by_duration=gradient.by_duration,
            by_forcing=forcing,
            by_level=gradient.by_level + self.system.B[k].T @ by_forcing[0],
            by_matrix=matrices,
        )

    def _physical(self, integrals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives by A and by f from those by balanced augmented matrices, (k, n, n + 1)."""
        scales, unit = self.system.scaled.scales, self.system.scaled.unit
        return integrals[:, :, :-1] * scales / scales[:, None], integrals[:, :, -1] / (unit * scales)

    def _gradient(self, functional: _Functional) -> Gradient:
        system = self.system
        N, n, T = system.n_steps, system.n_states, system.durations
        matrices = system.scaled.matrices
        # The costate within a step, with a constant 1 for what the functional adds to it.
        backward = np.zeros((N, n + 1, n + 1))
        backward[:, :n, :n] = np.swapaxes(matrices[:, :n, :n], 1, 2)
        backward[:, :n, n] = functional.density
        added = exponentials(backward * T[:, None, None])[:, :n, n]
        costates = solve_cyclic_adjoint(system.maps.maps[:, :n, :n], (added + functional.seeds)[:, :, None])[:, :, 0]
        # Before the jump, of which the costate is the transposed one's.
        ends = self._before_jumps(np.roll(costates, -1, axis=0))
        integrals = _products(
            (backward, np.swapaxes(matrices, 1, 2)),
            (np.column_stack([ends, np.ones(N)]), self._trajectory.starts),
            T,
        )[:, :n]
        by_matrix, by_forcing = self._physical(integrals)
        rates = (matrices @ self._ends[:, :, None])[:, :n, 0]
        return Gradient(
            by_duration=read_only(np.sum(ends * rates, axis=1) + functional.durations),
            by_forcing=read_only(by_forcing),
            by_level=read_only(np.einsum("kim,ki->m", system.B, by_forcing) + functional.levels),
            by_matrix=read_only(by_matrix),
        )


def sensitivity(system: PeriodicSystem) -> Sensitivity:
    """Return the derivatives of the periodic steady state and of the multipliers.

    Raises
    ------
    NoOrbitError, NonUniqueOrbitError
        There is no orbit, or not one only.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.
    """
    expect_system(system)
    steady_state(system)
    return Sensitivity(system=system)


def _products(
    matrices: tuple[NDArray[Any], NDArray[Any]], ends: tuple[NDArray[Any], NDArray[Any]], durations: FloatArray
) -> NDArray[Any]:
    """Return the integrals of e^{M1 (T - s)} w z' e^{M2 s} over the steps, (N, k1, k2)."""
    first, second = matrices
    w, z = ends
    N, k1, k2 = len(first), first.shape[1], second.shape[1]
    outer = w[:, :, None] * z[:, None, :]
    # As large as one over the duration, so that it does not spoil the scaling of the exponential.
    sizes = np.max(np.abs(outer), axis=(1, 2), keepdims=True)
    sizes = np.where(sizes > 0, sizes, 1.0)
    block = np.zeros((N, k1 + k2, k1 + k2), dtype=np.result_type(first, second, outer))
    block[:, :k1, :k1], block[:, k1:, k1:] = first, second
    block *= durations[:, None, None]
    block[:, :k1, k1:] = outer / sizes
    expm = complex_exponentials if np.iscomplexobj(block) else exponentials
    return expm(block)[:, :k1, k1:] * sizes * durations[:, None, None]
