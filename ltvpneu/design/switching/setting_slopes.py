"""How the best settings change with a parameter of the machine."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.design.switching.sequential import Found, best_from
from ltvpneu.design.switching.subproblem import Search
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import moved

BESIDE = 2e-3
"""Relative step of a parameter to either side [-]."""
TIGHTER = 1e-2
"""Share of the residual that is allowed beside, for differences of settings are small [-]."""
MOST_ITERATIONS = 30
FURTHEST = 0.1
"""Share of the bounds by which a setting beside is another optimum [-]."""


def setting_slopes(
    found: Found,
    at: tuple[Machine, float],
    names: Sequence[str],
    beside: Callable[[Machine, float], Search],
    tolerance: float,
) -> dict[str, FloatArray]:
    """Return the derivatives of the best setting, shares of the bounds, over parameters of the machine.

    By the conditions of optimality beside: each problem with the parameter a little larger and smaller is solved from
    the optimum, in a few convex steps. Differences see what the curvature, the constraints and their order do.
    """
    p = found.setting.size
    slopes = {name: np.full(p, math.nan) for name in names}
    if found.status != "optimal" or found.at_kink:
        # On a kink what it does to one side differs from the other.
        return slopes
    for name in names:
        try:
            sides, width = moved(*at, name, BESIDE)
            ends = [
                best_from(beside(*side), [found.setting], TIGHTER * tolerance, MOST_ITERATIONS, None) for side in sides
            ]
        except (LtvpneuError, ValueError):
            continue
        near = all(float(np.max(np.abs(end.setting - found.setting))) < FURTHEST for end in ends)
        if near and all(end.status == "optimal" or end.residual <= tolerance for end in ends):
            slopes[name] = (ends[0].setting - ends[1].setting) / width
    return slopes
