"""`ltvpneu size`: a task in the words of a drive engineer, and the parts that do it as a table and as JSON."""

import argparse
from typing import TYPE_CHECKING, Any

from ltvpneu.face.machine_file import MOUNTINGS
from ltvpneu.face.tables import heading, table
from ltvpneu.face.units import parse, pressure_shown
from ltvpneu.physics.cylinder import ATMOSPHERE
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.load import Load

if TYPE_CHECKING:
    from ltvpneu.design import Sized, Sizing

SHOWN = 6
"""Pairs that a table shows at most."""


def run_sizing(options: argparse.Namespace, progress: Any) -> "Sizing":
    """Find the parts for a command line's task."""
    # A lazy door: design loads cvxpy.
    from ltvpneu import design

    if len(options.time) > 2:
        raise ValueError(f"--time: found {len(options.time)} numbers, expected one, or two: out and in")
    dry, stiction = options.friction or (0.0, 0.0)
    load = Load(
        mass=options.mass,
        dry_friction=dry,
        stiction=stiction,
        force=options.force,
        mounting=_mounting(options.mounting or "horizontal"),
    )
    try:
        supply = parse(_number_or_text(options.supply), "pressure")
    except ValueError as error:
        raise ValueError(f"--supply: {error}") from None
    return design.size(
        1e-3 * options.stroke,
        load,
        options.time[0] if len(options.time) == 1 else (options.time[0], options.time[1]),
        supply,
        kinds=tuple(options.kind or ("5/2",)),
        impact_energy=options.impact,
        end_velocity=options.speed,
        progress=progress,
    )


def _number_or_text(given: str) -> float | str:
    try:
        return float(given)
    except ValueError:
        return given


def _mounting(given: str) -> float:
    """Return an angle [rad]."""
    if given in MOUNTINGS:
        return MOUNTINGS[given]
    try:
        return parse(given, "angle")
    except ValueError as error:
        raise ValueError(f"--mounting: {error}; or one of {', '.join(MOUNTINGS)}") from None


def size_text(found: "Sizing") -> str:
    """Return what was found as tables."""
    best = found.best
    if found.is_found:
        said = f"{best.cylinder.name}, rod {1e3 * best.cylinder.rod:g} mm, with {best.valve.name} ({best.valve.kind})"
    else:
        said = f"no pair of the catalogue does it; the nearest: {best.cylinder.name}, with {best.valve.name}"
    supply = pressure_shown(found.machine.supply_pressure, ATMOSPHERE)
    # Those that come nearest, in the order of their cost.
    near = sorted(sorted(found.tried, key=lambda one: one.share)[:SHOWN], key=found.tried.index)
    return "\n".join(
        [
            heading("Size").lstrip("\n"),
            f"{said}; supply {supply}",
            f"  data: {best.cylinder.source}; {best.valve.source}",
            f"  {len(found.tried)} pairs tried, cheapest first: the smaller bore, then the smaller valve",
            "",
            table(
                ["cylinder", "valve", "out [ms]", "in [ms]", "at the stop [J]", "air [Nl]", "remark"],
                [_row(one) for one in near],
            ),
        ]
    )


def _row(one: "Sized") -> list[str]:
    times = [
        f"{1e3 * one.strokes[way].time:.4g}" if way in one.strokes and one.strokes[way].arrives else "-"
        for way in ("out", "in")
    ]
    impact = max((stroke.impact_energy for stroke in one.strokes.values()), default=0.0)
    air = f"{1e3 * one.air_mass / ANR_DENSITY:.3g}" if one.strokes else "-"
    return [one.cylinder.name, one.valve.name, *times, f"{impact:.3g}", air, one.remark or "does it"]


def size_json(found: "Sizing") -> dict[str, Any]:
    """Return what was found, in SI units."""
    return {"found": found.is_found, "best": _entry(found.best), "tried": [_entry(one) for one in found.tried]}


def _entry(one: "Sized") -> dict[str, Any]:
    return {
        "cylinder": {"series": one.cylinder.series, "bore": one.cylinder.bore, "rod": one.cylinder.rod},
        "valve": one.valve.name,
        "share": one.share if one.share < float("inf") else None,
        "remark": one.remark,
        "strokes": {
            way: {
                "time": stroke.time if stroke.arrives else None,
                "end_velocity": stroke.end_velocity,
                "impact_energy": stroke.impact_energy,
                "air_mass": stroke.air_mass,
            }
            for way, stroke in one.strokes.items()
        },
    }
