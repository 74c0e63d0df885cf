"""Where no setting keeps all goals: the setting that breaks the fewest, and those by the least.

How much a goal is broken counts by what it ranges over on the settings that were looked at, so goals of different units
compare. Goals that some setting keeps by itself come first, equations before bounds: so what can be met is met, say a
wanted mean, and the others come as near as that leaves them.
"""

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.sequential import FEASIBLE, Found, best_from, is_better
from ltvpneu.design.switching.subproblem import Noted, Search
from ltvpneu.errors import LtvpneuError

FIRST, SECOND = 1e3, 30.0
"""By what an equation, and a bound, that some setting keeps by itself count more than a goal that none keeps [-]."""
STARTS = 2
"""Settings from which the nearest one is looked for, beside the one found before."""


def nearest(search: Search, found: Found, tolerance: float, max_iterations: int, progress: Progress | None) -> Found:
    """Return the setting nearest to keeping all goals, where the one that was found keeps not all; else that one."""
    sub, noted = search.subproblem, search.noted
    if not noted or sub.merit(found.setting, found.figures, 0.0)[1] <= max(FEASIBLE, tolerance):
        return found
    ranges = ranges_of(noted)
    before = sub.sizes
    sub.measure_by({name: range_ / _weight(noted, name) for name, range_ in ranges.items()})
    try:
        other = best_from(search, _starts(search, found), tolerance, max_iterations, progress)
    except (LtvpneuError, ValueError):
        sub.measure_by(before)
        return found
    best = other if is_better(search, other, found) else found
    if best.status == "stopped" and sub.merit(best.setting, best.figures, 0.0)[1] > max(FEASIBLE, tolerance):
        # All settings were looked over, from the best of them searches started, and none came to keep the goals.
        best.status = "infeasible"
    best.n_cycles, best.n_failed = search.n_cycles, search.n_failed
    return best


def ranges_of(noted: list[Noted]) -> dict[str, float]:
    """Return what the two sides of each constraint differ by at most, less what they differ by at least."""
    found: dict[str, float] = {}
    for name in noted[0].differences if noted else ():
        table = np.array([one.differences[name] for one in noted])
        span = float(np.max(np.ptp(table, axis=0), initial=0.0))
        found[name] = span or float(np.max(np.abs(table), initial=0.0)) or 1.0
    return found


def _weight(noted: list[Noted], name: str) -> float:
    """Return what a constraint counts: more if it could be kept by itself.

    An inequality where some setting keeps it, an equation where its sides cross between settings.
    """
    table = np.array([one.differences[name] for one in noted])
    if name in noted[0].equations:
        return FIRST if ((table.min(axis=0) <= 0) & (table.max(axis=0) >= 0)).all() else 1.0
    return SECOND if (table <= 0).all(axis=1).any() else 1.0


def _starts(search: Search, found: Found) -> list[FloatArray]:
    """Return what was found, and of the settings looked at the nearest ones, no two close together."""
    sub, chosen = search.subproblem, [found.setting]
    ranked = sorted(search.noted, key=lambda one: sub.distance(one))
    apart = 1.0 / max(len(ranked), 1) ** (1 / found.setting.size)
    for one in ranked:
        if len(chosen) > STARTS:
            break
        if all(float(np.max(np.abs(one.setting - other))) > apart for other in chosen):
            chosen.append(one.setting)
    return chosen
