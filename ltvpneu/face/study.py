"""The main job: one machine worked through by its three models.

Figures only; `report` prints them, `pictures` draws them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.amplitude import MODELS, AmplitudeResponse, Model, amplitude_response
from ltvpneu.models.cycles.floquet import cycle_floquet
from ltvpneu.models.linear.error_estimate import ErrorEstimate
from ltvpneu.models.linear.lti import lti_model
from ltvpneu.models.linear.ltv import ltv_model
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.linear.staircase import default_steps
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import Attractors, attractors
from ltvpneu.models.nonlinear.floquet import orbit_floquet
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.stiction_band import StictionBand, stiction_band
from ltvpneu.periodic.orbits.floquet import Floquet
from ltvpneu.periodic.orbits.orbit import Orbit


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Case(Value):
    """One frequency, worked through. What failed is absent from the dicts and stands in `failures`."""

    machine: Machine
    frequency: float
    models: dict[str, LtvModel]
    floquets: dict[str, Floquet]
    orbits: dict[str, Orbit]
    estimates: dict[str, ErrorEstimate]
    """How far off the linear models say they are, without the nonlinear one."""
    bands: dict[str, StictionBand]
    """Where the piston stays at rest, if its orbit is one of a stiction band."""
    attractors: dict[str, Attractors]
    """What the nonlinear machine settles on from other starts."""
    failures: dict[str, str]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Study(Value):
    """Everything that `ltvpneu study` prints and draws."""

    machine: Machine
    n_steps: int
    cases: tuple[Case, ...]
    frictionless: tuple[Case, ...]
    """The same without dry friction, which the linear models neglect; empty where the machine has none."""
    response: AmplitudeResponse
    frictionless_amplitudes: FloatArray
    """Amplitudes of the nonlinear model without dry friction at the frequencies of `response` [m]."""


def run_study(
    machine: Machine,
    frequencies: Sequence[float],
    *,
    n_steps: int | None,
    operating_points: OperatingPoints,
    grid: FloatArray,
    progress: Callable[[int], object],
) -> Study:
    """Work a machine through; `progress` is called with 1 after each of `n_parts` parts."""
    n_steps = default_steps(machine.at(frequencies[0])) if n_steps is None else n_steps

    def cases(present: Machine) -> tuple[Case, ...]:
        found: list[Case] = []
        for frequency in frequencies:
            found.append(run_case(present, frequency, n_steps, operating_points))
            progress(1)
        return tuple(found)

    return Study(
        machine=machine,
        n_steps=n_steps,
        cases=cases(machine),
        frictionless=cases(machine.without_dry_friction()) if machine.has_dry_friction else (),
        response=amplitude_response(
            machine,
            grid,
            models=models_of(machine),
            n_steps=n_steps,
            operating_points=operating_points,
            progress=progress,
        ),
        frictionless_amplitudes=amplitude_response(
            machine.without_dry_friction(), grid, models=["nonlinear"], progress=progress
        ).amplitude("nonlinear"),
    )


def models_of(machine: Machine) -> tuple[Model, ...]:
    """Return the models of a study: without a spring no position is balanced, about which an LTI model would be."""
    return tuple(name for name in MODELS if name != "lti" or machine.load.spring_stiffness > 0)


def n_parts(machine: Machine, frequencies: Sequence[float], grid: FloatArray) -> int:
    """Return how many parts `run_study` reports."""
    return len(frequencies) * (2 if machine.has_dry_friction else 1) + 2 * grid.size


def run_case(machine: Machine, frequency: float, n_steps: int | None, operating_points: OperatingPoints) -> Case:
    """Work one frequency through."""
    case = Case(
        machine=machine,
        frequency=frequency,
        models={},
        floquets={},
        orbits={},
        estimates={},
        bands={},
        attractors={},
        failures={},
    )
    for name in models_of(machine):
        try:
            if name == "nonlinear":
                _add_nonlinear(case)
                continue
            model = (
                ltv_model(machine, frequency, n_steps=n_steps, operating_points=operating_points)
                if name == "ltv"
                else lti_model(machine, frequency)
            )
            case.models[name], case.floquets[name] = model, cycle_floquet(model)
            case.orbits[name] = model.orbit
            case.estimates[name] = model.error_estimate
        except (LtvpneuError, ValueError) as error:
            case.failures[name] = str(error)
    return case


def _add_nonlinear(case: Case) -> None:
    machine = case.machine
    orbit = case.orbits["nonlinear"] = nonlinear_orbit(machine, case.frequency)
    case.attractors["nonlinear"] = attractors(machine, case.frequency)
    case.floquets["nonlinear"] = orbit_floquet(machine, orbit)
    if not orbit.is_isolated:
        case.bands["nonlinear"] = stiction_band(machine, case.frequency)


def frequency_grid(frequencies: Sequence[float], n_points: int) -> FloatArray:
    """Return frequencies for the response: half the lowest to one and a half times the highest, evenly on a log scale.

    The frequencies themselves are among them.
    """
    even = np.geomspace(0.5 * min(frequencies), 1.5 * max(frequencies), n_points)
    asked = np.array(frequencies, dtype=np.float64)
    # A point beside one that was asked for would show the same number twice.
    apart = np.all(np.abs(even[:, None] / asked - 1) > 0.02, axis=1)
    return np.union1d(even[apart], asked)
