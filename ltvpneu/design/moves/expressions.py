"""A move as cvxpy expressions, about the present durations of its parts."""

from typing import Any, final

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.design.switching.cycle import place_of, signal_scales
from ltvpneu.design.switching.subproblem import FigureBlock
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.passage import Passage

TYPICAL_TIME = 0.1
"""By which flows become the size of masses [s]."""


@final
class Move:
    """A move as cvxpy expressions, linearized about the present durations of its parts; SI units.

    Attributes
    ----------
    durations : cvxpy.Expression
        Of the parts between which valves switch [s], (n_parts,).
    time : cvxpy.Expression
        Of the whole move [s].
    """

    def __init__(self, machine: Machine, durations: Any) -> None:
        self.machine = machine
        self.durations: Any = durations
        self.time: Any = cp.sum(durations)
        self.blocks: list[FigureBlock] = []
        self._scales = signal_scales(machine)
        self._known: dict[tuple[str, str], Any] = {}

    def end(self, signal: str) -> Any:
        """Return a state's last value; at rest, as it would be had nothing stopped the piston: `Passage.unheld_end`."""
        return self._block("end", signal)

    def maximum(self, signal: str) -> Any:
        """Return a state's greatest value on the way; for upper bounds."""
        return self._block("maximum", signal)

    def minimum(self, signal: str) -> Any:
        """Return a state's least value on the way; for lower bounds."""
        return self._block("minimum", signal)

    def speed(self) -> Any:
        """Return the piston's greatest speed in either direction [m/s]; convex, for upper bounds."""
        return cp.maximum(self.maximum("velocity"), -self.minimum("velocity"))

    def air_mass(self) -> Any:
        """Return the mass drawn from the supply [kg]."""
        return self._block("air_use", "")

    def impact_energy(self) -> Any:
        """Return the most that the moving mass loses at a stop [J]."""
        return self._block("impact", "")

    def _block(self, kind: Any, signal: str) -> Any:
        state = place_of(signal, self.machine.states) if signal else 0
        if (kind, signal) not in self._known:
            block = FigureBlock(scenario="", figures=(Figure(kind, state),), scale=self._scale(kind, signal))
            self.blocks.append(block)
            self._known[kind, signal] = block.scale * block.variable[0]
        return self._known[kind, signal]

    def _scale(self, kind: str, signal: str) -> float:
        if kind == "air_use":
            return self._scales["air_use"] * TYPICAL_TIME
        if kind == "impact":
            return self.machine.load.mass * self._scales["velocity"] ** 2 / 2
        return self._scales[signal]


def figure_of(way: Passage, asked: Figure) -> float:
    """Return a figure of a move."""
    if asked.kind == "end":
        return float(way.unheld_end[0][asked.state])
    if asked.kind == "air_use":
        return way.air_mass
    if asked.kind == "impact":
        return way.impact_energy
    return way.extreme(asked.state, greatest=asked.kind == "maximum")


def end_rows(way: Passage, figures: list[Figure]) -> dict[int, FloatArray]:
    """Return the derivatives of those figures that are last values, by their number, over the parts' durations."""
    ends = [number for number, asked in enumerate(figures) if asked.kind == "end"]
    slopes = way.unheld_end[1] if ends else np.zeros((0, 0))
    return {number: slopes[figures[number].state] for number in ends}
