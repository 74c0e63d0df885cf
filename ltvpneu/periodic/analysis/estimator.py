r"""Optimal estimator (Kalman filter), the dual of the regulator: its Riccati equation runs backward on A', C'.

`sampled=True` takes one measurement at each step's start.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array, read_only, solved
from ltvpneu._values import Value
from ltvpneu.periodic.analysis.gramians import balanced_matrices
from ltvpneu.periodic.analysis.lyapunov import from_reversed, step_gramians
from ltvpneu.periodic.analysis.riccati import definite, root_of, semidefinite, stabilizing
from ltvpneu.periodic.analysis.scattering import Scattering, continuous_steps, free_steps
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.per_step import symmetric


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
        semidefinite("Qn", symmetric("Qn", Qn, N, n)),
        definite("Rn", symmetric("Rn", Rn, N, len(system.outputs))),
    )
    sampled = sampled or isinstance(system, DiscretePeriodicSystem)
    steps = _dual_steps(system, noise, sampled)
    # Where sampled, a step of no duration takes no measurement of its own.
    long = system.durations[:, None, None] > 0
    backward = Scattering(E=steps.E[::-1], G=steps.G[::-1], H=steps.H[::-1])
    solution = stabilizing(backward, system, "detectable")
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
        gained = step_gramians(np.swapaxes(A, 1, 2), root_of(Q), np.zeros((N, 0, n)), system.durations).controllability
        long, maps = system.durations[:, None, None] > 0, system.flows.maps[:, :n, :n]
        steps = Scattering(E=np.swapaxes(maps, 1, 2), G=np.where(long, G, 0.0), H=gained @ np.swapaxes(gained, 1, 2))
    else:
        steps = continuous_steps(A, G, Q, system.durations)
    if not system.has_jumps:
        return steps
    # The dual runs backward: it meets the jump first.
    return free_steps(np.swapaxes(system.scaled_jumps[:, :n, :n], 1, 2)).then(steps)


def _dual_parts(
    system: AnyPeriodicSystem, noise: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return balanced A', C' Rn^-1 C and Qn of each step."""
    A, _, C = system.balanced if isinstance(system, DiscretePeriodicSystem) else balanced_matrices(system)
    scales = system.scales
    G = np.swapaxes(C, 1, 2) @ solved(noise[1], C)
    return np.swapaxes(A, 1, 2), G, noise[0] / scales[:, None] / scales
