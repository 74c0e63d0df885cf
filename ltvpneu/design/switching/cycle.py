"""A machine's cycle as cvxpy expressions, about the present setting of what is being designed."""

from difflib import get_close_matches
from typing import Literal, final

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import finite_array
from ltvpneu.design.switching.subproblem import FigureBlock
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.supply_flow import source_flow


@final
class LinearizedCycle:
    """One scenario's cycle as cvxpy expressions, linearized about the present setting; SI units.

    Where figures are looked at, they are those of the refitted model at the present setting, to first order in a step.
    """

    def __init__(self, name: str, machine: Machine, blocks: list[FigureBlock], scales: dict[str, float]) -> None:
        self.name, self.machine, self._blocks, self._scales = name, machine, blocks, scales
        self._known: dict[tuple[object, ...], cp.Expression] = {}

    def size(self, signal: str) -> float:
        """Return the size by which changes of a signal are judged, in its own unit."""
        if signal != "air_use":
            self._state(signal)
        return self._scales[signal]

    def mean(self, signal: str) -> cp.Expression:
        """Return a state's time mean."""
        return self._block(("mean", signal), [Figure("mean", self._state(signal))], signal)[0]

    def maximum(self, signal: str) -> cp.Expression:
        """Return a state's greatest value; convex, for upper bounds."""
        return cp.max(self._extremes("maximum", signal))

    def minimum(self, signal: str) -> cp.Expression:
        """Return a state's least value; concave, for lower bounds."""
        return cp.min(self._extremes("minimum", signal))

    def amplitude(self, signal: str) -> cp.Expression:
        """Return half of a state's peak-to-peak; convex, for upper bounds."""
        return (self.maximum(signal) - self.minimum(signal)) / 2

    def affine_amplitude(self, signal: str) -> cp.Expression:
        """Return half the peak-to-peak, affine, for lower bounds and equations.

        At the extremes as they are now: where two draw level it has a kink that this does not see.
        """
        state = self._state(signal)
        found = self._block(("swing", signal), [Figure("minimum", state), Figure("maximum", state)], signal)
        return (found[1] - found[0]) / 2

    def at(self, signal: str, angles: ArrayLike) -> cp.Expression:
        """Return a state at angles of the turn [rad], shape (n_angles,), to track a wanted cycle."""
        turned = np.mod(finite_array("angles", np.atleast_1d(np.asarray(angles, dtype=np.float64)), (None,)), 2 * np.pi)
        state = self._state(signal)
        return self._block(("at", signal, *turned.tolist()), [Figure("at", state, angle) for angle in turned], signal)

    def air_use(self) -> cp.Expression:
        """Return the mean mass flow from the supply, by the law of the flow along the model's cycle [kg/s]."""
        return self._block(("air_use",), [Figure("air_use")], "air_use")[0]

    def _extremes(self, kind: Literal["minimum", "maximum"], signal: str) -> cp.Expression:
        state, n_pieces = self._state(signal), self.machine.openings.fractions.size - 1
        within = [Figure(kind, state, 0.0, piece) for piece in range(n_pieces)]
        return self._block((kind, signal), [Figure(kind, state), *within], signal)

    def _state(self, signal: str) -> int:
        return place_of(signal, self.machine.states)

    def _block(self, key: tuple[object, ...], figures: list[Figure], signal: str) -> cp.Expression:
        if key not in self._known:
            block = FigureBlock(scenario=self.name, figures=tuple(figures), scale=self._scales[signal])
            self._blocks.append(block)
            self._known[key] = block.scale * block.variable
        return self._known[key]


def place_of(signal: str, states: tuple[str, ...]) -> int:
    """Return the number of a state.

    Raises
    ------
    ValueError
        There is none of that name; the nearest is named.
    """
    if signal not in states:
        near = get_close_matches(str(signal), states, 1, 0.4)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"signal: found {signal!r}, expected one of {', '.join(states)}{hint}")
    return states.index(signal)


def signal_scales(machine: Machine) -> dict[str, float]:
    """Return the sizes by which changes of the states [m, m/s, Pa, K] and of the air use [kg/s] are judged."""
    return {**dict(zip(machine.states, machine.state_scales.tolist(), strict=True)), "air_use": _flow_size(machine)}


def _flow_size(machine: Machine) -> float:
    """Return the size of flows from the supply: what the largest openings pass when choked [kg/s]."""
    state = machine.rest_state.copy()
    state[2 : 2 + machine.n_volumes] = max(machine.exhaust_pressure, 0.4 * machine.supply_pressure)
    largest = np.max(machine.openings.areas[:, 0], axis=0)
    areas = np.array([[largest, np.full_like(largest, np.inf)]])
    return float(source_flow(state[None], areas, True, machine.record)[0]) or 1.0
