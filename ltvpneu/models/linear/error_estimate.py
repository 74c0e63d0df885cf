"""How far a linear model's amplitude, mean and extremes are from the nonlinear machine's, without simulating that."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.models.linear.defect import Given, corrected
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import step_means
from ltvpneu.periodic.orbit import Orbit, signal_index
from ltvpneu.physics.liquid import Liquid

CELLS = 256
"""Cells of the fine staircase on which the defect is taken, in each valve period."""
MOST_CORRECTIONS = 4
MOST_PRESSURE = 4.0
"""Highest pressure of a liquid that operating points are kept at, over that of the supply [-]."""
LEAST_TEMPERATURE, MOST_TEMPERATURE = 0.3, 3.0
"""Range that temperatures of operating points are kept in, over that of the surroundings [-]."""
HELD = 0.05
"""How far from the cycle its operating points may be held for an estimate, in the time mean, over the states' scales
[-]."""
SETTLED, NEGLIGIBLE = 0.2, 2e-3
"""The defect is taken again, of the sum, until that moves the estimate by less than this share of it, or less than this
share of the amplitude."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ErrorEstimate(Value):
    """Estimated errors of a linear model's cycle: the model's value less the nonlinear machine's, each (n_states,).

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> estimate = lp.ltv_model(machine, frequency=15.0).error_estimate
    >>> print(f"{100 * estimate.relative_amplitude('position'):.0f} %")
    63 %
    """

    states: tuple[str, ...]
    orbit: Orbit
    minima: FloatArray
    maxima: FloatArray
    means: FloatArray
    is_reliable: bool
    """Whether the corrected cycle was found to repeat, where the nonlinear equations hold; if not, the figures are only
    a first guess."""

    def __repr__(self) -> str:
        return f"<ErrorEstimate of {self.orbit.name}: {self.amplitude(0):+.3g} of {self.orbit.amplitude(0):.6g}>"

    def amplitude(self, state: str | int) -> float:
        """Return the error of half the peak-to-peak, in the state's unit."""
        i = signal_index(self.states, state)
        return float(self.maxima[i] - self.minima[i]) / 2

    def mean(self, state: str | int) -> float:
        """Return the error of the time mean, in the state's unit."""
        return float(self.means[signal_index(self.states, state)])

    def minimum(self, state: str | int) -> float:
        """Return the error of the least value, in the state's unit."""
        return float(self.minima[signal_index(self.states, state)])

    def maximum(self, state: str | int) -> float:
        """Return the error of the greatest value, in the state's unit."""
        return float(self.maxima[signal_index(self.states, state)])

    def relative_amplitude(self, state: str | int) -> float:
        """Return the error of the amplitude over the estimated true amplitude [-]; infinite if that is zero."""
        error = self.amplitude(state)
        true = self.orbit.amplitude(state) - error
        return error / true if true > 0 else float("inf")


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class _Corrector(Value):
    machine: Machine
    frequency: float
    orbit: Orbit
    distance: float

    @cached_property
    def cells(self) -> FloatArray:
        """Cell boundaries over all the orbit's valve periods, as shares of one."""
        orbit, table = self.orbit, self.machine.openings
        own = orbit.step_times * self.frequency
        switches = np.concatenate([number + table.fractions[:-1] for number in range(orbit.n_periods)])
        bounds = np.union1d(own, switches)
        # The same instant twice, but for rounding, is no cell.
        bounds = bounds[np.append(np.diff(bounds) > 1e-9, True)]
        count = math.ceil(CELLS * orbit.n_periods / (bounds.size - 1))
        # Denser at the starts of steps, where what switched has its effect.
        shares = (np.arange(count) / count) ** 2 if count > 1 else np.zeros(1)
        return np.append((bounds[:-1, None] + np.diff(bounds)[:, None] * shares).ravel(), bounds[-1])

    def given(self, points: FloatArray) -> Given:
        machine, cells = self.machine, self.cells
        once = np.mod((cells[:-1] + cells[1:]) / 2, 1.0)
        areas = np.empty((once.size, 2, len(machine.ends)))
        for number in range(self.orbit.n_periods):
            mine = (cells[:-1] >= number - 1e-12) & (cells[:-1] < number + 1 - 1e-12)
            ends = np.clip(np.append(cells[:-1][mine], number + 1.0) - number, 0.0, 1.0)
            areas[mine] = step_means(machine.openings, np.array(ends))
        return Given(
            times=cells / self.frequency,
            points=points,
            areas=areas,
            scales=np.array(machine.state_scales),
            distance=float(self.distance),
        )

    def points(self, orbit: Orbit) -> FloatArray:
        """Means of the cycle over the cells by Simpson's rule, kept where the equations hold, (n_cells, n)."""
        n = len(self.machine.states)
        times = self.cells / self.frequency
        widths = np.diff(times)
        # Just inside the cells: outputs may jump at boundaries, states do not.
        values = [orbit.trajectory.at(times[:-1] + share * widths)[:n].T for share in (0.0, 0.5, 1.0 - 1e-12)]
        return self.inside((values[0] + 4 * values[1] + values[2]) / 6)

    def holds(self, points: FloatArray) -> bool:
        """Return whether the equations hold at points (n_cells, n), to within what the estimate is right to."""
        widths = np.diff(self.cells)
        held = widths / widths.sum() @ np.abs(self.inside(points) - points)
        return bool((held <= HELD * self.machine.state_scales).all())

    def inside(self, points: FloatArray) -> FloatArray:
        """Return operating points kept between the sources' pressures, and where volumes are well above zero."""
        machine = self.machine
        held = points.copy()
        count = 2 + machine.n_volumes
        lowest, highest = 0.95 * machine.exhaust_pressure, 1.05 * machine.supply_pressure
        if isinstance(machine.gas, Liquid):
            # A moving mass drives a liquid far past its sources' pressures.
            lowest, highest = 2 * machine.gas.vapor_pressure, MOST_PRESSURE * machine.supply_pressure
        held[:, 2:count] = np.clip(held[:, 2:count], lowest, highest)
        temperature = machine.gas.temperature
        held[:, count:] = np.clip(held[:, count:], LEAST_TEMPERATURE * temperature, MOST_TEMPERATURE * temperature)
        for V, A, *_ in machine.volume_fields[: len(machine.cylinder.chambers)]:
            edge = -0.9 * V / A
            held[:, 0] = np.maximum(held[:, 0], edge) if A > 0 else np.minimum(held[:, 0], edge)
        return held


def error_estimate(machine: Machine, frequency: float, orbit: Orbit, distance: float) -> ErrorEstimate:
    """Return the estimated errors of a linear model's cycle, from its defect in the nonlinear equations.

    `distance` is as of `ltv_model`; `orbit` the cycle.
    """
    n, scales = len(machine.states), machine.state_scales
    corrector = _Corrector(machine=machine, frequency=frequency, orbit=orbit, distance=distance)
    start = np.append(orbit.initial_state / scales, 1.0)
    points = corrector.points(orbit)
    first = before = np.array([orbit.amplitude(0), orbit.mean(0)]) / scales[0]
    best, change = corrected(start, corrector.given(points), machine.record, 1e-7, 400)
    is_reliable = best.is_finite and change < 1e-4
    for _ in range(MOST_CORRECTIONS - 1):
        after = np.array([(best.highs[0] - best.lows[0]) / 2, best.sums[0] / orbit.period])
        moved, error = np.abs(after - before).max(), np.abs(after - first).max()
        if not is_reliable or moved < max(SETTLED * error, NEGLIGIBLE * after[0]):
            break
        before, start, points = after, best.state, corrector.inside(best.means)
        following, change = corrected(start, corrector.given(points), machine.record, 1e-7, 400)
        is_reliable = following.is_finite and change < 1e-4
        best = following if is_reliable else best
    # Held inside at the end, the points are not those of the cycle found, and its error is another.
    is_reliable = is_reliable and corrector.holds(best.means)
    own = np.array([[orbit.minimum(i), orbit.maximum(i), orbit.mean(i)] for i in range(n)])
    found = np.array([best.lows, best.highs, best.sums / orbit.period]).T * scales[:, None]
    errors = own - found
    return ErrorEstimate(
        states=machine.states,
        orbit=orbit,
        minima=read_only(errors[:, 0]),
        maxima=read_only(errors[:, 1]),
        means=read_only(errors[:, 2]),
        is_reliable=bool(is_reliable),
    )
