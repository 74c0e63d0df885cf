"""The figures of a study as plain data in SI units, for a JSON file."""

import math
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from ltvpneu.face.report import remarks
from ltvpneu.face.study import Case, Study
from ltvpneu.models.linear.error_estimate import ErrorEstimate
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.operating_points import quasi_static_turn
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import Attractors
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.periodic.orbits.floquet import Floquet
from ltvpneu.periodic.orbits.orbit import Orbit


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
                "is_isolated": {m: response.is_isolated[i] for i, m in enumerate(response.models)},
                "nonlinear_amplitudes_without_dry_friction": study.frictionless_amplitudes,
                "failures": [failure_data(failed) for failed in response.failures],
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
        "ambient_pressure": machine.ambient_pressure,
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
            for c in machine.at(machine.switching_frequency or 1.0).connections
        ],
    }
    if machine.load.spring_stiffness > 0 and not machine.has_switching_times:
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
        "attractors": {name: attractors_data(found) for name, found in case.attractors.items()},
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


def floquet_data(found: Floquet) -> dict[str, Any]:
    """Return multipliers and verdict; of a nonlinear orbit, over its own period."""
    return {
        "multipliers": [[value.real, value.imag] for value in found.multipliers],
        "log_moduli": found.log_moduli,
        "spectral_radius": found.spectral_radius,
        "margin": found.margin,
        "verdict": found.verdict,
    }


def estimate_data(estimate: ErrorEstimate) -> dict[str, Any]:
    """Return the estimated errors of a linear model's cycle: its value less the nonlinear machine's."""
    return {
        "is_reliable": estimate.is_reliable,
        "verdict": estimate.verdict,
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
        "is_isolated": orbit.is_isolated,
        "rest": orbit.rest,
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


def attractors_data(found: Attractors) -> dict[str, Any]:
    """Return what a machine settles on from different starts."""
    return {
        "is_single": found.is_single,
        "n_starts": len(found.starts),
        "orbits": [
            {
                "share": share,
                "mean": orbit.mean("position"),
                "amplitude": orbit.amplitude("position"),
                "n_periods": orbit.n_periods,
                "rest": orbit.rest,
            }
            for share, orbit in zip(found.shares, found.orbits, strict=True)
        ],
    }


def failure_data(failed: FailedPoint) -> dict[str, Any]:
    """Return a point without an answer, with every coordinate."""
    return {"model": failed.model, "frequency": failed.frequency, "duty": failed.duty, "error": str(failed.error)}


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
