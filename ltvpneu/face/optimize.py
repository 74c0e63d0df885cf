"""`ltvpneu optimize`: goals from the command line, the design, its tables, JSON and pictures."""

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from tqdm import tqdm

from ltvpneu._arrays import FloatArray
from ltvpneu.face.report import depends, shown
from ltvpneu.face.request import Request, dimension_of
from ltvpneu.face.results import Results
from ltvpneu.face.study_data import attractors_data
from ltvpneu.face.tables import heading, table
from ltvpneu.face.units import pressure_shown
from ltvpneu.models.cycles.orbit_map import MAP_SPREAD, orbit_map
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import attractors
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.liquid import Liquid

if TYPE_CHECKING:
    from ltvpneu.design import DutySolution, GoalCheck


DUTIES = np.linspace(0.05, 0.95, 19)
"""At which it is looked what positions a duty holds."""


SLOPES = (
    "supply_pressure", "exhaust_pressure", "load.mass", "load.force", "load.dry_friction", "load.spring_stiffness",
    "load.viscous_damping",
)  # fmt: skip
"""Parameters over which the best objective is differentiated."""


def followed_text(found: "DutySolution", cycle: tuple[FloatArray, FloatArray]) -> str:
    """Return how far from a wanted cycle of the position the machine goes."""
    one = found.corrected or found
    orbit = one.nonlinear["nominal"]
    if not isinstance(orbit, Orbit):
        return f"wanted cycle: the machine does not follow it: {orbit}"
    missed = 1e3 * (orbit.at(cycle[0] / (2 * np.pi * one.frequency))[0] - cycle[1])
    return f"wanted cycle: missed by {np.sqrt(np.mean(missed**2)):.3g} mm rms, {np.max(np.abs(missed)):.3g} mm at most"


def run_request(machine: Machine, request: Request, *, model: Any, globally: bool) -> "DutySolution":
    """Solve, with a progress bar."""
    # A lazy door: cvxpy takes a second to load, and no other command needs it.
    from ltvpneu import design

    with progress_bar("optimize") as progress:
        return design.optimize_duty(
            machine,
            request.frequency,
            request.variables,
            minimize=request.minimize,
            **asked(machine, request),
            pulses=request.pulses,
            choices=request.choices or None,
            ranges=request.ranges or None,
            model=model,
            globally=globally,
            correct=True,
            slopes=_slopes_shown(machine, request),
            progress=progress,
        )


def _slopes_shown(machine: Machine, request: Request) -> list[str]:
    """Return parameters of which it is shown how the optimum depends on them: numbers that are there and not free."""
    from ltvpneu.models.machine.parameters import present_value

    at = request.frequency[0] if isinstance(request.frequency, tuple) else request.frequency
    return [name for name in SLOPES if name not in (request.variables or {}) and present_value(machine, at, name) != 0]


@contextmanager
def progress_bar(name: str) -> Generator[Callable[[str, float], None]]:
    """Show a bar; what is called moves it, with what is done and the share of all that is."""
    with tqdm(total=1.0, desc=name, leave=False, bar_format="{desc} |{bar}| {elapsed}") as bar:

        def progress(text: str, share: float) -> None:
            bar.set_description_str(f"{name}: {text}", refresh=False)
            bar.update(share - bar.n)

        yield progress


def asked(machine: Machine, request: Request) -> dict[str, Any]:
    """Return the goals, scenarios and limits of the valve that were asked for, as the design functions take them."""
    from ltvpneu import design
    from ltvpneu.models.machine.parameters import present_value, with_values

    at = request.frequency[0] if isinstance(request.frequency, tuple) else request.frequency

    def scenario(factors: Mapping[str, float]) -> Any:
        for name in factors:
            present_value(machine, at, name)
        return lambda one: with_values(one, {n: k * present_value(one, at, n) for n, k in factors.items()})

    return {
        "goals": design.Goals(
            mean=request.mean, amplitude=request.amplitude, maximum=request.maximum, minimum=request.minimum,
            **request.named, cycle=None if request.cycle is None else {"position": request.cycle},
        ),
        "scenarios": {name: scenario(factors) for name, factors in request.scenarios.items()},
        "valve": design.ValveLimits(**cast(dict[str, Any], request.valve)),
    }  # fmt: skip


def optimum_text(found: "DutySolution") -> str:
    """Return the tables of an optimum."""
    parts = [choices_text(found)] if found.choices else []
    parts.append(heading("Optimum"))
    said = {
        "optimal": "optimal: every goal is kept, and no small change does better",
        "infeasible": "infeasible: no setting near keeps every goal; this one comes nearest",
        "edge": "edge: better settings next to this one have no cycle, as where stiction holds the piston",
        "stopped": "stopped before the residual was small: look at the figures, try other bounds or starts",
    }
    corrected = found.corrected
    columns = [("linear model", found)] + ([("corrected on the nonlinear model", corrected)] if corrected else [])
    for name, one in columns:
        kink = ", on a kink of the model" if one.at_kink else ""
        parts.append(f"{name}: {said[one.status]} (residual {one.residual:.1e}{kink})")
        if one.broken:
            parts.append(f"  but the nonlinear machine breaks: {', '.join(one.broken)}")
    if found.not_corrected:
        parts.append(f"not corrected on the nonlinear model: {found.not_corrected}")
    if np.isposinf(found.lower_bound):
        parts.append("global search: no setting within the bounds keeps every goal, as far as the curvature seen holds")
    elif np.isfinite(found.lower_bound):
        parts.append(
            f"global search: no setting gets the objective below {found.lower_bound:.6g} ({found.objective:.6g})"
        )
    if found.ranges is not None:
        parts.append(f"over the ranges: {ranges_text(found.ranges)}")
    unheld = _unheld(found)
    if unheld:
        parts.append(unheld)
    if found.n_failed:
        parts.append(f"{found.n_failed} settings on the way had no cycle, or stiction held the piston there")
    rows = [
        [name, *(setting_shown(name, one.values[name], one.machine.ambient_pressure) for _, one in columns)]
        for name in found.values
    ]
    for number in range(len(found.commands)):
        for row, what in enumerate(("on", "off")):
            times = [f"{1e3 * one.commands[number][row]:.3f} ms" for _, one in columns]
            rows.append([f"command {what}" + (f" {number + 1}" if len(found.commands) > 1 else ""), *times])
    parts += ["", table(["setting", *(name for name, _ in columns)], rows), heading("What the machine does")]
    parts.append("All figures are the nonlinear machine's but those in the column of the linear model.\n")
    parts.append(table(*_figures(found)))
    if found.constraints:
        rows = [
            [
                name,
                f"{found.constraints[name]:.2g}",
                *(f"{one.nonlinear_constraints[name]:.2g}" for _, one in columns),
                f"{found.duals[name]:.3g}" if name in found.duals else "-",
            ]
            for name in found.constraints
        ]
        header = ["goal", "missed by, linear model", *(f"nonlinear, {name}" for name, _ in columns), "dual"]
        if corrected:
            header[2], header[3] = "nonlinear machine", "corrected"
        parts += [heading("Goals [SI units]"), table(header, rows)]
    parts += _slopes_text(corrected or found)
    if found.active:
        parts.append(f"\nactive: {', '.join(found.active)}")
    return "\n".join(parts)


def ranges_text(check: "GoalCheck") -> str:
    """Return how the machine keeps the goals over ranges, in a sentence or two."""
    told = f"{int(check.kept.sum())} of {len(check.points)} machines looked at keep all goals"
    missed = [f"{name} by up to {check.worst(name):.3g} (SI)" for name in check.broken if name in check.missed]
    if missed:
        told += f"; missed: {', '.join(missed)}"
    if check.failures:
        number, reason = next(iter(check.failures.items()))
        where = ", ".join(f"{name} {value:.4g}" for name, value in check.point(number).items())
        told += f"; {len(check.failures)} have no cycle, as at {where}: {reason}"
    return told


def choices_text(found: "DutySolution") -> str:
    """Return the table of what every choice came to, best first."""
    names, around = list(found.choice), found.machine.ambient_pressure
    rows: list[list[str]] = []
    for one in found.choices:
        labels = [
            label if isinstance(label, str)
            else f"{1e3 * label:g} mm" if name == "bore"
            else setting_shown(name, label, around)
            for name, label in one.choice.items()
        ]  # fmt: skip
        if one.final is None:
            rows.append([*labels, "-", "-", one.failure])
            continue
        objective = one.final.nonlinear_objective
        settings = ", ".join(f"{name} {setting_shown(name, value, around)}" for name, value in one.final.values.items())
        verdict = "keeps all goals" if one.keeps_goals else f"breaks {', '.join(one.final.broken) or 'none'}"
        rows.append([*labels, f"{objective:.5g}" if np.isfinite(objective) else "-", settings, verdict])
    return f"{heading('Choices, best first')}\n{table([*names, 'objective [SI]', 'settings', 'verdict'], rows)}"


def _slopes_text(found: "DutySolution") -> list[str]:
    """Return what one percent more of each parameter does to the best objective; nothing where that is not known."""
    from ltvpneu.models.machine.parameters import present_value

    rows: list[list[str]] = []
    free = list(found.values)
    for name, slope in found.slopes.items():
        value = present_value(found.machine, found.frequency, name)
        if np.isfinite(slope) and found.objective:
            share = 0.01 * value * slope / abs(found.objective)
            moves = [0.01 * value * found.setting_slopes[name][one] for one in free]
            shown_moves = [f"{move:+.2g}" if np.isfinite(move) else "-" for move in moves]
            rows.append(
                [
                    name,
                    setting_shown(name, value, found.machine.ambient_pressure),
                    f"{100 * share:+.2g} %",
                    *shown_moves,
                ]
            )
    if not rows:
        return []
    header = ["parameter", "now", "objective", *(f"{name} [SI]" for name in free)]
    return [heading("What 1 % more of a parameter changes, the settings following"), table(header, rows)]


def _unheld(found: "DutySolution") -> str:
    """Return which mean positions no duty holds, where a piston without a spring missed what was asked for."""
    asked = any(name.startswith(("mean position", "least mean position", "most mean")) for name in found.constraints)
    if found.machine.load.spring_stiffness > 0 or not asked or found.status == "optimal":
        return ""
    return orbit_map(found.machine, DUTIES, [found.frequency]).remark(found.frequency)


def _figures(found: "DutySolution") -> tuple[list[str], list[list[str]]]:
    """Return rows of the figures of all cycles."""
    header = ["cycle", "mean position", "amplitude", "air use", "remark"]
    rows: list[list[str]] = []
    if found.model is not None:
        rows.append(["linear model", *_cells(found.machine, found.model.orbit)])
    for one, name in ((found, ""), (found.corrected, ", corrected")):
        for scenario, orbit in one.nonlinear.items() if one is not None else ():
            label = f"nonlinear{name}" + ("" if scenario == "nominal" else f", {scenario}")
            if isinstance(orbit, Orbit) and one is not None:
                machine = one.scenario_machines[scenario]
                *cells, remark = _cells(machine, orbit)
                also = depends(attractors(machine, one.frequency, n_spread=MAP_SPREAD))
                rows.append([label, *cells, ", ".join([remark, *also] if remark else also)])
            else:
                rows.append([label, "-", "-", "-", str(orbit)])
    return header, rows


def _cells(machine: Machine, orbit: Orbit) -> list[str]:
    from ltvpneu.design import air_use

    remarks: list[str] = []
    if orbit.n_periods > 1:
        remarks.append(f"repeats every {orbit.n_periods} periods")
    if orbit.rest or not orbit.is_isolated:
        remarks.append(orbit.rest or "held by stiction")
    return [
        shown("position", orbit.mean("position")),
        shown("position", orbit.amplitude("position")),
        flow_shown(air_use(machine, orbit), machine),
        ", ".join(remarks),
    ]


def flow_shown(flow: float, machine: Machine) -> str:
    """Return a mass flow [kg/s] as people speak of it; of a gas as its volume at ANR too."""
    normal = "" if isinstance(machine.gas, Liquid) else f" = {6e4 * flow / ANR_DENSITY:.1f} Nl/min"
    return f"{1e3 * flow:.3f} g/s{normal}"


def optimum_data(found: "DutySolution") -> dict[str, Any]:
    """Return an optimum as plain values for JSON, in SI units; None stands for what is not known."""
    from ltvpneu.design import air_use

    def cycles(one: "DutySolution") -> dict[str, Any]:
        return {
            name: orbit
            if isinstance(orbit, str)
            else {
                "mean_position": orbit.mean("position"),
                "amplitude": orbit.amplitude("position"),
                "air_use": air_use(one.scenario_machines[name], orbit),
                "is_isolated": orbit.is_isolated,
                "rest": orbit.rest,
                "attractors": attractors_data(
                    attractors(one.scenario_machines[name], one.frequency, n_spread=MAP_SPREAD)
                ),
                "n_periods": orbit.n_periods,
            }
            for name, orbit in one.nonlinear.items()
        }

    def known(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    def data(one: "DutySolution") -> dict[str, Any]:
        return {
            "status": one.status,
            "values": one.values,
            "frequency": one.frequency,
            "commands": [list(pair) for pair in one.commands],
            "objective": known(one.objective),
            "nonlinear_objective": known(one.nonlinear_objective),
            "lower_bound": known(one.lower_bound),
            "residual": known(one.residual),
            "at_kink": one.at_kink,
            "not_corrected": one.not_corrected,
            "duals": {name: known(value) for name, value in one.duals.items()},
            "slopes": {name: known(value) for name, value in one.slopes.items()},
            "setting_slopes": {
                name: {variable: known(value) for variable, value in moves.items()}
                for name, moves in one.setting_slopes.items()
            },
            "active": list(one.active),
            "missed_by": {name: known(value) for name, value in one.constraints.items()},
            "nonlinear_missed_by": {name: known(value) for name, value in one.nonlinear_constraints.items()},
            "broken_on_the_machine": list(one.broken),
            "spectral_radius": known(one.spectral_radius),
            "nonlinear": cycles(one),
        }

    choices = [
        {
            "choice": one.choice,
            "failure": one.failure,
            "keeps_goals": one.keeps_goals,
            "values": None if one.final is None else one.final.values,
            "objective": None if one.final is None else known(one.final.nonlinear_objective),
        }
        for one in found.choices
    ]
    corrected = data(found.corrected) if found.corrected is not None else None
    check = found.ranges
    ranges = None if check is None else {
        "n_points": len(check.points),
        "n_kept": int(check.kept.sum()),
        "missed_by_at_most": {name: check.worst(name) for name in check.missed},
        "without_a_cycle": [check.point(number) | {"reason": text} for number, text in check.failures.items()],
    }  # fmt: skip
    return data(found) | {"ranges": ranges, "corrected": corrected, "choice": found.choice, "choices": choices}


def write_optimum(found: "DutySolution", results: Results) -> None:
    """Write JSON, the machine at the optimum and the picture of the cycles."""
    # A lazy door, as of the study.
    from ltvpneu.face import pictures

    results.data("optimum", optimum_data(found))
    results.text("optimum.toml", (found.corrected or found).machine.to_toml())
    results.picture("optimum", pictures.draw(found))


def setting_shown(name: str, value: float, ambient: float) -> str:
    """Return a setting with a unit that people use; pressures over the ambient one [Pa] too."""
    dimension = dimension_of(name)
    if name == "frequency":
        return f"{value:.5g} Hz"
    if dimension == "pressure":
        return pressure_shown(value, ambient)
    if dimension == "angle":
        return f"{np.degrees(value):.3f} deg"
    return f"{value:.6g}"
