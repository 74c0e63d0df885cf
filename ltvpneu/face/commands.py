"""What the sub-commands do; loaded once the command line has been read."""

import argparse
import math
from typing import TYPE_CHECKING

from tqdm import tqdm

from ltvpneu.errors import NotConvergedError
from ltvpneu.face.machine_file import load_machine
from ltvpneu.face.optimize import followed_text, optimum_text, run_request, write_optimum
from ltvpneu.face.report import LABELS, depends, multipliers_text, remarks, study_text
from ltvpneu.face.request import parse_request
from ltvpneu.face.results import Results
from ltvpneu.face.study import Study, frequency_grid, n_parts, run_study
from ltvpneu.face.study_data import study_data
from ltvpneu.face.sweep import LARGEST, grid, run_sweep, sweep_text, write_sweep
from ltvpneu.face.tables import table
from ltvpneu.face.trade_off import run_trade_off, trade_off_text, write_trade_off
from ltvpneu.models.cycles.floquet import cycle_floquet
from ltvpneu.models.cycles.orbit_map import MAP_SPREAD
from ltvpneu.models.linear.ltv import OperatingPoints, ltv_model
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import attractors
from ltvpneu.models.nonlinear.floquet import orbit_floquet
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.proportional import ProportionalValve

if TYPE_CHECKING:
    from ltvpneu.face.study_design import DesignStudy

STABLE, NOT_STABLE = 0, 1
"""Exit codes."""


def optimize(options: argparse.Namespace) -> int:
    """Find duty, frequency or angles for a wanted motion."""
    machine = load_machine(options.machine)
    if options.pulses is not None and options.pulses < 1:
        raise ValueError(f"--pulses: found {options.pulses}, expected 1 or more")
    if options.trade_off is not None:
        if options.pulses is not None:
            turn = 2 * math.pi / options.pulses
            machine = machine.with_pulses([(i * turn, (i + machine.duty) * turn) for i in range(options.pulses)])
        return _trade_off(machine, options)
    request = parse_request(machine, options)
    found = run_request(machine, request, model=options.model, globally=options.globally)
    print(f"{machine.name}\n{optimum_text(found)}")
    if request.cycle is not None:
        print(f"\n{followed_text(found, request.cycle)}")
    if options.out is not None:
        results = Results(options.out)
        write_optimum(found, results)
        print(f"\n{results.listed()}")
    return 0 if found.status == "optimal" else 1


def _trade_off(machine: Machine, options: argparse.Namespace) -> int:
    request = parse_request(machine, options)
    front = run_trade_off(machine, request, options.trade_off, points=options.points, model=options.model)
    print(f"{machine.name}\n{trade_off_text(front)}")
    if options.out is not None:
        results = Results(options.out)
        write_trade_off(front, results)
        print(f"\n{results.listed()}")
    return 0


def _machine(options: argparse.Namespace) -> Machine:
    machine = load_machine(options.machine)
    return machine if options.duty is None else machine.with_duty(options.duty)


def study(options: argparse.Namespace) -> int:
    """Work a machine through: tables, pictures, JSON."""
    machine = _machine(options)
    for frequency in options.frequency:
        if not 0 < frequency < float("inf"):
            raise ValueError(f"--frequency: found {frequency:g} Hz, expected a finite number above zero")
    if options.points < 1:
        raise ValueError(f"--points: found {options.points}, expected 1 or more")
    frequencies = frequency_grid(options.frequency, options.points)
    results = Results(options.out)
    # A lazy door: cvxpy takes a second to load, and not every command needs it.
    from ltvpneu.face.study_design import design_text, n_design_parts, run_design
    from ltvpneu.face.warm import beside

    springless = machine.load.spring_stiffness == 0
    points = options.operating_points or ("fitted" if springless else "lti")
    if springless:
        print("The load has no spring, so no position is balanced by itself: there is no LTI model to compare, and the")
        print(f"LTV model takes operating points {points!r}.\n")
    total = n_parts(machine, options.frequency, frequencies)
    switches = not isinstance(machine.valve, ProportionalValve)
    total += n_design_parts(options.frequency) if switches else 0
    # Where the equations have to be compiled, those of the design part are at the same time.
    with beside("cycles of linear models", "design"), tqdm(total=total, desc="study", unit="part", leave=False) as bar:
        found = run_study(
            machine,
            options.frequency,
            n_steps=options.n_steps,
            operating_points=points,
            grid=frequencies,
            progress=bar.update,
        )
        # The first tables need not wait for the last.
        bar.write(study_text(found))
        has_orbits = any(case.orbits for case in found.cases)
        if has_orbits:
            # Kept, should what follows be stopped.
            write_study(found, results)
        designed = run_design(machine, options.frequency, bar.update) if switches and has_orbits else None
    if not has_orbits:
        raise ValueError("no model gave an orbit at any frequency; the reasons stand in the tables above")
    if designed is None:
        print("The valve is proportional and has no duty cycle to map or to design; in Python, duty_problem takes its")
        print("command's points, pressures and frequency as variables.\n")
    else:
        print(design_text(designed))
        write_design(found, designed, results)
    print(results.listed())
    return 0


def write_study(study: Study, results: Results) -> None:
    """Write the numbers of a study and its pictures."""
    # A lazy door: matplotlib takes longer to load than the study to run.
    from ltvpneu.face import pictures

    machine = study.machine
    results.data("study", study_data(study))
    models = [case.models["ltv"] for case in study.cases if "ltv" in case.models]
    results.picture("valve_areas", pictures.draw(models[0] if models else machine.at(study.cases[0].frequency)))
    for case in study.cases:
        if case.orbits:
            label = f"{case.frequency:g}_Hz".replace(".", "p")
            title = f"{machine.name}: cycle at {case.frequency:g} Hz, duty {machine.duty:.3g}"
            orbits = {LABELS[name]: orbit for name, orbit in case.orbits.items()}
            results.picture(f"cycle_{label}", pictures.draw_cycles(orbits, title))
    free = study.frictionless_amplitudes if study.frictionless else None
    results.picture("amplitude", pictures.draw_amplitudes(study.response, free))
    found = {f"{case.frequency:g} Hz": case.floquets["ltv"] for case in study.cases if "ltv" in case.floquets}
    if found:
        results.picture("multipliers", pictures.draw(found))


def write_design(study: Study, designed: "DesignStudy", results: Results) -> None:
    """Write the numbers of a study again, with those of the design beside them, and the design's pictures."""
    from ltvpneu.face import pictures
    from ltvpneu.face.study_design import design_data

    results.data("study", study_data(study) | {"design": design_data(designed)})
    results.picture("duty_map", pictures.draw(designed.duties))
    results.picture("stability_map", pictures.draw(designed.stability))
    if designed.optimum is not None:
        results.picture("optimum", pictures.draw(designed.optimum))


def stability(options: argparse.Namespace) -> int:
    """Print the verdict of the LTV model at each frequency."""
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


def sweep(options: argparse.Namespace) -> int:
    """Map duty and frequency."""
    machine = load_machine(options.machine)
    duties = grid("duty", options.duty, options.points, 1.0)
    frequencies = grid("frequency", options.frequency, options.points, LARGEST)
    results = Results(options.out)
    found = run_sweep(machine, duties, frequencies, options.n_steps, options.operating_points)
    print(f"{machine.name}: {options.points} x {options.points} points\n\n{sweep_text(found)}")
    write_sweep(found, results)
    print(results.listed())
    return 0


def warm(options: argparse.Namespace) -> int:
    """Compile the machine's equations and keep them on disk."""
    if options.jobs is not None and options.jobs < 1:
        raise ValueError(f"--jobs: found {options.jobs}, expected 1 or more")
    # A lazy door: it needs all that the package has.
    from ltvpneu.face.warm import warm as compile_all

    found = compile_all(options.jobs)
    where = f"kept in {found.folder}" if found.folder else "not kept: no folder can be written to"
    print(f"{found.compiled} parts compiled, {found.loaded} found on disk, in {found.seconds:.0f} s; {where}")
    return 0
