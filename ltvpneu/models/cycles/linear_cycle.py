r"""The cycle of a refitted linear model, its figures and their derivatives.

In scaled states cell c of the linear model takes its start y_c and its duration tau_c to y_{c+1}, so along the turn

.. math:: dy_{c+1} = A_c\, dy_c + b_c\, d\tau_c + e_c\, d\theta, \qquad (I - A_{N-1} \cdots A_0)\, dy_0 = \ldots

and a figure is a sum over cells, or the state at a place in one of them. An extreme's place is kept: the signal's slope
vanishes there, or it lies at a switch or an event and moves with it. A, b and e are central differences through each
cell's fit.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._values import Value
from ltvpneu.errors import NonUniqueOrbitError, NotConvergedError
from ltvpneu.models.cycles.cells import Cells, Probes, Turn, march_cells
from ltvpneu.models.cycles.figures import CycleFigures, Figure, Slopes
from ltvpneu.models.cycles.turns import TOLERANCE
from ltvpneu.models.linear.march import march_period
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.own_cycle import Found, Question, as_model, trajectory_of_steps
from ltvpneu.models.linear.plan import Plan, Steps, new_steps, together
from ltvpneu.models.linear.repeat import STATE_STEP, Repeated
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import STEP, around, is_angle
from ltvpneu.models.machine.piston import at_stop
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class LinearCycle(Value):
    """A cycle of a linear model whose every cell is a piece of the openings, or a part of one."""

    question: Question
    cells: FloatArray
    """Shares of the turn, (n_cells + 1,)."""
    plan: Plan
    repeated: Repeated
    settings: dict[str, float]
    changed_at: Callable[[Mapping[str, float]], tuple[Machine, FloatArray]]
    """The machine at another setting, and its cells."""

    @property
    def initial_state(self) -> FloatArray:
        """State at the start of the period, (n,)."""
        return self.repeated.start[:-1] * self.plan.scales

    @property
    def n_turns(self) -> int:
        """Valve periods after which it repeats."""
        return self.repeated.n_periods

    @cached_property
    def periods(self) -> tuple[Steps, ...]:
        """The linear steps of every turn."""
        state, found = self.repeated.start, list[Steps]()
        for _ in range(self.n_turns):
            steps = new_steps(self.plan)
            marched = march_period(state, self.plan.copy(), steps)
            found.append(steps.cut_to(marched.n_steps))
            state = marched.state
        return tuple(found)

    @cached_property
    def model(self) -> LtvModel:
        """The linear model, as `ltv_model` returns it."""
        found = Found(
            question=self.question,
            cells=self.cells,
            plan=self.plan,
            repeated=self.repeated,
            periods=self.periods,
            iterations=self.repeated.n_marched,
        )
        return as_model(found)

    def expect_unique(self) -> None:
        """Raise where the piston rests in a stiction band."""
        if any((steps.modes == STUCK).all() for steps in self.periods) and not self.model.orbit.is_isolated:
            free = np.zeros((self.plan.scales.size, 1))
            free[0] = 1.0
            raise NonUniqueOrbitError(
                f"at {self.question.frequency:g} Hz and duty {self.question.machine.duty:.4g} stiction holds the "
                "piston all the time: where it rests is not decided by the switching (see lp.stiction_band)",
                least_norm=self.initial_state,
                free_directions=free,
            )

    def figures(
        self, asked: Sequence[Figure], parameters: Sequence[str], slopes: Callable[[], FloatArray]
    ) -> CycleFigures:
        """Return figures and derivatives; `slopes` gives those of the cells' durations, (n_cells, n_parameters)."""
        scales, n = self.plan.scales, self.plan.scales.size
        durations = np.tile(self.plan.pieces["end"] - self.plan.pieces["begin"], self.n_turns)
        probes, known = self._probes(asked)
        differ = _Differences(self, probes, any(figure.kind == "air_use" for figure in asked), durations)
        base = differ.base
        means = np.append(base.integrals.sum(axis=0), base.flows.sum()) / durations.sum()
        # A row of means, or of values at the probes, and its unit.
        rows = [_row(figure, known.get(row), n) for row, figure in enumerate(asked)]
        sizes = np.append(scales, 1.0)[[column for _, column in rows]]
        values = [means[column] if k is None else base.values[k, column] for k, column in rows]
        if not np.isfinite(values).all():
            raise NotConvergedError(
                f"a figure of the {self.question.mode} model's cycle at {self.question.frequency:g} Hz and duty "
                f"{self.question.machine.duty:.4g} is not finite: the cycle leaves the range of the medium's laws",
                residual=self.repeated.residual,
                iterations=self.repeated.n_marched,
            )

        def differentiate() -> Slopes:
            along = np.tile(slopes(), (self.n_turns, 1))
            of_means, of_probes, map_ = differ.slopes(along, parameters)
            jacobian = np.empty((len(asked), len(parameters)))
            for row, (k, column) in enumerate(rows):
                jacobian[row] = of_means[column] if k is None else of_probes[k, column]
                if k is not None and asked[row].kind == "at":
                    # At an angle, not at a place within a cell: that moves with the edges.
                    cell, share = probes.cells[k], probes.shares[k]
                    own = along[:cell].sum(axis=0) + share * along[cell]
                    turned = asked[row].angle / (2 * np.pi) * (along.sum(axis=0) / self.n_turns)
                    jacobian[row] += base.rates[k, column] * (turned - own)
            return Slopes(jacobian * sizes[:, None], map_)

        return CycleFigures(
            machine=self.question.machine,
            frequency=self.question.frequency,
            values=np.array(values) * sizes,
            initial_state=self.initial_state,
            n_periods=self.n_turns,
            differentiate=differentiate,
            find_model=lambda: self.model,
        )

    def _probes(self, asked: Sequence[Figure]) -> tuple[Probes, dict[int, int]]:
        """Return the places that figures are read off at, and which belongs to which figure."""
        places: list[tuple[int, int, float]] = []
        known: dict[int, int] = {}
        extremes: dict[int, _Extremes] = {}
        for row, (kind, state, angle, within) in enumerate(asked):
            if kind in ("mean", "air_use"):
                continue
            if kind == "at":
                share = angle / (2 * np.pi) % 1.0
                cell = min(int(np.searchsorted(self.cells, share, side="right")) - 1, self.cells.size - 2)
                place = cell, -1, float((share - self.cells[cell]) / (self.cells[cell + 1] - self.cells[cell]))
            else:
                if state not in extremes:
                    extremes[state] = self._extremes(state)
                place = extremes[state].place(kind == "maximum", within)
            known[row] = len(places)
            places.append(place)
        found = Probes(
            np.array([cell for cell, _, _ in places], dtype=np.int64),
            np.array([row for _, row, _ in places], dtype=np.int64),
            np.array([share for _, _, share in places], dtype=np.float64),
        )
        return found, known

    def _extremes(self, state: int) -> "_Extremes":
        n_cells, turns = self.cells.size - 1, np.arange(self.n_turns)
        per_piece = n_cells // (self.question.machine.openings.fractions.size - 1)
        steps, counts = together(self.periods), [period.cells.size for period in self.periods]
        cells = steps.cells + n_cells * np.repeat(turns, counts)
        first = np.searchsorted(cells, cells)
        found = _Extremes({}, {})
        for step, (low, high) in enumerate(self._trajectory.step_extremes(state)):
            for kept, extreme, sign in ((found.low, low, -1), (found.high, high, 1)):
                cell, row = int(cells[step]), step - int(first[step])
                share = min(extreme.time / float(steps.durations[step]), 1.0)
                piece = cell % n_cells // per_piece
                present = kept.get(piece)
                if present is None or sign * extreme.value > sign * present[0]:
                    kept[piece] = extreme.value, cell, row, share
        return found

    @cached_property
    def _trajectory(self) -> ExponentialTrajectory:
        return trajectory_of_steps(self.question.machine, self.periods)


class _Extremes(NamedTuple):
    """A signal's least and greatest value within each piece of the openings: value, cell of all turns, step, share."""

    low: dict[int, tuple[float, int, int, float]]
    high: dict[int, tuple[float, int, int, float]]

    def place(self, greatest: bool, piece: int) -> tuple[int, int, float]:
        kept = self.high if greatest else self.low
        # Where edges have changed their order there may be fewer pieces than there were.
        if piece in kept:
            return kept[piece][1:]
        return (max if greatest else min)(kept.values())[1:]


@final
class _Differences:
    """Central differences of a turn's cells, all moved at once."""

    def __init__(self, cycle: LinearCycle, probes: Probes, with_flow: bool, durations: FloatArray) -> None:
        self.cycle, self.probes, self.with_flow, self.durations = cycle, probes, with_flow, durations
        self.steps = new_steps(cycle.plan)
        start = np.tile(cycle.repeated.start, (durations.size, 1))
        self.base = self._march(cycle.plan, start, durations, True)
        self.K = probes.cells.size

    def _march(self, plan: Plan, starts: FloatArray, durations: FloatArray, chained: bool) -> Turn:
        turn = march_cells(Cells(starts, chained, durations), plan.copy(), self.steps, self.probes, self.with_flow)
        if turn.status != OK:
            raise NotConvergedError(
                "a march next to the cycle did not come through: there is no derivative here", residual=0, iterations=1
            )
        return turn

    def _between(self, up: Turn, down: Turn, width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes of ends, integrals and flows, (N, 2 n + 1), and of the values at the probes, (K, n)."""
        whole = [np.column_stack([turn.ends, turn.integrals, turn.flows]) for turn in (up, down)]
        wide = np.broadcast_to(width, self.durations.shape)
        return (whole[0] - whole[1]) / wide[:, None], (up.values - down.values) / wide[self.probes.cells][:, None]

    def slopes(self, along: FloatArray, parameters: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how means and flow, (n + 1, p), and values at the probes, (K, n, p), follow parameters; and the map.

        `along` is how the cells' durations do, (N, p). Places keep their share of the cell.
        """
        (N, n), p, base = self.base.ends.shape, len(parameters), self.base
        by_start, probe_by_start = self._by_start()
        by_duration, probe_by_duration = self._by_duration()
        direct = np.zeros((N, 2 * n + 1, p))
        probe_direct = np.zeros((self.K, n, p))
        for column, name in enumerate(parameters):
            if name != "frequency" and not is_angle(name):
                direct[:, :, column], probe_direct[:, :, column] = self._by_parameter(name)
        moved = by_duration[:, :, None] * along[:, None, :] + direct
        start, map_ = _periodic(by_start[:, :n], moved[:, :n])
        changes = np.empty((N, n, p))
        for c in range(N):
            changes[c] = start
            start = by_start[c, :n] @ start + moved[c, :n]
        summed = np.sum(by_start[:, n:] @ changes + moved[:, n:], axis=0)
        total, means = self.durations.sum(), np.append(base.integrals.sum(axis=0), base.flows.sum())
        of_means = (summed - means[:, None] / total * along.sum(axis=0)) / total
        cells = self.probes.cells
        of_probes = (
            probe_by_start @ changes[cells] + probe_by_duration[:, :, None] * along[cells][:, None, :] + probe_direct
        )
        return of_means, of_probes, map_

    def _by_start(self) -> tuple[FloatArray, FloatArray]:
        """Return slopes over the cells' starts, (N, 2 n + 1, n) and of the probes (K, n, n)."""
        plan, starts = self.cycle.plan, self.base.starts
        N, n = starts.shape[0], starts.shape[1] - 1
        found, probes = np.empty((N, 2 * n + 1, n)), np.empty((self.K, n, n))
        machine, length = self.cycle.question.machine.record, plan.scales[0]
        away = np.array([-at_stop(float(x) * length, machine) for x in starts[:, 0]])
        for j in range(n):
            move = np.zeros((N, n + 1))
            # Beyond a stop there is no motion: there both moves go into the stroke.
            sides = away if j < 2 else np.zeros_like(away)
            move[:, j] = STATE_STEP * np.where(sides == 0, 1, 2 * sides)
            up = self._march(plan, starts + move, self.durations, False)
            move[:, j] = STATE_STEP * np.where(sides == 0, -1, sides)
            down = self._march(plan, starts + move, self.durations, False)
            found[:, :, j], probes[:, :, j] = self._between(up, down, 2 * STATE_STEP)
            if sides.any():
                one = self._into_stroke(up, down, sides)
                found[sides != 0, :, j], probes[sides[self.probes.cells] != 0, :, j] = one
        return found, probes

    def _into_stroke(self, far: Turn, near: Turn, sides: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the slopes of cells at a stop, by two moves into the stroke, and of the probes in them."""
        width = np.where(sides == 0, 1, 2 * sides) * STATE_STEP
        by_near, by_far = self._between(near, self.base, width), self._between(far, self.base, width)
        cells, seen = sides != 0, sides[self.probes.cells] != 0
        return (4 * by_near[0] - by_far[0])[cells], (4 * by_near[1] - by_far[1])[seen]

    def _by_duration(self) -> tuple[FloatArray, FloatArray]:
        """Return slopes over the cells' durations, (N, 2 n + 1) and (K, n)."""
        width = STEP * self.durations
        up = self._march(self.cycle.plan, self.base.starts, self.durations + width, False)
        down = self._march(self.cycle.plan, self.base.starts, self.durations - width, False)
        return self._between(up, down, 2 * width)

    def _by_parameter(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return slopes over what is no instant of switching, the cells' durations kept, likewise."""
        question = self.cycle.question
        high, low = around(name, self.cycle.settings[name])
        turns: list[Turn] = []
        for moved in (high, low):
            machine, cells = self.cycle.changed_at({**self.cycle.settings, name: moved})
            plan = replace(question, machine=machine).plan(cells, TOLERANCE)
            # In the present scales, which may follow the parameter.
            plan.records["run"]["settings"] = self.cycle.plan.records["run"]["settings"]
            plan = plan._replace(scales=self.cycle.plan.scales)
            turns.append(self._march(plan, self.base.starts, self.durations, False))
        return self._between(turns[0], turns[1], high - low)


def _row(figure: Figure, probe: int | None, n: int) -> tuple[int | None, int]:
    """Return which probe a figure is read off at, None for a mean, and which column it is in."""
    return (None, n) if figure.kind == "air_use" else (probe, figure.state)


def _periodic(maps: FloatArray, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the change of the cycle's start, (n, p), and the map over it, (n, n)."""
    n = maps.shape[1]
    whole, free = np.eye(n), np.zeros(moved.shape[1:])
    for one, extra in zip(maps, moved, strict=True):
        whole, free = one @ whole, one @ free + extra
    start: FloatArray = np.linalg.solve(np.eye(n) - whole, free).astype(np.float64)
    return start, whole
