"""What the commands about one drive do, from `drive` to `keys`; loaded once the command line has been read."""

import argparse
import csv
import io
import json

import numpy as np

from ltvpneu.face.machine_text import bundled_machines, bundled_valves, machine_text, parsed
from ltvpneu.face.results import Results
from ltvpneu.face.tables import heading, table


def drive(options: argparse.Namespace) -> int:
    """Print what a drive does."""
    # Lazy doors here and below: a list of machines needs none of this.
    from tqdm import tqdm

    from ltvpneu.face.drive import drive_text, write_drive
    from ltvpneu.face.machine_file import load_machine
    from ltvpneu.models.cycles.data_sheet import N_DUTIES, PRICE, data_sheet

    machine = load_machine(options.machine)
    price = PRICE if options.price is None else options.price
    total = 0 if options.frequency is None else N_DUTIES
    with tqdm(total=total, desc="duties", unit="duty", leave=False, disable=True if not total else None) as bar:
        sheet = data_sheet(machine, options.frequency, price=price, life=options.life, progress=bar.update)
    print(sheet.to_json() if options.json else drive_text(sheet), end="\n" if options.json else "")
    if not options.json:
        results = Results(options.out)
        write_drive(sheet, results)
        print(f"\n{results.listed()}")
    return 0


def simulate(options: argparse.Namespace) -> int:
    """Follow a drive over time."""
    from ltvpneu.face.machine_file import load_machine
    from ltvpneu.models.nonlinear.simulation import simulate as follow
    from ltvpneu.models.nonlinear.stroke import start_of_stroke

    machine = load_machine(options.machine)
    if options.duty is not None:
        machine = machine.with_duty(options.duty)
    if not 0 < options.duration < float("inf"):
        raise ValueError(f"--duration: found {options.duration:g} s, expected a finite number above zero")
    frequency = 1 / options.duration if options.frequency is None else options.frequency
    if not 0 < frequency < float("inf"):
        raise ValueError(f"--frequency: found {frequency:g} Hz, expected a finite number above zero")
    n_periods = max(1, int(np.ceil(options.duration * frequency - 1e-9)))
    start = None
    if options.start != "rest":
        start = start_of_stroke(machine, "out" if options.start == "retracted" else "in")
    response = follow(machine, frequency, n_periods, start, points_per_period=max(20, 2000 // n_periods))
    times, states = np.asarray(response.time), np.asarray(response.states)
    kept = times <= options.duration * (1 + 1e-12)
    times, states = times[kept], states[:, kept]
    if options.json:
        found = {name: values.tolist() for name, values in zip(machine.states, states, strict=True)}
        print(json.dumps({"machine": machine.name, "time": times.tolist(), **found}))
        return 0
    results = Results(options.out)
    results.text("simulate.csv", _transient_text(machine.states, times, states))
    from ltvpneu.face.drive_pictures import draw_transient

    title = f"{machine.name}: duty {machine.duty:.3g} at {frequency:.4g} Hz, from {options.start}"
    cylinder = machine.cylinder
    stops = None if cylinder.is_absent else (cylinder.lower_stop, cylinder.upper_stop)
    results.picture("simulate", draw_transient(title, machine.states, times, states, stops))
    last = ", ".join(f"{name} {value:.6g}" for name, value in zip(machine.states, states[:, -1], strict=True))
    print(f"{title}\nat {times[-1]:.6g} s, in SI units: {last}\n\n{results.listed()}")
    return 0


def _transient_text(states: tuple[str, ...], times: np.ndarray, values: np.ndarray) -> str:
    """Return the table of a transient, as CSV."""
    units = {"position": "m", "velocity": "m/s", "pressure": "Pa", "temperature": "K"}
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["time [s]", *(f"{state} [{units[state.partition('_')[0]]}]" for state in states)])
    writer.writerows(np.column_stack([times, values.T]).tolist())
    return text.getvalue()


def new(options: argparse.Namespace) -> int:
    """Print a machine file."""
    from ltvpneu.face.machine_file import parse_machine
    from ltvpneu.face.new_file import new_file

    text = new_file(_given(options))
    # What is printed can be read: a wrong word is named now.
    parse_machine(text, "new")
    print(text, end="")
    return 0


def _given(options: argparse.Namespace) -> dict[str, dict[str, str]]:
    """Return what the options say, as TOML, by table and key."""
    found: dict[str, dict[str, str]] = {"": {}, "cylinder": {}, "load": {}, "valve": {}}

    def put(table_name: str, key: str, value: object, form: str) -> None:
        if value is not None:
            found[table_name][key] = form.format(value)

    put("", "name", options.name, '"{}"')
    put("", "supply_pressure", options.supply, '"{}"')
    for key in ("bore", "stroke"):
        put("cylinder", key, getattr(options, key), '"{:g} mm"')
    if options.rod == 0:
        found["cylinder"]["rodless"] = "true"
    else:
        put("cylinder", "rod", options.rod, '"{:g} mm"')
    put("cylinder", "clearance", options.clearance, '"{:g} %"')
    put("cylinder", "mounting", options.mounting, '"{}"')
    put("load", "mass", options.mass, '"{:g} kg"')
    put("valve", "type", options.valve, '"{}"')
    put("valve", "model", options.model, '"{}"')
    put("valve", "sonic_conductance", options.C, '"{:g} dm^3/(s bar)"')
    put("valve", "critical_pressure_ratio", options.b, "{:g}")
    if options.delay is not None:
        for key, value in zip(("opening_delay", "closing_delay"), options.delay, strict=True):
            put("valve", key, value, '"{:g} ms"')
    if options.friction is not None:
        for key, value in zip(("dry_friction", "stiction"), options.friction, strict=True):
            put("load", key, value, '"{:g} N"')
    if options.model is not None and options.valve is None:
        known = bundled_valves().get(options.model, {})
        put("valve", "type", known.get("type"), '"{}"')
    return found


def size(options: argparse.Namespace) -> int:
    """Find parts for a task; return 0 if some do, 1 if none."""
    from ltvpneu.face.optimize import progress_bar
    from ltvpneu.face.size import run_sizing, size_json, size_text

    with progress_bar("size") as progress:
        found = run_sizing(options, progress)
    print(json.dumps(size_json(found), indent=2) if options.json else size_text(found))
    if options.out is not None:
        results = Results(options.out)
        results.text("drive.toml", found.machine.to_toml())
        if not options.json:
            print(f"\n{results.listed()}")
    return 0 if found.is_found else 1


def move(options: argparse.Namespace) -> int:
    """Find a move; return 0 if there is one, 1 if not."""
    from ltvpneu.face.machine_file import load_machine
    from ltvpneu.face.move import move_json, move_request, move_text
    from ltvpneu.face.optimize import progress_bar

    machine = load_machine(options.machine)
    request = move_request(machine, options)
    from ltvpneu import design

    with progress_bar("move") as progress:
        found = design.optimize_move(machine, **request, progress=progress)
    if options.json:
        print(json.dumps(move_json(found), indent=2))
    else:
        from ltvpneu.face.plots import plot

        print(move_text(found, options.minimize))
        results = Results(options.out)
        response = found.response
        results.text(
            "move.csv", _transient_text(machine.states, np.asarray(response.time), np.asarray(response.states))
        )
        results.data("move", move_json(found))
        results.picture("move", plot(found))
        print(f"\n{results.listed()}")
    return 0 if found.status != "infeasible" else 1


def machines(options: argparse.Namespace) -> int:
    """List the bundled machines and valves."""
    drives = {name: parsed(*machine_text(name)) for name in bundled_machines()}
    valves = bundled_valves()
    if options.json:
        listed = {name: {"name": data["name"], "source": data.get("source", "")} for name, data in drives.items()}
        print(json.dumps({"machines": listed, "valves": valves}, indent=2))
        return 0
    print(heading("Machines").lstrip("\n"))
    print(table(["machine", "remark"], [[name, str(data["name"])] for name, data in drives.items()]))
    print(heading("Valves: `model` of a file's valve, C in dm^3/(s bar)"))
    rows = [
        [
            name,
            str(valve["type"]),
            str(valve["sonic_conductance"]).partition(" ")[0],
            f"{valve['critical_pressure_ratio']:g}",
            str(valve.get("exhaust", {}).get("sonic_conductance", "as C")).partition(" dm")[0],
            str(valve["source"]),
        ]
        for name, valve in valves.items()
    ]
    print(table(["valve", "type", "C", "b", "C to exhaust", "remark"], rows))
    return 0


def schema(options: argparse.Namespace) -> int:
    """Print the JSON Schema of machine files."""
    from ltvpneu.face.schema import machine_schema

    print(json.dumps(machine_schema(), indent=2))
    return 0


def keys(options: argparse.Namespace) -> int:
    """Print a page of all keys of machine files."""
    from ltvpneu.face.keys_page import keys_page

    print(keys_page(), end="")
    return 0
