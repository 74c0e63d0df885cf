"""Where the steps go: cuts of the turn, even or by the error that each step makes.

A step's local error falls with the third power of its length, so n pieces of a step of error e make e / n^3 each. Cuts
go one by one to the step whose pieces make the most. Near an infinite slope the power is lower; a few rounds of
marching and cutting anew close in on it all the same.

Stick, slip and stops are cut at exactly. Where a flow chokes no cut is made: the slope of every law of flow here is
continuous there (it is zero on both sides, over the downstream pressure), so a step across has the same order of error
as any other, and is cut if that is large.
"""

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu.models.machine_arrays import OpeningTable
from ltvpneu.models.runge_kutta import Schedule
from ltvpneu.models.staircase import step_means


def cuts_by_error(boundaries: FloatArray, starts: FloatArray, errors: FloatArray, n_cells: int) -> FloatArray:
    """Return cell boundaries, n_cells + 1 shares of the turn from 0 to 1, finer where errors are large.

    Parameters
    ----------
    boundaries : ndarray, shape (n_least + 1,)
        Boundaries that stay.
    starts : ndarray, shape (n_steps + 1,)
        Where the steps marched so far start, and 1.
    errors : ndarray, shape (n_steps,)
    n_cells : int
    """
    widths = np.diff(starts)
    # Where a step has next to no error its own rounding decides nothing, its length does.
    weights = np.maximum(errors, 1e-4 * np.max(errors, initial=1e-300) * widths**3)
    counts = np.ones(widths.size)
    for _ in range(n_cells - (boundaries.size - 1)):
        counts[np.argmax(weights / counts**3)] += 1
    cuts = [start + width * np.arange(1, int(n)) / n for start, width, n in zip(starts, widths, counts, strict=False)]
    found = np.sort(np.concatenate([boundaries, *cuts]))
    # The same instant twice, but for rounding, is no cell.
    found = found[np.insert(np.diff(found) > 1e-12, 0, True)]
    found[-1] = 1.0
    return found


def even_cuts(boundaries: FloatArray, n_cells: int) -> FloatArray:
    """Return n_cells + 1 boundaries, the intervals between those given divided evenly, the longest most often."""
    widths = np.diff(boundaries)
    counts = np.ones(widths.size)
    for _ in range(n_cells - widths.size):
        counts[np.argmax(widths / counts)] += 1
    cuts = [start + width * np.arange(int(n)) / n for start, width, n in zip(boundaries, widths, counts, strict=False)]
    return np.append(np.concatenate(cuts), 1.0)


def cut_schedule(table: OpeningTable, cells: FloatArray, period: float) -> tuple[Schedule, IntArray, FloatArray]:
    """Return the openings on pieces that end at the cells' boundaries too, each cell's first piece, and its mean areas.

    Shapes: cells (n_cells + 1,) to first pieces (n_cells + 1,) and areas (n_cells, 2, n_paths).
    """
    if np.array_equal(table.fractions, cells):
        schedule = Schedule(table.fractions * period, table.areas, table.ramped)
        return schedule, np.arange(cells.size), np.array(step_means(table, table.fractions), order="C")
    fractions = np.union1d(table.fractions, cells)
    middles = (fractions[:-1] + fractions[1:]) / 2
    piece = np.searchsorted(table.fractions, middles) - 1
    begin, width = table.fractions[:-1][piece], np.diff(table.fractions)[piece]
    shares = ((fractions[:-1] - begin) / width, (fractions[1:] - begin) / width)
    areas = np.empty((middles.size, *table.areas.shape[1:]))
    for row in (0, 2):
        at_start, at_end = table.areas[piece, row], table.areas[piece, row + 1]
        for which, share in enumerate(shares):
            with np.errstate(invalid="ignore"):
                between = at_start + share[:, None] * (at_end - at_start)
            # Not interpolated where equal: an absent second restriction is infinite at both ends.
            areas[:, row + which] = np.where(at_start == at_end, at_start, between)
    ramped: BoolArray = table.ramped[piece]
    areas.setflags(write=False)
    schedule = Schedule(fractions * period, areas, ramped)
    return schedule, np.searchsorted(fractions, cells), np.array(step_means(table, cells), order="C")
