"""One turn of a fitted or self-consistent model, cell by cell, from starts that need not join up. Compiled.

Where cells start and how long they last, no other cell feels but through its own start. So what a turn depends on, edge
by edge, takes a few turns with all cells moved at once, however many edges there are, and products of small matrices.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray
from ltvpneu._compiled import compiled
from ltvpneu.models.linear.march import march_period
from ltvpneu.models.linear.plan import Plan, Steps
from ltvpneu.models.machine.dynamics import STUCK
from ltvpneu.models.machine.openings import PIECE, write_areas
from ltvpneu.models.machine.supply_flow import source_flow
from ltvpneu.models.nonlinear.integrator import OK
from ltvpneu.periodic.algebra.small import apply, exponential

INTERVALS = 32
"""Intervals of each step over which the flow from the supply is integrated by Simpson's rule."""


class Probes(NamedTuple):
    """Places at which the state is looked at."""

    cells: IntArray
    """(n_probes,)"""
    rows: IntArray
    """Which step of the cell, where events cut it into several; below zero, whichever the share is in; (n_probes,)."""
    shares: FloatArray
    """Of the step's duration, or of the cell's, (n_probes,)."""


class Turn(NamedTuple):
    """What a turn is, cell by cell; scaled states."""

    status: int
    starts: FloatArray
    """Augmented, (n_cells, n + 1)."""
    ends: FloatArray
    """(n_cells, n)"""
    integrals: FloatArray
    """Of the state over time, (n_cells, n)."""
    flows: FloatArray
    """Mass from the supply [kg], (n_cells,); zero where not asked for."""
    values: FloatArray
    """At the probes, (n_probes, n)."""
    rates: FloatArray
    """Likewise, over time."""


@compiled
def _cell_plan(cell: int, duration: float, plan: Plan) -> Plan:
    """Return the plan of one cell alone; a cell is one piece of the openings, or a part of one."""
    n_paths, pieces, areas = plan.areas.shape[2], np.empty(1, PIECE), np.empty((1, 2, plan.areas.shape[2]))
    # Field by field: a record that is copied whole takes seconds to compile.
    piece, whole = pieces[0], plan.pieces[cell]
    piece.begin, piece.end, piece.ramped = 0.0, duration, whole.ramped
    for path in range(n_paths):
        for row in range(4):
            piece.areas[row, path] = whole.areas[row, path]
        for row in range(2):
            areas[0, row, path] = plan.areas[cell, row, path]
    return Plan(plan.records, pieces, np.arange(2), areas, plan.scales)


@compiled
def _mass_drawn(row: int, begin: float, one: Plan, steps: Steps) -> float:
    """Return the mass that one step takes from the supply, by the law of the flow along the step's own motion [kg]."""
    n, duration, nodes = one.scales.size, steps.durations[row], 2 * INTERVALS + 1
    map_, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    exponential(steps.matrices[row], duration / (2 * INTERVALS), map_, mean)
    states, openings = np.empty((nodes, n)), np.empty((nodes, 2, one.areas.shape[2]))
    state, following = steps.starts[row].copy(), np.empty(n + 1)
    for node in range(nodes):
        for i in range(n):
            states[node, i] = state[i] * one.scales[i]
        write_areas(begin + duration * node / (2 * INTERVALS), one.pieces[0], openings[node])
        apply(map_, state, following)
        state, following = following, state
    flows = source_flow(states, openings, True, one.records[0].run.machine)
    total = flows[0] + flows[-1]
    for node in range(1, 2 * INTERVALS):
        total += flows[node] * (4.0 if node % 2 else 2.0)
    return total * duration / (6 * INTERVALS)


class Cells(NamedTuple):
    """Where cells of one or more turns start, and how long they last."""

    starts: FloatArray
    """Scaled, augmented; chained, only the first counts: (n_turns * n_cells, n + 1)."""
    chained: bool
    """Whether each starts where the one before it ended."""
    durations: FloatArray
    """[s], (n_turns * n_cells,)"""


@compiled
def march_cells(cells: Cells, plan: Plan, steps: Steps, probes: Probes, with_flow: bool) -> Turn:
    """March every cell from its own start, or chained; `plan` is that of one turn, `steps` are written over.

    Each cell of the plan is a piece of the openings or a part of one.
    """
    N, n, n_cells = cells.starts.shape[0], cells.starts.shape[1] - 1, plan.areas.shape[0]
    begun, durations = cells.starts.copy(), cells.durations
    ends, integrals, flows = np.empty((N, n)), np.zeros((N, n)), np.zeros(N)
    K = probes.cells.size
    values, rates = np.empty((K, n)), np.empty((K, n))
    map_, mean = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
    state, work = np.empty(n + 1), np.empty(n + 1)
    for number in range(N):
        one = _cell_plan(number % n_cells, durations[number], plan)
        marched = march_period(begun[number].copy(), one, steps)
        if marched.status != OK:
            return Turn(marched.status, begun, ends, integrals, flows, values, rates)
        ends[number] = marched.state[:n]
        if cells.chained and number + 1 < N:
            begun[number + 1] = marched.state
        time = 0.0
        for row in range(marched.n_steps):
            duration = steps.durations[row]
            exponential(steps.matrices[row], duration, map_, mean)
            apply(mean, steps.starts[row], work)
            for i in range(n):
                if i != 1 or steps.modes[row] != STUCK:
                    integrals[number, i] += work[i] * duration
            if with_flow:
                flows[number] += _mass_drawn(row, time, one, steps)
            last = row == marched.n_steps - 1
            for probe in range(K):
                if probes.cells[probe] != number:
                    continue
                wanted = probes.rows[probe]
                since = probes.shares[probe] * (durations[number] if wanted < 0 else duration)
                since -= time if wanted < 0 else 0.0
                here = since >= 0.0 and (last or since < duration) if wanted < 0 else row == wanted or last
                if here and (wanted < 0 or row <= wanted):
                    exponential(steps.matrices[row], since, map_, mean)
                    apply(map_, steps.starts[row], state)
                    apply(steps.matrices[row], state, work)
                    values[probe], rates[probe] = state[:n], work[:n]
            time += duration
    return Turn(OK, begun, ends, integrals, flows, values, rates)
