r"""`DiscretePeriodicSystem`: a periodic system in discrete time.

From the start of step k, of duration T_k, to that of the next

    z_{k+1} = A_k z_k + B_k u_k + r_k,    y_k = C_k z_k + D_k u_k + q_k

with inputs that are held over the step and outputs at its start. A sampled machine, a converter seen once a switch and
a digital controller are such systems.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self, final

import numpy as np

from ltvpneu._arrays import FloatArray, positive, read_only
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import ScaledSteps, StepMaps, balancing_scales
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.coefficients import Coefficients
from ltvpneu.periodic.systems.held import held_maps
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system

if TYPE_CHECKING:
    import control

MOST_STEPS = 100_000
"""Of two systems together."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DiscretePeriodicSystem(Coefficients):
    """A periodic system in discrete time; parameters are those of `PeriodicSystem`, which has no jumps here.

    `floquet`, `lyapunov`, `gramians`, `h2_norm`, `hankel_norm`, `hinf_norm`, `lqr`, `kalman`, `lifted`, `steady_state`,
    `response` and the interconnections take it as they take a `PeriodicSystem`: integrals over time are sums over the
    steps here, means over the period those over the steps.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.DiscretePeriodicSystem.from_matrices([[[0.5]], [[3.0]]], [[0.0]] * 2, [0.1, 0.1], B=[[[1.0]]] * 2)
    >>> lp.floquet(system).multipliers.real, lp.lqr(system, [[1.0]], [[1.0]]).multipliers.real.round(4)
    (array([1.5]), array([0.0977]))
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.durations > 0).all():
            step = int(np.argmin(self.durations))
            raise ValueError(f"durations: found {self.durations[step]:g} s in step {step}, expected all above zero")

    def __repr__(self) -> str:
        ports = f"{self.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return f"<DiscretePeriodicSystem {self.name}: {self.n_steps} steps in {self.period:.6g} s, {ports}>"

    @classmethod
    def from_control(cls, sys: "control.StateSpace | control.TransferFunction", *, dt: float | None = None) -> Self:
        """Return a time-invariant system in discrete time as a periodic one of one step, such as `design.duty_model`'s.

        Parameters
        ----------
        sys : control.StateSpace or control.TransferFunction
        dt : float, optional
            Sampling time [s], where that of `sys` is not given.

        Raises
        ------
        ValueError
            Continuous time, or no sampling time.
        """
        given = getattr(sys, "dt", None)
        if given == 0:
            raise ValueError(f"sys: found {getattr(sys, 'name', sys)} in continuous time, expected discrete time")
        if given is None or given is True:
            if dt is None:
                raise ValueError("dt: found a system without a sampling time, expected dt in seconds")
            given = positive("dt", dt, "s")
        A, B, C, D, names, name = bridge.matrices_of(sys, given)
        states, inputs, outputs = names
        return cls(
            durations=np.array([given]), A=A[None], B=B[None], C=C[None], D=D[None], r=np.zeros((1, len(A))),
            q=np.zeros((1, len(C))), levels=np.zeros(len(inputs)), states=states, inputs=inputs, outputs=outputs,
            name=name,
        )  # fmt: skip

    @property
    def dt(self) -> float | None:
        """Duration of the steps where all are equal, else None [s]."""
        first = float(self.durations[0])
        return first if np.allclose(self.durations, first, rtol=1e-9, atol=0) else None

    def beside(self, other: Self) -> tuple[Self, Self]:
        """Return both systems over a common period.

        Raises
        ------
        ValueError
            Steps of other durations.
        """
        total = math.lcm(self.n_steps, other.n_steps)
        if total > MOST_STEPS:
            raise ValueError(
                f"interconnection: found {self.n_steps} and {other.n_steps} steps, expected {MOST_STEPS} at most in "
                "the period that they share"
            )
        a, b = self._repeated(total // self.n_steps), other._repeated(total // other.n_steps)
        if not np.allclose(a.durations, b.durations, rtol=1e-9, atol=0):
            step = int(np.argmax(np.abs(a.durations - b.durations)))
            raise ValueError(
                f"interconnection: found step {step} of {a.durations[step]:g} s in {a.name} and of "
                f"{b.durations[step]:g} s in {b.name}, expected equal steps"
            )
        return a, b

    def _repeated(self, times: int) -> Self:
        if times == 1:
            return self
        parts = {field: np.concatenate([getattr(self, field)] * times) for field in ("A", "B", "r", "C", "D", "q")}
        return replace(self, durations=np.tile(self.durations, times), **parts)

    @cached_property
    def scales(self) -> FloatArray:
        """What the states are divided by so that all steps together are balanced, (n,)."""
        return read_only(balancing_scales(self.A, np.ones(self.n_steps)))

    @cached_property
    def input_maps(self) -> FloatArray:
        """[A, B, r] of each step, (n_steps, n, n + m + 1)."""
        return read_only(np.concatenate([self.A, self.B, self.r[:, :, None]], axis=2))

    @cached_property
    def maps(self) -> StepMaps:
        """The maps of the balanced augmented state over all steps, at the input levels."""
        n, scales = self.n_states, self.scales
        forcing = self.f / scales
        largest = float(np.max(np.abs(forcing), initial=0.0))
        unit = 2.0 ** round(math.log2(largest)) if largest > 0 else 1.0
        maps = np.zeros((self.n_steps, n + 1, n + 1))
        maps[:, :n, :n], maps[:, :n, n], maps[:, n, n] = self.balanced[0], forcing / unit, 1.0
        return StepMaps(maps=maps, steps=ScaledSteps(matrices=np.zeros_like(maps), scales=scales, unit=unit))

    @cached_property
    def balanced(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A, B and C in states divided by their scales."""
        scales = self.scales
        return self.A * (scales / scales[:, None]), self.B / scales[:, None], self.C * scales


def sampled(system: PeriodicSystem) -> DiscretePeriodicSystem:
    """Return the system in discrete time: inputs held over each step, outputs at its start.

    Parameters
    ----------
    system : PeriodicSystem

    Raises
    ------
    StepOverflowError
        A step grows by more than double precision holds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0]] * 2, [0.5, 0.5], B=[[[1.0]]] * 2)
    >>> lp.sampled(system).A.ravel().round(4)
    array([0.6065, 0.2231])
    """
    expect_system(system)
    system = system.without_empty_steps()
    n = system.n_states
    maps = held_maps(system)
    return DiscretePeriodicSystem(
        durations=system.durations,
        A=maps[:, :, :n],
        B=maps[:, :, n:-1],
        r=maps[:, :, -1],
        C=system.C,
        D=system.D,
        q=system.q,
        levels=system.levels,
        states=system.states,
        inputs=system.inputs,
        outputs=system.outputs,
        name=f"{system.name}_sampled",
    )


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class HeldTrajectory(Value):
    """One period of a solution in discrete time: every signal stays from the start of a step to that of the next."""

    system: DiscretePeriodicSystem
    step_states: FloatArray
    """(n_steps, n)"""

    @cached_property
    def _signals(self) -> FloatArray:
        """At the starts of the steps, (n_signals, n_steps)."""
        system = self.system
        outputs = (system.C @ self.step_states[:, :, None])[:, :, 0] + system.output_bias
        extra = [i for i, name in enumerate(system.outputs) if name not in system.states]
        return np.concatenate([self.step_states, outputs[:, extra]], axis=1).T

    def at(self, times: FloatArray) -> FloatArray:
        """Return the signals at times within the period [s], shape (n_signals, n_times)."""
        return self._signals[:, self.system.step_at(times)[0]]

    def means(self) -> FloatArray:
        """Return the means of the signals over the steps, shape (n_signals,)."""
        return self._signals.mean(axis=1)

    def extremes(self, signal: int) -> tuple[float, float]:
        """Return the least and the greatest value of a signal."""
        return float(self._signals[signal].min()), float(self._signals[signal].max())


AnyPeriodicSystem = PeriodicSystem | DiscretePeriodicSystem


def expect_periodic(system: object) -> None:
    """Raise `TypeError` unless given a periodic system in continuous or discrete time."""
    if isinstance(system, DiscretePeriodicSystem):
        return
    if getattr(system, "dt", 0) not in (0, None) and hasattr(system, "A"):
        raise TypeError(
            f"system: found {type(system).__name__} in discrete time, expected a PeriodicSystem or a "
            "DiscretePeriodicSystem; DiscretePeriodicSystem.from_control makes one"
        )
    expect_system(system)
