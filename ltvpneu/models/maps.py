"""Maps over frequency and duty: what kind of orbit the nonlinear machine has, and how far off a linear model is.

A machine with stiction has regions without a unique orbit: bands, where it rests anywhere within an interval;
subharmonics; and between these, points where the state never repeats. Those are told apart from slow ones by their
Lyapunov exponent, the mean logarithm by which two neighbours draw apart in a valve period: above zero it is chaos.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, read_only
from ltvpneu.errors import LtvpneuError, NotSettledError
from ltvpneu.models.amplitude import FailedPoint
from ltvpneu.models.integrator import OK, integrate_period
from ltvpneu.models.ltv import OperatingPoints, ltv_model
from ltvpneu.models.machine import Machine
from ltvpneu.models.nonlinear import integration_settings, nonlinear_orbit, schedule_of
from ltvpneu.models.runge_kutta import Run
from ltvpneu.models.staircase import default_steps
from ltvpneu.physics.valve import check_duty

KINDS = ("unique", "band", "subharmonic", "chaotic", "failed")
CHAOS_PERIODS = 1000
NEIGHBOUR = 1e-6
"""Scaled distance at which neighbours are set [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class OrbitMap:
    """Kinds of orbits over frequency (rows) and duty (columns), each array (n_frequencies, n_duties)."""

    machine: Machine
    frequencies: FloatArray
    """[Hz]"""
    duties: FloatArray
    kinds: tuple[tuple[str, ...], ...]
    """Of `KINDS`."""
    n_periods: FloatArray
    """Valve periods after which the orbit repeats; nan where it does not."""
    amplitudes: FloatArray
    """Of the position [m]; nan likewise."""
    means: FloatArray
    n_simulated: FloatArray
    """Valve periods simulated to find it."""
    lyapunov_exponents: FloatArray
    """Per valve period [-], where the state never repeats; else nan."""
    failures: tuple[FailedPoint, ...]

    def count(self, kind: str) -> int:
        """Return at how many points the orbit is of a kind."""
        if kind not in KINDS:
            raise ValueError(f"kind: found {kind!r}, expected one of {', '.join(KINDS)}")
        return sum(row.count(kind) for row in self.kinds)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ValidityMap:
    """Estimated errors of a linear model over frequency (rows) and duty (columns); nan where it was not found."""

    machine: Machine
    frequencies: FloatArray
    """[Hz]"""
    duties: FloatArray
    mode: str
    n_steps: int
    amplitudes: FloatArray
    """The model's amplitudes of the position [m]."""
    errors: FloatArray
    """Their estimated errors over the true amplitudes [-]; infinite where stiction is estimated to hold the piston."""
    failures: tuple[FailedPoint, ...]


def orbit_map(
    machine: Machine, duties: ArrayLike, frequencies: ArrayLike, *, progress: Callable[[int], object] | None = None
) -> OrbitMap:
    """Return what kind of orbit the nonlinear machine settles on from rest, over duty and frequency.

    Parameters
    ----------
    machine : Machine
    duties : array_like, shape (n_duties,)
        Between 0 and 1.
    frequencies : array_like, shape (n_frequencies,)
        [Hz], above zero.
    progress : callable, optional
        Called with 1 after each point, such as the `update` of a tqdm bar.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.orbit_map(lp.load_machine("kunt_singh_1990"), [0.5, 0.7, 0.86], [5.4, 20.0])
    >>> found.kinds
    (('unique', 'unique', 'subharmonic'), ('unique', 'band', 'band'))
    """
    duty_grid, frequency_grid = grid_of(duties, frequencies)
    shape = (frequency_grid.size, duty_grid.size)
    names = ("n_periods", "amplitudes", "means", "n_simulated", "lyapunov_exponents")
    arrays = {name: np.full(shape, np.nan) for name in names}
    kinds, failures = [["failed"] * shape[1] for _ in range(shape[0])], []
    for row, column in np.ndindex(shape):
        present, frequency = machine.with_duty(float(duty_grid[column])), float(frequency_grid[row])
        try:
            orbit = nonlinear_orbit(present, frequency)
        except NotSettledError as error:
            exponent = _lyapunov_exponent(present, frequency, np.asarray(error.last_state))
            arrays["lyapunov_exponents"][row, column] = exponent
            arrays["n_simulated"][row, column] = error.n_simulated
            kinds[row][column] = "chaotic" if exponent > 0 else "failed"
            failures.append(FailedPoint(model="nonlinear", frequency=frequency, error=error))
        except LtvpneuError as error:
            failures.append(FailedPoint(model="nonlinear", frequency=frequency, error=error))
        else:
            kinds[row][column] = "band" if not orbit.is_unique else "subharmonic" if orbit.n_periods > 1 else "unique"
            arrays["n_periods"][row, column] = orbit.n_periods
            arrays["amplitudes"][row, column] = orbit.amplitude("position")
            arrays["means"][row, column] = orbit.mean("position")
            arrays["n_simulated"][row, column] = orbit.n_simulated
        if progress is not None:
            progress(1)
    return OrbitMap(
        machine=machine,
        frequencies=frequency_grid,
        duties=duty_grid,
        kinds=tuple(tuple(line) for line in kinds),
        failures=tuple(failures),
        **{name: read_only(values) for name, values in arrays.items()},
    )


def validity_map(
    machine: Machine,
    duties: ArrayLike,
    frequencies: ArrayLike,
    *,
    n_steps: int | None = None,
    operating_points: OperatingPoints = "fitted",
    progress: Callable[[int], object] | None = None,
) -> ValidityMap:
    """Return how far a linear model is estimated to be off in amplitude, over duty and frequency.

    Parameters are those of `orbit_map` and `ltv_model`. The nonlinear model is not simulated.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.validity_map(lp.load_machine("kunt_singh_1990"), [0.5], [4.0, 15.0], operating_points="lti")
    >>> found.errors.round(1).tolist()
    [[0.1], [0.6]]
    """
    duty_grid, frequency_grid = grid_of(duties, frequencies)
    n_steps = default_steps(machine) if n_steps is None else n_steps
    shape = (frequency_grid.size, duty_grid.size)
    amplitudes, errors = np.full(shape, np.nan), np.full(shape, np.nan)
    failures: list[FailedPoint] = []
    for row, column in np.ndindex(shape):
        present, frequency = machine.with_duty(float(duty_grid[column])), float(frequency_grid[row])
        try:
            model = ltv_model(present, frequency, n_steps=n_steps, operating_points=operating_points)
            amplitudes[row, column] = model.orbit.amplitude("position")
            errors[row, column] = model.error_estimate.relative_amplitude("position")
        except (LtvpneuError, ValueError) as error:
            failures.append(FailedPoint(model="ltv", frequency=frequency, error=error))
        if progress is not None:
            progress(1)
    return ValidityMap(
        machine=machine,
        frequencies=frequency_grid,
        duties=duty_grid,
        mode=operating_points,
        n_steps=n_steps,
        amplitudes=read_only(amplitudes),
        errors=read_only(errors),
        failures=tuple(failures),
    )


def grid_of(duties: ArrayLike, frequencies: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return duties and frequencies as arrays, checked."""
    duty_grid = finite_array("duties", duties, (None,))
    for i, duty in enumerate(duty_grid):
        check_duty(float(duty), f"duties[{i}]")
    frequency_grid = finite_array("frequencies", frequencies, (None,))
    for name, grid in (("duties", duty_grid), ("frequencies", frequency_grid)):
        if grid.size == 0:
            raise ValueError(f"{name}: found none, expected one or more")
    if (frequency_grid <= 0).any():
        raise ValueError(f"frequencies: found {frequency_grid.min():g} Hz, expected numbers above zero")
    return duty_grid, frequency_grid


def _lyapunov_exponent(machine: Machine, frequency: float, state: FloatArray) -> float:
    """Return the mean logarithm by which a neighbour draws away in a valve period, set near again after each."""
    run = Run(schedule_of(machine, 1 / frequency), machine.arrays, integration_settings(machine, 1e-11))
    scales = machine.state_scales
    apart = np.zeros(scales.size)
    apart[0] = NEIGHBOUR
    total, counted = 0.0, 0
    for _ in range(CHAOS_PERIODS):
        one, other = integrate_period(state, run, False), integrate_period(state + apart * scales, run, False)
        if one.status != OK or other.status != OK:
            break
        difference = (other.state - one.state) / scales
        size = float(np.linalg.norm(difference))
        if size == 0:
            # Both stuck at the same place: nothing draws apart faster than that it comes together.
            return -math.inf
        total += math.log(size / NEIGHBOUR)
        counted += 1
        apart, state = difference * (NEIGHBOUR / size), one.state
    return total / counted if counted else math.nan
