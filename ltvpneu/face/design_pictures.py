"""Pictures of what `ltvpneu.design` returns; loaded only for these."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu.design.control.closed_loop import ClosedLoop
from ltvpneu.design.duty_map import DutyMap
from ltvpneu.design.moves.solution import MoveSolution
from ltvpneu.design.pattern.pattern import PatternSolution
from ltvpneu.design.stability_map import StabilityMap
from ltvpneu.design.switching.duty_solution import DutySolution
from ltvpneu.design.switching.trade_off import TradeOff
from ltvpneu.face.move_pictures import draw_move
from ltvpneu.face.shown import PALETTE, objective_unit
from ltvpneu.models.cycles.orbit_map import OrbitMap
from ltvpneu.models.machine.machine import Machine
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.orbits.steady import steady_state
from ltvpneu.physics.on_off_valve import OnOffValve

MARKERS = "osD^vP*X"
MOST_NAMED = 3
"""Settings that a title names at most."""


def draw_design(result: object) -> Figure | None:
    """Draw a result of the design layer; None for one that has no picture."""
    if isinstance(result, DutyMap):
        return draw_duty_map(result)
    if isinstance(result, ClosedLoop):
        return draw_closed_loop(result)
    if isinstance(result, DutySolution):
        return draw_optimum(result)
    if isinstance(result, PatternSolution):
        return draw_pattern(result)
    if isinstance(result, TradeOff):
        return draw_trade_off(result)
    if isinstance(result, MoveSolution):
        return draw_move(result)
    if isinstance(result, StabilityMap):
        return draw_stability_map(result)
    return None


def draw_duty_map(found: DutyMap) -> Figure:
    """Mean position and amplitude over duty, one line a frequency; hollow where stiction holds the piston.

    Where the start decides, every orbit that was found has its own mark, and no line joins them.
    """
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    orbits = found.orbits
    for row, frequency in enumerate(orbits.frequencies):
        style = {"color": PALETTE[row % len(PALETTE)], "marker": MARKERS[row % len(MARKERS)], "markersize": 4}
        for axes, name, values in ((upper, "mean", found.means), (lower, "amplitude", found.amplitudes)):
            duties, lines = _unbroken(orbits, row, values[row])
            axes.plot(duties, 1e3 * lines, label=f"{frequency:g} Hz", **style)
            stars = {"linestyle": "none", "marker": "*", "markersize": 9, "color": style["color"]}
            axes.plot(*_branch_points(orbits, row, name), **stars)
        held = np.array([kind == "band" for kind in orbits.kinds[row]])
        upper.plot(
            orbits.duties[held], 1e3 * found.means[row][held], linestyle="none", marker="o", markersize=8,
            markerfacecolor="none", color=style["color"],
        )  # fmt: skip
    if any("band" in row for row in orbits.kinds):
        upper.plot([], [], linestyle="none", marker="o", markersize=8, markerfacecolor="none", color="0.3",
                   label="held by stiction")  # fmt: skip
    if orbits.depends_on_start.any():
        upper.plot([], [], linestyle="none", marker="*", markersize=9, color="0.3", label="depends on the start")
    upper.set_ylabel("mean position [mm]")
    lower.set_ylabel("amplitude [mm]")
    lower.set_xlabel("duty [-]")
    upper.set_title(f"{orbits.machine.name}: duty map", fontsize=11)
    upper.legend(fontsize=8)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure


def _unbroken(orbits: OrbitMap, row: int, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return duties and values for a line, broken where the start decides and where the piston jumps."""
    duties, shown = orbits.duties, np.where(orbits.depends_on_start[row], np.nan, values)
    gap = orbits.unheld(float(orbits.frequencies[row]))
    if gap is None:
        return duties, shown
    beside = [sorted(pair) for pair in pairwise(orbits.means[row])]
    jumps = [i for i, (low, high) in enumerate(beside, start=1) if low <= gap[0] and high >= gap[1]]
    return np.insert(duties, jumps, np.nan), np.insert(shown, jumps, np.nan)


def _branch_points(orbits: OrbitMap, row: int, name: str) -> tuple[list[float], list[float]]:
    """Return duties and values [mm] of all orbits where the start decides."""
    points = [
        (float(orbits.duties[column]), 1e3 * float(getattr(branch, name)))
        for column in np.flatnonzero(orbits.depends_on_start[row])
        for branch in orbits.branches[row][column]
    ]
    return [duty for duty, _ in points], [value for _, value in points]


def draw_stability_map(found: StabilityMap) -> Figure:
    """Ripple as shades, stiction bands and unstable models as marks, outlines of what is certified."""
    figure = Figure(figsize=(7.4, 5.4), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("0.85")
    shades = axes.pcolormesh(found.frequencies, found.duties, 1e3 * found.amplitudes.T, cmap="Blues", vmin=0.0)
    figure.colorbar(shades, ax=axes, label="amplitude of the position, nonlinear [mm]")
    frequency, duty = np.meshgrid(found.frequencies, found.duties, indexing="ij")
    marks = [
        ("held by stiction", ~found.is_isolated & np.isfinite(found.amplitudes), "x", PALETTE[3]),
        ("depends on the start", found.depends_on_start, "*", PALETTE[4]),
        ("LTV model not stable", np.isfinite(found.spectral_radii) & ~found.is_stable, "^", PALETTE[2]),
    ]
    handles: list[Artist] = []
    for label, where, marker, colour in marks:
        if where.any():
            handles += axes.plot(
                frequency[where], duty[where], linestyle="none", marker=marker, color=colour, markersize=4, label=label
            )
    rate = "" if found.certificate is None else f", box: {found.certificate.decay_rate:.2g} 1/s"
    outlines: list[tuple[str, BoolArray, Any, Any]] = [
        (f"certified: the LTV model's steps under any switching{rate}", found.is_certified, "-", PALETTE[1]),
        ("certified: every G (8b) along the cycle", found.is_certified & found.stays_in_box, "--", "0.1"),
    ]
    for label, where, style, colour in outlines:
        if where.any():
            _outline(axes, found.frequencies, found.duties, where, style, colour)
            handles.append(Line2D([], [], color=colour, linestyle=style, label=label))
    axes.set_xlabel("valve frequency [Hz]")
    axes.set_ylabel("duty [-]")
    axes.set_title(f"{found.machine.name}: stability and ripple", fontsize=11)
    if handles:
        axes.legend(handles=handles, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    return figure


def _outline(
    axes: Axes, frequencies: FloatArray, duties: FloatArray, where: BoolArray, style: Any, colour: Any
) -> None:
    """Draw round the points where something holds, along the edges of their cells."""
    sides = [_cell_edges(frequencies), _cell_edges(duties)]
    padded = np.pad(where, 1)
    lines: list[Any] = []
    for row, column in np.argwhere(np.diff(padded, axis=0)):
        if 0 < column <= duties.size:
            x = sides[0][row]
            lines.append([(x, sides[1][column - 1]), (x, sides[1][column])])
    for row, column in np.argwhere(np.diff(padded, axis=1)):
        if 0 < row <= frequencies.size:
            y = sides[1][column]
            lines.append([(sides[0][row - 1], y), (sides[0][row], y)])
    axes.add_collection(LineCollection(lines, colors=colour, linestyles=style, linewidths=2.0, clip_on=False))


def _cell_edges(values: FloatArray) -> FloatArray:
    if values.size == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middles = (values[:-1] + values[1:]) / 2
    return np.concatenate([[2 * values[0] - middles[0]], middles, [2 * values[-1] - middles[-1]]])


def draw_closed_loop(done: ClosedLoop) -> Figure:
    """Position, its mean over each period and the reference; below, the duty."""
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    period = 1 / done.frequency
    edges = period * np.arange(done.references.size + 1)
    upper.plot(done.response.time, 1e3 * done.response.states[0], color="0.7", linewidth=0.8, label="position")
    upper.stairs(1e3 * done.mean_positions, edges, baseline=None, color=PALETTE[0], linewidth=1.6, zorder=3,
                 label="mean over the period")  # fmt: skip
    upper.stairs(
        1e3 * done.references, edges, baseline=None, color=PALETTE[1], linestyle="--", zorder=4, label="reference"
    )
    n = done.references.size
    for valve, (asked, made) in enumerate(
        zip(done.commands.reshape(n, -1).T, done.duties.reshape(n, -1).T, strict=True)
    ):
        of = "the valve" if done.commands.ndim == 1 else f"valve {valve + 1}"
        color = PALETTE[0] if done.commands.ndim == 1 else PALETTE[valve % len(PALETTE)]
        told = PALETTE[1] if done.commands.ndim == 1 else "0.5"
        lower.stairs(asked, edges, baseline=None, color=told, linestyle=":", label=f"asked of {of}")
        lower.stairs(made, edges, baseline=None, color=color, label=f"made by {of}")
    upper.set_ylabel("position [mm]")
    lower.set_ylabel("duty [-]")
    lower.set_xlabel("time [s]")
    upper.set_title(f"{done.machine.name}: closed loop at {done.frequency:g} Hz", fontsize=11)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def draw_optimum(found: DutySolution) -> Figure:
    """Position over the period: the linear model it was designed on, and the nonlinear machine in every scenario."""
    orbits: dict[str, Orbit | str] = {}
    if found.model is not None:
        orbits["linear model"] = found.model.orbit
    orbits |= {f"nonlinear{'' if name == 'nominal' else ', ' + name}": o for name, o in found.nonlinear.items()}
    if found.corrected is not None:
        orbits["nonlinear, corrected"] = found.corrected.nonlinear["nominal"]
    # Of many edges the lower panel tells more than a title could.
    settings = ", ".join(f"{name} {value:.4g}" for name, value in found.values.items() if name != "frequency")
    shown = f": {settings}" if len(found.values) <= MOST_NAMED else ""
    title = f"{found.machine.name} at {found.frequency:.4g} Hz{shown} ({found.status})"
    return _cycles_and_openings(orbits, found.machine, found.frequency, title)


def draw_trade_off(found: TradeOff) -> Figure:
    """Front of both objectives, on the model and on the nonlinear machine, and the cycles at its ends."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    front, cycles = figure.subplots(1, 2)
    (first, across), (second, along) = ((name, objective_unit(name)) for name in found.minimize)
    x, y = along.factor * found.values[:, 1], across.factor * found.values[:, 0]
    front.plot(x, y, color=PALETTE[0], marker="." if len(x) > 1 else "o", label="model")
    machine = along.factor * found.nonlinear_values[:, 1], across.factor * found.nonlinear_values[:, 0]
    front.plot(*machine, linestyle="none", marker="o", markerfacecolor="none", color=PALETTE[1],
               label="nonlinear machine")  # fmt: skip
    front.set_xlabel(_with_unit(second, along.symbol))
    front.set_ylabel(_with_unit(first, across.symbol))
    ends = {f"least {first}": found.solutions[0], f"least {second}": found.solutions[-1]}
    for number, (name, one) in enumerate(ends.items()):
        orbit = one.nonlinear["nominal"]
        if isinstance(orbit, Orbit) and (number == 0 or not found.is_single):
            times = np.linspace(0.0, orbit.period, 400)
            label = f"{name}: {one.frequency:.4g} Hz"
            cycles.plot(1e3 * times, 1e3 * orbit.at(times)[0], color=PALETTE[2 + number], label=label)
    cycles.set_xlabel("time [ms]")
    cycles.set_ylabel("position [mm]")
    for axes in (front, cycles):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    what = "do not conflict" if found.is_single else f"{len(x)} points"
    figure.suptitle(f"{found.solutions[0].machine.name}: {first} against {second}, {what}", fontsize=11)
    return figure


def _with_unit(name: str, symbol: str) -> str:
    return name.replace("_", " ") + (f" [{symbol}]" if symbol else "")


def draw_pattern(found: PatternSolution) -> Figure:
    """Position over the period on the linear model and the nonlinear machine; below, the slots."""
    if found.system is None or found.machine is None:
        raise TypeError("plot: found an infeasible pattern, which has no picture")
    orbits: dict[str, Orbit | str] = {
        "linear model": steady_state(found.system),
        "nonlinear": found.nonlinear,
    }
    title = f"{found.machine.name} at {found.frequency:.4g} Hz: {found.pattern.size} slots, {found.n_pulses} pulses"
    return _cycles_and_openings(orbits, found.machine, found.frequency, title)


def _cycles_and_openings(orbits: dict[str, Orbit | str], machine: Machine, frequency: float, title: str) -> Figure:
    figure = Figure(figsize=(7, 5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[4, 1])
    times = np.linspace(0.0, 1 / frequency, 600)
    for number, (name, orbit) in enumerate(orbits.items()):
        if isinstance(orbit, str):
            continue
        style = {"color": PALETTE[number % len(PALETTE)], "linestyle": ["-", "--", ":", "-."][number % 4]}
        label = f"{name}: mean {1e3 * orbit.mean(0):.1f} mm, amplitude {1e3 * orbit.amplitude(0):.2f} mm"
        upper.plot(1e3 * times, 1e3 * orbit.at(times)[0], label=label, **style)
    valve = machine.valve
    on = (valve.open_window(frequency) if isinstance(valve, OnOffValve) else valve.on_window()).profile
    angles = np.linspace(0.0, 2 * np.pi, 1200, endpoint=False)
    lower.fill_between(
        1e3 * angles / (2 * np.pi * frequency), [on.at(float(angle)) for angle in angles], color=PALETTE[0], alpha=0.4,
        step="post",
    )  # fmt: skip
    upper.set_ylabel("position [mm]")
    lower.set_ylabel("valve open")
    lower.set_yticks([0, 1])
    lower.set_xlabel("time [ms]")
    upper.set_title(title, fontsize=10)
    upper.legend(fontsize=8)
    upper.grid(alpha=0.3)
    return figure
