"""Figures of the nonlinear machine's cycle and their derivatives: the counterpart of `LinearCycles`.

By central differences of one turn, integrated at a tolerance of 1e-10, and the implicit function theorem for the
cycle's start. Slower than the linear model's, and the judge of it.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.errors import LtvpneuError, NonUniqueOrbitError
from ltvpneu.models.cycles.figures import CycleFigures, Figure, Slopes
from ltvpneu.models.cycles.turns import TOLERANCE, nonlinear_turn, slopes_along_turn
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import with_values
from ltvpneu.models.nonlinear.integrator import Record
from ltvpneu.models.nonlinear.mass_drawn import mass_drawn
from ltvpneu.models.nonlinear.method import DormandPrince
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory, polynomial_extremes, trajectory_of
from ltvpneu.periodic.orbits.orbit import Orbit

ORBIT_TOLERANCE = 1e-7
"""Scaled distance from the orbit at which a cycle counts as found, at the tightest [-]."""


@final
class NonlinearCycles:
    """Cycles of the nonlinear machine, one per setting of its parameters.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Where it is no parameter [Hz].
    change : callable, optional
        What is made of the machine once its parameters are set: a scenario.
    rtol : float
        Of the integrations; derivatives ask for the default.
    max_periods : int
        Valve periods simulated for a cycle.
    """

    def __init__(
        self,
        machine: Machine,
        frequency: float,
        change: Callable[[Machine], Machine] | None = None,
        rtol: float = TOLERANCE,
        max_periods: int = 5000,
    ) -> None:
        self.machine, self.frequency, self._change = machine.at(frequency), frequency, change
        self.rtol, self.max_periods = rtol, max_periods
        self._start: FloatArray | None = None

    def _changed(self, machine: Machine) -> Machine:
        return machine if self._change is None else self._change(machine)

    def orbit(self, values: Mapping[str, float]) -> Orbit:
        """Return the cycle at a setting of the parameters; errors as of `nonlinear_orbit`."""
        return self._orbit_of(self._changed(with_values(self.machine, values)), self._frequency_of(values))

    def _frequency_of(self, values: Mapping[str, float]) -> float:
        return float(values.get("frequency", self.frequency))

    def _orbit_of(self, machine: Machine, frequency: float) -> Orbit:
        find = partial(
            nonlinear_orbit,
            method=DormandPrince(rtol=self.rtol),
            tolerance=max(ORBIT_TOLERANCE, 0.1 * self.rtol),
            max_periods=self.max_periods,
        )
        if self._start is not None:
            try:
                orbit = find(machine, frequency, self._start)
                if orbit.is_isolated:
                    self._start = orbit.initial_state
                    return orbit
            except LtvpneuError:
                pass
        # Where it rests depends on how it came there: then, and after a failure, from the machine's own rest.
        orbit = find(machine, frequency)
        self._start = orbit.initial_state
        return orbit

    def figures(
        self, values: Mapping[str, float], figures: Sequence[Figure], parameters: Sequence[str]
    ) -> CycleFigures:
        """Return a cycle's figures and their derivatives.

        Raises
        ------
        NonUniqueOrbitError
            Stiction holds the piston all the time.
        LtvpneuError
            As of `nonlinear_orbit`.
        """
        plain, frequency = with_values(self.machine, values), self._frequency_of(values)
        machine = self._changed(plain)
        orbit = self._orbit_of(machine, frequency)
        if not orbit.is_isolated:
            free = np.zeros((len(machine.states), 1))
            free[0] = 1.0
            raise NonUniqueOrbitError(
                f"at {frequency:g} Hz and duty {machine.duty:.4g} stiction holds the piston all the time: where it "
                "rests is not decided by the switching (see lp.stiction_band)",
                least_norm=orbit.initial_state,
                free_directions=free,
            )

        def of_machine(start: FloatArray, machine: Machine, frequency: float) -> FloatArray:
            end, record = nonlinear_turn(start, machine, frequency, orbit.n_periods, self.rtol)
            along = trajectory_of(record)
            return np.append(end, [_figure(along, record, machine, frequency, figure) for figure in figures])

        def of_turn(start: FloatArray, plain: Machine, frequency: float) -> FloatArray:
            return of_machine(start, self._changed(plain), frequency)

        start, n = orbit.initial_state.copy(), len(machine.states)

        def differentiate() -> Slopes:
            by_state, by_parameter = slopes_along_turn(of_turn, (plain, frequency, start), parameters)
            scales = machine.state_scales
            maps = by_state[:n] * scales / scales[:, None]
            by_start = scales[:, None] * np.linalg.solve(np.eye(n) - maps, by_parameter[:n] / scales[:, None])
            return Slopes(by_parameter[n:] + by_state[n:] @ by_start, maps)

        return CycleFigures(
            machine=machine,
            frequency=frequency,
            values=of_machine(start, machine, frequency)[n:],
            initial_state=start,
            n_periods=orbit.n_periods,
            differentiate=differentiate,
        )


def _figure(along: PolynomialTrajectory, record: Record, machine: Machine, frequency: float, asked: Figure) -> float:
    kind, state, angle, piece = asked
    if kind == "mean":
        return float(along.means()[state])
    if kind == "at":
        return float(along.at(np.array([angle / (2 * np.pi) / frequency]))[state, 0])
    if kind == "air_use":
        return mass_drawn(record, machine, frequency) / float(np.sum(record.spans))
    n_pieces = machine.openings.fractions.size - 1
    # Where edges have changed their order there may be fewer pieces than there were.
    within = record.pieces % n_pieces == piece if 0 <= piece < n_pieces else slice(None)
    low, high = polynomial_extremes(record.coefficients[within, :, state].copy(), record.spans[within].copy())
    return high if kind == "maximum" else low
