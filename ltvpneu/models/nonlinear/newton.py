"""The orbit next to a start by Newton's method on the map over a period, whether it attracts or not."""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._clock import Deadline
from ltvpneu.errors import LtvpneuError, NotSettledError
from ltvpneu.models.nonlinear.period_map import PeriodMap, Turn

MOST_STEPS = 60
LEAST_SHARE = 2.0**-12
"""Share of a step of Newton's method below which it is given up [-]."""


def nearest_orbit(
    period: PeriodMap, start: FloatArray, tolerance: float, deadline: Deadline | None
) -> tuple[Turn, float, int]:
    """Return the turn that closes nearest to a start, its scaled distance from the orbit, and the turns taken.

    Each step is cut until what the next one would be is shorter (Deuflhard's test).

    Raises
    ------
    NotSettledError
        Newton's method leads to no orbit from there.
    TimeLimitError
    """
    scales = period.machine.state_scales
    turn, taken = period.turn(start), 1
    step, solve = _step(period, turn)
    for _ in range(MOST_STEPS):
        length = float(np.max(np.abs(step)))
        if length <= tolerance:
            return turn, length, taken
        share = 1.0
        while share >= LEAST_SHARE:
            if deadline is not None:
                deadline.check(f"{taken} turns of the search for an orbit taken")
            following = _turn_from(period, turn.start + share * step * scales)
            taken += 1
            if following is not None:
                left = solve @ ((following.end - following.start) / scales)
                if float(np.max(np.abs(left))) <= (1.0 - 0.25 * share) * length:
                    break
            share *= 0.5
        else:
            break
        turn = following
        step, solve = _step(period, turn)
    residual = float(np.max(np.abs((turn.end - turn.start) / scales)))
    raise NotSettledError(
        f"no orbit next to the start by Newton's method: a period still changes the scaled state by {residual:.1e} "
        f"(tolerance {tolerance:.1e}). Start nearer to it, for one from an orbit at a frequency or duty close by",
        residual=residual,
        n_simulated=taken,
        last_state=turn.end,
    )


def _turn_from(period: PeriodMap, start: FloatArray) -> Turn | None:
    try:
        return period.turn(start)
    except (ValueError, LtvpneuError):
        # Beyond a stop, below no pressure, or the equations do not come through: no place to go on from.
        return None


def _step(period: PeriodMap, turn: Turn) -> tuple[FloatArray, FloatArray]:
    """Return the scaled step of Newton's method from a turn, (n,), and the inverse that it is taken with, (n, n)."""
    scales = period.machine.state_scales
    derivative = period.derivative(turn) * scales / scales[:, None]
    if not np.isfinite(derivative).all():
        # No step is shorter than one that is no number: the search ends there, and says so.
        return np.full(scales.size, math.nan), np.eye(scales.size)
    # A piston that is held stays where it is: of all solutions the shortest.
    inverse = np.linalg.pinv(np.eye(scales.size) - derivative, rcond=1e-13).astype(np.float64)
    step: FloatArray = inverse @ ((turn.end - turn.start) / scales)
    return step, inverse
