"""The command line: `ltvpneu drive`, `simulate`, `move`, `study`, `stability`, `optimize`, `sweep` and others."""

import argparse
import importlib
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ltvpneu import __version__
from ltvpneu.errors import LtvpneuError
from ltvpneu.face.machine_text import bundled_machines, machine_text, parsed
from ltvpneu.models.linear.modes import MODES

DRIVE_COMMANDS = ("drive", "simulate", "move", "new", "size", "machines", "schema", "keys")
BAD_INPUT, STOPPED = 2, 130
"""Exit codes; 0 and 1 are those of the commands."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0 if done or stable, 1 if not stable, 2 for bad input, 130 if stopped by Ctrl-C."""
    options = _parser().parse_args(arguments)
    machine: str = getattr(options, "machine", "")

    def show(message: Warning | str, *_: object, **__: object) -> None:
        print(f"ltvpneu {options.command}: warning: {_located(str(message), machine)}", file=sys.stderr)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default", UserWarning)
            warnings.showwarning = show
            # What can be said at once is said before anything is loaded that takes time.
            if machine:
                parsed(*machine_text(machine))
            room = "drive_commands" if options.command in DRIVE_COMMANDS else "commands"
            run: int = getattr(importlib.import_module(f"ltvpneu.face.{room}"), options.command)(options)
            return run
    except (LtvpneuError, ValueError, TypeError, OSError, ImportError) as error:
        print(f"ltvpneu {options.command}: error: {_located(str(error), machine)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"\nltvpneu {options.command}: stopped", file=sys.stderr)
        return STOPPED


def _located(message: str, machine: str) -> str:
    """Put the machine file's name before a complaint of one of its keys that was found out only by a model."""
    tables = ("load.", "cylinder.", "valve.", "gas.", "flow_paths", "supply_pressure", "exhaust_pressure", "ambient_")
    name = Path(machine).name if machine.endswith(".toml") else f"{machine}.toml"
    return f"{name}: {message}" if message.startswith(tables) else message


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ltvpneu", description="Control design for pneumatic actuators switched by on-off valves."
    )
    parser.add_argument("--version", action="version", version=f"ltvpneu {__version__}")
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
    _add_design(study, "lti, the paper's; without a spring, fitted")

    stability = commands.add_parser(
        "stability",
        help="print the verdict of the LTV model; exit 0 stable, 1 not stable or held by stiction, 2 bad input",
    )
    stability.add_argument("machine", metavar="MACHINE", help=machine_help)
    stability.add_argument(
        "--frequency", type=float, nargs="+", required=True, metavar="HZ", help="valve frequencies [Hz]"
    )
    _add_design(stability, None)

    optimize = commands.add_parser(
        "optimize",
        help="find duty, frequency or angles for a wanted motion; exit 0 found, 1 not reachable, 2 bad input",
    )
    optimize.add_argument("machine", nargs="?", default="kunt_singh_1990", metavar="MACHINE", help=machine_help)
    _add_goals(optimize)

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

    _add_drive_commands(commands, machine_help)

    warm = commands.add_parser("warm", help="compile the machine's equations ahead of use, and keep them on disk")
    warm.add_argument("--jobs", type=int, metavar="N", help="processes at work (default: one for each core)")
    return parser


def _add_drive_commands(commands: Any, machine_help: str) -> None:
    drive = commands.add_parser("drive", help="what a drive does, on one screen: strokes, air, what its duty holds")
    drive.add_argument("machine", metavar="MACHINE", help=machine_help)
    drive.add_argument("--frequency", type=float, metavar="HZ", help="switching frequency [Hz]")
    drive.add_argument("--price", type=float, metavar="P", help="of a cubic metre of air at ANR (default: 0.02)")
    drive.add_argument("--life", type=float, metavar="N", help="switches that the valve is good for, such as 50e6")
    drive.add_argument(
        "--out", type=Path, default=Path("drive"), metavar="DIR", help="folder for two pictures (default: drive)"
    )
    drive.add_argument("--json", action="store_true", help="print all figures as JSON, in SI units")

    simulate = commands.add_parser("simulate", help="follow a drive over time: a picture and a table of numbers (CSV)")
    simulate.add_argument("machine", metavar="MACHINE", help=machine_help)
    simulate.add_argument("--duty", type=float, metavar="D", help="duty cycle, 0 to 1 (default: the machine's own)")
    simulate.add_argument("--duration", type=float, required=True, metavar="S", help="how long [s]")
    simulate.add_argument(
        "--frequency", type=float, metavar="HZ", help="switching frequency [Hz] (default: one period in all)"
    )
    simulate.add_argument(
        "--from", dest="start", choices=("rest", "retracted", "extended"), default="rest",
        help="start: at rest at exhaust pressure, or on a stop with the valve long in its other position",
    )  # fmt: skip
    simulate.add_argument(
        "--out", type=Path, default=Path("simulate"), metavar="DIR", help="folder (default: simulate)"
    )
    simulate.add_argument("--json", action="store_true", help="print times and states as JSON instead, in SI units")

    _add_move(commands, machine_help)

    new = commands.add_parser("new", help="print a commented machine file to start from")
    for name, unit, text in (
        ("bore", "MM", "diameter of the piston [mm]"), ("rod", "MM", "diameter of the rod [mm]; 0 for none"),
        ("stroke", "MM", "[mm]"), ("mass", "KG", "moving mass [kg]"), ("C", "C", "sonic conductance [dm^3/(s bar)]"),
        ("b", "B", "critical pressure ratio"), ("clearance", "PERCENT", "volume left at the ends [%%]"),
    ):  # fmt: skip
        new.add_argument(f"--{name}", type=float, metavar=unit, help=text)
    new.add_argument("--name", help="of the machine")
    new.add_argument("--mounting", help='"horizontal", "up", "down" or an angle such as "30 deg"')
    new.add_argument("--valve", metavar="TYPE", help='such as 5/2, 3/2 or "5/3 closed"')
    new.add_argument("--model", help='a bundled valve, such as "SMC SY3000"; `ltvpneu machines` lists them')
    new.add_argument("--supply", help='such as "6 bar(g)"')
    new.add_argument("--delay", type=float, nargs=2, metavar=("ON", "OFF"), help="delays of the valve [ms]")
    new.add_argument("--friction", type=float, nargs=2, metavar=("DRY", "STICTION"), help="[N]")

    size = commands.add_parser("size", help="find the cheapest cylinder and valve of the catalogue for a task")
    for name, unit, text in (("stroke", "MM", "[mm]"), ("mass", "KG", "moving mass [kg]")):
        size.add_argument(f"--{name}", type=float, required=True, metavar=unit, help=text)
    size.add_argument(
        "--time", type=float, nargs="+", required=True, metavar="S", help="most for a stroke [s], or two: out and in"
    )
    size.add_argument("--supply", required=True, metavar="P", help='such as "6 bar(g)"')
    size.add_argument("--mounting", help='"horizontal" (default), "up", "down" or an angle such as "30 deg"')
    size.add_argument("--friction", type=float, nargs=2, metavar=("DRY", "STICTION"), help="[N] (default: none)")
    size.add_argument("--force", type=float, default=0.0, metavar="N", help="external force towards out [N]")
    size.add_argument("--impact", type=float, metavar="J", help="most energy at the stop [J]")
    size.add_argument("--speed", type=float, metavar="V", help="most speed at the stop [m/s]")
    size.add_argument(
        "--kind",
        action="append",
        metavar="TYPE",
        help='of valve, such as 5/2 (default) or "5/3 closed"; may be repeated',
    )
    size.add_argument("--out", type=Path, metavar="DIR", help="folder for the drive's machine file")
    size.add_argument("--json", action="store_true", help="print what was found as JSON, in SI units")

    _add_lists(commands)


def _add_lists(commands: Any) -> None:
    machines = commands.add_parser("machines", help="list the bundled machines and valves")
    machines.add_argument("--json", action="store_true", help="as JSON")
    commands.add_parser("schema", help="print the JSON Schema of machine files, for editors")
    commands.add_parser("keys", help="print a page of all keys of machine files")


def _add_move(commands: Any, machine_help: str) -> None:
    move = commands.add_parser("move", help="find when the valves switch for a move from rest to rest")
    move.add_argument("machine", metavar="MACHINE", help=machine_help)
    place = "a position such as 20mm, or retracted or extended: a stop"
    move.add_argument("--from", dest="start", required=True, metavar="PLACE", help=place)
    move.add_argument("--to", dest="end", required=True, metavar="PLACE", help=place)
    move.add_argument("--switches", type=int, metavar="N", help="within the move, at most (default: as many as pay)")
    move.add_argument("--minimize", choices=("time", "air", "impact"), default="time", help="default: time")
    move.add_argument(
        "--max", action="append", default=[], metavar="NAME=VALUE",
        help="upper bounds on the way, such as speed=0.5m/s, impact_energy=0.1J or pressure_1=5bar",
    )  # fmt: skip
    move.add_argument("--no-hold", action="store_true", help="the last pressures need not hold the piston")
    move.add_argument("--longest", metavar="TIME", help="that a move may take, such as 300ms")
    move.add_argument("--out", type=Path, default=Path("move"), metavar="DIR", help="folder (default: move)")
    move.add_argument("--json", action="store_true", help="print what was found as JSON, in SI units")


def _add_goals(parser: argparse.ArgumentParser) -> None:
    several: dict[str, Any] = {"action": "append", "default": [], "metavar": "NAME=VALUE"}
    parser.add_argument(
        "--frequency", nargs=1, required=True, metavar="HZ", help="valve frequency, such as 20, or its bounds, 10..30"
    )
    parser.add_argument("--mean", **several, help="time mean of a state, such as position=45mm or position=40mm..50mm")
    parser.add_argument(
        "--max",
        **several,
        help="upper bounds, such as amplitude=2mm, pressure_1=3.5bar, air_use=2g/s, speed=0.3m/s or impact_energy=0.1J",
    )
    parser.add_argument("--min", **several, help="lower bounds, such as position=10mm, speed=0.1m/s or life=2000h")
    parser.add_argument("--life", type=float, metavar="N", help="switches that the valve is good for, such as 50e6")
    parser.add_argument(
        "--minimize",
        help="amplitude, air_use, mean_error, tracking or switching (default: amplitude, or tracking with --follow)",
    )  # fmt: skip
    parser.add_argument(
        "--free", **several,
        help="what may be changed, such as duty=0.1..0.9 or supply_pressure=3bar..6bar (default: the duty)",
    )  # fmt: skip
    parser.add_argument("--scenario", **several, help="what has to be borne too, such as supply_pressure=-10%%")
    parser.add_argument(
        "--choose", action="append", default=[], metavar="NAME=A,B,...",
        help="lists to choose from, such as bore=25mm,32mm, valve=SMC SY3000,SMC SY5000 or pulses=1,2",
    )  # fmt: skip
    parser.add_argument(
        "--range", **several,
        help="what is not known well, such as supply_pressure=+-5%% or load.force=0N..50N: goals hold at the worst",
    )  # fmt: skip
    parser.add_argument("--pulses", type=int, metavar="N", help="pulses a period (default: the machine's own)")
    parser.add_argument(
        "--follow", metavar="CYCLE",
        help="wanted cycle of the position, a sine as 45mm+-10mm or a file with columns degrees,mm",
    )  # fmt: skip
    for name, text in (
        ("shortest-on", "shortest command on"), ("shortest-off", "shortest command off"),
        ("opening-delay", "delay of opening"), ("closing-delay", "delay of closing"),
    ):  # fmt: skip
        parser.add_argument(f"--{name}", type=float, default=0.0, metavar="MS", help=f"{text} [ms]")
    parser.add_argument(
        "--model", choices=("fitted", "self-consistent"), default="fitted", help="linear model (default: fitted)"
    )
    parser.add_argument("--global", dest="globally", action="store_true", help="search all of one or two settings")
    parser.add_argument(
        "--trade-off", metavar="A,B",
        help="instead of one optimum the front between two objectives, such as air_use,amplitude",
    )  # fmt: skip
    parser.add_argument("--points", type=int, default=20, metavar="N", help="points of that front (default: 20)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for JSON, a picture and the machine's file")


def _add_design(parser: argparse.ArgumentParser, points: str | None) -> None:
    parser.add_argument("--duty", type=float, metavar="D", help="duty cycle, 0 to 1 (default: the machine's own)")
    _add_model(parser, points)


def _add_model(parser: argparse.ArgumentParser, standard: str | None) -> None:
    words = "those that see friction and stops: fitted, of liquids self-consistent" if standard is None else standard
    parser.add_argument(
        "--n-steps", type=int, metavar="N", help="steps of the LTV model (default: 2, or one for each valve position)"
    )
    parser.add_argument(
        "--operating-points",
        choices=MODES,
        default=standard if standard in MODES else None,
        help=f"of the LTV model (default: {words})",
    )
