"""`Orbit`: one period of a periodic solution, of whatever model, with exact means and extremes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, whole
from ltvpneu._values import Value
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.signals import signal_index

if TYPE_CHECKING:
    import control


class Trajectory(Protocol):
    """One period of a solution as a formula in time. Signals: the states, then the outputs."""

    def at(self, times: FloatArray) -> FloatArray:
        """Return the signals at times within the period [s], shape (n_signals, n_times)."""
        ...

    def means(self) -> FloatArray:
        """Return the time means of the signals, shape (n_signals,)."""
        ...

    def extremes(self, signal: int) -> tuple[float, float]:
        """Return the least and the greatest value of a signal."""
        ...


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Orbit(Value):
    """One period of a periodic solution.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> orbit = lp.nonlinear_orbit(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> print(f"{1e3 * orbit.amplitude('position'):.2f} mm, isolated: {orbit.is_isolated}")
    35.28 mm, isolated: True
    """

    system_period: float
    """Period of the system [s]; the orbit repeats after `n_periods` of these."""
    n_periods: int
    step_times: FloatArray
    """Boundaries of its steps [s], from 0 to the orbit's own period, shape (n_steps + 1,)."""
    step_states: FloatArray
    """State at the start of each step, shape (n_steps, n)."""
    step_labels: tuple[str, ...]
    """What each step is."""
    trajectory: Trajectory
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    is_isolated: bool
    """Whether no other periodic solution lies next to it; false for one of a stiction band. Whether there are others
    far from it, which other starts lead to, is what `attractors` looks for."""
    residual: float
    """Change of the scaled state over one orbit [-]: how well it closes."""
    n_simulated: int
    """System periods simulated to reach it; 0 where it was solved for."""
    name: str
    rest: str = ""
    """Of a piston that rests throughout, what holds it: "held by stiction", or "rests on the upper stop, 50 mm"."""

    def __repr__(self) -> str:
        kind = f", {self.rest}" if self.rest else "" if self.is_isolated else ", one of a band"
        amplitude = f"amplitude of {self.signals[0]} {self.amplitude(0):.6g}"
        return f"<Orbit of {self.name}: period {self.period:.6g} s, {len(self.step_labels)} steps, {amplitude}{kind}>"

    @property
    def period(self) -> float:
        """The orbit's own period [s]."""
        return self.n_periods * self.system_period

    @property
    def initial_state(self) -> FloatArray:
        """State at the start of the period, shape (n,)."""
        return self.step_states[0]

    @property
    def branches(self) -> FloatArray:
        """States at the starts of its system periods, (n_periods, n): the branches of a subharmonic."""
        starts = self.system_period * np.arange(float(self.n_periods))
        return self.trajectory.at(starts)[: len(self.states)].T

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the states, then of the outputs that are not states."""
        return (*self.states, *(name for name in self.outputs if name not in self.states))

    def amplitude(self, signal: str | int) -> float:
        """Half the peak-to-peak of a signal, eq. (18)."""
        low, high = self.trajectory.extremes(self._index(signal))
        return (high - low) / 2

    def mean(self, signal: str | int) -> float:
        """Time mean of a signal over the orbit, eq. (15)."""
        return float(self.trajectory.means()[self._index(signal)])

    def minimum(self, signal: str | int) -> float:
        """Least value of a signal on the orbit."""
        return self.trajectory.extremes(self._index(signal))[0]

    def maximum(self, signal: str | int) -> float:
        """Greatest value of a signal on the orbit."""
        return self.trajectory.extremes(self._index(signal))[1]

    def at(self, times: ArrayLike) -> FloatArray:
        """Return states, then outputs, at any times [s], shape (n_signals, n_times)."""
        within = np.mod(finite_array("times", times, (None,)), self.period)
        return self.trajectory.at(within)

    def response(self, n_points: int = 401) -> "control.TimeResponseData":
        """Return one orbit as a `control.TimeResponseData`, at evenly spaced times and at its step boundaries."""
        n_points = whole("n_points", n_points, 2)
        times = np.union1d(np.linspace(0.0, self.period, n_points), self.step_times)
        values = self.trajectory.at(times)
        rows = [self._index(name) for name in self.outputs]
        n = len(self.states)
        return bridge.time_response(times, (self.states, values[:n]), (self.outputs, values[rows]), self.name)

    def _index(self, signal: str | int) -> int:
        return signal_index(self.signals, signal)
