"""`SwitchAware`: a solver for `control.input_output_response` that restarts at every switch of every periodic block.

An adaptive solver steps across a switch without noticing, and over a short pulse altogether. python-control hands the
right-hand side to the solver as an opaque function, so blocks and solver meet here: asked once, every periodic block
in the diagram reports its switches (`reporting`), and during a segment every block keeps to the step in force at its
middle (`segment_middle`), whatever rounding does to the times at its ends.
"""

import inspect
from collections.abc import Callable, Generator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, cast, final

import numpy as np
from scipy.integrate import DOP853, OdeSolver

from ltvpneu._arrays import FloatArray

SwitchTimes = Callable[[float, float], FloatArray]
"""Returns the switches strictly between two times."""

_reports: ContextVar[list[SwitchTimes] | None] = ContextVar("reports", default=None)
_segment: ContextVar[float | None] = ContextVar("segment", default=None)


@contextmanager
def reporting() -> Generator[list[SwitchTimes]]:
    """Collect the switches of every periodic block evaluated inside."""
    found: list[SwitchTimes] = []
    token = _reports.set(found)
    try:
        yield found
    finally:
        _reports.reset(token)


def report(switch_times: SwitchTimes) -> None:
    """Say when a block switches, if a solver is asking."""
    asking = _reports.get()
    if asking is not None:
        asking.append(switch_times)


def segment_middle() -> float | None:
    """Return the middle of the segment that a switch-aware solver is in, or None."""
    return _segment.get()


def _input_kinks(fun: Callable[..., object], start: float, end: float) -> FloatArray:
    """Return the times strictly between two at which the input given to `control.input_output_response` has a kink.

    It interpolates linearly between the caller's time points, in a function that only the right-hand side's closure
    knows; a solver that is at rest would jump over a pulse there too.
    """
    try:
        interpolate = inspect.getclosurevars(fun).nonlocals["ufun"]
        known = inspect.getclosurevars(interpolate).nonlocals
        times, values = np.asarray(known["T"], dtype=float), np.asarray(known["U"], dtype=float)
    except (KeyError, TypeError, ValueError):
        return np.empty(0)
    slopes = np.diff(values, axis=-1) / np.diff(times)
    kinks = times[1:-1][(np.diff(slopes, axis=-1) != 0).any(axis=0)]
    return kinks[(kinks > start) & (kinks < end)]


@final
class SwitchAware(OdeSolver):
    """Solver that ends a step at every switch of every periodic block and starts anew there.

    For `control.input_output_response(..., solve_ivp_method=lp.SwitchAware)`; options go into its `solve_ivp_kwargs`.

    Parameters
    ----------
    fun, t0, y0, t_bound, vectorized
        As scipy hands them over.
    base : type
        `OdeSolver` used between switches, DOP853 by default; `scipy.integrate.Radau` or `LSODA` for stiff systems.
    rtol, atol : float
        Tight by default, 1e-10 and 1e-12: between switches the solution is smooth.
    **options
        Further options of the base solver.
    """

    def __init__(
        self,
        fun: Callable[[float, FloatArray], FloatArray],
        t0: float,
        y0: FloatArray,
        t_bound: float,
        vectorized: bool = False,
        base: type[Any] = DOP853,
        **options: Any,
    ) -> None:
        if t_bound < t0:
            raise ValueError(f"SwitchAware: found an end at {t_bound:g} s before the start at {t0:g} s")
        self._base = base
        self._options = {"rtol": 1e-10, "atol": 1e-12, **options}
        self._middle = t0
        with reporting() as blocks:
            fun(t0, np.asarray(y0, dtype=float))
        super().__init__(self._guarded(fun), t0, y0, t_bound, vectorized, support_complex=False)
        switches = [block(t0, t_bound) for block in blocks] + [_input_kinks(fun, t0, t_bound)]
        stops = np.unique(np.concatenate([*switches, [t_bound]]))
        # Switches of two blocks that differ by rounding are one.
        apart = np.diff(stops, prepend=t0) > 8 * np.spacing(max(abs(t0), abs(t_bound)))
        self._stops: list[float] = [float(t) for t in stops[apart | (stops == t_bound)]]
        self._start(float(t0))

    def _guarded(self, fun: Callable[[float, FloatArray], FloatArray]) -> Callable[[float, FloatArray], FloatArray]:
        def inside(t: float, y: FloatArray) -> FloatArray:
            token = _segment.set(self._middle)
            try:
                return fun(t, y)
            finally:
                _segment.reset(token)

        return inside

    def _start(self, t: float) -> None:
        end = self._stops.pop(0)
        self._middle = t + (end - t) / 2
        self._inner = self._base(self.fun, t, self.y, end, vectorized=self.vectorized, **self._options)

    def _step_impl(self) -> tuple[bool, str | None]:
        if self._inner.status == "finished":
            self._start(float(self._inner.t))
        message = cast("str | None", self._inner.step())
        self.t, self.y = self._inner.t, self._inner.y
        return self._inner.status != "failed", message

    def _dense_output_impl(self) -> Any:
        return self._inner.dense_output()
