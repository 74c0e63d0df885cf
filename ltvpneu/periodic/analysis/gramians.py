"""Controllability and observability Gramians of a stable periodic system.

P' = A P + P A' + B B' forward and -Q' = A' Q + Q A + C' C backward, both periodic; in discrete time
P_{k+1} = A P_k A' + B B' and Q_k = A' Q_{k+1} A + C' C. The square roots of the eigenvalues
of P Q at one instant are the Hankel singular values there: gains from past inputs to future outputs.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.analysis.lyapunov import compressed, expect_stable, from_reversed, periodic_factors, step_gramians
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.system import PeriodicSystem


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Gramians(Value):
    """Gramians over the period, from their factors at the starts of the steps.

    In discrete time those of a step hold until the next one starts.
    """

    system: AnyPeriodicSystem
    balanced_factors: tuple[FloatArray, FloatArray]
    """Factors of P and Q in the system's balanced coordinates, each (n_steps, n, n)."""

    def __repr__(self) -> str:
        return f"<Gramians of {self.system.name}: Hankel singular values {self.hankel_singular_values[0]} at its start>"

    @cached_property
    def controllability_factors(self) -> FloatArray:
        """L with P = L L' at the start of each step, (n_steps, n, n)."""
        return read_only(self.balanced_factors[0] * self.system.scales[:, None])

    @cached_property
    def observability_factors(self) -> FloatArray:
        """L with Q = L L' at the start of each step, (n_steps, n, n)."""
        return read_only(self.balanced_factors[1] / self.system.scales[:, None])

    @cached_property
    def controllability(self) -> FloatArray:
        """P at the start of each step, (n_steps, n, n)."""
        return read_only(_squared(self.controllability_factors))

    @cached_property
    def observability(self) -> FloatArray:
        """Q at the start of each step, (n_steps, n, n)."""
        return read_only(_squared(self.observability_factors))

    @cached_property
    def hankel_singular_values(self) -> FloatArray:
        """At the start of each step, largest first, (n_steps, n)."""
        return read_only(_hankel(*self.balanced_factors))

    def hankel_singular_values_at(self, times: ArrayLike) -> FloatArray:
        """Return the Hankel singular values at any times [s], largest first, (n_times, n)."""
        return _hankel(*self._factors_at(finite_array("times", times, (None,))))

    def controllability_at(self, times: ArrayLike) -> FloatArray:
        """Return P at any times [s], (n_times, n, n)."""
        factors, _ = self._factors_at(finite_array("times", times, (None,)))
        return _squared(factors * self.system.scales[:, None])

    def observability_at(self, times: ArrayLike) -> FloatArray:
        """Return Q at any times [s], (n_times, n, n)."""
        _, factors = self._factors_at(finite_array("times", times, (None,)))
        return _squared(factors / self.system.scales[:, None])

    def _factors_at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        system = self.system
        step, local = system.step_at(np.mod(times, system.period))
        if isinstance(system, DiscretePeriodicSystem):
            return self.balanced_factors[0][step], self.balanced_factors[1][step]
        left = system.durations[step] - local
        A, B, C = (part[step] for part in balanced_matrices(system))
        since = step_gramians(A, B, C, local).controllability
        until = step_gramians(A, B, C, left).observability
        following = (step + 1) % system.n_steps
        P, Q = self.balanced_factors
        from_start = exponentials(A * local[:, None, None]) @ P[step]
        jumped = system.scaled_jumps[step, :-1, :-1] @ exponentials(A * left[:, None, None])
        to_end = np.swapaxes(jumped, 1, 2) @ Q[following]
        return np.concatenate([since, from_start], axis=2), np.concatenate([until, to_end], axis=2)


def gramians(system: AnyPeriodicSystem) -> Gramians:
    """Return the controllability and observability Gramians.

    Raises
    ------
    NotStableError
        Unstable, or too close to it to tell.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[0.0]], [2.0], B=[[[1.0]]], C=[[[1.0]]])
    >>> lp.gramians(system).controllability
    array([[[0.5]]])
    """
    expect_periodic(system)
    expect_stable(system, "a Gramian")
    if isinstance(system, DiscretePeriodicSystem):
        _, B, C = system.balanced
        reached, seen = compressed(B), compressed(np.swapaxes(C, 1, 2))
    else:
        steps = step_gramians(*balanced_matrices(system), system.durations)
        reached, seen = system.scaled_jumps[:, :-1, :-1] @ steps.controllability, steps.observability
    maps = system.maps.maps[:, :-1, :-1]
    backward = periodic_factors(np.swapaxes(maps[::-1], 1, 2), seen[::-1])
    return Gramians(
        system=system,
        balanced_factors=(periodic_factors(maps, reached), from_reversed(backward)),
    )


def balanced_matrices(system: PeriodicSystem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B and C of all steps in the system's balanced coordinates."""
    scales, n = system.scaled.scales, system.n_states
    return system.scaled.matrices[:, :n, :n], system.B / scales[:, None], system.C * scales


def _squared(factors: FloatArray) -> FloatArray:
    return factors @ np.swapaxes(factors, 1, 2)


def _hankel(P: FloatArray, Q: FloatArray) -> FloatArray:
    values = np.asarray(np.linalg.svd(np.swapaxes(Q, 1, 2) @ P, compute_uv=False), dtype=np.float64)
    return values[:, : P.shape[1]]
