"""A move of the nonlinear machine, as it was designed."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.passage import Passage, Position
from ltvpneu.periodic.systems import bridge

if TYPE_CHECKING:
    import control


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MoveSolution(Value):
    """A move of the nonlinear machine."""

    machine: Machine
    status: str
    """"optimal": to the conditions of optimality, of the best that was found. "stopped": the end and all bounds are
    kept, and no step makes it better, but the conditions are not met, as where the optimum lies on a kink.
    "infeasible": no move was found that ends where it should; this one is nearest."""
    objective: float
    order: tuple[Position, ...]
    """Whether each valve is on, the machine's own first, part by part."""
    durations: FloatArray
    """Of the parts [s], (n_parts,)."""
    figures: dict[str, float]
    """Time [s], last states, greatest speed [m/s], air mass [kg], impact energy [J]."""
    missed: dict[str, float]
    """By how much each constraint is broken, in its own unit; 0 where it is kept."""
    duals: dict[str, float]
    """Of the constraints: what one more unit of each bound saves."""
    residual: float
    """Of the conditions of optimality, scaled [-]."""
    way: Passage
    delays: tuple[tuple[float, float], ...]
    """Of each valve, from a command until it has opened and shut [s]."""
    n_simulations: int
    """Moves that were integrated in the search, those for slopes included."""
    n_looked_at: int
    """Parts that were integrated on the grid of switching times."""
    by_switches: dict[int, float]
    """The best objective with so many switches; nan where none ended where it should."""

    def __repr__(self) -> str:
        place = f"{1e3 * self.way.start[0]:.4g} to {1e3 * self.way.end[0]:.4g} mm"
        missed = f", misses {', '.join(self.broken)}" if self.broken else ""
        how = f"{1e3 * self.time:.6g} ms with {self.n_switches} switches"
        return f"<MoveSolution: {self.status}, {place} in {how}{missed}>"

    @property
    def time(self) -> float:
        """From the first opening to the end [s]."""
        return float(np.sum(self.durations))

    @property
    def n_switches(self) -> int:
        """Within the move, the first position not counted."""
        return len(self.order) - 1

    @property
    def switching_times(self) -> FloatArray:
        """When valves have switched, from the start of the move [s], (n_switches,)."""
        return np.cumsum(self.durations)[:-1]

    @property
    def broken(self) -> tuple[str, ...]:
        """Constraints that are not kept."""
        return tuple(name for name, by in self.missed.items() if by > 0)

    @property
    def commands(self) -> tuple[tuple[tuple[float, bool], ...], ...]:
        """What each valve has to be told, and when, its delays taken off [s]."""
        begins = [0.0, *self.switching_times.tolist()]
        found: list[tuple[tuple[float, bool], ...]] = []
        for valve, (opening, closing) in enumerate(self.delays):
            told: list[tuple[float, bool]] = []
            for begin, position in zip(begins, self.order, strict=True):
                on = position[valve]
                if not told or told[-1][1] != on:
                    told.append((begin - (opening if on else closing), on))
            found.append(tuple(told))
        return tuple(found)

    @property
    def end_state(self) -> FloatArray:
        """The last state, (n_states,)."""
        return self.way.end

    @cached_property
    def response(self) -> "control.TimeResponseData":
        """All states over the move, by name."""
        even = np.linspace(0.0, self.time, 400)
        times = np.union1d(even, self.switching_times)
        named = self.machine.states, self.way.at(times)
        return bridge.time_response(times, named, named, self.machine.name)
