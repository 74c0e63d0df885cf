"""The design part of a study: duty map, certified stability, one worked optimum. Loads cvxpy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ltvpneu._values import Value
from ltvpneu.design import DutyMap, DutySolution, StabilityMap, duty_map, optimize_duty, stability_map
from ltvpneu.errors import LtvpneuError
from ltvpneu.face.optimize import optimum_data, optimum_text
from ltvpneu.face.report import grouped_failures
from ltvpneu.face.study_data import failure_data, plain
from ltvpneu.face.tables import heading, table
from ltvpneu.models.cycles.orbit_map import DEPENDS
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.machine.machine import Machine

DUTIES = np.linspace(0.05, 0.95, 19)
MAP_DUTIES, N_FREQUENCIES = np.linspace(0.1, 0.9, 13), 12
FASTEST, SMOOTHER = 2.0, 0.5
"""Times the frequency that the optimum may take, and the share of the amplitude there that it is allowed [-]."""
N_PARTS = 10
"""Parts of progress that the optimum counts as."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Example(Value):
    """What the worked optimum is asked for."""

    frequency: float
    """From which on it may choose [Hz]."""
    mean: float
    """Wanted mean position [m]."""
    amplitude: float
    """Largest amplitude [m]: half of that at `frequency` with this mean."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class DesignStudy(Value):
    """Everything of the design part; an example or an optimum that is not there has its reason in `failure`."""

    duties: DutyMap
    stability: StabilityMap
    example: Example | None
    optimum: DutySolution | None
    failure: str


def n_design_parts(frequencies: Sequence[float]) -> int:
    """Return how many parts `run_design` reports."""
    return len(frequencies) * DUTIES.size + MAP_DUTIES.size * N_FREQUENCIES + N_PARTS


def run_design(machine: Machine, frequencies: Sequence[float], progress: Callable[[int], object]) -> DesignStudy:
    """Work the design part through; `progress` is called with 1 after each of `n_design_parts` parts."""
    duties = duty_map(machine, DUTIES, frequencies, progress=progress)
    span = np.linspace(min(frequencies), 2 * max(frequencies), N_FREQUENCIES)
    # Without a spring no position is balanced, about which the paper's points would be.
    points: OperatingPoints = "lti" if machine.load.spring_stiffness > 0 else "fitted"
    stability = stability_map(machine, MAP_DUTIES, span, operating_points=points, progress=progress)
    example, optimum, failure = None, None, ""
    try:
        example = example_of(duties, max(frequencies))
        optimum = optimize_duty(
            machine,
            (example.frequency, FASTEST * example.frequency),
            minimize="air_use",
            mean={"position": example.mean},
            amplitude={"position": example.amplitude},
            correct=True,
        )
    except (LtvpneuError, ValueError) as error:
        failure = str(error)
    progress(N_PARTS)
    return DesignStudy(duties=duties, stability=stability, example=example, optimum=optimum, failure=failure)


def example_of(found: DutyMap, frequency: float) -> Example:
    """Return goals within reach from a frequency on: the middle of the means there, with half the amplitude.

    Raises
    ------
    ValueError
        The piston moves at no duty, or no duty holds it between its ends.
    """
    row = found.row(frequency)
    if found.orbits.unheld(frequency) is not None:
        raise ValueError(found.orbits.remark(frequency))
    moving = np.array(
        [kind in ("unique", "subharmonic") and not branches[0].rest
         for kind, branches in zip(found.orbits.kinds[row], found.orbits.branches[row], strict=True)]
    )  # fmt: skip
    if not moving.any():
        raise ValueError(f"at {frequency:g} Hz the piston moves at no duty of the map: there is nothing to optimize")
    means, amplitudes = found.means[row][moving], found.amplitudes[row][moving]
    nearest = int(np.argmin(np.abs(means - (means.min() + means.max()) / 2)))
    return Example(frequency=frequency, mean=float(means[nearest]), amplitude=SMOOTHER * float(amplitudes[nearest]))


def design_text(found: DesignStudy) -> str:
    """Return the tables of the design part."""
    parts = [heading("Where is the piston, on average, and how does it ripple? (nonlinear)"), duty_table(found.duties)]
    parts += [heading("Where is that stable, and where is it proved?"), stability_text(found.stability)]
    parts.append(heading("One optimum, worked through"))
    if found.example is not None:
        wanted = found.example
        parts.append(
            f"  Least air for a mean of {1e3 * wanted.mean:.2f} mm with no more than {1e3 * wanted.amplitude:.3f} mm "
            f"of amplitude,\n  half of what it is at {wanted.frequency:g} Hz: at up to "
            f"{FASTEST * wanted.frequency:g} Hz, and any duty."
        )
    parts.append(f"  none: {found.failure}" if found.optimum is None else optimum_text(found.optimum))
    return "\n".join(parts) + "\n"


def duty_table(found: DutyMap) -> str:
    """Return mean and amplitude over duty; in brackets where stiction holds the piston."""
    orbits = found.orbits
    rows: list[list[str]] = []
    for column, duty in enumerate(orbits.duties):
        cells: list[str] = []
        for row in range(orbits.frequencies.size):
            shown = f"{1e3 * found.means[row, column]:.2f} / {1e3 * found.amplitudes[row, column]:.2f}"
            kind = orbits.kinds[row][column]
            branches = orbits.branches[row][column]
            lost = ["what does not repeat"] if len(branches) < 2 else []
            means = " or ".join([*(f"{1e3 * branch.mean:.2f}" for branch in branches), *lost])
            named = {"band": f"({shown})", "chaotic": "chaotic", "failed": "failed", DEPENDS: f"{means} *"}
            cells.append(named.get(kind, shown))
        rows.append([f"{duty:.2f}", *cells])
    header = ["duty", *(f"{frequency:g} Hz mean / amplitude [mm]" for frequency in orbits.frequencies)]
    held = "\n  (In brackets: stiction holds the piston there; where it rests is decided by how it came.)"
    start = "\n  (* depends on the start: the means of all orbits that were found.)"
    lines = [table(header, rows) + (held if orbits.count("band") else "") + (start if orbits.count(DEPENDS) else "")]
    lines += [f"  {remark}" for frequency in orbits.frequencies if (remark := orbits.remark(float(frequency)))]
    return "\n".join(lines)


def stability_text(found: StabilityMap) -> str:
    """Return what is stable, what is certified, and what it is certified for."""
    n = found.spectral_radii.size
    lines = [
        f"  {found.frequencies.size} frequencies from {found.frequencies[0]:g} to {found.frequencies[-1]:g} Hz, "
        f"{found.duties.size} duties from {found.duties[0]:g} to {found.duties[-1]:g}: {n} points.",
        f"  LTV model stable by its multipliers: {int(found.is_stable.sum())} points; largest radius "
        f"{np.nanmax(found.spectral_radii):.4g}."
        if np.isfinite(found.spectral_radii).any()
        else "  No LTV model was found at any point.",
        f"  Held by stiction: {int((~found.is_isolated & np.isfinite(found.amplitudes)).sum())} points. Depends on the "
        f"start: {int(found.depends_on_start.sum())} points.",
    ]
    if found.box is None or found.certificate is None:
        lines.append(
            f"  Nothing is certified. {found.remark}"
            if found.remark
            else "  No box of operating points has a common Lyapunov function, as where a step has no pressure that it "
            "settles at by itself: nothing is certified."
        )
    else:
        low, high = found.box.position
        chambers = ", ".join(f"{a / 1e5:.3f} to {b / 1e5:.3f} bar" for a, b in found.box.pressures)
        lines += [
            f"  One Lyapunov function serves positions from {1e3 * low:.2f} to {1e3 * high:.2f} mm, pressures from "
            f"{chambers}: decay at {found.certificate.decay_rate:.3g} 1/s under any switching.",
            f"  It proves the LTV model's steps stable, at any duty, pattern and frequency of them, at "
            f"{int(found.is_certified.sum())} points;",
            f"  at {int((found.is_certified & found.stays_in_box).sum())} the machine's whole cycle stays in the box.",
        ]
    lines += grouped_failures(found.failures)
    return "\n".join(lines)


def design_data(found: DesignStudy) -> dict[str, Any]:
    """Return every figure of the design part in SI units, ready for JSON."""
    orbits, stability = found.duties.orbits, found.stability
    certificate, box = stability.certificate, stability.box
    return plain(
        {
            "duty_map": {
                "frequencies": orbits.frequencies,
                "duties": orbits.duties,
                "means": found.duties.means,
                "amplitudes": found.duties.amplitudes,
                "kinds": [list(row) for row in orbits.kinds],
                "branches": [[[vars(branch) for branch in point] for point in row] for row in orbits.branches],
                "remarks": [orbits.remark(float(frequency)) for frequency in orbits.frequencies],
            },
            "stability_map": {
                "frequencies": stability.frequencies,
                "duties": stability.duties,
                "spectral_radii": stability.spectral_radii,
                "amplitudes": stability.amplitudes,
                "is_isolated": stability.is_isolated,
                "depends_on_start": stability.depends_on_start,
                "decay_rates": stability.decay_rates,
                "stays_in_box": stability.stays_in_box,
                "box": None if box is None else {"position": box.position, "pressures": box.pressures},
                "certificate": None
                if certificate is None
                else {"decay_rate": certificate.decay_rate, "P": certificate.functions[0]},
                "failures": [failure_data(failed) for failed in stability.failures],
            },
            "example": None if found.example is None else dict(vars(found.example)),
            "optimum": None if found.optimum is None else optimum_data(found.optimum),
            "failure": found.failure,
        }
    )
