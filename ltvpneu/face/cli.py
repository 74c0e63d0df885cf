"""The command line: `ltvpneu study`, `ltvpneu stability`, `ltvpneu optimize` and `ltvpneu sweep`."""

import argparse
import json
import math
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from ltvpneu.errors import LtvpneuError, NotConvergedError
from ltvpneu.face.machine_file import bundled_machines, load_machine
from ltvpneu.face.optimize import optimum_text, parse_request, run_request, write_optimum
from ltvpneu.face.report import LABELS, depends, multipliers_text, remarks, study_text, table
from ltvpneu.face.study import Study, frequency_grid, n_parts, run_study
from ltvpneu.face.study_data import study_data
from ltvpneu.face.sweep import LARGEST, grid, run_sweep, sweep_text, write_sweep
from ltvpneu.models.cycles.floquet import cycle_floquet
from ltvpneu.models.cycles.orbit_map import MAP_SPREAD
from ltvpneu.models.linear.ltv import MODES, OperatingPoints, ltv_model
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import attractors
from ltvpneu.models.nonlinear.floquet import orbit_floquet
from ltvpneu.models.nonlinear.simulation import nonlinear_orbit
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.proportional import ProportionalValve

if TYPE_CHECKING:
    from ltvpneu.face.study_design import DesignStudy

STABLE, NOT_STABLE, BAD_INPUT = 0, 1, 2
"""Exit codes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done or stable, 1 not stable, 2 bad input."""
    options = _parser().parse_args(arguments)

    def show(message: Warning | str, *_: object, **__: object) -> None:
        print(f"ltvpneu {options.command}: warning: {_located(str(message), options.machine)}", file=sys.stderr)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default", UserWarning)
            warnings.showwarning = show
            return options.run(options)
    except (LtvpneuError, ValueError, TypeError, OSError, ImportError) as error:
        print(f"ltvpneu {options.command}: error: {_located(str(error), options.machine)}", file=sys.stderr)
        return BAD_INPUT


def _located(message: str, machine: str) -> str:
    """Put the machine file's name before a complaint of one of its keys that was found out only by a model."""
    tables = ("load.", "cylinder.", "valve.", "gas.", "flow_paths", "supply_pressure", "exhaust_pressure", "ambient_")
    name = Path(machine).name if machine.endswith(".toml") else f"{machine}.toml"
    return f"{name}: {message}" if message.startswith(tables) else message


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ltvpneu", description="Control design for pneumatic actuators switched by on-off valves."
    )
    parser.add_argument("--version", action="version", version=f"ltvpneu {version('ltvpneu')}")
    commands = parser.add_subparsers(dest="command", required=True)
    machine_help = f"a TOML file, or a bundled machine: {', '.join(bundled_machines())}"

    study = commands.add_parser("study", help="work a machine through: tables, pictures, JSON")
    study.add_argument("machine", nargs="?", default="kunt_singh_1990", metavar="MACHINE", help=machine_help)
    study.add_argument(
        "--frequency", type=float, nargs="+", default=[1.0, 4.0, 10.0], metavar="HZ",
        help="valve frequencies to work through [Hz] (default: 1 4 10)",
    )  # fmt: skip
    study.add_argument(
        "--out",
        type=Path,
        default=Path("study"),
        metavar="DIR",
        help="folder for pictures and JSON (default: study)",
    )
    study.add_argument("--points", type=int, default=40, help="frequencies of the amplitude response (default: 40)")
    _add_design(study, "lti")
    study.set_defaults(run=_study)

    stability = commands.add_parser(
        "stability",
        help="print the verdict of the LTV model; exit 0 stable, 1 not stable or held by stiction, 2 bad input",
    )
    stability.add_argument("machine", metavar="MACHINE", help=machine_help)
    stability.add_argument(
        "--frequency", type=float, nargs="+", required=True, metavar="HZ", help="valve frequencies [Hz]"
    )
    _add_design(stability, None)
    stability.set_defaults(run=_stability)

    optimize = commands.add_parser(
        "optimize",
        help="find duty, frequency or angles for a wanted motion; exit 0 found, 1 not reachable, 2 bad input",
    )
    optimize.add_argument("machine", nargs="?", default="kunt_singh_1990", metavar="MACHINE", help=machine_help)
    _add_goals(optimize)
    optimize.set_defaults(run=_optimize)

    sweep = commands.add_parser(
        "sweep", help="map duty and frequency: stiction bands, subharmonics, and how far off the LTV model is"
    )
    sweep.add_argument("machine", nargs="?", default="kunt_singh_1990", metavar="MACHINE", help=machine_help)
    sweep.add_argument(
        "--frequency", type=float, nargs=2, default=[0.2, 20.0], metavar=("LOW", "HIGH"),
        help="limits of the valve frequency [Hz] (default: 0.2 20)",
    )  # fmt: skip
    sweep.add_argument(
        "--duty", type=float, nargs=2, default=[0.05, 0.95], metavar=("LOW", "HIGH"),
        help="limits of the duty cycle (default: 0.05 0.95)",
    )  # fmt: skip
    sweep.add_argument("--points", type=int, default=20, help="points along each axis (default: 20)")
    sweep.add_argument("--out", type=Path, default=Path("sweep"), metavar="DIR", help="folder (default: sweep)")
    _add_model(sweep, "fitted")
    sweep.set_defaults(run=_sweep)
    return parser


def _add_goals(parser: argparse.ArgumentParser) -> None:
    several: dict[str, Any] = {"action": "append", "default": [], "metavar": "NAME=VALUE"}
    parser.add_argument(
        "--frequency", nargs=1, required=True, metavar="HZ", help="valve frequency, such as 20, or its bounds, 10..30"
    )
    parser.add_argument("--mean", **several, help="time mean of a state, such as position=45mm or position=40mm..50mm")
    parser.add_argument(
        "--max", **several, help="upper bounds, such as amplitude=2mm, pressure_1=3.5bar or air_use=2g/s"
    )
    parser.add_argument("--min", **several, help="lower bounds of states, such as position=10mm")
    parser.add_argument(
        "--minimize", default="amplitude",
        help="amplitude, air_use, mean_error or switching (default: amplitude)",
    )  # fmt: skip
    parser.add_argument(
        "--free", **several,
        help="what may be changed, such as duty=0.1..0.9 or supply_pressure=3bar..6bar (default: the duty)",
    )  # fmt: skip
    parser.add_argument("--scenario", **several, help="what has to be borne too, such as supply_pressure=-10%%")
    parser.add_argument("--pulses", type=int, default=1, metavar="N", help="pulses a period (default: 1)")
    for name, text in (
        ("shortest-on", "shortest command on"), ("shortest-off", "shortest command off"),
        ("opening-delay", "delay of opening"), ("closing-delay", "delay of closing"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="MS", help=f"{text} [ms]")
    parser.add_argument(
        "--model", choices=("fitted", "self-consistent"), default="fitted", help="linear model (default: fitted)"
    )
    parser.add_argument("--global", dest="globally", action="store_true", help="search all of one or two settings")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for optimum.json and a picture")


def _optimize(options: argparse.Namespace) -> int:
    machine = load_machine(options.machine)
    if options.pulses < 1:
        raise ValueError(f"--pulses: found {options.pulses}, expected 1 or more")
    if options.pulses > 1:
        turn = 2 * math.pi / options.pulses
        machine = machine.with_pulses([(i * turn, (i + machine.duty) * turn) for i in range(options.pulses)])
    found = run_request(machine, parse_request(machine, options), model=options.model, globally=options.globally)
    print(f"{machine.name}\n{optimum_text(found)}")
    if options.out is not None:
        _make(options.out)
        print("\nwritten:", *(f"  {path}" for path in write_optimum(found, options.out)), sep="\n")
    return 0 if found.status == "optimal" else 1


def _add_design(parser: argparse.ArgumentParser, points: str | None) -> None:
    parser.add_argument("--duty", type=float, metavar="D", help="duty cycle, 0 to 1 (default: the machine's own)")
    _add_model(parser, points)


def _add_model(parser: argparse.ArgumentParser, default: str | None) -> None:
    own = "those that see friction and stops: fitted, of liquids self-consistent"
    standard = own if default is None else f"{default}, the paper's" if default == "lti" else default
    parser.add_argument(
        "--n-steps", type=int, metavar="N", help="steps of the LTV model (default: 2, or one for each valve position)"
    )
    parser.add_argument(
        "--operating-points",
        choices=MODES,
        default=default,
        help=f"of the LTV model (default: {standard})",
    )


def _machine(options: argparse.Namespace) -> Machine:
    machine = load_machine(options.machine)
    return machine if options.duty is None else machine.with_duty(options.duty)


def _study(options: argparse.Namespace) -> int:
    machine = _machine(options)
    for frequency in options.frequency:
        if not 0 < frequency < float("inf"):
            raise ValueError(f"--frequency: found {frequency:g} Hz, expected a finite number above zero")
    if options.points < 1:
        raise ValueError(f"--points: found {options.points}, expected 1 or more")
    frequencies = frequency_grid(options.frequency, options.points)
    _make(options.out)
    # A lazy door: cvxpy takes a second to load, and not every command needs it.
    from ltvpneu.face.study_design import design_text, n_design_parts, run_design

    total = n_parts(machine, options.frequency, frequencies)
    switches = not isinstance(machine.valve, ProportionalValve)
    total += n_design_parts(options.frequency) if switches else 0
    # The first part of the first run takes longest: it compiles the laws.
    with tqdm(total=total, desc="study", unit="part", leave=False) as bar:
        study = run_study(
            machine,
            options.frequency,
            n_steps=options.n_steps,
            operating_points=options.operating_points,
            grid=frequencies,
            progress=bar.update,
        )
        if switches and any(case.orbits for case in study.cases):
            designed = run_design(machine, options.frequency, bar.update)
        else:
            designed = None
    print(study_text(study))
    if not any(case.orbits for case in study.cases):
        raise ValueError("no model gave an orbit at any frequency; the reasons stand in the tables above")
    if designed is None:
        print("The valve is proportional and has no duty cycle to map or to design; in Python, duty_problem takes its")
        print("command's points, pressures and frequency as variables.\n")
    else:
        print(design_text(designed))
    written = write_study(study, designed, options.out)
    print("written:", *(f"  {path}" for path in written), sep="\n")
    return 0


def write_study(study: Study, designed: "DesignStudy | None", folder: Path) -> list[Path]:
    """Write the pictures and the JSON of a study; return their paths."""
    # A lazy door: matplotlib takes longer to load than the study to run.
    from ltvpneu.face import pictures
    from ltvpneu.face.study_design import design_data

    machine = study.machine
    models = [case.models["ltv"] for case in study.cases if "ltv" in case.models]
    figures = {"valve_areas": pictures.draw(models[0] if models else machine)}
    for case in study.cases:
        if case.orbits:
            label = f"{case.frequency:g}_Hz".replace(".", "p")
            title = f"{machine.name}: cycle at {case.frequency:g} Hz, duty {machine.duty:.3g}"
            orbits = {LABELS[name]: orbit for name, orbit in case.orbits.items()}
            figures[f"cycle_{label}"] = pictures.draw_cycles(orbits, title)
    free = study.frictionless_amplitudes if study.frictionless else None
    figures["amplitude"] = pictures.draw_amplitudes(study.response, free)
    found = {f"{case.frequency:g} Hz": case.floquets["ltv"] for case in study.cases if "ltv" in case.floquets}
    if found:
        figures["multipliers"] = pictures.draw(found)
    if designed is not None:
        figures["duty_map"] = pictures.draw(designed.duties)
        figures["stability_map"] = pictures.draw(designed.stability)
    if designed is not None and designed.optimum is not None:
        figures["optimum"] = pictures.draw(designed.optimum)
    written: list[Path] = []
    for name, figure in figures.items():
        written.append(folder / f"{name}.png")
        figure.savefig(written[-1], dpi=150)
    written.append(folder / "study.json")
    data = study_data(study) | ({} if designed is None else {"design": design_data(designed)})
    written[-1].write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return written


def _stability(options: argparse.Namespace) -> int:
    machine = _machine(options)
    points = options.operating_points or ("self-consistent" if isinstance(machine.gas, Liquid) else "fitted")
    rows: list[list[str]] = []
    all_stable = True
    # On a terminal only: a script reads what comes out.
    with tqdm(total=len(options.frequency), desc="stability", unit="frequency", leave=False, disable=None) as bar:
        for frequency in options.frequency:
            row, is_stable = _stability_row(machine, frequency, options.n_steps, points)
            rows.append(row)
            all_stable = all_stable and is_stable
            bar.update(1)
    print(f"{machine.name}: LTV model, operating points {points!r}\n")
    header = ["frequency [Hz]", "duty", "steps", "periods", "multipliers", "radius", "computed to", "verdict", "remark"]
    print(table(header, rows))
    return STABLE if all_stable else NOT_STABLE


def _stability_row(
    machine: Machine, frequency: float, n_steps: int | None, points: OperatingPoints
) -> tuple[list[str], bool]:
    """Return a line of the table, and whether the verdict is stable; the nonlinear orbit's where no model is found."""
    try:
        model = ltv_model(machine, frequency, n_steps=n_steps, operating_points=points)
        found, orbit, steps = cycle_floquet(model), model.orbit, f"{model.system.n_steps}"
        # A cycle may take several periods to repeat, and its steps are then those of all of them.
        periods, said = 1 if model.own_cycle is None else model.own_cycle.n_periods, list[str]()
    except NotConvergedError:
        orbit = nonlinear_orbit(machine, frequency)
        found, steps, periods = orbit_floquet(machine, orbit), "-", orbit.n_periods
        said = [f"of the nonlinear orbit, as no {points!r} model was found"]
    said += [*remarks(orbit, machine), *depends(attractors(machine, frequency, n_spread=MAP_SPREAD))]
    # No more digits than it is computed to.
    share = found.margin / max(found.spectral_radius, found.margin)
    digits = 6 if found.margin < 1e-6 else max(math.ceil(-math.log10(share)), 1)
    place = [f"{frequency:g}", f"{machine.duty:.4g}", steps, f"{periods}"]
    figures = [f"{found.spectral_radius:.{min(digits, 6)}g}", f"{found.margin:.1e}", found.verdict]
    return [*place, multipliers_text(found), *figures, ", ".join(said)], found.is_stable


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out: found {str(folder)!r}, expected a folder that can be made ({error})") from None


def _sweep(options: argparse.Namespace) -> int:
    machine = load_machine(options.machine)
    duties = grid("duty", options.duty, options.points, 1.0)
    frequencies = grid("frequency", options.frequency, options.points, LARGEST)
    _make(options.out)
    sweep = run_sweep(machine, duties, frequencies, options.n_steps, options.operating_points)
    print(f"{machine.name}: {options.points} x {options.points} points\n\n{sweep_text(sweep)}")
    written = write_sweep(sweep, options.out)
    print("written:", *(f"  {path}" for path in written), sep="\n")
    return 0
