r"""Optimal regulator (LQR): u = -R^-1 (B' X + S') z = -K(t) z with X of the periodic Riccati equation (`riccati`).

`sampled=True` holds the control over each step: the discrete periodic problem whose cost is still the integral over
time, exactly. In discrete time the cost is a sum over the steps.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array, read_only, solved
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.analysis.gramians import balanced_matrices
from ltvpneu.periodic.analysis.lyapunov import step_gramians
from ltvpneu.periodic.analysis.riccati import definite, root_of, semidefinite, stabilizing
from ltvpneu.periodic.analysis.scattering import Scattering, continuous_steps, free_steps
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.per_step import each_step, symmetric
from ltvpneu.periodic.systems.system import PeriodicSystem


class Weights(NamedTuple):
    """Of states, inputs and of both together; one a step."""

    Q: FloatArray
    R: FloatArray
    S: FloatArray


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Regulator(Value):
    """Optimal periodic state feedback u = -K(t) z."""

    system: AnyPeriodicSystem
    weights: Weights
    cost_to_go: FloatArray
    """X at the start of each step: from z there on, z' X z is what is left to pay; (n_steps, n, n)."""
    step_gains: FloatArray
    """K at the start of each step, (n_steps, m, n); where sampled, over all of it."""
    multipliers: ComplexArray
    """Of the closed loop, largest first, (n,)."""
    is_sampled: bool
    """Whether the control is held over each step, as in discrete time."""
    residual: float
    """How far X is from periodic, relative to its largest entry [-]."""

    def __repr__(self) -> str:
        kind = "sampled" if self.is_sampled else "continuous"
        return f"<Regulator, {kind}, of {self.system.name}: closed-loop multipliers {self.multipliers}>"

    def gain(self, t: ArrayLike) -> FloatArray:
        """Return K at any time or times [s], shape (m, n) for one time, (n_times, m, n) for several."""
        times = np.atleast_1d(finite_array("t", t))
        step, _ = self.system.step_at(np.mod(times, self.system.period))
        if self.is_sampled:
            found = self.step_gains[step]
        else:
            X = self.cost_to_go_at(times)
            B, weights = self.system.B[step], self.weights
            found = solved(weights.R[step], np.swapaxes(B, 1, 2) @ X + np.swapaxes(weights.S[step], 1, 2))
        return found[0] if np.ndim(t) == 0 else found

    def cost_to_go_at(self, times: ArrayLike) -> FloatArray:
        """Return X at any times [s] under continuous control, (n_times, n, n)."""
        system = self.system
        if self.is_sampled or isinstance(system, DiscretePeriodicSystem):
            raise ValueError("cost_to_go_at: within a step the cost of held control depends on it; take cost_to_go")
        step, local = system.step_at(np.mod(finite_array("times", times, (None,)), system.period))
        A, G, Q = (part[step] for part in _hamiltonian_parts(system, self.weights))
        scales = system.scaled.scales
        jumps = system.scaled_jumps[step, :-1, :-1]
        after = self.cost_to_go[(step + 1) % system.n_steps] * scales[:, None] * scales
        after = np.swapaxes(jumps, 1, 2) @ after @ jumps
        within = continuous_steps(A, G, Q, system.durations[step] - local)
        return within.cost_before(after) / scales[:, None] / scales


def lqr(
    system: AnyPeriodicSystem, Q: ArrayLike, R: ArrayLike, *, S: ArrayLike | None = None, sampled: bool = False
) -> Regulator:
    """Return the control u = -K(t) z that minimizes the integral of z' Q z + u' R u + 2 z' S u.

    The forcing does not enter: z and u are distances from an orbit and its input levels. In discrete time the integral
    is a sum over the steps.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    Q : array_like, shape (n, n) or (n_steps, n, n)
        Symmetric, positive semidefinite.
    R : array_like, shape (m, m) or (n_steps, m, m)
        Symmetric, positive definite.
    S : array_like, shape (n, m) or (n_steps, n, m), optional
        Zero by default.
    sampled : bool
        Hold the control over each step.

    Raises
    ------
    NotStabilizableError
        No stabilizing solution: an unstable mode that no input reaches, or one on the stability boundary that the cost
        does not see.
    ValueError
        Weights of the wrong shape, not symmetric or not definite.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[0.0]], [[0.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> lp.lqr(system, [[4.0]], [[1.0]]).gain(0.5).round(12)
    array([[2.]])
    """
    expect_periodic(system)
    weights = _weights(system, Q, R, S)
    if isinstance(system, DiscretePeriodicSystem):
        A, B, _ = system.balanced
        units = np.ones(len(system.inputs))
        both = np.concatenate([system.scales, units])
        return _step_regulator(system, weights, (A, B, _cost(weights) * both[:, None] * both), units)
    if sampled:
        return _sampled_regulator(system, weights)
    steps = continuous_steps(*_hamiltonian_parts(system, weights), system.durations)
    if system.has_jumps:
        steps = steps.then(free_steps(system.scaled_jumps[:, :-1, :-1]))
    solution = stabilizing(steps, system, "stabilizable")
    scales = system.scaled.scales
    found = Regulator(
        system=system,
        weights=weights,
        cost_to_go=read_only(solution.X / scales[:, None] / scales),
        step_gains=np.zeros(0),
        multipliers=solution.multipliers,
        is_sampled=False,
        residual=solution.residual,
    )
    reached = np.swapaxes(system.B, 1, 2) @ found.cost_to_go + np.swapaxes(weights.S, 1, 2)
    return replace(found, step_gains=read_only(solved(weights.R, reached)))


def _sampled_regulator(system: PeriodicSystem, weights: Weights) -> Regulator:
    N, n, m = system.B.shape
    scales = system.scaled.scales
    A, B, _ = balanced_matrices(system)
    largest = np.max(np.abs(B), axis=(0, 1), initial=0.0) * system.period
    units = np.exp2(-np.round(np.log2(np.where(largest > 0, largest, 1.0))))
    both = np.concatenate([scales, units])
    held = np.zeros((N, n + m, n + m))
    held[:, :n, :n], held[:, :n, n:] = A, B * units
    cost = _cost(weights) * both[:, None] * both
    root = np.swapaxes(root_of(cost), 1, 2)
    factors = step_gramians(held, np.zeros((N, n + m, 0)), root, system.durations).observability
    paid = factors @ np.swapaxes(factors, 1, 2)
    maps = exponentials(held * system.durations[:, None, None])
    # The jump at the end of a step, of no cost, is part of its map.
    jumps = system.scaled_jumps[:, :n, :n]
    F, Gamma = jumps @ maps[:, :n, :n], jumps @ maps[:, :n, n:]
    return _step_regulator(system, weights, (F, Gamma, paid), units)


def _step_regulator(
    system: AnyPeriodicSystem,
    weights: Weights,
    maps: tuple[FloatArray, FloatArray, FloatArray],
    units: FloatArray,
) -> Regulator:
    """Return the regulator of z_{k+1} = F z + Gamma u at the cost [z; u]' paid [z; u] a step, in balanced coordinates.

    Inputs are divided by `units`.
    """
    F, Gamma, paid = maps
    n, m = system.B.shape[1:]
    scales = system.scales
    # A step of no duration costs nothing and moves nothing: any R will do there.
    R = np.where(system.durations[:, None, None] > 0, paid[:, n:, n:], np.eye(m))
    from_inputs = solved(R, np.swapaxes(Gamma, 1, 2))
    from_states = solved(R, paid[:, n:, :n])
    steps = Scattering(
        E=F - Gamma @ from_states, G=Gamma @ from_inputs, H=paid[:, :n, :n] - paid[:, :n, n:] @ from_states
    )
    solution = stabilizing(steps, system, "stabilizable")
    after = np.roll(solution.X, -1, axis=0)
    pulled = np.swapaxes(Gamma, 1, 2) @ after
    gains = solved(R + pulled @ Gamma, pulled @ F + paid[:, n:, :n])
    return Regulator(
        system=system,
        weights=weights,
        cost_to_go=read_only(solution.X / scales[:, None] / scales),
        step_gains=read_only(gains * units[:, None] / scales),
        multipliers=solution.multipliers,
        is_sampled=True,
        residual=solution.residual,
    )


def _hamiltonian_parts(system: PeriodicSystem, weights: Weights) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return balanced A - B R^-1 S', B R^-1 B' and Q - S R^-1 S' of each step."""
    A, B, _ = balanced_matrices(system)
    scales = system.scaled.scales
    S = weights.S * scales[:, None]
    Bt, St = np.swapaxes(B, 1, 2), np.swapaxes(S, 1, 2)
    Q = weights.Q * scales[:, None] * scales
    return (
        A - B @ solved(weights.R, St),
        B @ solved(weights.R, Bt),
        Q - S @ solved(weights.R, St),
    )


def _weights(system: AnyPeriodicSystem, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None) -> Weights:
    N, n, m = system.n_steps, system.n_states, len(system.inputs)
    weights = Weights(
        symmetric("Q", Q, N, n),
        definite("R", symmetric("R", R, N, m)),
        np.zeros((N, n, m)) if S is None else finite_array("S", each_step("S", S, N, n), (N, n, m)),
    )
    semidefinite("Q" if S is None else "[[Q, S], [S', R]]", weights.Q if S is None else _cost(weights))
    return weights


def _cost(weights: Weights) -> FloatArray:
    """Return [[Q, S], [S', R]] of each step."""
    upper = np.concatenate([weights.Q, weights.S], axis=2)
    return np.concatenate([upper, np.concatenate([np.swapaxes(weights.S, 1, 2), weights.R], axis=2)], axis=1)
