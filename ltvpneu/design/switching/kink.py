r"""Slopes at a kink: those met on its sides, mixed so that the convex problem foretells the least.

With weights w, by minimax duality, the greatest over w of the least merit over steps is the least over steps of the
greatest merit: where no step helps on every side, the mixture is the one of Clarke's derivatives that shows it.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, cast

import numpy as np
from scipy.optimize import brentq

from ltvpneu._arrays import FloatArray
from ltvpneu.design.switching.subproblem import Answer, BlockFigures, Subproblem, stacked
from ltvpneu.errors import LtvpneuError

BESIDE, DISTINCT = 1e-3, 1e-4
"""How far off settings beside may be, of the bounds, and by how much their slopes have to differ, relative [-]."""
MOST_PIECES, MOST_MIXTURES, SHARES = 12, 10, 1e-7
"""Sides that are mixed at most, rounds in which another one is mixed in, and how well its share is found [-]."""


class Here(NamedTuple):
    """Where the iteration is."""

    subproblem: Subproblem
    setting: FloatArray
    linear: tuple[FloatArray, FloatArray]
    """Values and slopes of the figures."""
    penalty: float
    tolerance: float

    def foretold(self, slopes: FloatArray) -> Answer:
        """Return the answer of the convex problem with other slopes, unit curvature and no trust region."""
        p = self.setting.size
        return self.subproblem.ask(self.setting, (self.linear[0], slopes), np.eye(p), 1.0, self.penalty)


def mixed_slopes(here: Here, beside: Sequence[tuple[FloatArray, list[BlockFigures]]]) -> FloatArray | None:
    """Return the weighted mean of slopes here and beside; None where there are no others beside."""
    pieces = _pieces(here, beside)
    if len(pieces) == 1:
        return None
    stack, weights = np.array(pieces), np.eye(len(pieces))[0]
    for _ in range(MOST_MIXTURES):
        answer = here.foretold(np.tensordot(weights, stack, 1))
        worth = np.array([answer.figure_duals @ (one @ answer.step) for one in pieces])
        if np.max(np.abs(answer.step)) <= 0.1 * here.tolerance or np.max(worth) - weights @ worth <= 1e-18:
            break
        weights = _between(here, stack, weights, np.eye(len(pieces))[int(np.argmax(worth))])
    return np.asarray(np.tensordot(weights, stack, 1), dtype=np.float64)


def _pieces(here: Here, beside: Sequence[tuple[FloatArray, list[BlockFigures]]]) -> list[FloatArray]:
    """Return slopes here, and those beside that differ from them while the values go on without a jump."""
    present, pieces = here.linear[0], [here.linear[1]]
    for setting, figures in reversed(beside):
        distance = float(np.max(np.abs(setting - here.setting)))
        if not 0 < distance <= BESIDE or len(pieces) == MOST_PIECES:
            continue
        try:
            values, slopes = stacked(figures, here.setting.size)
        except (LtvpneuError, ValueError):
            continue
        size = max(float(np.max(np.abs(one), initial=0.0)) for one in (*pieces, slopes))
        jumps = float(np.max(np.abs(values - present), initial=0.0)) > 10 * size * distance
        if not jumps and all(np.max(np.abs(slopes - one), initial=0.0) > DISTINCT * size for one in pieces):
            pieces.append(slopes)
    return pieces


def _between(here: Here, stack: FloatArray, weights: FloatArray, other: FloatArray) -> FloatArray:
    """Return the weights between two, from which neither way foretells less."""
    change = np.tensordot(other - weights, stack, 1)

    @cache
    def fall(share: float) -> float:
        answer = here.foretold(np.tensordot((1 - share) * weights + share * other, stack, 1))
        return float(answer.figure_duals @ (change @ answer.step))

    if fall(1.0) >= 0:
        return other
    share = cast(float, brentq(fall, 0.0, 1.0, xtol=SHARES)) if fall(0.0) > 0 else 0.0
    return (1 - share) * weights + share * other
