"""Tables of a study for the terminal, in shop units."""

import math
from collections.abc import Sequence

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.face.study import Case, Study
from ltvpneu.face.tables import heading, table
from ltvpneu.face.units import pressure_shown
from ltvpneu.models.linear.error_estimate import ErrorEstimate
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import Attractors, describe
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.models.nonlinear.stiction_band import StictionBand
from ltvpneu.periodic.orbits.floquet import Floquet
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.real_gas import RealGas

MOST_PLACES = 3
"""Points that a reason for failures names."""
REST_OF = 1e4
"""Ratio to the true amplitude from which on an estimated error says that the machine rests [-]."""
LABELS = {"nonlinear": "nonlinear", "ltv": "LTV", "lti": "LTI"}


def study_text(study: Study) -> str:
    """Return the whole report."""
    machine = study.machine
    parts = [heading(f"{machine.name}: the machine"), machine_table(machine)]
    parts += [heading("Where are the models linearized, and what are G_m and f_m?"), operating_text(study)]
    parts += [heading("Is it stable?"), stability_table(study.cases)]
    if study.frictionless:
        title = "What is the periodic steady state? (dry friction in the nonlinear model only)"
        parts += [heading(title), cycle_table(study.cases)]
        parts += [
            heading("The same without dry friction: like against like"),
            cycle_table(study.frictionless),
        ]
    else:
        parts += [heading("What is the periodic steady state?"), cycle_table(study.cases)]
    parts += [heading("How does the amplitude fall with frequency?"), response_table(study)]
    return "\n".join(parts) + "\n"


def machine_table(machine: Machine) -> str:
    """Return what the machine is, in shop units."""
    cylinder, load = machine.cylinder, machine.load
    chambers = ", ".join(name.replace("_", " ") for name in cylinder.chambers)
    rows = [
        ["supply pressure", pressure_shown(machine.supply_pressure, machine.ambient_pressure)],
        ["exhaust pressure", pressure_shown(machine.exhaust_pressure, machine.ambient_pressure)],
        [
            "ambient pressure",
            f"{machine.ambient_pressure / 1e5:.4g} bar(a), pushes with {ambient_force(machine):.4g} N",
        ],
        ["duty cycle", f"{machine.duty:.4g}"],
        ["chambers", f"{chambers} ({'single' if len(cylinder.chambers) == 1 else 'double'}-acting)"],
        [
            "piston areas 1 / 2",
            f"{1e6 * cylinder.piston_area_1:.4g} / {1e6 * cylinder.piston_area_2:.4g} mm²",
        ],
        [
            "mass, spring, damping",
            f"{load.mass:.4g} kg, {load.spring_stiffness:.4g} N/m, {load.viscous_damping:.4g} N s/m",
        ],
        ["dry friction / stiction", f"{load.dry_friction:.4g} / {load.stiction:.4g} N"],
        ["collapse of the valve's volume", machine.collapse],
        ["medium", medium_text(machine)],
        *([f"process in {name.replace('_', ' ')}", process_text(machine, k)] for k, name in enumerate(machine.volumes)),
    ]
    # Of a valve with delays they are open at other angles at each frequency, by as much.
    for connection in machine.at(machine.switching_frequency or 1.0).connections:
        area = 1e6 * float(np.max([connection.first.starts.max(), connection.first.ends.max()]))
        rows.append(
            [
                f"{connection.source.replace('_', ' ')} to {connection.chamber.replace('_', ' ')}",
                f"at most {area:.4g} mm² effective",
            ]
        )
    width = max(len(row[0]) for row in rows)
    return "\n".join(f"  {name.ljust(width)}   {value}" for name, value in rows)


def ambient_force(machine: Machine) -> float:
    """Return the force of the ambient air on rods and an open side, towards higher positions [N]."""
    return machine.cylinder.ambient_push_area * machine.ambient_pressure


def medium_text(machine: Machine) -> str:
    """Return what flows."""
    gas = machine.gas
    if isinstance(gas, Liquid):
        modulus = gas.effective_bulk_modulus(machine.supply_pressure) / 1e9
        return f"liquid of {gas.density:.4g} kg/m³, bulk modulus {modulus:.3g} GPa at supply pressure"
    if isinstance(gas, RealGas):
        return f"real gas: {gas.fluid} at {gas.temperature:.5g} K"
    return f"ideal gas, γ = {gas.heat_capacity_ratio:.4g}, R = {gas.specific_gas_constant:.5g} J/(kg K)"


def process_text(machine: Machine, k: int) -> str:
    """Return the thermal process of volume k."""
    volume = machine.volume_fields[k]
    if isinstance(machine.gas, Liquid):
        return "by its bulk modulus"
    if volume.temperature_place >= 0:
        conductance, wall = volume.conductance, volume.wall_temperature
        return f"energy balance, wall {conductance:.3g} W/K at {wall:.5g} K" if conductance else "adiabatic"
    exponent = volume.polytropic_exponent
    return "isothermal" if exponent == 1 else f"polytropic, n = {exponent:.4g}"


def operating_text(study: Study) -> str:
    """Return operating points of every case, and the matrices of the middle one."""
    machine = study.machine
    rows: list[list[str]] = []
    temperatures = machine.states[2 + machine.n_volumes :]
    for case in study.cases:
        for name, model in case.models.items():
            # The LTI model has one point; it stands in the first row.
            for step, point in enumerate(model.operating_points[: 1 if name == "lti" else None]):
                held = any(h.step == step for h in model.held_back)
                pressures = [
                    shown_number(name, value) for name, value in zip(machine.states[2:], point[2:], strict=True)
                ]
                duration = f"{1e3 * model.system.durations[step]:.4g}"
                position = f"{1e3 * point[0]:.2f}"
                label = f"{case.frequency:g} Hz {LABELS[name]}"
                rows.append([label, str(step + 1), duration, position, *pressures, "yes" if held else ""])
    if not rows:
        return "\n".join(["  none", *failure_lines(study.cases)])
    names = [f"{name.replace('_', ' ')} [{'K' if name in temperatures else 'bar'}]" for name in machine.states[2:]]
    text = [table(["model", "step", "duration [ms]", "position [mm]", *names, "held back"], rows)]
    text += _held_back_text(study)
    case = study.cases[len(study.cases) // 2]
    for name, model in case.models.items():
        text += [
            "",
            f"  {LABELS[name]} at {case.frequency:g} Hz, z = ({', '.join(machine.states)}), SI units:",
        ]
        same = name == "lti"
        for step in range(1 if same else model.system.n_steps):
            text.append(_matrix_text("G" if same else f"G_{step + 1}", model.system.A[step]))
        for step in range(model.system.n_steps):
            text.append("  " + f"f_{step + 1}".ljust(5) + _row_text(model.system.f[step]))
    return "\n".join(text)


def _held_back_text(study: Study) -> list[str]:
    lines: list[str] = []
    for case in study.cases:
        for name, model in case.models.items():
            lines += [
                f"  held back: {case.frequency:g} Hz {LABELS[name]} step {held.step + 1} {held.state}: "
                f"asked {shown(held.state, held.asked)}, used {shown(held.state, held.used)}"
                for held in model.held_back
            ]
    if lines:
        distance = next(model.least_distance for case in study.cases for model in case.models.values())
        reach = "  (Operating points are kept within what the machine reaches with the valve at rest"
        lines += (
            [
                f"{reach}, and at least",
                f"  {100 * distance:g} % away from the pressure of an open source, where the "
                "flow's slope is infinite.)",
            ]
            if study.machine.has_infinite_slopes
            else [f"{reach}.)"]
        )
    return lines


def shown_number(signal: str, value: float) -> str:
    """Return a pressure in bar, or a temperature in K, as it stands in tables."""
    return f"{value:.2f}" if signal.startswith("temperature") else f"{value / 1e5:.4f}"


def shown(signal: str, value: float) -> str:
    """Return a value in the unit in which its signal is shown."""
    units = {"position": (1e3, "mm"), "velocity": (1.0, "m/s")}
    factor, symbol = units.get(signal, (1.0, "K") if signal.startswith("temperature") else (1e-5, "bar"))
    return f"{factor * value:.5g} {symbol}"


def _matrix_text(name: str, matrix: FloatArray) -> str:
    rows = [_row_text(row) for row in matrix]
    return "\n".join("  " + (name if i == 0 else "").ljust(5) + row for i, row in enumerate(rows))


def _row_text(row: FloatArray) -> str:
    return "[" + " ".join(f"{value:12.5g}" for value in row) + " ]"


def stability_table(cases: Sequence[Case]) -> str:
    """Return multipliers and verdicts."""
    rows = [
        [
            f"{case.frequency:g} Hz {LABELS[name]}",
            multipliers_text(found),
            f"{found.spectral_radius:.4g}",
            found.verdict,
            _stability_remark(case, name, found),
        ]
        for case in cases
        for name, found in case.floquets.items()
    ]
    text = table(["model", "multipliers", "radius", "verdict", "remark"], rows) if rows else "  no model to ask"
    return "\n".join([text, *failure_lines(cases)])


def _stability_remark(case: Case, name: str, found: Floquet) -> str:
    model = case.models.get(name)
    if model is not None and model.beyond_stops > 0:
        return f"passes the end stops by {1e3 * model.beyond_stops:.3g} mm"
    return "" if found.orbit is None else found.orbit.rest


def failure_lines(cases: Sequence[Case]) -> list[str]:
    """Return each reason for a failure once, with where it struck."""
    where: dict[str, list[str]] = {}
    for case in cases:
        for name, why in case.failures.items():
            where.setdefault(why, []).append(f"{case.frequency:g} Hz {LABELS[name]}")
    return [f"  failed: {', '.join(places)}: {why}" for why, places in where.items()]


def grouped_failures(failures: Sequence[FailedPoint]) -> list[str]:
    """Return each reason why points of a map failed once, with how often and where first."""
    where: dict[tuple[str, str], list[str]] = {}
    for failed in failures:
        where.setdefault((failed.model, str(failed.error)), []).append(failed.where)
    lines: list[str] = []
    for (model, why), places in where.items():
        more = f" and {len(places) - MOST_PLACES} more points" if len(places) > MOST_PLACES else ""
        lines.append(f"  failed: {model} at {'; '.join(places[:MOST_PLACES])}{more}: {why}")
    return lines


def multipliers_text(found: Floquet) -> str:
    """Return the multipliers, a pair of complex ones as one, and as a power of ten what is beyond double precision."""
    parts: list[str] = []
    for value, log_modulus in zip(found.multipliers, found.log_moduli, strict=True):
        if value == 0 or np.isinf(value):
            parts.append("0" if log_modulus == -np.inf else f"10^{log_modulus / np.log(10):.1f}")
        elif abs(value.imag) <= 1e-12 * abs(value):
            parts.append(f"{value.real:.4g}")
        elif value.imag > 0:
            parts.append(f"{value.real:.4g} ± {value.imag:.4g}j")
    return ", ".join(parts)


def cycle_table(cases: Sequence[Case]) -> str:
    """Return amplitude, mean and pressures of the models, with errors against the nonlinear one."""
    rows: list[list[str]] = []
    machine = cases[0].machine
    pressures = machine.states[2 : 2 + machine.n_volumes]
    for case in cases:
        reference = case.orbits.get("nonlinear")
        for name, orbit in case.orbits.items():
            cells = _cycle_cells(orbit, reference, case.estimates.get(name))
            ranges = [f"{orbit.minimum(p) / 1e5:.3f} to {orbit.maximum(p) / 1e5:.3f}" for p in pressures]
            found = [*remarks(orbit, case.machine, case.bands.get(name)), *depends(case.attractors.get(name))]
            rows.append([f"{case.frequency:g} Hz {LABELS[name]}", *cells, *ranges, ", ".join(found)])
        rows += [
            [f"{case.frequency:g} Hz {LABELS[name]}", "failed", *[""] * (6 + len(pressures))]
            for name in case.failures
            if name not in case.orbits
        ]
    header = ["model", "amplitude [mm]", "error", "estimated", "mean [mm]", "error [mm]", "estimated [mm]"]
    names = [f"{name.replace('_', ' ')} [bar abs]" for name in pressures]
    text = table([*header, *names, "remark"], rows)
    notes = [
        f"  (? {case.frequency:g} Hz {LABELS[name]}: {estimate.verdict})"
        for case in cases
        for name, estimate in case.estimates.items()
        if not estimate.is_reliable
    ]
    return "\n".join([text, *notes, *failure_lines(cases)])


def _cycle_cells(orbit: Orbit, reference: Orbit | None, estimate: ErrorEstimate | None) -> list[str]:
    amplitude, mean = orbit.amplitude("position"), orbit.mean("position")
    error, shift, estimated, estimated_shift = "", "", "", ""
    if estimate is not None:
        # Relative to the estimated true amplitude, which is zero where stiction would hold the piston.
        relative, doubt = estimate.relative_amplitude("position"), "" if estimate.is_reliable else "?"
        estimated = f"{100 * relative:+.1f} %{doubt}" if abs(relative) < REST_OF else f"rests{doubt}"
        estimated_shift = f"{1e3 * estimate.mean('position'):+.2f}{doubt}"
    if reference is not None and orbit is not reference:
        of_reference = reference.amplitude("position")
        # A piston that rests moves by rounding only: a ratio would mean nothing.
        error = f"{100 * (amplitude / of_reference - 1):+.1f} %" if of_reference > 1e-7 else ""
        shift = f"{1e3 * (mean - reference.mean('position')):+.2f}"
    return [f"{1e3 * amplitude:.3f}", error, estimated, f"{1e3 * mean:.2f}", shift, estimated_shift]


def remarks(orbit: Orbit, machine: Machine, band: StictionBand | None = None) -> list[str]:
    """Return what is special about an orbit, and where a linear one leaves what the machine can do."""
    found: list[str] = []
    if not orbit.is_isolated:
        within = f"one of a stiction band, {1e3 * band.lowest:.2f} to {1e3 * band.highest:.2f} mm" if band else ""
        found += [text for text in (orbit.rest, within) if text] or ["one of a stiction band"]
    elif orbit.rest:
        found.append(orbit.rest)
    if orbit.n_periods > 1:
        found.append(f"repeats every {orbit.n_periods} periods")
    low, high = orbit.minimum("position"), orbit.maximum("position")
    lower, upper = machine.cylinder.lower_stop, machine.cylinder.upper_stop
    tolerance = 1e-9 + 1e-6 * (high - low)
    if low < lower - tolerance or high > upper + tolerance:
        found.append("passes the end stops")
    elif not orbit.rest and not machine.cylinder.is_absent and (low <= lower + tolerance or high >= upper - tolerance):
        found.append("rests on an end stop for a while")
    lowest = machine.gas.vapor_pressure if isinstance(machine.gas, Liquid) else 0.0
    for name in machine.states[2 : 2 + machine.n_volumes]:
        if orbit.minimum(name) <= 0:
            found.append(f"{name.replace('_', ' ')} below vacuum")
        elif orbit.minimum(name) < lowest:
            found.append(f"{name.replace('_', ' ')} below vapor pressure")
        elif orbit.minimum(name) < 0.98 * machine.exhaust_pressure:
            found.append(f"{name.replace('_', ' ')} below exhaust")
        if orbit.maximum(name) > 1.02 * machine.supply_pressure:
            found.append(f"{name.replace('_', ' ')} above supply")
    return found


def depends(settled: Attractors | None) -> list[str]:
    """Return where else the machine settles from other starts, if it does."""
    if settled is None or settled.is_single or not settled.orbits:
        return []
    others = [describe(orbit) for i, orbit in enumerate(settled.orbits) if i != settled.reached[0]]
    return [f"depends on the start: also {'; '.join(others) or 'what does not repeat'}"]


def response_table(study: Study) -> str:
    """Return amplitude over frequency."""
    response = study.response
    rows: list[list[str]] = []
    for column, frequency in enumerate(response.frequencies):
        cells = [f"{1e3 * value:.3f}" if math.isfinite(value) else "failed" for value in response.amplitudes[:, column]]
        free = [f"{1e3 * study.frictionless_amplitudes[column]:.3f}"] if study.frictionless else []
        rows.append([f"{frequency:.3g}", *cells, *free, _response_remark(study, column)])
    header = ["frequency [Hz]", *(f"{LABELS[m]} [mm]" for m in response.models)]
    free = ["nonlinear without dry friction [mm]"] if study.frictionless else []
    reasons: dict[tuple[str, str], list[str]] = {}
    for f in response.failures:
        reasons.setdefault((LABELS[f.model], str(f.error)), []).append(f"{f.frequency:.3g}")
    failures = [f"  failed: {model} at {', '.join(at)} Hz: {why}" for (model, why), at in reasons.items()]
    return "\n".join([table([*header, *free, "remark"], rows), *failures])


def _response_remark(study: Study, column: int) -> str:
    response = study.response
    row = response.models.index("nonlinear")
    found: list[str] = []
    if response.is_isolated[row, column] == 0:
        found.append("stiction band")
    if response.n_periods[row, column] > 1:
        found.append(f"period {int(response.n_periods[row, column])}")
    return ", ".join(found)
