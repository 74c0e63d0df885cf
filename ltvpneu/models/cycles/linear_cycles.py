"""Refitted linear models of a machine, one cycle per setting of its parameters: what a design is worked out on."""

from collections.abc import Callable, Mapping, Sequence
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.errors import NotConvergedError
from ltvpneu.models.cycles.figures import CycleFigures, Figure
from ltvpneu.models.cycles.linear_cycle import LinearCycle
from ltvpneu.models.cycles.turns import TOLERANCE
from ltvpneu.models.linear.operating_points import LEAST_DISTANCE
from ltvpneu.models.linear.own_cycle import OwnCycle, Question
from ltvpneu.models.linear.plan import new_steps
from ltvpneu.models.linear.repeat import SAFE_RADIUS, Repeated, repeat_march
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import STEP, around, is_angle, with_values

MOST_PERIODS, SOME_PERIODS, FEW_PERIODS = 300, 60, 12
"""Valve periods marched for a cycle from rest; what takes longer, as in chaos, counts as none. From the cycle before,
and from one beside whose map is known."""


@final
class LinearCycles:
    """Refitted linear models of a machine, one cycle per setting of its parameters.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Where it is no parameter [Hz].
    mode : {"fitted", "self-consistent"}
    steps_per_piece : int
        Steps into which each piece of the openings is divided evenly, so that steps move with the edges.
    distance : float
        As `least_distance` of `ltv_model`.
    change : callable, optional
        What is made of the machine once its parameters are set: a scenario.
    """

    def __init__(
        self,
        machine: Machine,
        frequency: float,
        mode: OwnCycle = "fitted",
        steps_per_piece: int = 1,
        distance: float = LEAST_DISTANCE,
        change: Callable[[Machine], Machine] | None = None,
    ) -> None:
        self.machine, self.frequency, self.distance, self._change = machine.at(frequency), frequency, distance, change
        self.mode: OwnCycle = mode
        self.steps_per_piece = steps_per_piece
        self._start: FloatArray | None = None
        self._latest: CycleFigures | None = None
        self._known: tuple[FloatArray, FloatArray] | None = None
        """Start of a cycle beside that attracts, (n,), and the inverse of I - P_z there, scaled, (n, n)."""
        self._edge_slopes: dict[str, tuple[FloatArray, FloatArray]] = {}

    def question(self, values: Mapping[str, float]) -> Question:
        """Return what model is meant at a setting of the parameters."""
        machine = self.machine_at(values)
        frequency = float(values.get("frequency", self.frequency))
        return Question(machine=machine, frequency=frequency, mode=self.mode, distance=self.distance)

    def machine_at(self, values: Mapping[str, float]) -> Machine:
        """Return the machine at a setting of the parameters, changed as the scenario has it."""
        machine = with_values(self.machine, values)
        return machine if self._change is None else self._change(machine)

    def cells_of(self, machine: Machine) -> FloatArray:
        """Return the cells of a machine's turn, as shares of it, (n_cells + 1,)."""
        return divided(machine.openings.fractions, self.steps_per_piece)

    def cycle(self, values: Mapping[str, float]) -> LinearCycle:
        """Return the cycle at a setting of the parameters.

        Raises
        ------
        NotConvergedError
            None was found.
        NonUniqueOrbitError
            Stiction holds the piston all the time.
        """
        question = self.question(values)
        cells = self.cells_of(question.machine)
        plan = question.plan(cells, TOLERANCE)
        steps = new_steps(plan)

        def from_start(start: FloatArray, most: int, known: FloatArray | None = None) -> Repeated:
            scaled = np.append(start / plan.scales, 1.0)
            return repeat_march(scaled, plan, steps, 10 * TOLERANCE, most, known=known)

        known, repeated = self._beside(), None
        if known is not None:
            repeated = from_start(known[0], FEW_PERIODS, known[1])
        if (repeated is None or repeated.n_periods == 0) and self._start is not None:
            repeated = from_start(self._start, SOME_PERIODS)
        if repeated is None or repeated.n_periods == 0:
            repeated = from_start(question.machine.rest_state, MOST_PERIODS)
        if repeated.n_periods == 0:
            raise NotConvergedError(
                f"the {self.mode} model at {question.frequency:g} Hz and duty {question.machine.duty:.4g} has no cycle "
                "that was found",
                residual=repeated.residual,
                iterations=repeated.n_marched,
            )
        found = LinearCycle(
            question=question,
            cells=cells,
            plan=plan,
            repeated=repeated,
            settings=dict(values),
            changed_at=lambda changed: self._changed_at(changed, cells),
        )
        self._start = found.initial_state
        return found

    def figures(
        self, values: Mapping[str, float], figures: Sequence[Figure], parameters: Sequence[str]
    ) -> CycleFigures:
        """Return a cycle's figures and their derivatives; errors as of `cycle`."""
        cycle = self.cycle(values)
        cycle.expect_unique()

        def along() -> FloatArray:
            slopes = [self._slopes_of(cycle, name) for name in parameters]
            return np.array(slopes).reshape(len(parameters), cycle.cells.size - 1).T

        self._latest = cycle.figures(figures, parameters, along)
        return self._latest

    def _beside(self) -> tuple[FloatArray, FloatArray] | None:
        """Return the start and the inverse of the last cycle whose derivatives have been worked out."""
        latest = self._latest
        if latest is not None and latest.is_differentiated:
            self._latest, self._known = None, None
            if latest.n_periods == 1 and latest.spectral_radius < SAFE_RADIUS:
                map_ = latest.slopes.map_
                self._known = latest.initial_state, np.linalg.inv(np.eye(len(map_)) - map_).astype(np.float64)
        return self._known

    def _slopes_of(self, cycle: LinearCycle, name: str) -> FloatArray:
        """Return how the durations of the cells of one turn follow a parameter [s], (n_cells,)."""
        question, cells = cycle.question, cycle.cells
        if name == "frequency":
            slopes = -np.diff(cells) / question.frequency**2
            if not question.machine.has_switching_times:
                return slopes
            # Times in seconds are other angles at another frequency.
            high, low = around(name, question.frequency)
            up, down = (cycle.changed_at({**cycle.settings, name: moved})[1] for moved in (high, low))
            return slopes + np.diff(up - down) / ((high - low) * question.frequency)
        if is_angle(name):
            return np.diff(self._cell_slopes(cycle, name)) / question.frequency
        # A ramp, or a point of a command, moves the pieces too; pressures and the like do not.
        high, low = around(name, cycle.settings[name])
        up, down = (cycle.changed_at({**cycle.settings, name: moved})[1] for moved in (high, low))
        return np.diff(up - down) / ((high - low) * question.frequency)

    def _changed_at(self, values: Mapping[str, float], cells: FloatArray) -> tuple[Machine, FloatArray]:
        """Return the machine at another setting, and its cells, of which there must be as many."""
        machine = self.machine_at(values)
        moved = self.cells_of(machine)
        if moved.size != cells.size:
            raise _order_changes(values)
        return machine, moved

    def _cell_slopes(self, cycle: LinearCycle, name: str) -> FloatArray:
        table = cycle.question.machine.openings
        known = self._edge_slopes.get(name)
        # The way from edges to pieces is affine as long as the pieces come in the same order.
        if known is not None and _same_pieces(known[0], table.areas):
            return known[1]
        value = cycle.settings[name]
        for step in (STEP, -STEP):
            moved = self.machine_at({**cycle.settings, name: value + step}).openings
            if _same_pieces(moved.areas, table.areas):
                slopes = divided(moved.fractions - table.fractions, self.steps_per_piece) / step
                self._edge_slopes[name] = table.areas, slopes
                return slopes
        raise _order_changes({name: value})


def _order_changes(values: Mapping[str, float]) -> ValueError:
    found = ", ".join(f"{name} {value:g}" for name, value in values.items())
    return ValueError(
        f"parameters: found {found}, from where the order of the switching instants changes; keep them apart"
    )


def _same_pieces(one: FloatArray, other: FloatArray) -> bool:
    # Where a ramp ends, rounding leaves a little of the opening, or nothing.
    largest = float(np.max(one, where=np.isfinite(one), initial=0.0))
    return one.shape == other.shape and np.allclose(one, other, rtol=1e-9, atol=1e-9 * largest)


def divided(fractions: FloatArray, n: int) -> FloatArray:
    """Return boundaries with each interval divided into n, evenly."""
    if n == 1:
        return fractions
    shares = np.arange(n) / n
    inner = fractions[:-1, None] + np.diff(fractions)[:, None] * shares
    return np.append(inner.ravel(), fractions[-1])
