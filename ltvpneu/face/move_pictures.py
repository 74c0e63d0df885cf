"""Pictures of moves."""

import numpy as np
from matplotlib.figure import Figure

from ltvpneu.design.moves.solution import MoveSolution
from ltvpneu.face.shown import PALETTE, unit_of


def draw_move(found: MoveSolution) -> Figure:
    """Position, velocity and pressures over the move; below, when each valve is on."""
    machine, times = found.machine, np.linspace(0.0, found.time, 600)
    values = found.way.at(times)
    names = [name for name in machine.states if name.startswith("pressure")]
    figure = Figure(figsize=(7, 6.5), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[3, 2, 3, 0.4 + 0.3 * len(found.delays)])
    for ax, signals in zip(axes, (["position"], ["velocity"], names), strict=False):
        unit = unit_of(signals[0])
        for k, name in enumerate(signals):
            color = "0.15" if len(signals) == 1 else PALETTE[k % len(PALETTE)]
            ax.plot(1e3 * times, unit.factor * values[machine.states.index(name)], color=color, label=name)
        what = signals[0].partition("_")[0]
        ax.set_ylabel(f"{what} [{unit.symbol.replace('bar', 'bar abs')}]")
        ax.grid(alpha=0.3)
        if len(signals) > 1:
            ax.legend([name.replace("_", " ") for name in signals], fontsize=8)
        for time in found.switching_times:
            ax.axvline(1e3 * time, color="0.6", linewidth=0.8, linestyle=":")
    for stop in (machine.cylinder.lower_stop, machine.cylinder.upper_stop):
        if np.isfinite(stop):
            axes[0].axhline(1e3 * stop, color="0.6", linewidth=0.8, linestyle="--")
    edges = np.concatenate([[0.0], np.cumsum(found.durations)])
    for valve in range(len(found.delays)):
        for number, position in enumerate(found.order):
            if position[valve]:
                axes[3].barh(
                    valve, 1e3 * (edges[number + 1] - edges[number]), left=1e3 * edges[number], height=0.6,
                    color=PALETTE[valve % len(PALETTE)],
                )  # fmt: skip
    labels = ["valve on"] if len(found.delays) == 1 else [f"valve {k + 1} on" for k in range(len(found.delays))]
    axes[3].set_yticks(range(len(labels)), labels)
    axes[3].set_ylim(-0.5, len(labels) - 0.5)
    axes[3].set_xlabel("time [ms]")
    axes[3].set_xlim(0.0, 1e3 * found.time)
    figure.suptitle(
        f"{machine.name}: {1e3 * found.way.start[0]:.4g} to {1e3 * found.way.end[0]:.4g} mm in "
        f"{1e3 * found.time:.4g} ms",
        fontsize=11,
    )
    return figure
