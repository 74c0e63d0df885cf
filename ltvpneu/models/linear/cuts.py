"""Where the steps go: cuts of the turn, even or by the error that each step makes.

A step's local error falls with the third power of its length, so n pieces of a step of error e make e / n^3 each. Cuts
go one by one to the step whose pieces make the most. Near an infinite slope the power is lower; a few rounds of
marching and cutting anew close in on it all the same.

Stick, slip and stops are cut at exactly. Where a flow chokes no cut is made: the slope of every law of flow here is
continuous there (it is zero on both sides, over the downstream pressure), so a step across has the same order of error
as any other, and is cut if that is large.
"""

import numpy as np

from ltvpneu._arrays import FloatArray


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
