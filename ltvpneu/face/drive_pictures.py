"""Pictures of strokes, of their work, and of what duties hold."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ltvpneu._arrays import FloatArray
from ltvpneu.face.shown import PALETTE, unit_of
from ltvpneu.models.cycles.data_sheet import DataSheet, Switching
from ltvpneu.models.nonlinear.stroke import Stroke
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.liquid import Liquid


def draw_strokes(sheet: DataSheet) -> Figure:
    """Position, velocity and pressures of both strokes over time from the valve's switching."""
    # Placed by hand: the automatic layout draws all of it twice.
    figure = Figure(figsize=(9, 6.5))
    axes = figure.subplots(3, len(sheet.strokes), sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.08, top=0.9, hspace=0.1, wspace=0.08)
    for column, one in enumerate(sheet.strokes.values()):
        draw_stroke(one, list(axes[:, column]))
        for ax in axes[:, column] if column else ():
            ax.set_ylabel("")
        said = f"{1e3 * one.time:.1f} ms, {one.end_velocity:.3g} m/s at the stop" if one.arrives else "does not arrive"
        axes[0, column].set_title(f"stroke {one.direction}: {said}", fontsize=10)
    figure.suptitle(f"{sheet.machine.name}: strokes", fontsize=11)
    return figure


def draw_one_stroke(one: Stroke) -> Figure:
    """Position, velocity and pressures of a stroke over time from the valve's switching."""
    figure = Figure(figsize=(7, 6.5))
    axes = figure.subplots(3, 1, sharex=True)
    figure.subplots_adjust(left=0.1, right=0.97, bottom=0.08, top=0.93, hspace=0.1)
    draw_stroke(one, list(axes))
    figure.suptitle(f"{one.machine.name}: stroke {one.direction}", fontsize=11)
    return figure


def draw_stroke(one: Stroke, axes: list[Axes]) -> None:
    """Draw one stroke into three axes: position, velocity, pressures."""
    machine, times, values = one.machine, 1e3 * one.times, one.states
    for ax, signal in zip(axes, ("position", "velocity"), strict=False):
        unit = unit_of(signal)
        ax.plot(times, unit.factor * values[machine.states.index(signal)], color="0.15", linewidth=1.8)
        ax.set_ylabel(f"{signal} [{unit.symbol}]")
    for k, name in enumerate(machine.states[2 : 2 + machine.n_volumes]):
        axes[2].plot(times, 1e-5 * values[2 + k], color=PALETTE[k % len(PALETTE)], label=name.replace("_", " "))
    for stop in (machine.cylinder.lower_stop, machine.cylinder.upper_stop):
        axes[0].axhline(1e3 * stop, color="0.6", linewidth=0.8, linestyle=":")
    for source, level in (("supply", machine.supply_pressure), ("exhaust", machine.exhaust_pressure)):
        axes[2].axhline(1e-5 * level, color="0.6", linewidth=0.8, linestyle=":")
        axes[2].annotate(source, (times[-1], 1e-5 * level), fontsize=7, color="0.4", ha="right", va="bottom")
    axes[2].set_ylabel("pressure [bar abs]")
    axes[2].legend(fontsize=8, loc="center right")
    axes[2].set_xlabel("time from the valve's switching [ms]")
    for ax in axes:
        ax.grid(alpha=0.3)
        if one.arrives:
            ax.axvline(1e3 * one.time, color=PALETTE[1], linewidth=1, linestyle="--")


def draw_work(sheet: DataSheet) -> Figure:
    """Pressures over the position: what each encloses is the work of its chamber."""
    figure = Figure(figsize=(7, 4.4))
    ax = figure.subplots()
    figure.subplots_adjust(left=0.09, right=0.97, bottom=0.12, top=0.92)
    machine = sheet.machine
    styles = {"out": "-", "in": "--"}
    for direction, one in sheet.strokes.items():
        values = one.states
        for k, name in enumerate(machine.states[2 : 2 + machine.n_volumes]):
            ax.plot(1e3 * values[0], 1e-5 * values[2 + k], linestyle=styles[direction], color=PALETTE[k % len(PALETTE)],
                    label=f"{name.replace('_', ' ')}, stroke {direction}")  # fmt: skip
    ax.set_xlabel("position [mm]")
    ax.set_ylabel("pressure [bar abs]")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    ax.set_title(f"{machine.name}: pressures over the position", fontsize=11)
    return figure


def draw_switching(found: Switching) -> Figure:
    """Mean position and ripple, and air, over the commanded duty."""
    orbits = found.orbits
    figure = Figure(figsize=(7, 5.6))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    figure.subplots_adjust(left=0.1, right=0.97, bottom=0.09, top=0.93, hspace=0.08)
    low, high = orbits.machine.cylinder.lower_stop, orbits.machine.cylinder.upper_stop
    # Of a duty with several orbits each is a point; between duties that share one side a line is drawn.
    for duty, branches in zip(orbits.duties, orbits.branches[0], strict=True):
        for branch in branches:
            # Half the span on either side of the mean, no further than the stops.
            reach = [[min(branch.amplitude, branch.mean - low)], [min(branch.amplitude, high - branch.mean)]]
            above.errorbar(
                duty, 1e3 * branch.mean, yerr=1e3 * np.maximum(reach, 0.0), fmt="o", markersize=5, capsize=3,
                color=PALETTE[0] if len(branches) == 1 else PALETTE[1],
            )  # fmt: skip
    gap = found.unheld
    if gap is not None:
        above.axhspan(1e3 * gap[0], 1e3 * gap[1], color="0.6", alpha=0.25, label="held by no duty")
    for stop in (low, high):
        above.axhline(1e3 * stop, color="0.6", linewidth=0.8, linestyle=":")
    above.plot([], [], "o", color=PALETTE[0], label="mean and ripple, whatever the start")
    above.plot([], [], "o", color=PALETTE[1], label="depends on the start")
    is_air = not isinstance(orbits.machine.gas, Liquid)
    flows = found.mass_flows * (6e4 / ANR_DENSITY if is_air else 60.0)
    below.plot(orbits.duties, flows, "o-", color=PALETTE[4], markersize=4)
    for ax in (above, below):
        for edge in found.duty_band:
            ax.axvline(edge, color="0.4", linewidth=0.8, linestyle="--")
        ax.grid(alpha=0.3)
    above.set_ylabel("position [mm]")
    above.legend(fontsize=8)
    below.set_ylabel("air [Nl/min]" if is_air else "drawn [kg/min]")
    below.set_ylim(bottom=0)
    below.set_xlabel("commanded duty (dashed: where the valve's times leave it shut or open)")
    figure.suptitle(f"{orbits.machine.name}: switched at {found.frequency:.4g} Hz", fontsize=11)
    return figure


def draw_transient(
    title: str, states: tuple[str, ...], times: FloatArray, values: FloatArray, stops: tuple[float, float] | None
) -> Figure:
    """All states of a transient over time; `values` (n_states, n_times); `stops` None where there is no piston."""
    times = 1e3 * times
    # Without a cylinder there is nothing to see of its piston.
    groups = {"position": ["position"], "velocity": ["velocity"]} if stops is not None else {}
    groups["pressure"] = [name for name in states if name.startswith("pressure")]
    if warm := [name for name in states if name.startswith("temperature")]:
        groups["temperature"] = warm
    figure = Figure(figsize=(8, 1.2 + 1.9 * len(groups)), layout="constrained")
    axes = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (what, names) in zip(axes, groups.items(), strict=True):
        unit = unit_of(what)
        for k, name in enumerate(names):
            color = "0.15" if len(names) == 1 else PALETTE[k % len(PALETTE)]
            ax.plot(times, unit.factor * values[states.index(name)], color=color, label=name.replace("_", " "))
        ax.set_ylabel(f"{what} [{unit.symbol.replace('bar', 'bar abs')}]")
        ax.grid(alpha=0.3)
        if len(names) > 1:
            ax.legend(fontsize=8)
    for stop in stops or ():
        if np.isfinite(stop):
            axes[0].axhline(1e3 * stop, color="0.6", linewidth=0.8, linestyle=":")
    axes[-1].set_xlabel("time [ms]")
    axes[-1].set_xlim(times[0], times[-1])
    figure.suptitle(title, fontsize=11)
    return figure
