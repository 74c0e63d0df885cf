"""Figures of a machine's cycle, and their derivatives over anything that a designer sets.

Means, extremes, samples and the mass flow from the supply; of refitted linear models (`linear_figures`) or of the
nonlinear one (`nonlinear_figures`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.machine.machine import Machine

FigureKind = Literal["mean", "minimum", "maximum", "at", "air_use", "end", "impact"]
"""The last two are those of moves."""
WHOLE = -1
"""Instead of a piece's number: all of them."""


class Figure(NamedTuple):
    """One number of a cycle."""

    kind: FigureKind
    """Of a state's mean, extremes, or value at an angle; or the mean mass flow from the supply [kg/s]."""
    state: int = 0
    angle: float = 0.0
    """For "at" [rad], 0 to 2 pi."""
    piece: int = WHOLE
    """For extremes: within this piece of the openings. Where those of two pieces draw level the whole turn's has a
    kink, while each piece's own goes on smoothly."""


class Slopes(NamedTuple):
    """Derivatives of figures."""

    jacobian: FloatArray
    """(n_figures, n_parameters)"""
    map_: FloatArray
    """Derivative of the scaled state after the cycle's own period over that at its start, (n, n)."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class CycleFigures(Value):
    """A cycle's figures at one setting of the parameters; the derivatives are worked out when first asked for."""

    machine: Machine
    frequency: float
    """[Hz]"""
    values: FloatArray
    """(n_figures,)"""
    initial_state: FloatArray
    """(n,)"""
    n_periods: int
    """Valve periods after which it repeats."""
    differentiate: Callable[[], Slopes]
    find_model: Callable[[], LtvModel] | None = None
    """Of a linear model, what returns it."""

    @cached_property
    def slopes(self) -> Slopes:
        """Derivatives of all figures, and the cycle's stability."""
        return self.differentiate()

    @property
    def jacobian(self) -> FloatArray:
        """Derivatives over the parameters, (n_figures, n_parameters).

        Raises
        ------
        NotConvergedError
            A march next to the cycle did not come through.
        """
        return self.slopes.jacobian

    @property
    def spectral_radius(self) -> float:
        """Of the derivative of the map over the cycle's own period: below one, small deviations die out."""
        return float(np.max(np.abs(np.linalg.eigvals(self.slopes.map_))))

    @property
    def is_differentiated(self) -> bool:
        """Whether the derivatives have been worked out."""
        return "slopes" in self.__dict__
