"""What periodic systems in continuous and in discrete time share: coefficients that are constant on each step."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, IntArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.periodic.systems.bridge import CONSTANT_INPUT
from ltvpneu.periodic.systems.joined import in_parallel, in_series
from ltvpneu.periodic.systems.signals import signals_chosen

Matrices = Sequence[ArrayLike] | FloatArray
"""One matrix or vector a step: a list of them, or a stack."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Coefficients(Value, ABC):
    """A, B, r, C, D and q of each step, input levels, and names; checked, copied and closed to writing."""

    durations: FloatArray
    """[s], (n_steps,)"""
    A: FloatArray
    """(n_steps, n, n)"""
    B: FloatArray
    """(n_steps, n, m)"""
    r: FloatArray
    """(n_steps, n)"""
    C: FloatArray
    """(n_steps, p, n)"""
    D: FloatArray
    """(n_steps, p, m)"""
    q: FloatArray
    """(n_steps, p)"""
    levels: FloatArray
    """(m,)"""
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    name: str = "periodic"

    def __post_init__(self) -> None:
        durations = finite_array("durations", self.durations, (None,))
        N = durations.size
        if (durations < 0).any():
            worst = int(np.argmin(durations))
            raise ValueError(f"durations: found {durations[worst]:g} s in step {worst}, expected none negative")
        if not durations.any():
            raise ValueError("durations: found a period of 0 s, expected at least one step longer than zero")
        A = finite_array("A", self.A, (N, None, None))
        n, m, p = A.shape[1], len(self.inputs), len(self.outputs)
        shapes: dict[str, tuple[int, ...]] = {
            "A": (N, n, n), "B": (N, n, m), "r": (N, n), "C": (N, p, n), "D": (N, p, m), "q": (N, p), "levels": (m,)
        }  # fmt: skip
        object.__setattr__(self, "durations", durations)
        for field, shape in shapes.items():
            object.__setattr__(self, field, finite_array(field, getattr(self, field), shape))
        if len(self.states) != n:
            raise ValueError(f"states: found {len(self.states)} names {self.states}, expected {n}")
        for kind in ("states", "inputs", "outputs"):
            names: tuple[str, ...] = getattr(self, kind)
            if len(set(names)) != len(names):
                raise ValueError(f"{kind}: found {names}, expected each name once")
        if CONSTANT_INPUT in self.inputs:
            raise ValueError(f"inputs: found {CONSTANT_INPUT!r}, which is kept for the input that carries r and q")

    @classmethod
    def from_matrices(
        cls,
        A: Matrices,
        f: Matrices,
        durations: ArrayLike,
        B: Matrices | None = None,
        C: Matrices | None = None,
        D: Matrices | None = None,
    ) -> Self:
        """Return the system with one entry of each list a step; f becomes the remainder r.

        Parameters
        ----------
        A : sequence of array_like, shape (n, n)
        f : sequence of array_like, shape (n,)
        durations : array_like, shape (n_steps,)
            [s]
        B : sequence of array_like, shape (n, m), optional
            Inputs u1, u2, ... at level zero; none by default.
        C : sequence of array_like, shape (p, n), optional
            Outputs y1, y2, ...; the states by default.
        D : sequence of array_like, shape (p, m), optional
            Zero by default.

        Raises
        ------
        ValueError
            Ragged or non-finite matrices, shapes that do not fit, negative durations.
        """
        durations = finite_array("durations", durations, (None,))
        N = durations.size
        system_matrices = finite_array("A", A, (N, None, None))
        n = system_matrices.shape[1]
        inputs = finite_array("B", B, (N, n, None)) if B is not None else np.zeros((N, n, 0))
        outputs = finite_array("C", C, (N, None, n)) if C is not None else np.tile(np.eye(n), (N, 1, 1))
        m, p = inputs.shape[2], outputs.shape[1]
        states = tuple(f"z{i + 1}" for i in range(n))
        return cls(
            durations=durations,
            A=system_matrices,
            B=inputs,
            r=finite_array("f", f, (N, n)),
            C=outputs,
            D=finite_array("D", D, (N, p, m)) if D is not None else np.zeros((N, p, m)),
            q=np.zeros((N, p)),
            levels=np.zeros(m),
            states=states,
            inputs=tuple(f"u{i + 1}" for i in range(m)),
            outputs=states if C is None else tuple(f"y{i + 1}" for i in range(p)),
        )

    def with_levels(self, levels: ArrayLike) -> Self:
        """Return the system with other values of its inputs, shape (m,)."""
        return replace(self, levels=finite_array("levels", levels, (len(self.inputs),)))

    def select(self, *, outputs: Sequence[str | int] | None = None, inputs: Sequence[str | int] | None = None) -> Self:
        """Return the system with some of its outputs and inputs, in the order given; all by default.

        An input that is left out stays at its level, which becomes part of r and q.

        Parameters
        ----------
        outputs, inputs : sequence of str or int, optional
            Names or numbers.

        Raises
        ------
        ValueError
            No such output or input, or one given twice.

        Examples
        --------
        >>> import ltvpneu as lp
        >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
        >>> model.system.select(outputs=["position"], inputs=["supply_pressure"])
        <PeriodicSystem Kunt___Singh_1990_ltv: 2 steps in 0.25 s, 3 states, 1 inputs, 1 outputs>
        """
        rows = signals_chosen("outputs", outputs, self.outputs)
        columns = signals_chosen("inputs", inputs, self.inputs)
        held = np.setdiff1d(np.arange(len(self.inputs)), columns)
        fixed = self.levels[held]
        return replace(
            self,
            B=self.B[:, :, columns],
            r=self.r + self.B[:, :, held] @ fixed,
            C=self.C[:, rows],
            D=self.D[:, rows][:, :, columns],
            q=(self.q + self.D[:, :, held] @ fixed)[:, rows],
            levels=self.levels[columns],
            inputs=tuple(self.inputs[i] for i in columns),
            outputs=tuple(self.outputs[i] for i in rows),
        )

    @cached_property
    def period(self) -> float:
        """Sum of the durations [s]."""
        return float(np.sum(self.durations))

    @property
    def n_steps(self) -> int:
        """N_s, number of steps in a period."""
        return self.durations.size

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.A.shape[1]

    @cached_property
    def f(self) -> FloatArray:
        """Forcing B u + r of each step at the input levels, shape (n_steps, n)."""
        return read_only(self.B @ self.levels + self.r)

    @cached_property
    def output_bias(self) -> FloatArray:
        """D u + q of each step at the input levels, shape (n_steps, p)."""
        return read_only(self.D @ self.levels + self.q)

    @cached_property
    def switching_times(self) -> FloatArray:
        """Step boundaries from 0 to the period [s], shape (n_steps + 1,)."""
        return read_only(np.concatenate([[0.0], np.cumsum(self.durations)]))

    def step_at(self, times: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the step in force at times within the period [s], at a switch the new one, and the time since then."""
        step = np.clip(np.searchsorted(self.switching_times, times, side="right") - 1, 0, self.n_steps - 1)
        return step, np.clip(times - self.switching_times[step], 0.0, self.durations[step])

    @property
    @abstractmethod
    def dt(self) -> float | None:
        """Sampling time of a time-invariant system that this one can be joined with, zero in continuous time [s].

        None: no such system, as steps differ in length.
        """

    @abstractmethod
    def beside(self, other: Any) -> tuple[Self, Self]:
        """Return both systems with the same steps over a common period."""

    def without_jumps(self) -> Self:
        """Return the system without jumps of its state."""
        return self

    def jumps_beside(self, other: Any) -> dict[str, FloatArray]:
        """Return the jumps of both, side by side; none where neither has any."""
        return {}

    def __mul__(self, other: Any) -> Self:
        """Return `other`, then this system, as `control.StateSpace` has it; of a number, this system times it."""
        if isinstance(other, int | float | np.number):
            return in_series(self, float(other) * np.eye(len(self.outputs)), self)
        return in_series(other, self, self)

    def __rmul__(self, other: Any) -> Self:
        """Return this system, then `other`; of a number, this system times it."""
        return self * other if isinstance(other, int | float | np.number) else in_series(self, other, self)

    def __add__(self, other: Any) -> Self:
        """Return both with the same inputs and the sum of their outputs."""
        return in_parallel(self, other, self)

    def __radd__(self, other: Any) -> Self:
        """Return the same sum, the states of `other` first."""
        return in_parallel(other, self, self)

    def __neg__(self) -> Self:
        """Return the system with its outputs' signs turned."""
        return replace(self, C=-self.C, D=-self.D, q=-self.q)

    def __sub__(self, other: Any) -> Self:
        """Return the difference of the outputs, with the same inputs."""
        return in_parallel(self, -other, self)

    def __rsub__(self, other: Any) -> Self:
        """Return the difference of the outputs, with the same inputs."""
        return in_parallel(other, -self, self)

    __array_ufunc__ = None
    """So that numpy leaves a matrix times a system to the system."""
