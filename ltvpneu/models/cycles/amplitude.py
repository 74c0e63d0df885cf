"""Amplitude over frequency, eq. (18), of all three models."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.linear.lti import lti_model
from ltvpneu.models.linear.ltv import ltv_model
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.periodic.orbits.orbit import Orbit

Model = Literal["nonlinear", "ltv", "lti"]


MODELS: tuple[Model, ...] = ("nonlinear", "ltv", "lti")


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class AmplitudeResponse(Value):
    """Amplitude and mean of the position over frequency; nan where a point failed, with the reason in `failures`."""

    machine: Machine
    frequencies: FloatArray
    """[Hz], shape (n_frequencies,)"""
    models: tuple[str, ...]
    amplitudes: FloatArray
    """Half the peak-to-peak [m], shape (n_models, n_frequencies)."""
    means: FloatArray
    """Time means [m], likewise."""
    n_periods: FloatArray
    """Valve periods after which each orbit repeats, likewise."""
    is_isolated: FloatArray
    """1 where the orbit is isolated, 0 in a stiction band, likewise."""
    failures: tuple[FailedPoint, ...]

    def amplitude(self, model: str) -> FloatArray:
        """Return the amplitudes of one model [m], shape (n_frequencies,)."""
        if model not in self.models:
            raise ValueError(f"model: found {model!r}, expected one of {', '.join(self.models)}")
        return self.amplitudes[self.models.index(model)]


def amplitude_response(
    machine: Machine,
    frequencies: ArrayLike,
    models: Sequence[Model] = MODELS,
    *,
    n_steps: int | None = None,
    operating_points: OperatingPoints = "lti",
    progress: Callable[[int], object] | None = None,
) -> AmplitudeResponse:
    """Return the amplitude (18) over a grid of frequencies.

    Parameters
    ----------
    machine : Machine
    frequencies : array_like, shape (n_frequencies,)
        [Hz], all above zero.
    models : sequence of {"nonlinear", "ltv", "lti"}
    n_steps, operating_points
        Of the LTV model.
    progress : callable, optional
        Called with 1 after each frequency, such as the `update` of a tqdm bar.

    Returns
    -------
    AmplitudeResponse
        A point that fails keeps its error as data and the sweep goes on.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.amplitude_response(lp.load_machine("kunt_singh_1990"), [1.0, 4.0], models=["nonlinear"])
    >>> (1e3 * found.amplitude("nonlinear")).round(1).tolist()
    [39.3, 35.3]
    """
    expect_machine(machine)
    grid = finite_array("frequencies", frequencies, (None,))
    if grid.size == 0 or (grid <= 0).any():
        raise ValueError(f"frequencies: found {grid.tolist()}, expected numbers above zero [Hz]")
    for model in models:
        if model not in MODELS:
            raise ValueError(f"models: found {model!r}, expected {', '.join(MODELS)}")
    shape = (len(models), grid.size)
    table = {name: np.full(shape, np.nan) for name in ("amplitudes", "means", "n_periods", "is_isolated")}
    failures: list[FailedPoint] = []
    for column, frequency in enumerate(grid):
        for row, model in enumerate(models):
            try:
                orbit = _orbit(machine, float(frequency), model, n_steps, operating_points)
            except (LtvpneuError, ValueError) as error:
                failures.append(FailedPoint(model=model, frequency=float(frequency), duty=machine.duty, error=error))
                continue
            table["amplitudes"][row, column] = orbit.amplitude("position")
            table["means"][row, column] = orbit.mean("position")
            table["n_periods"][row, column] = orbit.n_periods
            table["is_isolated"][row, column] = orbit.is_isolated
        if progress is not None:
            progress(1)
    return AmplitudeResponse(
        machine=machine,
        frequencies=grid,
        models=tuple(models),
        failures=tuple(failures),
        **{name: read_only(values) for name, values in table.items()},
    )


def _orbit(
    machine: Machine, frequency: float, model: Model, n_steps: int | None, operating_points: OperatingPoints
) -> Orbit:
    if model == "nonlinear":
        return nonlinear_orbit(machine, frequency)
    if model == "lti":
        return lti_model(machine, frequency).orbit
    return ltv_model(machine, frequency, n_steps=n_steps, operating_points=operating_points).orbit
