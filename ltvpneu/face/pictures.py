"""Pictures of results. Engineering units live here and in the machine files: mm, bar, Hz, ms."""

from collections.abc import Mapping
from typing import Any

import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ltvpneu._arrays import FloatArray
from ltvpneu.face.drive_pictures import draw_one_stroke, draw_strokes, draw_switching
from ltvpneu.face.map_pictures import draw_orbit_map, draw_validity_map
from ltvpneu.face.shown import PALETTE, unit_of
from ltvpneu.models.cycles.amplitude import AmplitudeResponse
from ltvpneu.models.cycles.data_sheet import DataSheet, Switching
from ltvpneu.models.cycles.orbit_map import OrbitMap
from ltvpneu.models.cycles.sensitivity import ParameterSensitivity
from ltvpneu.models.cycles.validity_map import ValidityMap
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.staircase import Staircase, staircase
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import step_means
from ltvpneu.models.nonlinear.attractors import Attractors, describe
from ltvpneu.models.nonlinear.stroke import Stroke
from ltvpneu.periodic.orbits.floquet import Floquet, floquet
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.discrete import DiscretePeriodicSystem
from ltvpneu.periodic.systems.system import PeriodicSystem

# The line styles tell the models apart without colour.
STYLES: dict[str, dict[str, Any]] = {
    "nonlinear": {"color": "0.15", "linestyle": "-", "linewidth": 1.8},
    "ltv": {"color": PALETTE[0], "linestyle": "--", "linewidth": 1.6},
    "lti": {"color": PALETTE[1], "linestyle": ":", "linewidth": 1.8},
}
LABELS = {"nonlinear": "nonlinear", "ltv": "LTV", "lti": "LTI"}


def draw(result: object) -> Figure:
    """Draw any result; see `ltvpneu.plot`."""
    if isinstance(result, Machine):
        return draw_areas(result)
    if isinstance(result, LtvModel):
        return draw_areas(result.machine, _stairs_of(result))
    if isinstance(result, PeriodicSystem | DiscretePeriodicSystem):
        return draw_multipliers({result.name: floquet(result)})
    if isinstance(result, Floquet):
        return draw_multipliers({"": result})
    if isinstance(result, Orbit):
        return draw_cycles({result.name: result}, title=_orbit_title(result))
    if isinstance(result, Attractors):
        return draw_attractors(result)
    if isinstance(result, AmplitudeResponse):
        return draw_amplitudes(result)
    if isinstance(result, ParameterSensitivity):
        return draw_sensitivity(result)
    if isinstance(result, DataSheet):
        return draw_strokes(result)
    if isinstance(result, Stroke):
        return draw_one_stroke(result)
    if isinstance(result, Switching):
        return draw_switching(result)
    if isinstance(result, OrbitMap):
        return draw_orbit_map(result)
    if isinstance(result, ValidityMap):
        return draw_validity_map(result)
    if isinstance(result, Mapping) and result:
        return _draw_mapping(result)
    return _draw_by_itself(result)


def _draw_mapping(result: Mapping[str, object]) -> Figure:
    orbits = {str(label): value for label, value in result.items() if isinstance(value, Orbit)}
    if len(orbits) == len(result):
        return draw_cycles(orbits, title=f"{1 / next(iter(orbits.values())).system_period:.4g} Hz")
    multipliers = {str(label): value for label, value in result.items() if isinstance(value, Floquet)}
    if len(multipliers) == len(result):
        return draw_multipliers(multipliers)
    kinds = sorted({type(value).__name__ for value in result.values()})
    raise TypeError(f"plot: found a dict of {', '.join(kinds)}, expected one of Orbit only or of Floquet only")


def _draw_by_itself(result: object) -> Figure:
    """Draw a response of python-control by its own method."""
    if type(result).__module__.startswith("ltvpneu.design"):
        # Loads cvxpy, which whoever has such a result has loaded.
        from ltvpneu.face.design_pictures import draw_design

        figure = draw_design(result)
        if figure is not None:
            return figure
    method = getattr(result, "plot", None)
    if not type(result).__module__.startswith("control") or method is None:
        raise TypeError(
            f"plot: found {type(result).__name__}, expected a Machine, LtvModel, PeriodicSystem, Floquet, "
            "Orbit, Attractors, DataSheet, Stroke, ParameterSensitivity, AmplitudeResponse, OrbitMap, ValidityMap, "
            "DutyMap, ClosedLoop, "
            "a dict of Orbit or of Floquet, or a response of python-control"
        )
    import matplotlib.pyplot as plt

    # python-control draws over the current figure.
    plt.figure()
    return method().figure


def _orbit_title(orbit: Orbit) -> str:
    repeats = f", repeats every {orbit.n_periods} valve periods" if orbit.n_periods > 1 else ""
    return f"{orbit.name}: {1 / orbit.system_period:.4g} Hz{repeats}{_rest(orbit)}"


def _rest(orbit: Orbit | None) -> str:
    return "" if orbit is None or not orbit.rest else f", {orbit.rest}"


def _stairs_of(model: LtvModel) -> Staircase:
    if model.own_cycle is None:
        return staircase(model.machine, model.system.n_steps)
    # Cut at stick and slip too; of a subharmonic, the first valve period.
    ends = model.system.switching_times * model.frequency
    fractions = np.append(ends[ends < 1 - 1e-9], 1.0)
    return Staircase(fractions, step_means(model.machine.openings, fractions))


def draw_areas(machine: Machine, stairs: Staircase | None = None) -> Figure:
    """Effective areas over the turn of the valve (Fig. 2b), and a staircase over them (Fig. 4)."""
    figure = Figure(figsize=(7, 2 + 1.3 * len(machine.connections)), layout="constrained")
    axes = figure.subplots(len(machine.connections), 1, sharex=True, squeeze=False)[:, 0]
    for number, (ax, connection) in enumerate(zip(axes, machine.connections, strict=True)):
        for profile, label in ((connection.first, "area"), (connection.second, "second restriction")):
            if profile is None:
                continue
            angles = np.repeat(profile.angles, 2)[1:-1]
            values = np.column_stack([profile.starts, profile.ends]).ravel()
            color = PALETTE[0] if label == "area" else PALETTE[4]
            ax.plot(np.degrees(angles), 1e6 * values, label=label, linewidth=2, color=color)
        if stairs is not None:
            steps = stairs.areas[:, 0, number]
            ax.stairs(
                1e6 * steps, 360 * stairs.fractions, baseline=None, color=PALETTE[2], linestyle="--",
                linewidth=1.6, zorder=3,
                label=f"staircase, {steps.size} steps",
            )  # fmt: skip
        ax.set_title(f"{connection.source} to {connection.chamber.replace('_', ' ')}", fontsize=10, loc="left")
        ax.set_ylabel("C A [mm²]")
        ax.set_ylim(bottom=0)
        ax.margins(y=0.15)
        ax.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="upper right")
    axes[-1].set_xlabel("valve angle [deg]")
    axes[-1].set_xlim(0, 360)
    axes[-1].set_xticks(range(0, 361, 45))
    figure.suptitle(f"{machine.name}: effective areas, duty {machine.duty:.3g}", fontsize=11)
    return figure


def draw_cycles(orbits: Mapping[str, Orbit], title: str = "") -> Figure:
    """Position and pressures over one cycle, of one or more orbits (Figs. 6-8)."""
    first = next(iter(orbits.values()))
    signals = [name for name in first.signals if name != "velocity"]
    figure = Figure(figsize=(7, 1.2 + 2.1 * len(signals)), layout="constrained")
    axes = figure.subplots(len(signals), 1, sharex=True, squeeze=False)[:, 0]
    span = max(orbit.period for orbit in orbits.values())
    for number, (label, orbit) in enumerate(orbits.items()):
        times = np.union1d(np.linspace(0, span, 801), orbit.step_times)
        # At the very end of the cycle the start of the next would be shown.
        values = orbit.at(np.minimum(times, span * (1 - 1e-12)))
        for ax, signal in zip(axes, signals, strict=True):
            unit = unit_of(signal)
            style = STYLES.get(label.lower(), {"color": PALETTE[number % len(PALETTE)]})
            shown = label if orbit.rest and orbit.rest in label else f"{label}{_rest(orbit)}"
            ax.plot(1e3 * times, unit.factor * values[orbit.signals.index(signal)], label=shown, **style)
    for ax, signal in zip(axes, signals, strict=True):
        symbol = unit_of(signal).symbol.replace("bar", "bar abs")
        ax.set_ylabel(signal.replace("_", " ") + (f" [{symbol}]" if symbol else ""))
        ax.grid(alpha=0.3)
    for time in first.step_times[1:-1] if first.n_simulated == 0 else ():
        for ax in axes:
            ax.axvline(1e3 * time, color="0.7", linewidth=0.8, zorder=0)
    if len(orbits) > 1:
        axes[0].legend(fontsize=8, loc="best")
    axes[-1].set_xlabel("time [ms]")
    axes[-1].set_xlim(0, 1e3 * span)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def draw_attractors(found: Attractors) -> Figure:
    """Every cycle that a machine settles on, with its share of the starts."""
    if not found.orbits:
        raise ValueError("plot: found attractors without an orbit, as no start led to one; look at .failures")
    orbits = {
        f"{100 * share:.0f} %: {describe(orbit)}": orbit
        for share, orbit in zip(found.shares, found.orbits, strict=True)
    }
    return draw_cycles(
        orbits, title=f"{found.machine.name} at {found.frequency:.4g} Hz, from {len(found.starts)} starts"
    )


def draw_amplitudes(found: AmplitudeResponse, frictionless: FloatArray | None = None) -> Figure:
    """Amplitude over frequency of all models (Fig. 9); orbits that are not unique or subharmonic are marked.

    `frictionless` holds amplitudes of the nonlinear model without dry friction [m], like to set against like.
    """
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    ax = figure.subplots()
    unit = unit_of("position")
    for row, model in enumerate(found.models):
        values = unit.factor * found.amplitudes[row]
        ax.plot(found.frequencies, values, label=LABELS[model], marker=".", markersize=4, **STYLES[model])
        special = {"in a stiction band": found.is_isolated[row] == 0, "subharmonic": found.n_periods[row] > 1}
        for (label, where), marker in zip(special.items(), ("s", "D"), strict=True):
            if where.any():
                ax.plot(
                    found.frequencies[where], values[where], marker, color=PALETTE[2], markersize=6,
                    markerfacecolor="none", label=f"{LABELS[model]}: {label}",
                )  # fmt: skip
    if frictionless is not None:
        label = "nonlinear, no dry friction"
        ax.plot(found.frequencies, unit.factor * frictionless, label=label, color="0.55", linewidth=1.4)
    ax.set_xlabel("valve frequency [Hz]")
    ax.set_ylabel(f"amplitude of position [{unit.symbol}]")
    if found.frequencies.size > 2 and found.frequencies[-1] / found.frequencies[0] > 20:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        ax.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8)
    ax.set_title(f"{found.machine.name}: amplitude over frequency, duty {found.machine.duty:.3g}", fontsize=11)
    return figure


def draw_multipliers(multipliers: Mapping[str, Floquet]) -> Figure:
    """Floquet multipliers on the unit circle."""
    figure = Figure(figsize=(5.2, 5.2), layout="constrained")
    ax = figure.subplots()
    turn = np.linspace(0, 2 * np.pi, 361)
    ax.fill(np.cos(turn), np.sin(turn), color=PALETTE[0], alpha=0.06, linewidth=0)
    ax.plot(np.cos(turn), np.sin(turn), color="0.4", linewidth=1)
    markers = "osD^vP*X"
    handles: list[Line2D] = []
    for number, (label, found) in enumerate(multipliers.items()):
        line = ax.plot(
            found.multipliers.real, found.multipliers.imag, markers[number % len(markers)],
            color=PALETTE[number % len(PALETTE)],
            markerfacecolor="none", markeredgewidth=1.5, markersize=8,
            label=f"{label}  radius {found.spectral_radius:.3g}, {found.verdict}{_rest(found.orbit)}".strip(),
        )  # fmt: skip
        handles += line
    _add_cross(ax)
    ax.set_aspect("equal")
    ax.set_xlabel("real part")
    ax.set_ylabel("imaginary part")
    ax.grid(alpha=0.3)
    ax.legend(handles=handles, fontsize=8, loc="upper left")
    ax.set_title("Floquet multipliers", fontsize=11)
    return figure


def _add_cross(ax: Axes) -> None:
    ax.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    ax.axvline(0, color="0.7", linewidth=0.8, zorder=0)


def draw_sensitivity(found: ParameterSensitivity) -> Figure:
    """Draw how the position's amplitude and mean change for one percent more of each parameter."""
    figure = Figure(figsize=(7, 1.4 + 0.5 * len(found.parameters)), layout="constrained")
    ax = figure.subplots()
    places = np.arange(len(found.parameters))
    for number, (label, derivative) in enumerate((("amplitude", found.amplitude), ("mean", found.mean))):
        changes = [
            1e3 * 0.01 * value * derivative("position", name)
            for name, value in zip(found.parameters, found.values, strict=True)
        ]
        ax.barh(places + 0.4 * (number - 0.5), changes, 0.36, color=PALETTE[number], label=label)
    ax.set_yticks(places, [name.replace("_", " ") for name in found.parameters])
    ax.invert_yaxis()
    ax.axvline(0, color="0.4", linewidth=0.8)
    ax.set_xlabel("change of the position for 1 % more of the parameter [mm]")
    ax.grid(axis="x", alpha=0.3)
    ax.legend(fontsize=8)
    return figure
