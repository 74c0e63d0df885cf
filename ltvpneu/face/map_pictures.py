"""Pictures of maps over frequency and duty."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ltvpneu.face.shown import PALETTE
from ltvpneu.models.cycles.orbit_map import KINDS, SAID, OrbitMap
from ltvpneu.models.cycles.validity_map import ValidityMap

GROUND = "0.85"
LEVELS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Relative errors at which the shades change [-]."""


def draw_orbit_map(found: OrbitMap) -> Figure:
    """Kinds of orbits over frequency and duty, with the periods of subharmonics."""
    figure, axes = _axes(f"{found.machine.name}: what the machine settles on")
    numbers = np.array([[KINDS.index(kind) for kind in row] for row in found.kinds], dtype=np.float64)
    colours = ["0.92", PALETTE[0], PALETTE[1], PALETTE[2], PALETTE[4], "0.4"]
    most = len(KINDS) - 0.5
    axes.pcolormesh(found.frequencies, found.duties, numbers.T, cmap=ListedColormap(colours), vmin=-0.5, vmax=most)
    for row, column in np.argwhere(numbers == KINDS.index("subharmonic")):
        label = f"{found.n_periods[row, column]:.0f}"
        axes.text(
            float(found.frequencies[row]), float(found.duties[column]), label, ha="center", va="center", fontsize=7
        )
    handles = [
        Patch(color=colour, label=f"{SAID.get(kind, kind)} ({found.count(kind)})")
        for kind, colour in zip(KINDS, colours, strict=True)
        if found.count(kind)
    ]
    axes.legend(handles=handles, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=len(handles))
    return figure


def draw_validity_map(found: ValidityMap) -> Figure:
    """Estimated relative errors of the amplitude over frequency and duty."""
    title = f'{found.machine.name}: estimated error of the amplitude, "{found.mode}", {found.n_steps} steps'
    figure, axes = _axes(title)
    norm = BoundaryNorm(LEVELS, 256, extend="max")
    shades = axes.pcolormesh(found.frequencies, found.duties, np.abs(found.errors).T, cmap="viridis_r", norm=norm)
    bar = figure.colorbar(shades, ax=axes, ticks=LEVELS)
    bar.ax.set_yticklabels(_percent(LEVELS))
    # An error relative to no movement is no figure: the ground shows, as where no cycle was found.
    axes.set_facecolor(GROUND)
    if not np.isfinite(found.errors).all():
        patch = Patch(color=GROUND, label="no figure: the piston rests, or no cycle found")
        axes.legend(handles=[patch], fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    return figure


def _percent(levels: Sequence[float]) -> list[str]:
    return [f"{100 * level:g} %" for level in levels]


def _axes(title: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.set_xlabel("valve frequency [Hz]")
    axes.set_ylabel("duty [-]")
    axes.set_title(title, fontsize=11)
    return figure, axes
