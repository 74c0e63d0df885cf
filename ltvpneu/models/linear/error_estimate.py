"""How far a linear model's amplitude, mean and extremes are from the nonlinear machine's, and whether it has the cycle.

The machine is followed from the cycle's own state to the orbit there: a few periods, which take about as long as a
model of two steps does. They confirm the cycle or refute it.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.method import DormandPrince
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.period_map import PeriodMap
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.signals import signal_index

MOST_PERIODS = 500
"""Valve periods in which the machine has to settle."""
MOVES = 1e-4
"""Scaled travel from which on a piston moves [-]."""
LOOSE, LOOSE_TOLERANCE = DormandPrince(rtol=1e-5), 1e-3
"""How other starts are followed: all that is asked is whether they lead elsewhere."""
SAME = 3e-3
"""Scaled distance within which two orbits are one [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ErrorEstimate(Value):
    """Errors of a linear model's cycle: the model's value less that of the machine beside it, each (n_states,).

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
    """Whether the machine has this cycle: it settles near it, after as many valve periods, moving or at rest as it
    does. If not, the figures are those of the machine's turn from the cycle's state."""
    verdict: str
    """What the machine does from the cycle's state: why it is reliable or not, and what else there is."""

    def __repr__(self) -> str:
        errs = f"{self.amplitude(0):+.3g} of {self.orbit.amplitude(0):.6g}"
        return f"<ErrorEstimate of {self.orbit.name}: {errs}, {self.verdict}>"

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
        """Return the error of the amplitude over the machine's [-]; infinite if that is zero."""
        error = self.amplitude(state)
        true = self.orbit.amplitude(state) - error
        return error / true if true > 0 else float("inf")


def error_estimate(machine: Machine, frequency: float, orbit: Orbit) -> ErrorEstimate:
    """Return the errors of a linear model's cycle beside the machine's own orbit there."""
    start, scales = _inside(machine, orbit.initial_state), machine.state_scales
    try:
        found = nonlinear_orbit(machine, frequency, start, max_periods=MOST_PERIODS)
    except LtvpneuError as error:
        return _of_one_turn(machine, frequency, orbit, start, error)
    if not found.is_isolated:
        found = _as_from_rest(machine, frequency, found)
    n = len(machine.states)
    reached = np.array([[found.minimum(i), found.maximum(i), found.mean(i)] for i in range(n)])
    refuted = _refuted(orbit, found, float(scales[0]))
    verdict = f"refuted: {refuted}" if refuted else _confirmed(machine, frequency, found)
    return _estimate(orbit, reached, not refuted, verdict)


def _refuted(orbit: Orbit, found: Orbit, length: float) -> str:
    """Return why the machine's orbit is no counterpart of a model's cycle; nothing if it is one."""
    if orbit.n_periods != found.n_periods:
        return f"the model repeats after {orbit.n_periods} valve periods, the machine after {found.n_periods}"
    moves = [2 * one.amplitude(0) > MOVES * length for one in (orbit, found)]
    if moves[0] and not moves[1]:
        return f"the piston moves in the model, in the machine it comes to rest ({found.rest or 'as good as at rest'})"
    if moves[1] and not moves[0]:
        return "the piston rests in the model, in the machine it moves"
    return ""


def _confirmed(machine: Machine, frequency: float, found: Orbit) -> str:
    """Return what is to be said of a cycle that the machine has: what else it has."""
    band = "" if found.is_isolated else f", one of a band: {found.rest} at {1e3 * found.mean(0):.4g} mm"
    scales = machine.state_scales
    for place, start in _other_starts(machine):
        try:
            other = nonlinear_orbit(
                machine, frequency, start, method=LOOSE, max_periods=MOST_PERIODS, tolerance=LOOSE_TOLERANCE
            )
        except LtvpneuError:
            return f"confirmed{band}, but {place} the machine does not settle soon"
        if band and not other.is_isolated:
            # Another place of the band, as far as is known.
            continue
        apart = np.min(np.max(np.abs(found.branches - other.initial_state) / scales, axis=1))
        if not other.is_isolated or other.n_periods != found.n_periods or apart > SAME:
            reached = other.rest or f"an amplitude of {1e3 * other.amplitude(0):.4g} mm"
            where = f"{reached} at {1e3 * other.mean(0):.4g} mm"
            return f"confirmed{band}, one of several: {place} the machine settles on {where}"
    return f"confirmed{band}"


def _other_starts(machine: Machine) -> list[tuple[str, FloatArray]]:
    """Return where else to look for orbits: at rest, and at rest on the stops."""
    rest, found = np.array(machine.rest_state), list[tuple[str, FloatArray]]()
    if machine.has_dry_friction or machine.has_stops:
        found.append(("from rest", rest))
    for stop in (machine.cylinder.lower_stop, machine.cylinder.upper_stop):
        if math.isfinite(stop) and machine.load.spring_stiffness == 0.0:
            found.append((f"from its stop at {1e3 * stop:g} mm", np.array([stop, *rest[1:]])))
    return found


def _as_from_rest(machine: Machine, frequency: float, found: Orbit) -> Orbit:
    """Return the place of a band that the machine comes to from rest, as models are marched; else the one given."""
    try:
        other = nonlinear_orbit(machine, frequency, max_periods=MOST_PERIODS)
    except LtvpneuError:
        return found
    return found if other.is_isolated else other


def _of_one_turn(
    machine: Machine, frequency: float, orbit: Orbit, start: FloatArray, error: LtvpneuError
) -> ErrorEstimate:
    """Return the errors beside one turn of a machine that settles nowhere from there."""
    n, reached = len(machine.states), np.full((len(machine.states), 3), math.nan)
    try:
        turn = PeriodMap(machine=machine, frequency=frequency, n_periods=orbit.n_periods).turn(start)
    except LtvpneuError:
        return _estimate(orbit, reached, False, f"refuted: {error}")
    extremes = [turn.trajectory.extremes(i) for i in range(n)]
    reached = np.column_stack([np.array(extremes), turn.trajectory.means()])
    return _estimate(orbit, reached, False, f"refuted: {error}")


def _estimate(orbit: Orbit, reached: FloatArray, is_reliable: bool, verdict: str) -> ErrorEstimate:
    n = len(reached)
    own = np.array([[orbit.minimum(i), orbit.maximum(i), orbit.mean(i)] for i in range(n)])
    errors = own - reached
    return ErrorEstimate(
        states=orbit.states,
        orbit=orbit,
        minima=read_only(errors[:, 0].copy()),
        maxima=read_only(errors[:, 1].copy()),
        means=read_only(errors[:, 2].copy()),
        is_reliable=is_reliable,
        verdict=verdict,
    )


def _inside(machine: Machine, state: FloatArray) -> FloatArray:
    """Return a state where the machine's equations hold: between the stops, at pressures and volumes above zero."""
    held, cylinder, count = np.array(state), machine.cylinder, machine.n_volumes
    held[0] = min(max(held[0], cylinder.lower_stop), cylinder.upper_stop)
    for V, A, *_ in machine.volume_fields[: len(cylinder.chambers)]:
        edge = -0.9 * V / A if A else math.inf
        held[0] = max(held[0], edge) if A > 0 else min(held[0], edge)
    lowest = 0.5 * min(machine.exhaust_pressure, machine.supply_pressure)
    held[2 : 2 + count] = np.clip(held[2 : 2 + count], lowest, 4.0 * machine.supply_pressure)
    held[2 + count :] = np.clip(held[2 + count :], 0.3 * machine.gas.temperature, 3.0 * machine.gas.temperature)
    return held
