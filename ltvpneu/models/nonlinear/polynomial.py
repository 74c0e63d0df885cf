"""A trajectory as the integrator's interpolant: on each interval a polynomial of fourth degree in time."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from scipy.interpolate import PPoly

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled
from ltvpneu._values import Value
from ltvpneu.models.nonlinear.integrator import Record


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class PolynomialTrajectory(Value):
    """One period of a solution as the integrator's interpolant: a polynomial on each of its intervals."""

    starts: FloatArray
    """Starts of the intervals [s], shape (n_intervals,)."""
    spans: FloatArray
    """Their lengths [s]."""
    coefficients: FloatArray
    """Ascending powers of the time since the start, shape (n_intervals, 5, n_states)."""

    @cached_property
    def _polynomial(self) -> PPoly:
        # PPoly wants the highest power first and (power, interval, state).
        edges = np.append(self.starts, self.starts[-1] + self.spans[-1])
        return PPoly(np.moveaxis(self.coefficients[:, ::-1], 1, 0), edges, extrapolate=True)

    def at(self, times: FloatArray) -> FloatArray:
        """Return the states at times within the period [s], shape (n_states, n_times)."""
        values: FloatArray = self._polynomial(times)
        return values.T

    def means(self) -> FloatArray:
        """Return the time means, shape (n_states,)."""
        powers = np.arange(1, 6)
        integrals = self.spans[:, None] ** powers / powers
        return np.einsum("ij,ijk->k", integrals, self.coefficients) / np.sum(self.spans)

    def extremes(self, signal: int) -> tuple[float, float]:
        """Return the least and the greatest value of a state: at interval ends or where the derivative vanishes."""
        return polynomial_extremes(self.coefficients[:, :, signal].copy(), self.spans)


def trajectory_of(record: Record) -> PolynomialTrajectory:
    """Return what a record holds as a trajectory."""
    return PolynomialTrajectory(starts=record.starts, spans=record.spans, coefficients=record.coefficients)


@compiled
def polynomial_extremes(coefficients: FloatArray, spans: FloatArray) -> tuple[float, float]:
    """Return the least and the greatest value of a piecewise quartic.

    On each interval they lie at an end or at a root of the derivative, a cubic. Between the cubic's own extremes, roots
    of a parabola, it is monotone, so a change of sign brackets each root.

    Parameters
    ----------
    coefficients : ndarray, shape (n_intervals, 5)
        Ascending powers of the time since the start of the interval.
    spans : ndarray, shape (n_intervals,)
    """
    low, high = math.inf, -math.inf
    cuts = np.empty(4)
    for i in range(spans.size):
        c, span = coefficients[i], spans[i]
        cuts[0], cuts[3] = 0.0, span
        # Second derivative 2 c2 + 6 c3 t + 12 c4 t^2; its roots outside the interval cut nothing off.
        discriminant = 9.0 * c[3] * c[3] - 24.0 * c[2] * c[4]
        root = math.sqrt(max(discriminant, 0.0))
        larger = -(3.0 * c[3] + math.copysign(root, c[3]))
        first = larger / (12.0 * c[4]) if c[4] != 0.0 else span
        second = 2.0 * c[2] / larger if larger != 0.0 else span
        cuts[1] = min(max(min(first, second), 0.0), span)
        cuts[2] = min(max(max(first, second), 0.0), span)
        for time in (0.0, span):
            value = _quartic(c, time)
            low, high = min(low, value), max(high, value)
        for j in range(3):
            if _quartic_slope(c, cuts[j]) * _quartic_slope(c, cuts[j + 1]) < 0.0:
                value = _quartic(c, _slope_root(c, cuts[j], cuts[j + 1]))
                low, high = min(low, value), max(high, value)
    return low, high


@compiled
def _quartic(c: FloatArray, t: float) -> float:
    return c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))


@compiled
def _quartic_slope(c: FloatArray, t: float) -> float:
    return c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))


@compiled
def _slope_root(c: FloatArray, begin: float, end: float) -> float:
    rising = _quartic_slope(c, end) > 0.0
    for _ in range(60):
        middle = 0.5 * (begin + end)
        if (_quartic_slope(c, middle) > 0.0) == rising:
            end = middle
        else:
            begin = middle
    return 0.5 * (begin + end)
