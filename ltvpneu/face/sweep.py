"""`ltvpneu sweep`: maps over duty and frequency of what the machine settles on and how far off a linear model is."""

import sys
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from tqdm import tqdm

from ltvpneu._values import Value
from ltvpneu.face.report import grouped_failures
from ltvpneu.face.results import Results
from ltvpneu.face.study_data import failure_data, plain
from ltvpneu.face.tables import table
from ltvpneu.models.cycles.orbit_map import KINDS, Branch, OrbitMap, orbit_map
from ltvpneu.models.cycles.validity_map import ValidityMap, validity_map
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.machine.machine import Machine

LARGEST = sys.float_info.max
MOST_SHOWN = 5
"""Points at which the start decides that a text lists."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Sweep(Value):
    """Both maps over the same grid."""

    orbits: OrbitMap
    validity: ValidityMap


def grid(name: str, limits: list[float], points: int, most: float) -> list[float]:
    """Return evenly spaced values from the first limit to the second.

    Raises
    ------
    ValueError
        The limits are not two rising numbers above zero and up to `most`, or there are fewer than two points.
    """
    low, high = limits
    if not 0 < low < high <= most:
        upper = f" and at most {most:g}" if most < LARGEST else ""
        raise ValueError(f"--{name}: found {low:g} {high:g}, expected two rising numbers above zero{upper}")
    if points < 2:
        raise ValueError(f"--points: found {points}, expected 2 or more")
    return np.linspace(low, high, points).tolist()


def run_sweep(
    machine: Machine,
    duties: list[float],
    frequencies: list[float],
    n_steps: int | None,
    operating_points: OperatingPoints,
) -> Sweep:
    """Work both maps out, with a progress bar."""
    # The nonlinear machine takes as long as the model, near enough for a bar.
    with tqdm(total=2 * len(duties) * len(frequencies), desc="sweep", unit="point", leave=False) as bar:
        orbits = orbit_map(machine, duties, frequencies, progress=bar.update)
        validity = validity_map(
            machine,
            duties,
            frequencies,
            n_steps=n_steps,
            operating_points=operating_points,
            progress=bar.update,
        )
    return Sweep(orbits=orbits, validity=validity)


def sweep_text(sweep: Sweep) -> str:
    """Return what a sweep found: how many of each kind, and how far off the linear model is."""
    orbits, validity = sweep.orbits, sweep.validity
    rows = [[kind, str(orbits.count(kind))] for kind in KINDS if orbits.count(kind)]
    errors = np.abs(validity.errors)
    total, known = errors.size, int(np.isfinite(errors).sum())
    model = f'LTV model, {validity.n_steps} steps, operating points "{validity.mode}"'
    note = "  (unique: one orbit from all starts that were tried, at rest at the ends and spread over the stroke)"
    lines = [table(["nonlinear orbit", "points"], rows), note, "", f"{model}: estimated error of the amplitude"]
    for limit in (0.01, 0.05, 0.2):
        lines.append(f"  at most {100 * limit:>2g} %: {int((errors <= limit).sum())} of {total} points")
    lines.append(f"  without a figure, the piston resting or no cycle found: {total - known}")
    lines += _dependent_points(orbits)
    lines += grouped_failures([*orbits.failures, *validity.failures])
    return "\n".join(lines)


def _dependent_points(orbits: OrbitMap) -> list[str]:
    """Return where the start decides, and between what; and which positions no duty holds."""
    lines: list[str] = []
    points = np.argwhere(orbits.depends_on_start)
    for row, column in points[:MOST_SHOWN]:
        branches = orbits.branches[row][column]
        lost = ["what does not repeat"] if len(branches) < 2 else []
        found = " or ".join([*(_branch_text(branch) for branch in branches), *lost])
        where = f"{orbits.frequencies[row]:g} Hz, duty {orbits.duties[column]:g}"
        lines.append(f"  depends on the start at {where}: {found}")
    if len(points) > MOST_SHOWN:
        lines.append(f"  and at {len(points) - MOST_SHOWN} more points; all are in the JSON")
    remark = orbits.remark()
    return [*lines, *([f"  {remark}"] if remark else [])]


def _branch_text(branch: Branch) -> str:
    periods = f", {branch.n_periods} periods" if branch.n_periods > 1 else ""
    return branch.rest or f"mean {1e3 * branch.mean:.4g} mm, amplitude {1e3 * branch.amplitude:.4g} mm{periods}"


def sweep_data(sweep: Sweep) -> dict[str, Any]:
    """Return every figure of a sweep in SI units, ready for JSON."""
    orbits, validity = sweep.orbits, sweep.validity
    names = ("frequencies", "duties", "kinds", "n_periods", "amplitudes", "means", "n_simulated", "lyapunov_exponents")
    linear = ("mode", "n_steps", "amplitudes", "errors")
    return plain(
        {
            "units": "SI: m, s, Hz; rows are frequencies, columns duties",
            "machine": orbits.machine.name,
            "nonlinear": {
                **{name: getattr(orbits, name) for name in names},
                "branches": [[[vars(branch) for branch in found] for found in row] for row in orbits.branches],
                "remark": orbits.remark(),
            },
            "ltv": {name: getattr(validity, name) for name in linear},
            "failures": [failure_data(failed) for failed in (*orbits.failures, *validity.failures)],
        }
    )


def write_sweep(sweep: Sweep, results: Results) -> None:
    """Write the JSON and both pictures."""
    # A lazy door, as for the study.
    from ltvpneu.face import pictures

    results.data("sweep", sweep_data(sweep))
    for name, found in (("orbit_map", sweep.orbits), ("validity_map", sweep.validity)):
        results.picture(name, pictures.draw(found))
