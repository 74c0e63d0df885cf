"""The figures of a study as plain data in SI units, for a JSON file."""

import math
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from ltvpneu.face.report import remarks
from ltvpneu.face.study import Case, Study
from ltvpneu.models.error_estimate import ErrorEstimate
from ltvpneu.models.linearize import LtvModel
from ltvpneu.models.machine import Machine
from ltvpneu.models.operating_points import quasi_static_turn
from ltvpneu.models.variational import OrbitFloquet
from ltvpneu.periodic.floquet import Floquet
from ltvpneu.periodic.orbit import Orbit


def study_data(study: Study) -> dict[str, Any]:
    """Return every figure of the report in SI units, ready for JSON; what is not finite is null."""
    response = study.response
    return plain(
        {
            "units": "SI: m, s, Pa absolute, kg, rad, Hz",
            "machine": machine_data(study.machine),
            "n_steps": study.n_steps,
            "cases": [case_data(case) for case in study.cases],
            "cases_without_dry_friction": [case_data(case) for case in study.frictionless],
            "amplitude_response": {
                "signal": "position",
                "frequencies": response.frequencies,
                "amplitudes": {m: response.amplitudes[i] for i, m in enumerate(response.models)},
                "means": {m: response.means[i] for i, m in enumerate(response.models)},
                "n_periods": {m: response.n_periods[i] for i, m in enumerate(response.models)},
                "is_unique": {m: response.is_unique[i] for i, m in enumerate(response.models)},
                "nonlinear_amplitudes_without_dry_friction": study.frictionless_amplitudes,
                "failures": [
                    {"model": f.model, "frequency": f.frequency, "error": str(f.error)} for f in response.failures
                ],
            },
        }
    )


def machine_data(machine: Machine) -> dict[str, Any]:
    """Return what a machine is."""
    cylinder, load, gas = machine.cylinder, machine.load, machine.gas
    data: dict[str, Any] = {
        "name": machine.name,
        "supply_pressure": machine.supply_pressure,
        "exhaust_pressure": machine.exhaust_pressure,
        "duty": machine.duty,
        "collapse": machine.collapse,
        "states": list(machine.states),
        "cylinder": asdict(cylinder),
        "load": dict(vars(load)),
        "gas": {"kind": type(gas).__name__, **{field.name: getattr(gas, field.name) for field in fields(gas)}},
        "connections": [
            {
                "source": c.source,
                "chamber": c.chamber,
                "effective_area": float(max(c.first.starts.max(), c.first.ends.max())),
            }
            for c in machine.connections
        ],
    }
    if machine.load.spring_stiffness > 0:
        data["mean_quasi_static_state"] = quasi_static_turn(machine, None).mean
    return data


def case_data(case: Case) -> dict[str, Any]:
    """Return every figure of one frequency."""
    return {
        "frequency": case.frequency,
        "models": {name: model_data(model) for name, model in case.models.items()},
        "floquet": {name: floquet_data(found) for name, found in case.floquets.items()},
        "orbits": {name: orbit_data(orbit, case.machine) for name, orbit in case.orbits.items()},
        "estimated_errors": {name: estimate_data(estimate) for name, estimate in case.estimates.items()},
        "stiction_bands": {name: {"lowest": b.lowest, "highest": b.highest} for name, b in case.bands.items()},
        "failures": case.failures,
    }


def model_data(model: LtvModel) -> dict[str, Any]:
    """Return the coefficients of a model."""
    system = model.system
    return {
        "mode": model.mode,
        "operating_points": model.operating_points,
        "held_back": [dict(vars(held)) for held in model.held_back],
        "least_distance": model.least_distance,
        "durations": system.durations,
        "G": system.A,
        "f": system.f,
        "B": system.B,
        "inputs": list(system.inputs),
        "levels": system.levels,
    }


def floquet_data(found: Floquet | OrbitFloquet) -> dict[str, Any]:
    """Return multipliers and verdict; of a nonlinear orbit, over its own period."""
    return {
        "multipliers": [[value.real, value.imag] for value in found.multipliers],
        "log_moduli": found.log_moduli,
        "spectral_radius": found.spectral_radius,
        "margin": found.margin if isinstance(found, Floquet) else None,
        "verdict": found.verdict,
    }


def estimate_data(estimate: ErrorEstimate) -> dict[str, Any]:
    """Return the estimated errors of a linear model's cycle: its value less the nonlinear machine's."""
    return {
        "is_reliable": estimate.is_reliable,
        "signals": {
            name: {
                "amplitude": estimate.amplitude(name),
                "mean": estimate.mean(name),
                "minimum": estimate.minimum(name),
                "maximum": estimate.maximum(name),
            }
            for name in estimate.states
        },
    }


def orbit_data(orbit: Orbit, machine: Machine) -> dict[str, Any]:
    """Return the figures of an orbit."""
    return {
        "remarks": remarks(orbit, machine),
        "is_unique": orbit.is_unique,
        "n_periods": orbit.n_periods,
        "residual": orbit.residual,
        "initial_state": orbit.initial_state,
        "branches": orbit.branches,
        "signals": {
            name: {
                "amplitude": orbit.amplitude(name),
                "mean": orbit.mean(name),
                "minimum": orbit.minimum(name),
                "maximum": orbit.maximum(name),
            }
            for name in orbit.signals
        },
    }


def plain(value: Any) -> Any:
    """Return nested data with arrays as lists and numbers that JSON does not know as null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
