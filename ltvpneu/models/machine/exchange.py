"""A machine with another valve or another bore out of a catalogue, all else as it is."""

import math
from dataclasses import replace

from ltvpneu._arrays import positive
from ltvpneu.models.machine.catalogue import CatalogueCylinder, CatalogueValve
from ltvpneu.models.machine.connections import SOURCES, FlowPath
from ltvpneu.models.machine.directional import directional_paths, n_coils, second_coil
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.catalog import LARGEST_BORE
from ltvpneu.physics.on_off_valve import OnOffValve


def with_valve(machine: Machine, valve: CatalogueValve) -> Machine:
    """Return the machine with a valve out of a catalogue in place of its own.

    Switched as the one before. Leaks and other paths that stand open stay, and so do tubes and silencers between the
    valve and the chambers.

    Parameters
    ----------
    machine : Machine
        With one on-off valve, or two that are the coils of one.
    valve : CatalogueValve

    Raises
    ------
    ValueError
        The machine has no on-off valve, or not the chambers that the valve feeds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> drive = lp.load_machine("double_acting_5_2")
    >>> larger = lp.with_valve(drive, lp.catalogue().valve("SMC SY5000"))
    >>> lp.stroke(larger).time < lp.stroke(drive).time
    True
    """
    if not isinstance(machine.valve, OnOffValve):
        raise ValueError(
            f"valve: found {valve.name} for {machine.name}, whose valve is no on-off valve; expected a machine that a "
            "directional valve switches"
        )
    standing = tuple(path for path in machine.flow_paths if not _is_switched(path))
    switched = [path for path in machine.flow_paths if _is_switched(path)]
    fed = {path.chamber for path in switched}
    needed = {"chamber_1", "chamber_2"} if valve.drives_both_ways else set[str]()
    missing = needed - set(machine.cylinder.chambers)
    if missing or (not needed and len(fed) > 1):
        has = " and ".join(machine.cylinder.chambers)
        raise ValueError(
            f'valve: found {valve.name}, a "{valve.kind}" valve for {"both chambers" if needed else "one chamber"}, '
            f"but the valve of {machine.name} feeds {' and '.join(sorted(fed))} of {has}"
        )
    first = OnOffValve(
        duty=machine.valve.duty,
        start=machine.valve.start,
        pulses=machine.valve.pulses,
        opening_delay=valve.opening_delay,
        closing_delay=valve.closing_delay,
    )
    others = (replace(first, pulses=None, **second_coil(valve.kind, first)),) if n_coils(valve.kind) > 1 else ()
    in_series = {(path.source, path.chamber): path.in_series for path in switched}
    paths = directional_paths(valve.kind, valve.law, exhaust=valve.exhaust, chamber=min(fed, default="chamber_1"))
    return replace(
        machine,
        valve=first,
        more_valves=others,
        flow_paths=(
            *(replace(path, in_series=in_series.get((path.source, path.chamber))) for path in paths),
            *standing,
        ),
    )


def _is_switched(path: FlowPath) -> bool:
    """Whether a path is one of a directional valve's: between a source and a chamber, on or off."""
    return path.source in SOURCES and path.opening in ("on", "off")


def with_bore(machine: Machine, bore: CatalogueCylinder | float) -> Machine:
    """Return the machine with a cylinder of another bore, of the same stroke.

    Dead volumes grow with the areas on their sides. The rod is that of the catalogue's cylinder; of a number it grows
    with the bore, and so do the areas of rod and seals.

    Parameters
    ----------
    machine : Machine
    bore : CatalogueCylinder or float
        Diameter [m].

    Raises
    ------
    ValueError
        The number is no bore in metres.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> wider = lp.with_bore(lp.load_machine("double_acting_5_2"), 0.040)
    >>> print(f"{1e4 * wider.cylinder.piston_area_1:.2f} cm^2")
    12.57 cm^2
    """
    old = machine.cylinder
    rods = old.rod_areas
    faces = old.piston_area_1 + rods[0], old.piston_area_2 + rods[1]
    if isinstance(bore, CatalogueCylinder):
        face, rod = math.pi / 4 * bore.bore**2, math.pi / 4 * bore.rod**2
        new_rods = tuple(rod if one > 0 else 0.0 for one in rods)
        areas = tuple(face - one for one in new_rods)
        growth = face / max(faces)
    else:
        if positive("bore", bore, "m") > LARGEST_BORE:
            raise ValueError(f"bore: found {bore:g} m, expected at most {LARGEST_BORE:g} m (32 mm is 0.032 m)")
        growth = math.pi / 4 * bore**2 / max(faces)
        areas = old.piston_area_1 * growth, old.piston_area_2 * growth
        new_rods = tuple(one * growth for one in rods)
    volumes = tuple(
        None if volume is None else volume * area / before
        for volume, area, before in zip(
            (old.dead_volume_1, old.dead_volume_2), areas, (old.piston_area_1, old.piston_area_2), strict=True
        )
    )
    return replace(
        machine,
        cylinder=replace(
            old,
            piston_area_1=areas[0],
            piston_area_2=areas[1],
            dead_volume_1=volumes[0],
            dead_volume_2=volumes[1],
            rod_area_1=new_rods[0],
            rod_area_2=new_rods[1],
            seal_friction_area=old.seal_friction_area * growth,
        ),
    )
