"""What a march of linear steps goes through, and the steps that it leaves."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import FloatArray, IntArray, layout
from ltvpneu.models.machine.openings import Pieces
from ltvpneu.models.machine.records import N_INPUTS
from ltvpneu.models.nonlinear.runge_kutta import Run, RunRecord

ROOM_PER_CELL, ROOM = 2, 256
"""Steps that there is room for: for each boundary of cells, and for cuts by events on top."""


class PlanRecord:
    """How steps are marched, as the compiled kernels read it."""

    fitted: bool
    """Whether steps are fitted; else tangents at their own means."""
    distance: float
    """As of `tangent_at`."""
    tolerance: float
    """Scaled difference from a step's means at which its operating point counts as found."""
    max_iterations: int
    run: RunRecord
    """The nonlinear equations."""


class Plan(NamedTuple):
    """What is marched through, and how."""

    records: NDArray[Any]
    """One `PlanRecord`, shape (1,)."""
    pieces: Pieces
    """They end at the boundaries of cells at least."""
    first_pieces: IntArray
    """First piece of each cell, and the number of pieces, (n_cells + 1,)."""
    areas: FloatArray
    """Means of the effective areas over each cell, (n_cells, 2, n_paths)."""
    scales: FloatArray
    """(n,)"""

    def copy(self) -> "Plan":
        """Return a plan with a record of its own: a march notes its progress there."""
        return self._replace(records=self.records.copy())


def new_plan(run: Run, first_pieces: IntArray, areas: FloatArray, scales: FloatArray, **how: float) -> Plan:
    """Return a plan; `how` holds the numbers of its record, by name."""
    records = np.zeros(1, layout(PlanRecord, run=run.records.dtype))
    records["run"] = run.records
    for name, value in how.items():
        records[name] = value
    return Plan(records, run.pieces, first_pieces, areas, np.array(scales))


class Steps(NamedTuple):
    """The steps of one period."""

    matrices: FloatArray
    """Scaled augmented matrices, (capacity, n + 1, n + 1)."""
    starts: FloatArray
    """Scaled augmented states, (capacity, n + 1)."""
    points: FloatArray
    """Operating points, (capacity, n)."""
    inputs: FloatArray
    """Slopes over the inputs, (capacity, n, 4)."""
    held: FloatArray
    """Half-widths of chords, (capacity, n)."""
    cells: IntArray
    """The cell that each belongs to, (capacity,)."""
    modes: IntArray
    """Modes of the piston."""
    durations: FloatArray
    """[s]"""
    errors: FloatArray
    """Local errors [-]."""
    iterations: IntArray
    """Of the search for the operating point."""

    def cut_to(self, count: int) -> "Steps":
        """Return the first so many steps."""
        return Steps._make(part[:count].copy() for part in self)


def new_steps(plan: Plan) -> Steps:
    """Return arrays for the steps of a period, with room for cuts by events."""
    n, capacity = plan.scales.size, ROOM_PER_CELL * plan.first_pieces.size + ROOM
    return Steps(
        matrices=np.empty((capacity, n + 1, n + 1)),
        starts=np.empty((capacity, n + 1)),
        points=np.empty((capacity, n)),
        inputs=np.empty((capacity, n, N_INPUTS)),
        held=np.zeros((capacity, n)),
        cells=np.empty(capacity, dtype=np.int64),
        modes=np.empty(capacity, dtype=np.int64),
        durations=np.empty(capacity),
        errors=np.empty(capacity),
        iterations=np.empty(capacity, dtype=np.int64),
    )


def together(periods: Sequence[Steps]) -> Steps:
    """Return the steps of several valve periods as one."""
    return Steps._make(np.concatenate(parts) for parts in zip(*periods, strict=True))
