"""How far off a linear model is over frequency and duty: each cycle beside the machine's own orbit there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, read_only
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.orbit_map import grid_of
from ltvpneu.models.linear.ltv import ltv_model
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.linear.staircase import default_steps
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.nonlinear.failed_point import FailedPoint


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class ValidityMap(Value):
    """Errors of a linear model over frequency (rows) and duty (columns); nan where it was not found."""

    machine: Machine
    frequencies: FloatArray
    """[Hz]"""
    duties: FloatArray
    mode: str
    n_steps: int
    amplitudes: FloatArray
    """The model's amplitudes of the position [m]."""
    errors: FloatArray
    """Their errors over the machine's amplitudes [-]; infinite where stiction holds the piston."""
    failures: tuple[FailedPoint, ...]


def validity_map(
    machine: Machine,
    duties: ArrayLike,
    frequencies: ArrayLike,
    *,
    n_steps: int | None = None,
    operating_points: OperatingPoints = "fitted",
    progress: Callable[[int], object] | None = None,
) -> ValidityMap:
    """Return how far a linear model is off in amplitude, over duty and frequency, by its `error_estimate`.

    Parameters are those of `orbit_map` and `ltv_model`.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.validity_map(lp.load_machine("kunt_singh_1990"), [0.5], [4.0, 15.0], operating_points="lti")
    >>> found.errors.round(1).tolist()
    [[0.1], [0.6]]
    """
    expect_machine(machine)
    duty_grid, frequency_grid = grid_of(duties, frequencies)
    n_steps = default_steps(machine.at(float(frequency_grid[0]))) if n_steps is None else n_steps
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
            failures.append(FailedPoint(model="ltv", frequency=frequency, duty=present.duty, error=error))
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
