"""A periodic system as a `control.NonlinearIOSystem`, for diagrams with whatever else python-control knows.

Loaded only by `to_iosys`, since the class below needs python-control's to be there.
"""

import inspect
from itertools import pairwise
from typing import Any, NoReturn, final

import control
import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.errors import SkippedStepError
from ltvpneu.periodic.systems import switching
from ltvpneu.periodic.systems.bridge import state_space
from ltvpneu.periodic.systems.system import PeriodicSystem


@final
class PeriodicIOSystem(control.NonlinearIOSystem):
    """z' = A(t) z + B(t) u + r(t), y = C(t) z + D(t) u + q(t), as an input/output system.

    Simulate with `solve_ivp_method=ltvpneu.SwitchAware`. With another solver the system keeps watch, and raises
    `SkippedStepError` when outputs are asked for after a whole step was jumped over.
    """

    def __init__(self, system: PeriodicSystem, name: str) -> None:
        self.periodic = system
        self._visited = _Visited()
        super().__init__(
            self._rate,
            self._output,
            states=list(system.states),
            inputs=list(system.inputs),
            outputs=list(system.outputs),
            name=name,
            dt=0,
        )

    def _rate(self, t: float, x: FloatArray, u: FloatArray, params: object) -> FloatArray:
        switching.report(self._switch_times)
        system = self.periodic
        middle = switching.segment_middle()
        count = self._count_at(float(t) if middle is None else middle)
        if middle is None:
            self._visited.rate(float(t), count)
        m = count % system.n_steps
        return system.A[m] @ x + system.B[m] @ u + system.r[m]

    def _output(self, t: float, x: FloatArray, u: FloatArray, params: object) -> FloatArray:
        system = self.periodic
        middle = switching.segment_middle()
        if middle is None:
            self._check(self._visited.output(float(t)))
        m = self._count_at(float(t) if middle is None else middle) % system.n_steps
        return system.C[m] @ x + system.D[m] @ u + system.q[m]

    def _count_at(self, t: float) -> int:
        """Return the number of the step in force, counted on from the start of the period at zero."""
        system = self.periodic
        # A time that rounding left just short of a switch is at the switch.
        slack = 1e-12 * system.period + 4 * np.spacing(abs(t))
        periods, within = divmod(t + slack, system.period)
        step, _ = system.step_at(np.array([within]))
        return int(periods) * system.n_steps + int(step[0])

    def _switch_times(self, start: float, end: float) -> FloatArray:
        """Return the switches strictly between two times."""
        system = self.periodic
        periods = np.arange(np.floor(start / system.period), np.ceil(end / system.period) + 1)
        times = (periods[:, None] * system.period + system.switching_times[:-1]).ravel()
        slack = 1e-12 * system.period
        return times[(times > start + slack) & (times < end - slack)]

    def _check(self, counts: list[int]) -> None:
        """Raise if steps of some duration are missing from those that a solver has seen."""
        for before, after in pairwise(counts):
            for count in range(before + 1, after):
                if self.periodic.durations[count % self.periodic.n_steps] > 0:
                    self._raise_skipped(count)

    def _raise_skipped(self, count: int) -> NoReturn:
        system = self.periodic
        period, m = divmod(count, system.n_steps)
        start = period * system.period + system.switching_times[m]
        raise SkippedStepError(
            f"{self.name}: the solver jumped over step {m + 1} of {system.durations[m]:g} s at t = {start:.6g} s, so "
            "its result is wrong. Use input_output_response(..., solve_ivp_method=ltvpneu.SwitchAware), which stops at "
            "every switch",
            time=float(start),
            step=m,
        )

    def _update_params(self, params: dict[str, Any] | None) -> None:
        # Called once before any operation of python-control; it offers no other hook to refuse one.
        callers = (frame.function for frame in inspect.stack(context=0))
        if "find_operating_point" in callers:
            raise TypeError(
                f"find_operating_point: {self.name} is periodic and has no equilibrium, only that of the step in force "
                "at t = 0. Its periodic steady state is ltvpneu.steady_state(system); in a diagram, take ltvpneu.lifted"
            )
        self._visited = _Visited()
        super()._update_params(params)

    def linearize(
        self,
        x0: Any,
        u0: Any = None,
        t: float = 0,
        params: Any = None,
        eps: float = 1e-6,
        copy_names: bool = False,
        **names: Any,
    ) -> control.StateSpace:
        """Return A, B, C, D of the step in force at t, exactly; arguments as python-control's."""
        system = self.periodic
        m = self._count_at(float(t)) % system.n_steps
        found = state_space(
            (system.A[m], system.B[m], system.C[m], system.D[m]),
            (system.states, system.inputs, system.outputs),
            names.pop("name", None) or f"{self.name}_linearized",
        )
        if names:
            found.update_names(**names)
        return found

    def poles(self) -> NoReturn:
        """Refuse: a periodic system has multipliers instead."""
        self._refuse("poles", "a periodic system has Floquet multipliers and exponents: ltvpneu.floquet(system)")

    def zeros(self) -> NoReturn:
        """Refuse."""
        self._refuse("zeros", "a periodic system has those of its lifted system: ltvpneu.lifted(system).zeros()")

    def damp(self) -> NoReturn:
        """Refuse."""
        self._refuse("damp", "damping belongs to the characteristic exponents: ltvpneu.floquet(system).exponents")

    def dcgain(self) -> NoReturn:
        """Refuse."""
        self._refuse("dcgain", "the mean response to a constant input is ltvpneu.harmonic_transfer(system, 0)")

    def sample(self, *args: object, **options: object) -> NoReturn:
        """Refuse."""
        self._refuse("sample", "sampled once a period it is ltvpneu.lifted(system)")

    def frequency_response(self, *args: object, **options: object) -> NoReturn:
        """Refuse."""
        self._refuse("frequency_response", "every frequency answers at many: ltvpneu.frequency_response(system, omega)")

    @property
    def plot_phase(self) -> NoReturn:
        """Refuse: `control.bode_plot` takes what is no linear system for a response and asks it for this."""
        self._refuse("bode_plot", "every frequency answers at many: ltvpneu.frequency_response(system, omega).plot()")

    def __array__(self, *args: object, **options: object) -> NoReturn:
        """Refuse: `control.lqr`, `place` and `ss` take what is no linear system for a matrix."""
        self._refuse(
            "conversion to a matrix or a linear system",
            "design with ltvpneu.lqr, ltvpneu.kalman, or on ltvpneu.lifted(system) or ltvpneu.averaged(system)",
        )

    def __call__(self, x: Any = None, *args: Any, **options: Any) -> NoReturn:
        """Refuse: there is no one transfer function."""
        self._refuse(
            "evaluation at a frequency", "harmonics are had from ltvpneu.harmonic_transfer(system, s, harmonics)"
        )

    def _refuse(self, operation: str, instead: str) -> NoReturn:
        raise TypeError(f"{operation}: has no meaning for {self.name}, a periodic system; {instead}")


class _Visited:
    """Which steps a plain solver has evaluated on the way that it kept.

    A call in an earlier step than the last means that the solver went back: what it saw beyond does not count. The end
    shows in an output asked for without a rate after it: at once where the system stands alone, in a diagram, where
    outputs and rates alternate, at the time of the last rate or at the second output.
    """

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._last_rate: float | None = None
        self._last_output: float | None = None
        self._alternating = False

    def rate(self, t: float, count: int) -> None:
        self._alternating = self._alternating or (self._last_output is not None and bool(self._counts))
        self._last_rate, self._last_output = t, None
        while self._counts and self._counts[-1] > count:
            self._counts.pop()
        if not self._counts or self._counts[-1] < count:
            self._counts.append(count)

    def output(self, t: float) -> list[int]:
        """Return the counts of the steps seen, in order, if the simulation has ended; else nothing."""
        stopped = not self._alternating or t == self._last_rate
        ended = stopped if self._last_output is None else self._last_output != t
        self._last_output = t
        return self._counts if ended else []
