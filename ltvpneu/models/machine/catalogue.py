"""Valves and cylinders by their makers' data: what the package brings along, and what a user adds to it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache
from typing import Any, final

from ltvpneu._arrays import not_negative, positive
from ltvpneu._values import Value
from ltvpneu.models.machine.directional import (
    DIRECTIONAL,
    Directional,
    directional_paths,
    has_both_outlets,
    n_coils,
    second_coil,
)
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.catalog import catalog_cylinder
from ltvpneu.physics.cylinder import ATMOSPHERE
from ltvpneu.physics.iso6358 import ISO6358
from ltvpneu.physics.load import Load
from ltvpneu.physics.makers import makers_table
from ltvpneu.physics.on_off_valve import OnOffValve

_UNITS = {"dm^3/(s bar)": 1e-8, "ms": 1e-3}


@final
@dataclass(frozen=True, kw_only=True)
class CatalogueValve(Value):
    """A directional valve as a catalogue has it.

    Parameters
    ----------
    name : str
    kind : str
        Ports / positions, as of `directional_paths`.
    law : ISO6358
        From the supply to a chamber.
    exhaust : ISO6358, optional
        From a chamber to the exhaust; by default as `law`.
    opening_delay, closing_delay : float
        From the command until it moves [s].
    source : str
        Where the numbers are printed.
    price : float, optional
        In any currency, the same throughout a catalogue.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> mine = lp.CatalogueValve(name="Mine", kind="5/2", law=lp.ISO6358(sonic_conductance=0.7e-8), price=35.0)
    >>> mine.drives_both_ways
    True
    """

    name: str
    kind: Directional
    law: ISO6358
    exhaust: ISO6358 | None = None
    opening_delay: float = 0.0
    closing_delay: float = 0.0
    source: str = ""
    price: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in DIRECTIONAL:
            raise ValueError(f"kind: found {self.kind!r}, expected one of {', '.join(DIRECTIONAL)}")
        not_negative("opening_delay", self.opening_delay, "s")
        not_negative("closing_delay", self.closing_delay, "s")
        if self.price is not None:
            not_negative("price", self.price)

    @property
    def drives_both_ways(self) -> bool:
        """Whether it feeds both chambers of a cylinder."""
        return has_both_outlets(self.kind)


@final
@dataclass(frozen=True, kw_only=True)
class CatalogueCylinder(Value):
    """A double-acting cylinder as a catalogue has it, of any stroke.

    Parameters
    ----------
    series : str
    bore, rod : float
        Diameters [m].
    source : str
        Where the numbers are printed.
    price : float, optional
        In the currency of the valves.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> lp.CatalogueCylinder(series="Mine", bore=0.032, rod=0.012).name
    'Mine, 32 mm'
    """

    series: str
    bore: float
    rod: float
    source: str = ""
    price: float | None = None

    def __post_init__(self) -> None:
        positive("bore", self.bore, "m")
        if not_negative("rod", self.rod, "m") >= self.bore:
            raise ValueError(f"rod: found a diameter of {self.rod:g} m, expected less than the bore of {self.bore:g} m")
        if self.price is not None:
            not_negative("price", self.price)

    @property
    def name(self) -> str:
        """Series and bore, for readers."""
        return f"{self.series}, {1e3 * self.bore:g} mm"


@final
@dataclass(frozen=True, kw_only=True)
class Catalogue(Value):
    """Cylinders and valves to choose from.

    Parameters
    ----------
    cylinders : tuple of CatalogueCylinder
    valves : tuple of CatalogueValve
        Of names that are all different.

    Raises
    ------
    ValueError
        Two valves of one name.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> small = lp.catalogue().of_kind("5/2")
    >>> print(len(small.valves), "valves,", len(small.cylinders), "bores")
    16 valves, 17 bores
    """

    cylinders: tuple[CatalogueCylinder, ...]
    valves: tuple[CatalogueValve, ...]

    def __post_init__(self) -> None:
        names = [valve.name for valve in self.valves]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"valves: found {', '.join(twice)} more than once, expected names that differ")

    def of_kind(self, *kinds: str) -> "Catalogue":
        """Return the catalogue with the valves of some kinds alone, such as "5/2"."""
        for kind in kinds:
            if kind not in DIRECTIONAL:
                raise ValueError(f"kinds: found {kind!r}, expected one of {', '.join(DIRECTIONAL)}")
        return replace(self, valves=tuple(valve for valve in self.valves if valve.kind in kinds))

    def valve(self, name: str) -> CatalogueValve:
        """Return the valve of a name.

        Raises
        ------
        ValueError
            There is none.
        """
        found = [valve for valve in self.valves if valve.name == name]
        if not found:
            names = [one.name for one in self.valves]
            near = get_close_matches(name, names, 3, 0.4) or names[:3]
            raise ValueError(
                f"valve: found {name!r}, expected one of the catalogue's {len(names)}, such as {', '.join(near)}"
            )
        return found[0]


@cache
def catalogue() -> Catalogue:
    """Return the catalogue that comes with the package: valves as printed, ISO 6432 and ISO 15552 cylinders.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> lp.catalogue().valve("SMC SY3000").source
    'SMC SY series, catalog'
    """
    cylinders = [
        CatalogueCylinder(series=series, bore=1e-3 * bore, rod=1e-3 * rod, source=table["source"])
        for series, table in makers_table("cylinders").items()
        for bore, rod in zip(table["bores"], table["rods"], strict=True)
    ]
    valves = [
        CatalogueValve(
            name=name,
            kind=table["type"],
            law=_law(table),
            exhaust=_law(table["exhaust"]) if "exhaust" in table else None,
            opening_delay=_number(table.get("opening_delay", "0 ms")),
            closing_delay=_number(table.get("closing_delay", "0 ms")),
            source=table["source"],
        )
        for name, table in makers_table("valves").items()
    ]
    return Catalogue(cylinders=tuple(cylinders), valves=tuple(valves))


def _law(table: dict[str, Any]) -> ISO6358:
    conductance = _number(table["sonic_conductance"])
    return ISO6358(sonic_conductance=conductance, critical_pressure_ratio=table["critical_pressure_ratio"])


def _number(text: str) -> float:
    """Return a number of the package's own tables, in SI units."""
    number, _, unit = text.partition(" ")
    return float(number) * _UNITS[unit]


def catalogue_drive(  # noqa: PLR0913 - one keyword for each part of a drive
    cylinder: CatalogueCylinder,
    valve: CatalogueValve,
    *,
    stroke: float,
    load: Load,
    supply_pressure: float,
    exhaust_pressure: float = ATMOSPHERE,
    clearance: float = 0.1,
) -> Machine:
    """Return a drive of a cylinder and a valve out of a catalogue.

    Parameters
    ----------
    cylinder : CatalogueCylinder
    valve : CatalogueValve
        That feeds both chambers.
    stroke : float
        [m]
    load : Load
    supply_pressure, exhaust_pressure : float
        [Pa, absolute]
    clearance : float
        Volume that is left in a chamber at its end of the stroke, as a share of what the stroke sweeps there [-].

    Raises
    ------
    ValueError
        The valve feeds one chamber alone, or a number is out of its range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> parts = lp.catalogue()
    >>> drive = lp.catalogue_drive(
    ...     parts.cylinders[6], parts.valve("SMC SY3000"), stroke=0.1, load=lp.Load(mass=3.0), supply_pressure=7.01e5)
    >>> print(drive.name, f"{1e3 * lp.stroke(drive).time:.0f} ms", sep="; ")
    ISO 15552, 32 mm, SMC SY3000; 85 ms
    """
    if not valve.drives_both_ways:
        raise ValueError(f'valve: found {valve.name}, a "{valve.kind}" that feeds one chamber, expected one for both')
    first = OnOffValve(opening_delay=valve.opening_delay, closing_delay=valve.closing_delay)
    return Machine(
        name=f"{cylinder.name}, {valve.name}",
        supply_pressure=supply_pressure,
        exhaust_pressure=exhaust_pressure,
        cylinder=catalog_cylinder(bore=cylinder.bore, rod=cylinder.rod, stroke=stroke, clearance=clearance),
        load=load,
        valve=first,
        more_valves=(replace(first, **second_coil(valve.kind, first)),) if n_coils(valve.kind) > 1 else (),
        flow_paths=directional_paths(valve.kind, valve.law, exhaust=valve.exhaust),
    )


def cheapest_first(
    cylinders: Sequence[CatalogueCylinder], valves: Sequence[CatalogueValve]
) -> list[tuple[CatalogueCylinder, CatalogueValve]]:
    """Return all pairs, cheapest first: by price where each part has one, else by bore, then by the valve's size."""
    pairs = [(cylinder, valve) for cylinder in cylinders for valve in valves]
    priced = all(part.price is not None for part in (*cylinders, *valves))

    def rank(pair: tuple[CatalogueCylinder, CatalogueValve]) -> tuple[float, ...]:
        cylinder, valve = pair
        size = cylinder.bore, valve.law.sonic_conductance, float(n_coils(valve.kind))
        return ((cylinder.price or 0.0) + (valve.price or 0.0), *size) if priced else size

    return sorted(pairs, key=rank)
