"""Where to start a search: a look at many settings of the machine itself, closer where figures jump or bend."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.subproblem import BlockFigures, Noted, Search, within_limits

Find = Callable[[FloatArray], list[BlockFigures] | None]
REFINEMENTS, ROUGH, MOST_LOOKS = 2, 0.01, 500
"""Rounds in which intervals of a grid are halved, change of a figure's step from one interval to the next, over its
span, from which they are, and settings looked at at most."""
RANKED_BY = (1e4, 300.0, 10.0)
"""Penalties by which settings to start from are ranked, the highest first: what keeps the constraints leads."""
NEARLY_KEPT = 0.15
"""Scaled violation beyond which a setting is not started from where others come nearer to the constraints [-]."""
STARTS_EACH = 3
"""Settings started from at most, by each ranking."""


def best_starts(
    search: Search, own: FloatArray, count: int, progress: Progress | None, most_broken: float = np.inf
) -> list[FloatArray]:
    """Return a few settings to start from, the best first, among one's own and a grid's or a Sobol sequence's.

    Of one or two settings, those that are better than their neighbours on the grid; by the merit with low and high
    penalties, as a setting that keeps the constraints may lie far from one that nearly does. A grid of one
    setting is made finer where figures jump or bend, as where the cycle changes its kind. Settings that break the
    constraints by more than `most_broken`, scaled, are left out.
    """
    p = own.size
    side = max(round(count ** (1 / p)), 2)
    if p > 2:
        points = qmc.Sobol(p, rng=0).random(count) if count else np.zeros((0, p))
    else:
        points = np.stack(np.meshgrid(*[np.linspace(0, 1, side)] * p, indexing="ij"), axis=-1).reshape(-1, p)
    looks: list[_Look] = []
    # Where the machine settles on no cycle soon, the model may have one.
    for find in (search.looked_at, search.figures):
        looks = _looks(search, find, [own, *points], progress)
        if any(look.noted is not None for look in looks):
            break
    else:
        if search.reason is not None:
            raise search.reason
        return [own]
    sub = search.subproblem
    sub.widen(_sizes(looks))
    objectives, broken = (np.full(len(looks), np.inf) for _ in range(2))
    for i, look in enumerate(looks):
        if look.noted is not None:
            objectives[i], broken[i] = sub.worth(look.noted)
    shape = (side,) * p if p == 2 else (len(looks) - 1,)
    chosen: list[int] = []
    for penalty in RANKED_BY:
        merits = objectives + penalty * broken
        good = [int(i) for i in np.argsort(merits) if np.isfinite(merits[i])]
        if p <= 2:
            lowest = _lower_than_neighbours(merits[1:].reshape(shape))
            good = [i for i in good if i == 0 or lowest.ravel()[i - 1]]
        chosen += [i for i in good[:STARTS_EACH] if i not in chosen]
    # If the constraints were kept near a setting that is far from keeping them, its neighbours would come nearer.
    most = min(max(2.0 * float(np.min(broken[chosen])), NEARLY_KEPT), most_broken)
    return [looks[i].setting for i in chosen if broken[i] <= most]


def starts_with_slopes(search: Search) -> list[FloatArray]:
    """Return a few of the settings looked at from which a search can begin, those that break the constraints least.

    For where the best of them have no slopes, as where a valve's ramps meet.
    """
    chosen: list[FloatArray] = []
    for one in sorted(search.noted, key=search.subproblem.distance):
        if len(chosen) < STARTS_EACH and search.with_slopes(one.setting) is not None:
            chosen.append(one.setting)
    return chosen


class _Look(NamedTuple):
    """What a setting looks like; nothing noted and no values where it has no cycle."""

    setting: FloatArray
    noted: Noted | None
    values: FloatArray


def _looks(search: Search, find: Find, points: Sequence[FloatArray], progress: Progress | None) -> list[_Look]:
    """Return looks at settings, the machine's own first; between those of one variable's grid, at more."""
    looks: list[_Look] = []
    for number, setting in enumerate(points):
        if progress is not None:
            progress("looking at settings", number / len(points))
        looks.append(_look(search, find, setting))
    if points[0].size == 1:
        looks[1:] = _refined(search, find, looks[1:], progress)
    return looks


def _look(search: Search, find: Find, setting: FloatArray) -> _Look:
    sub, nothing = search.subproblem, _Look(setting, None, np.zeros(0))
    figures = find(setting) if within_limits(sub.task, setting) else None
    if figures is None:
        return nothing
    if not sub.is_scaled:
        # By derivatives, which there are none of where switching instants change their order.
        exact = search.with_slopes(setting)
        if exact is None:
            return nothing
        sub.scale(setting, exact)
    values = np.concatenate([one.values for one in figures]) if figures else np.zeros(1)
    return _Look(setting, search.note(setting, figures), values)


def _sizes(looks: Sequence[_Look]) -> dict[str, float]:
    """Return how much objective, under an empty name, and constraints change over the bounds, if evenly.

    By the range of the middle half, so that a few far ones count for nothing.
    """
    noted = [look.noted for look in looks if look.noted is not None]
    tables = {"": np.array([[one.objective] for one in noted])}
    tables |= {name: np.array([one.differences[name] for one in noted]) for name in noted[0].differences}
    found: dict[str, float] = {}
    for name, table in tables.items():
        low, high = np.nanquantile(table, (0.25, 0.75), axis=0)
        found[name] = float(np.nan_to_num(np.max(2.0 * (high - low), initial=0.0)))
    return found


def _refined(search: Search, find: Find, looks: list[_Look], progress: Progress | None) -> list[_Look]:
    """Return looks along one setting with those between that a jump, a bend or the end of all cycles asks for."""
    for number in range(REFINEMENTS if any(look.values.size for look in looks) else 0):
        rough = _rough_intervals(looks)
        if len(looks) + rough.size > MOST_LOOKS:
            break
        if progress is not None:
            progress("looking closer where figures jump", number / REFINEMENTS)
        for i in rough[::-1].tolist():
            looks.insert(i + 1, _look(search, find, 0.5 * (looks[i].setting + looks[i + 1].setting)))
    return looks


def _rough_intervals(looks: Sequence[_Look]) -> IntArray:
    """Return the numbers of the intervals over which values cannot be trusted to go on as they do beside."""
    m = max(look.values.size for look in looks)
    values = np.array([look.values if look.values.size else np.full(m, np.nan) for look in looks])
    places = np.array([look.setting[0] for look in looks])
    known = np.logical_and.reduce(np.isfinite(values), axis=1)
    spans = np.ptp(values[known], axis=0) if known.any() else np.zeros(m)
    slopes = np.diff(values, axis=0) / np.diff(places)[:, None]
    widths = np.minimum(places[1:-1] - places[:-2], places[2:] - places[1:-1])
    # What a straight line through two neighbours would be off by.
    off = np.nan_to_num(np.abs(np.diff(slopes, axis=0)) * widths[:, None] / np.maximum(spans, 1e-300))
    bent = np.concatenate([[False], off.max(axis=1) > ROUGH, [False]])
    return np.flatnonzero((known[:-1] != known[1:]) | ((bent[:-1] | bent[1:]) & known[:-1] & known[1:]))


def _lower_than_neighbours(values: FloatArray) -> BoolArray:
    padded = np.pad(values, 1, constant_values=np.inf)
    lowest = np.isfinite(values)
    middle = (slice(1, -1),) * values.ndim
    for axis in range(values.ndim):
        for shift in (-1, 1):
            lowest &= values <= np.roll(padded, shift, axis)[middle]
    return lowest
