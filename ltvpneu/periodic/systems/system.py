"""`PeriodicSystem`: steps of constant coefficients, one after the other, for ever.

On step m, of duration T_m, with input levels u,

    z' = A_m z + B_m u + r_m,    y = C_m z + D_m u + q_m

so the forcing of eq. (8a) is f_m = B_m u + r_m. At the end of a step the state may jump, z+ = J_m z- + j_m. The whole
is a value: arrays are copied, checked and closed to writing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Self, final

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, finite_array, positive
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.algebra.propagate import ScaledSteps, StepMaps, scaled_steps, step_maps
from ltvpneu.periodic.algebra.stiff import NORM_OF_A_PIECE, Factors, step_factors, with_jumps
from ltvpneu.periodic.systems.coefficients import Coefficients, Matrices
from ltvpneu.periodic.systems.smooth import Function, smooth_steps, step_means
from ltvpneu.periodic.systems.step import Step

GROWTH = 1e3
"""Largest entry of a step's balanced transition matrix that costs no accuracy worth naming."""
MOST_PERIODS = 1000
"""Periods of one system in the common period beyond which two periods do not count as commensurate."""
SAME_TIME = 1e-12
"""Share of the period below which two switches are the same."""
MOST_PIECES = 1 << 17
"""Pieces into which stiff steps are split before pieces of a greater norm are taken."""


def expect_system(system: object) -> None:
    """Raise `TypeError` unless given a `PeriodicSystem`; a model that carries one is told so."""
    if not isinstance(system, PeriodicSystem):
        hint = "; give its .system" if isinstance(getattr(system, "system", None), PeriodicSystem) else ""
        raise TypeError(f"system: found {type(system).__name__}, expected a PeriodicSystem{hint}")


def expect_no_jumps(system: "PeriodicSystem", what: str) -> None:
    """Raise `ValueError` if the state jumps."""
    if system.has_jumps:
        raise ValueError(f"{what}: found a system whose state jumps at the ends of steps, expected one without jumps")


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PeriodicSystem(Coefficients):
    """A periodic, piecewise-constant system.

    Parameters
    ----------
    durations : array_like, shape (n_steps,)
        T_m [s], none negative, at least one above zero.
    A : array_like, shape (n_steps, n, n)
    B : array_like, shape (n_steps, n, m)
    r : array_like, shape (n_steps, n)
    C : array_like, shape (n_steps, p, n)
    D : array_like, shape (n_steps, p, m)
    q : array_like, shape (n_steps, p)
        Output offsets.
    levels : array_like, shape (m,)
        Values of the inputs.
    states, inputs, outputs : tuple of str
    name : str
    J : array_like, shape (n_steps, n, n), optional
        Jumps of the state at the ends of the steps, z+ = J z- + j; none by default.
    j : array_like, shape (n_steps, n), optional
        Zero by default.

    Examples
    --------
    An RC circuit switched to 1 V for a quarter of each second:

    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[1.0], [0.0]], [0.25, 0.75])
    >>> print(round(lp.steady_state(system).mean("z1"), 6))
    0.25
    """

    J: FloatArray | None = None
    j: FloatArray | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        N, n = self.r.shape
        if self.J is not None or self.j is not None:
            J = np.tile(np.eye(n), (N, 1, 1)) if self.J is None else self.J
            j = np.zeros((N, n)) if self.j is None else self.j
            object.__setattr__(self, "J", finite_array("J", J, (N, n, n)))
            object.__setattr__(self, "j", finite_array("j", j, (N, n)))

    def __repr__(self) -> str:
        ports = f"{self.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        jumps = f", {np.count_nonzero(self.jumps_at)} jumps" if self.has_jumps else ""
        return f"<PeriodicSystem {self.name}: {self.n_steps} steps in {self.period:.6g} s, {ports}{jumps}>"

    @classmethod
    def from_function(  # noqa: PLR0913 - the five matrices of a system
        cls,
        A: Function,
        period: float,
        f: Function | None = None,
        *,
        B: Function | None = None,
        C: Function | None = None,
        D: Function | None = None,
        rtol: float = 1e-9,
    ) -> Self:
        """Return the system of smooth coefficients A(t), as steps that keep a tolerance.

        Fourth order, by steps of the lengths that the coefficients ask for. Exact to `rtol` are the maps from step
        to step, and so multipliers and the states at the starts of steps; within a step the course is that of constant
        coefficients.

        Parameters
        ----------
        A : callable
            From the time within the period [s] to (n, n). Smooth; of coefficients that jump, `from_matrices` has the
            steps.
        period : float
            [s]
        f, B : callable, optional
            Likewise, to (n,) and (n, m); zero, and no inputs, by default.
        C, D : callable, optional
            Likewise, to (p, n) and (p, m); the states, and zero, by default. Each step has their means over it.
        rtol : float
            Error of the map over the period, relative to the largest maps of its parts.

        Raises
        ------
        NotConvergedError
            The coefficients change too fast, or jump.
        ValueError
            Coefficients that are not finite, or of shapes that do not fit.

        Examples
        --------
        Mathieu's equation z'' + (1 + 0.4 cos t) z = 0:

        >>> import math
        >>> import ltvpneu as lp
        >>> system = lp.PeriodicSystem.from_function(
        ...     lambda t: [[0.0, 1.0], [-1.0 - 0.4 * math.cos(t), 0.0]], 2 * math.pi)
        >>> print(f"{float(lp.monodromy(system).trace()):.6f}")
        2.008746
        """
        durations, parts = smooth_steps(A, f, B, positive("period", period, "s"), positive("rtol", rtol))
        n = parts.shape[1]
        inputs = None if B is None else parts[:, :, n:-1]
        outputs = None if C is None else step_means("C", C, durations, n)
        through = None if D is None else step_means("D", D, durations, parts.shape[2] - n - 1)
        return cls.from_matrices(parts[:, :, :n], parts[:, :, -1], durations, inputs, outputs, through)

    def with_jumps(self, J: Matrices, j: Matrices | None = None) -> Self:
        """Return the system whose state jumps at the end of each step, z+ = J z- + j: an impact, a reset.

        Parameters
        ----------
        J : sequence of array_like, shape (n, n)
            One a step, the identity where nothing jumps.
        j : sequence of array_like, shape (n,), optional
            Zero by default.

        Examples
        --------
        A capacitor that is charged to 1 V, and loses half of its charge once a second:

        >>> import ltvpneu as lp
        >>> charged = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[1.0]], [1.0])
        >>> halved = charged.with_jumps([[[0.5]]])
        >>> orbit = lp.steady_state(halved)
        >>> print(f"{orbit.maximum('z1'):.4f} V, then {orbit.minimum('z1'):.4f} V")
        0.7746 V, then 0.3873 V
        """
        return replace(self, J=finite_array("J", J), j=None if j is None else finite_array("j", j))

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """The steps, one by one."""
        names = (self.states, self.inputs, self.outputs)
        return tuple(
            Step(
                duration=float(self.durations[i]),
                A=self.A[i], B=self.B[i], r=self.r[i], C=self.C[i], D=self.D[i], q=self.q[i], f=self.f[i],
                names=names,
                name=f"{self.name}_step_{i + 1}",
            )
            for i in range(self.n_steps)
        )  # fmt: skip

    def split(self, pieces: Sequence[int] | IntArray) -> Self:
        """Return the system with each step split into that many equal ones, shape (n_steps,); it behaves the same."""
        counts = np.asarray(pieces)
        if counts.dtype.kind != "i" or counts.min(initial=1) < 1:
            raise ValueError(f"pieces: found {counts}, expected whole numbers, 1 or more")
        if counts.size != self.n_steps:
            raise ValueError(f"pieces: found {counts.size} numbers, expected one for each of the {self.n_steps} steps")
        if counts.max() == 1:
            return self
        ends = np.zeros(int(counts.sum()), dtype=np.bool_)
        ends[np.cumsum(counts) - 1] = True
        step = np.repeat(np.arange(self.n_steps), counts)
        return self.with_parts(np.repeat(self.durations / counts, counts), step, ends)

    def with_parts(self, durations: FloatArray, step: IntArray, ends: BoolArray) -> Self:
        """Return the system made of parts of its steps, each as long as given; the state jumps where a step `ends`."""
        parts = {field: getattr(self, field)[step] for field in ("A", "B", "r", "C", "D", "q")}
        if self.J is None or self.j is None:
            return replace(self, durations=durations, **parts)
        J = np.where(ends[:, None, None], self.J[step], np.eye(self.n_states))
        return replace(self, durations=durations, J=J, j=np.where(ends[:, None], self.j[step], 0.0), **parts)

    def without_empty_steps(self) -> Self:
        """Return the system without its steps of no duration; their jumps follow those of the step before."""
        kept = self.durations > 0
        if kept.all():
            return self
        numbers = np.flatnonzero(kept)
        found = self.with_parts(self.durations[kept], numbers, np.ones(numbers.size, dtype=np.bool_))
        if self.J is None or self.j is None:
            return found
        jumps, shifts = self.J[kept], self.j[kept]
        # From the first step that is kept on, once round the period.
        for k in np.roll(np.arange(self.n_steps), -numbers[0]):
            if not kept[k]:
                before = np.searchsorted(numbers, k) - 1
                jumps[before], shifts[before] = self.J[k] @ jumps[before], self.J[k] @ shifts[before] + self.j[k]
        return replace(found, J=jumps, j=shifts)

    @property
    def scales(self) -> FloatArray:
        """What the states are divided by so that all steps together are balanced, (n,)."""
        return self.scaled.scales

    @property
    def dt(self) -> float:
        """Zero: continuous time."""
        return 0.0

    def beside(self, other: Self) -> tuple[Self, Self]:
        """Return both systems with the same steps over a common period, cut at each other's switches.

        Raises
        ------
        ValueError
            Periods whose ratio is not one of two whole numbers up to 1000.
        """
        a, b = self.without_empty_steps(), other.without_empty_steps()
        ratio = Fraction(a.period / b.period).limit_denominator(MOST_PERIODS)
        if ratio.numerator > MOST_PERIODS or ratio == 0 or abs(ratio * b.period / a.period - 1) > 1e-9:
            raise ValueError(
                f"interconnection: found periods of {a.period:.12g} s and {b.period:.12g} s, expected a ratio of two "
                f"whole numbers up to {MOST_PERIODS}"
            )
        a, b = a._repeated(ratio.denominator), b._repeated(ratio.numerator)
        times = np.sort(np.concatenate([a.switching_times, b.switching_times * (a.period / b.period)]))
        near = np.diff(times) <= SAME_TIME * a.period
        # Cut at the first of times that are the same.
        kept = times[np.concatenate([[True], ~near])]
        kept[-1] = a.period
        durations = np.diff(kept)
        middles = kept[:-1] + durations / 2
        return a.cut(middles, durations), b.cut(middles * (b.period / a.period), durations)

    def _repeated(self, times: int) -> Self:
        """Return the system with several of its periods for one."""
        if times == 1:
            return self
        steps = np.tile(np.arange(self.n_steps), times)
        return self.with_parts(np.tile(self.durations, times), steps, np.ones(steps.size, dtype=np.bool_))

    def cut(self, middles: FloatArray, durations: FloatArray) -> Self:
        """Return the system in parts, each as long as given and with its middle there; no step is of no duration."""
        step, _ = self.step_at(middles)
        return self.with_parts(durations, step, np.append(np.diff(step) != 0, True))

    def without_jumps(self) -> Self:
        """Return the system without jumps of its state."""
        return replace(self, J=None, j=None) if self.has_jumps else self

    def jumps_beside(self, other: Self) -> dict[str, FloatArray]:
        """Return the jumps of both, side by side; none where neither has any."""
        if not (self.has_jumps or other.has_jumps):
            return {}
        n, k = self.n_states, other.n_states
        J, j = np.tile(np.eye(n + k), (self.n_steps, 1, 1)), np.zeros((self.n_steps, n + k))
        for system, part in ((self, slice(0, n)), (other, slice(n, None))):
            if system.J is not None and system.j is not None:
                J[:, part, part], j[:, part] = system.J, system.j
        return {"J": J, "j": j}

    @cached_property
    def growing_pieces(self) -> IntArray:
        """Number of equal pieces to take each step in, shape (n_steps,); one unless the state grows by `GROWTH`."""
        sizes = np.abs(self._flows.maps[:, :-1, :-1])
        if sizes.max(initial=0.0) <= GROWTH:
            return np.ones(self.n_steps, dtype=np.int64)
        growing = ~(sizes.max(axis=(1, 2), initial=0.0) <= GROWTH)
        return np.where(growing, self.fine_pieces, 1)

    @cached_property
    def step_norms(self) -> FloatArray:
        """Norms of balanced A times the duration, (n_steps,)."""
        n = self.n_states
        return np.abs(self.scaled.matrices[:, :n, :n]).sum(axis=1).max(axis=1, initial=0.0) * self.durations

    @cached_property
    def fine_pieces(self) -> IntArray:
        """Number of equal pieces of each step whose norm is at most `NORM_OF_A_PIECE`, shape (n_steps,).

        Coarser where that would make more than `MOST_PIECES` of them.

        Raises
        ------
        StepOverflowError
            A step is too stiff for any sensible number of pieces.
        """
        norms = self.step_norms
        total, limit = float(norms.sum()), NORM_OF_A_PIECE
        while total > limit * MOST_PIECES and limit < 500:
            limit *= 2
        if total > limit * 2 * MOST_PIECES:
            worst = int(np.argmax(norms))
            raise StepOverflowError(
                f"step {worst + 1} of {self.durations[worst]:g} s is too stiff: the norm of A times its duration is "
                f"{norms[worst]:.1e}, and this analysis takes pieces of {limit:g} at most. Are A and the durations in "
                "the same units of time? Else drop the fastest states"
            )
        return np.maximum(np.ceil(norms / limit), 1).astype(np.int64)

    @property
    def has_jumps(self) -> bool:
        """Whether jumps of the state are given."""
        return self.J is not None

    @property
    def jumps_at(self) -> BoolArray:
        """Whether the state jumps at the end of each step, shape (n_steps,)."""
        if self.J is None or self.j is None:
            return np.zeros(self.n_steps, dtype=np.bool_)
        return (np.eye(self.n_states) != self.J).any(axis=(1, 2)) | self.j.any(axis=1)

    @cached_property
    def scaled_jumps(self) -> FloatArray:
        """Jumps of the balanced augmented state at the ends of the steps, shape (n_steps, n + 1, n + 1)."""
        n, scales = self.n_states, self.scaled.scales
        jumps = np.tile(np.eye(n + 1), (self.n_steps, 1, 1))
        if self.J is not None and self.j is not None:
            jumps[:, :n, :n] = self.J * (scales / scales[:, None])
            jumps[:, :n, n] = self.j / (scales * self.scaled.unit)
        return jumps

    @cached_property
    def factors(self) -> Factors:
        """Factors of the transition matrices of all steps, in balanced coordinates, that no stiffness spoils."""
        found = step_factors(self.scaled.matrices[:, :-1, :-1], self.durations)
        return with_jumps(found, self.scaled_jumps[:, :-1, :-1], self.jumps_at) if self.has_jumps else found

    @cached_property
    def scaled(self) -> ScaledSteps:
        """The steps in balanced, augmented coordinates."""
        return scaled_steps(self.A, self.f, self.durations)

    @cached_property
    def _flows(self) -> StepMaps:
        with np.errstate(over="ignore", invalid="ignore"):
            return step_maps(self.scaled, self.durations)

    @cached_property
    def is_representable(self) -> bool:
        """Whether no step grows by more than double precision holds."""
        return bool(np.isfinite(self._flows.maps).all())

    @cached_property
    def flows(self) -> StepMaps:
        """The maps over all steps up to their ends, before the state jumps there.

        Raises
        ------
        StepOverflowError
            A step grows by more than double precision holds.
        """
        flows = self._flows
        if not self.is_representable:
            step = int(np.argwhere(~np.isfinite(flows.maps))[0][0])
            raise StepOverflowError(
                f"step {step + 1} of {self.durations[step]:g} s grows by more than double precision holds; its "
                "eigenvalues times its duration go beyond 700. Are A and the durations in the same units of time? "
                "Multipliers can still be had: floquet"
            )
        return flows

    @cached_property
    def maps(self) -> StepMaps:
        """The maps from the start of each step to that of the next, which orbit and response share; raises likewise."""
        flows = self.flows
        return replace(flows, maps=self.scaled_jumps @ flows.maps) if self.has_jumps else flows
