"""The staircase (10): any opening profile as a given number of steps, each with the step means of the areas.

Steps end where the profile jumps, so at least as many are needed as the valve has positions (N_0). Further ones go
to the longest piece of the profile, a ramp counting more than a plateau by its rise; with fewer steps than pieces,
boundaries fall on piece ends and middles of ramps, so that the staircase is as near to the profile as it can be.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray, read_only, whole
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import OpeningTable, step_means


class Staircase(NamedTuple):
    """Steps of constant areas over one turn."""

    fractions: FloatArray
    """Step boundaries as shares of the period, from 0 to 1, shape (n_steps + 1,)."""
    areas: FloatArray
    """Step means of the first and second effective area of each path [m^2], shape (n_steps, 2, n_paths)."""


def staircase(machine: Machine, n_steps: int) -> Staircase:
    """Return the machine's openings as `n_steps` steps, eq. (10) with erratum E9.

    A valve position that lasts across the start of the turn is cut in two there. Where no more steps are asked for than
    the valve has positions, it counts as one, so there is then a step more.

    Raises
    ------
    ValueError
        Fewer steps than the valve has positions between jumps.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu.models.linear.staircase import staircase
    >>> staircase(lp.load_machine("kunt_singh_1990").with_duty(0.25), 4).fractions.tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """
    n_steps = whole("n_steps", n_steps)
    table = machine.openings
    n_pieces = table.fractions.size - 1
    n_positions = _count_positions(table)
    if n_steps == n_positions - 1 and not (table.jumps == 0).any():
        n_steps = n_positions
    if n_steps < n_positions:
        raise ValueError(
            f"n_steps: found {n_steps}, expected at least {n_positions}, the number of valve positions between jumps "
            "of the openings"
        )
    fractions = _split(table, n_steps) if n_steps >= n_pieces else _merged(table, n_steps)
    return Staircase(read_only(fractions), read_only(step_means(table, fractions)))


def default_steps(machine: Machine) -> int:
    """Return the fewest steps of a staircase, two or as many as the valve has positions."""
    return max(2, _count_positions(machine.openings))


def _count_positions(table: OpeningTable) -> int:
    return int(np.count_nonzero(table.jumps)) + 1


def fine_staircase(machine: Machine, steps_per_ramp: int = 32) -> Staircase:
    """Return a staircase with one step for each plateau and many for each ramp, for time means over the turn."""
    table = machine.openings
    counts = np.where(table.rises > 0, steps_per_ramp, 1)
    fractions = _subdivided(table, counts)
    return Staircase(read_only(fractions), read_only(step_means(table, fractions)))


def _subdivided(table: OpeningTable, counts: FloatArray) -> FloatArray:
    if (counts == 1).all():
        return table.fractions
    pieces = [
        np.linspace(begin, end, int(count), endpoint=False)
        for begin, end, count in zip(table.fractions[:-1], table.fractions[1:], counts, strict=True)
    ]
    return np.concatenate([*pieces, [1.0]])


def _split(table: OpeningTable, n_steps: int) -> FloatArray:
    if n_steps == table.fractions.size - 1:
        return table.fractions
    sizes = np.diff(table.fractions) * (1 + table.rises)
    counts = np.ones(sizes.size)
    for _ in range(n_steps - sizes.size):
        counts[np.argmax(sizes / counts)] += 1
    return _subdivided(table, counts)


def _merged(table: OpeningTable, n_steps: int) -> FloatArray:
    """Return the boundaries, among piece ends and middles of ramps, of the staircase nearest to the profile.

    Nearest in the mean square of all areas, each relative to its maximum; found by dynamic programming.
    """
    counts = np.where(table.rises > 0, 2, 1)
    candidates = _subdivided(table, counts)
    cost = _step_costs(table, candidates)
    last = candidates.size - 1
    best, chosen = cost[0], []
    for _ in range(n_steps - 1):
        through = best[:, None] + cost
        chosen.append(np.argmin(through, axis=0))
        best = np.min(through, axis=0)
    boundaries = [last]
    for before in reversed(chosen):
        boundaries.append(int(before[boundaries[-1]]))
    return candidates[[0, *reversed(boundaries)]]


def _step_costs(table: OpeningTable, candidates: FloatArray) -> FloatArray:
    """Squared error of one step from candidate i to j, (K, K); infinite if j is not after i or a jump lies between."""
    widths = np.diff(candidates)
    means = step_means(table, candidates)
    with np.errstate(invalid="ignore"):
        means = np.nan_to_num(means / np.max(table.areas, axis=0)[(0, 2),])
    # What varies within a candidate interval is lost whatever is merged, so the interval's mean stands for it.
    first = np.cumsum(np.concatenate([np.zeros((1, *means.shape[1:])), widths[:, None, None] * means]), axis=0)
    second = np.cumsum(np.concatenate([np.zeros((1, *means.shape[1:])), widths[:, None, None] * means**2]), axis=0)
    spans = candidates[None, :] - candidates[:, None]
    jumps = table.jumps[table.jumps > 0]
    allowed = (spans > 0) & (
        np.searchsorted(jumps, candidates)[None, :] <= np.searchsorted(jumps, candidates, side="right")[:, None]
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = (second[None] - second[:, None]) - (first[None] - first[:, None]) ** 2 / spans[:, :, None, None]
    return np.where(allowed, np.sum(errors, axis=(2, 3)), np.inf)
