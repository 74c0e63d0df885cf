"""The command line: `ltvpneu study`, `ltvpneu stability` and `ltvpneu sweep`."""

import argparse
import json
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from tqdm import tqdm

from ltvpneu.errors import LtvpneuError
from ltvpneu.face.machine_file import bundled_machines, load_machine
from ltvpneu.face.report import LABELS, multipliers_text, study_text, table
from ltvpneu.face.study import Study, frequency_grid, n_parts, run_study
from ltvpneu.face.study_data import study_data
from ltvpneu.face.sweep import LARGEST, grid, run_sweep, sweep_text, write_sweep
from ltvpneu.models.ltv import MODES, ltv_model
from ltvpneu.models.machine import Machine
from ltvpneu.periodic.floquet import floquet

STABLE, NOT_STABLE, BAD_INPUT = 0, 1, 2
"""Exit codes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0 done or stable, 1 not stable, 2 bad input."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except (LtvpneuError, ValueError, TypeError, OSError) as error:
        print(f"ltvpneu {options.command}: error: {_located(str(error), options.machine)}", file=sys.stderr)
        return BAD_INPUT


def _located(message: str, machine: str) -> str:
    """Put the machine file's name before a complaint of one of its keys that was found out only by a model."""
    tables = ("load.", "cylinder.", "valve.", "gas.", "flow_paths", "supply_pressure", "exhaust_pressure")
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
    _add_design(study)
    study.set_defaults(run=_study)

    stability = commands.add_parser(
        "stability", help="print the verdict of the LTV model; exit 0 stable, 1 not stable, 2 bad input"
    )
    stability.add_argument("machine", metavar="MACHINE", help=machine_help)
    stability.add_argument(
        "--frequency", type=float, nargs="+", required=True, metavar="HZ", help="valve frequencies [Hz]"
    )
    _add_design(stability)
    stability.set_defaults(run=_stability)

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


def _add_design(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--duty", type=float, metavar="D", help="duty cycle, 0 to 1 (default: the machine's own)")
    _add_model(parser, "lti")


def _add_model(parser: argparse.ArgumentParser, default: str) -> None:
    standard = f"{default}, the paper's" if default == "lti" else default
    parser.add_argument("--n-steps", type=int, default=2, metavar="N", help="steps of the LTV model (default: 2)")
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
    total = n_parts(machine, options.frequency, frequencies)
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
    print(study_text(study))
    if not any(case.orbits for case in study.cases):
        raise ValueError("no model gave an orbit at any frequency; the reasons stand in the tables above")
    written = write_study(study, options.out)
    print("written:", *(f"  {path}" for path in written), sep="\n")
    return 0


def write_study(study: Study, folder: Path) -> list[Path]:
    """Write the pictures and the JSON of a study; return their paths."""
    # A lazy door: matplotlib takes longer to load than the study to run.
    from ltvpneu.face import pictures

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
    written: list[Path] = []
    for name, figure in figures.items():
        written.append(folder / f"{name}.png")
        figure.savefig(written[-1], dpi=150)
    written.append(folder / "study.json")
    written[-1].write_text(json.dumps(study_data(study), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return written


def _stability(options: argparse.Namespace) -> int:
    machine = _machine(options)
    rows: list[list[str]] = []
    all_stable = True
    for frequency in options.frequency:
        model = ltv_model(machine, frequency, n_steps=options.n_steps, operating_points=options.operating_points)
        found = floquet(model.system)
        all_stable = all_stable and found.is_stable
        figures = [f"{found.spectral_radius:.6g}", f"{found.margin:.1e}", found.verdict]
        rows.append([f"{frequency:g}", f"{machine.duty:.4g}", multipliers_text(found), *figures])
    print(f"{machine.name}: LTV model, {options.n_steps} steps, operating points {options.operating_points!r}\n")
    print(table(["frequency [Hz]", "duty", "multipliers", "radius", "computed to", "verdict"], rows))
    return STABLE if all_stable else NOT_STABLE


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
