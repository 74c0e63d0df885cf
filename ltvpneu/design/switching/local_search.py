"""Local searches from the best of many settings, more of them where these lead to no optimum."""

import numpy as np

from ltvpneu._arrays import FloatArray, whole
from ltvpneu.design.progress import Progress
from ltvpneu.design.switching.sequential import CLEARLY, Found, best_from, is_better
from ltvpneu.design.switching.starts import best_starts, starts_with_slopes
from ltvpneu.design.switching.subproblem import Search
from ltvpneu.errors import LtvpneuError

STARTS = {1: (161, 641), 2: (169, 441)}
"""Settings looked at first, by the number of variables; then more where that leads to no optimum."""
STARTS_BEYOND = (16,)
"""The same for more variables."""


def search_locally(
    search: Search,
    own: FloatArray,
    n_starts: int | None,
    limits: tuple[float, int],
    progress: Progress | None,
) -> Found:
    """Return the best of what local searches find; `limits` are the residual's tolerance and the most iterations.

    Raises
    ------
    LtvpneuError
        No setting looked at has a cycle: the last one's reason.
    """
    counts = STARTS.get(own.size, STARTS_BEYOND) if n_starts is None else (whole("n_starts", n_starts),)
    found: Found | None = None
    for count in counts:
        most = np.inf
        if found is not None and found.status == "infeasible":
            # The closer look is for settings that break the constraints less than what was found.
            most = CLEARLY * search.subproblem.merit(found.setting, found.figures, 0.0)[1]
        starts = best_starts(search, own, count, progress, most)
        if not starts:
            break
        try:
            other = best_from(search, starts, *limits, progress)
        except (LtvpneuError, ValueError):
            starts = starts_with_slopes(search)
            if not starts:
                raise
            other = best_from(search, starts, *limits, progress)
        found = other if found is None or is_better(search, other, found) else found
        if found.status == "optimal" or (found.status == "infeasible" and own.size == 1):
            break
    assert found is not None
    return found
