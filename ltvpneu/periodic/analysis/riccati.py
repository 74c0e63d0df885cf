r"""Periodic Riccati equations: optimal regulator (LQR) and optimal estimator (Kalman filter).

-X' = A' X + X A - (X B + S) R^-1 (B' X + S') + Q with X(T) = X(0), control u = -R^-1 (B' X + S') z = -K(t) z. Each step
is taken exactly, in the form that never grows (`scattering`), and doubling whole periods gives X at once. Where states
that the cost does not see are unstable, doubling finds a solution that leaves them alone; then Newton's method
[Kleinman1968]_ goes on from one that does not.

`sampled=True` holds the control over each step, or takes one measurement at each step's start: the discrete periodic
problem whose cost is still the integral over time, exactly.

.. [Kleinman1968] D. L. Kleinman, "On an iterative technique for Riccati equation computations", IEEE Trans. Autom.
   Control 13, 1968.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array, read_only, solved
from ltvpneu._values import Value
from ltvpneu.errors import NotStabilizableError
from ltvpneu.periodic.algebra.product import from_logs, log_multipliers
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.analysis.gramians import balanced_matrices
from ltvpneu.periodic.analysis.lyapunov import from_reversed, step_gramians
from ltvpneu.periodic.analysis.scattering import Scattering, continuous_steps, over_period
from ltvpneu.periodic.orbits.floquet import floquet
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


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Estimator(Value):
    """Optimal periodic estimator z_hat' = A z_hat + B u + L(t) (y - C z_hat - D u)."""

    system: AnyPeriodicSystem
    noise: tuple[FloatArray, FloatArray]
    """Qn and Rn of each step."""
    covariance: FloatArray
    """Of the error at the start of each step, where sampled before the measurement there; (n_steps, n, n)."""
    step_gains: FloatArray
    """L at the start of each step, (n_steps, n, p); where sampled, z_hat jumps by L times the surprise."""
    multipliers: ComplexArray
    """Of the error, largest first, (n,)."""
    is_sampled: bool
    """Whether there is one measurement a step, at its start, as in discrete time."""
    residual: float
    """How far the covariance is from periodic, relative to its largest entry [-]."""

    def __repr__(self) -> str:
        kind = "sampled" if self.is_sampled else "continuous"
        return f"<Estimator, {kind}, of {self.system.name}: multipliers of the error {self.multipliers}>"

    def gain(self, t: ArrayLike) -> FloatArray:
        """Return L at any time or times [s], shape (n, p) for one time, (n_times, n, p) for several."""
        times = np.atleast_1d(finite_array("t", t))
        step, _ = self.system.step_at(np.mod(times, self.system.period))
        if self.is_sampled:
            found = self.step_gains[step]
        else:
            C = self.system.C[step]
            found = np.swapaxes(solved(self.noise[1][step], C @ self.covariance_at(times)), 1, 2)
        return found[0] if np.ndim(t) == 0 else found

    def covariance_at(self, times: ArrayLike) -> FloatArray:
        """Return the error's covariance at any times [s] under continuous measurement, (n_times, n, n)."""
        system = self.system
        if self.is_sampled or isinstance(system, DiscretePeriodicSystem):
            raise ValueError("covariance_at: between measurements it depends on the one before; take covariance")
        step, local = system.step_at(np.mod(finite_array("times", times, (None,)), system.period))
        A, G, Q = (part[step] for part in _dual_parts(system, self.noise))
        scales = system.scaled.scales
        before = self.covariance[step] / scales[:, None] / scales
        return continuous_steps(A, G, Q, local).cost_before(before) * scales[:, None] * scales


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
    solution = _solved(steps.then(_jumps(system)) if system.has_jumps else steps, system, "stabilizable")
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


def kalman(system: AnyPeriodicSystem, Qn: ArrayLike, Rn: ArrayLike, *, sampled: bool = False) -> Estimator:
    """Return the Kalman filter, the dual of `lqr`.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    Qn : array_like, shape (n, n) or (n_steps, n, n)
        Intensity of the noise that drives the states (B W B' for one that comes in by the inputs), in discrete time
        its covariance over a step; positive semidefinite.
    Rn : array_like, shape (p, p) or (n_steps, p, p)
        Intensity of the noise on the outputs, positive definite; where sampled, its covariance at a measurement.
    sampled : bool
        One measurement at the start of each step instead of one all the time.

    Raises
    ------
    NotStabilizableError
        No stabilizing solution: an unstable mode that no output shows.
    ValueError
        Noise of the wrong shape, not symmetric or not definite.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[0.0]], [[0.0]]], [[0.0]] * 2, [0.3, 0.7])
    >>> lp.kalman(system, [[4.0]], [[1.0]]).covariance.ravel().round(12)
    array([2., 2.])
    """
    expect_periodic(system)
    N, n = system.n_steps, system.n_states
    noise = (
        _semidefinite("Qn", symmetric("Qn", Qn, N, n)),
        _definite("Rn", symmetric("Rn", Rn, N, len(system.outputs))),
    )
    sampled = sampled or isinstance(system, DiscretePeriodicSystem)
    steps = _dual_steps(system, noise, sampled)
    # Where sampled, a step of no duration takes no measurement of its own.
    long = system.durations[:, None, None] > 0
    backward = Scattering(E=steps.E[::-1], G=steps.G[::-1], H=steps.H[::-1])
    solution = _solved(backward, system, "detectable")
    scales = system.scales
    covariance = from_reversed(solution.X) * scales[:, None] * scales
    seen = system.C @ covariance
    spread = noise[1] + (seen @ np.swapaxes(system.C, 1, 2) if sampled else 0.0)
    gains = np.swapaxes(solved(spread, seen), 1, 2)
    return Estimator(
        system=system,
        noise=noise,
        covariance=read_only(covariance),
        step_gains=read_only(np.where(long, gains, 0.0) if sampled else gains),
        multipliers=solution.multipliers,
        is_sampled=sampled,
        residual=solution.residual,
    )


def _dual_steps(system: AnyPeriodicSystem, noise: tuple[FloatArray, FloatArray], sampled: bool) -> Scattering:
    """Return the steps of the dual problem, in the order of the system's own, in balanced coordinates."""
    A, G, Q = _dual_parts(system, noise)
    if isinstance(system, DiscretePeriodicSystem):
        return Scattering(E=A, G=G, H=Q)
    N, n = system.n_steps, system.n_states
    if sampled:
        gained = step_gramians(np.swapaxes(A, 1, 2), _root(Q), np.zeros((N, 0, n)), system.durations).controllability
        long, maps = system.durations[:, None, None] > 0, system.flows.maps[:, :n, :n]
        steps = Scattering(E=np.swapaxes(maps, 1, 2), G=np.where(long, G, 0.0), H=gained @ np.swapaxes(gained, 1, 2))
    else:
        steps = continuous_steps(A, G, Q, system.durations)
    if not system.has_jumps:
        return steps
    # The dual runs backward: it meets the jump first.
    jumps = _jumps(system)
    return Scattering(E=np.swapaxes(jumps.E, 1, 2), G=jumps.G, H=jumps.H).then(steps)


def _jumps(system: PeriodicSystem) -> Scattering:
    """Return the jumps at the ends of all steps, which cost nothing, in balanced coordinates."""
    jumps = system.scaled_jumps[:, :-1, :-1]
    return Scattering(E=jumps, G=np.zeros_like(jumps), H=np.zeros_like(jumps))


class _Solution(NamedTuple):
    X: FloatArray
    multipliers: ComplexArray
    residual: float


def _solved(steps: Scattering, system: AnyPeriodicSystem, needed: str) -> _Solution:
    """Return the stabilizing periodic solution at the starts of all steps, in balanced coordinates."""
    total = over_period(steps)
    n = total.E.shape[0]
    X = _doubled(total)
    if X is None or not _is_stabilizing(total, X):
        # Weight every state a little: then doubling stabilizes whatever can be, and Newton takes the weight off again.
        size = max(float(np.max(np.abs(total.H))), 1.0)
        seen = Scattering(E=total.E, G=total.G, H=total.H + size * np.eye(n))
        start = _doubled(seen)
        X = None if start is None or not _is_stabilizing(seen, start) else _newton(total, start)
    if X is None or not _is_stabilizing(total, X):
        own = floquet(system).multipliers
        unstable = ", ".join(f"{x:.6g}" for x in own if abs(x) >= 1 - 1e-9)
        raise NotStabilizableError(
            f"no stabilizing periodic solution: the system is not {needed}, or leaves a mode on the unit circle alone. "
            f"Multipliers of the open loop on or outside it: {unstable or 'none'}; at least one of them is "
            + ("not reached by any input, or not seen by Q" if needed == "stabilizable" else "not seen by any output"),
            multipliers=own,
        )
    found = np.empty_like(steps.E)
    after, factors = X, np.empty_like(steps.E)
    for k in range(len(found) - 1, -1, -1):
        step = Scattering(E=steps.E[k], G=steps.G[k], H=steps.H[k])
        factors[k] = step.closed_loop(after)
        found[k] = after = step.cost_before(after)
    size = max(float(np.max(np.abs(X), initial=0.0)), np.finfo(float).tiny)
    multipliers = from_logs(*log_multipliers(factors)).multipliers
    return _Solution(found, multipliers, float(np.max(np.abs(found[0] - X), initial=0.0)) / size)


def _doubled(total: Scattering) -> FloatArray | None:
    """Return the limit of H over ever more periods, or None if there is none."""
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(60):
            before, total = total.H, total.then(total)
            size = float(np.max(np.abs(total.H), initial=0.0))
            if not (np.isfinite(total.E).all() and size < 1e150):
                return None
            if np.max(np.abs(total.H - before), initial=0.0) <= 4e-16 * size:
                return total.H
    return None


def _newton(total: Scattering, X: FloatArray) -> FloatArray | None:
    """Return the stabilizing solution by Newton's method from a stabilizing start, or None."""
    for _ in range(60):
        loop = total.closed_loop(X)
        if _radius(loop) >= 1:
            return None
        before, weight = X, total.H + loop.T @ X @ total.G @ X @ loop
        X = _summed(loop, (weight + weight.T) / 2)
        if np.max(np.abs(X - before), initial=0.0) <= 1e-14 * np.max(np.abs(X), initial=0.0):
            break
    return X


def _summed(loop: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the sum of F'^k W F^k over all k for a stable F, by doubling: X of X = F' X F + W."""
    total = weight
    for _ in range(64):
        total = total + loop.T @ total @ loop
        loop = loop @ loop
        if np.max(np.abs(loop), initial=0.0) < 1e-100:
            break
    return total


def _is_stabilizing(total: Scattering, X: FloatArray) -> bool:
    return _radius(total.closed_loop(X)) < 1 - 1e-12


def _radius(matrix: FloatArray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0))


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
    root = np.swapaxes(_root(cost), 1, 2)
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
    solution = _solved(steps, system, "stabilizable")
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


def _dual_parts(
    system: AnyPeriodicSystem, noise: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return balanced A', C' Rn^-1 C and Qn of each step."""
    A, _, C = system.balanced if isinstance(system, DiscretePeriodicSystem) else balanced_matrices(system)
    scales = system.scales
    G = np.swapaxes(C, 1, 2) @ solved(noise[1], C)
    return np.swapaxes(A, 1, 2), G, noise[0] / scales[:, None] / scales


def _weights(system: AnyPeriodicSystem, Q: ArrayLike, R: ArrayLike, S: ArrayLike | None) -> Weights:
    N, n, m = system.n_steps, system.n_states, len(system.inputs)
    weights = Weights(
        symmetric("Q", Q, N, n),
        _definite("R", symmetric("R", R, N, m)),
        np.zeros((N, n, m)) if S is None else finite_array("S", each_step("S", S, N, n), (N, n, m)),
    )
    _semidefinite("Q" if S is None else "[[Q, S], [S', R]]", weights.Q if S is None else _cost(weights))
    return weights


def _cost(weights: Weights) -> FloatArray:
    """Return [[Q, S], [S', R]] of each step."""
    upper = np.concatenate([weights.Q, weights.S], axis=2)
    return np.concatenate([upper, np.concatenate([np.swapaxes(weights.S, 1, 2), weights.R], axis=2)], axis=1)


def _semidefinite(name: str, stack: FloatArray) -> FloatArray:
    values = np.linalg.eigvalsh(stack)
    if values.size and np.min(values) < -1e-12 * np.max(np.abs(values)):
        raise ValueError(f"{name}: found an eigenvalue of {np.min(values):.6g}, expected none below zero")
    return stack


def _definite(name: str, stack: FloatArray) -> FloatArray:
    values = np.linalg.eigvalsh(stack)
    if values.size and np.min(values) <= 1e-15 * np.max(np.abs(values)):
        raise ValueError(f"{name}: found an eigenvalue of {np.min(values):.6g}, expected all above zero")
    return stack


def _root(stack: FloatArray) -> FloatArray:
    """Return L with L L' = M for positive semidefinite M, (N, n, n)."""
    values, vectors = np.linalg.eigh(stack)
    return vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
