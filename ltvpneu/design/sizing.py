r"""From a task to a cylinder and a valve: strokes of the nonlinear machine, the cheapest parts first.

Pairs that cannot do it are known without following a stroke. With the filled side at the supply pressure and the other
at the exhaust, (7b) with erratum E4 gives the largest net push, F = p_s A_k - p_e A_j - p_a (A_k - A_j) + F_e
- m g sin(theta) - F_d. So no stroke is faster than sqrt(2 m s / F), and none begins unless the push is above the
stiction.
"""

import math
from dataclasses import dataclass
from typing import final

from ltvpneu._arrays import positive
from ltvpneu._values import Value
from ltvpneu.design.progress import Progress
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.catalogue import (
    Catalogue,
    CatalogueCylinder,
    CatalogueValve,
    catalogue_drive,
    cheapest_first,
)
from ltvpneu.models.machine.catalogue import catalogue as bundled
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.stroke import Direction, Stroke, stroke
from ltvpneu.physics.cylinder import ATMOSPHERE
from ltvpneu.physics.load import GRAVITY, Load

Wanted = float | tuple[float | None, float | None]
_WAYS: tuple[Direction, ...] = ("out", "in")


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Sized(Value):
    """A cylinder with a valve, and what they do."""

    cylinder: CatalogueCylinder
    valve: CatalogueValve
    machine: Machine
    strokes: dict[str, Stroke]
    """"out" and "in", as far as they were asked for and followed."""
    share: float
    """The largest of the figures, each over the most asked for [-]; infinite where a stroke does not arrive."""
    remark: str
    """What it breaks; empty where it keeps all."""

    def __repr__(self) -> str:
        done = ", ".join(f"{way} {1e3 * one.time:.4g} ms" for way, one in self.strokes.items() if one.arrives)
        return f"<Sized: {self.cylinder.name}, {self.valve.name}; {self.remark or done}>"

    @property
    def does(self) -> bool:
        """Whether it keeps all that was asked for."""
        return self.share <= 1.0

    @property
    def air_mass(self) -> float:
        """Of the strokes that were followed [kg]."""
        return sum(one.air_mass for one in self.strokes.values())


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Sizing(Value):
    """The cheapest parts of a catalogue for a task."""

    best: Sized
    """The cheapest that does; where none does, the nearest."""
    tried: tuple[Sized, ...]
    """Every pair looked at, cheapest first, up to the one that does."""

    def __repr__(self) -> str:
        found = "found" if self.is_found else "none does, the nearest"
        return f"<Sizing: {found}: {self.best!r}; {len(self.tried)} pairs tried>"

    @property
    def is_found(self) -> bool:
        """Whether a pair does what was asked for."""
        return self.best.does

    @property
    def machine(self) -> Machine:
        """The drive, to go on with."""
        return self.best.machine


def size(  # noqa: PLR0913 - keyword-only, each with its default
    stroke: float,
    load: Load | float,
    time: Wanted,
    supply: float,
    catalogue: Catalogue | None = None,
    *,
    kinds: tuple[str, ...] = ("5/2",),
    impact_energy: float | None = None,
    end_velocity: float | None = None,
    exhaust_pressure: float = ATMOSPHERE,
    clearance: float = 0.1,
    progress: Progress | None = None,
) -> Sizing:
    """Return the cheapest cylinder and valve that move a load over a stroke in time, proven on the nonlinear machine.

    Cheapest by the sum of prices where every part of the catalogue has one; else the smallest bore, then the smallest
    valve.

    Parameters
    ----------
    stroke : float
        [m]
    load : Load or float
        What is moved, or its mass alone [kg].
    time : float or (float or None, float or None)
        The most for a stroke, from the piston's start to the other stop [s]: for both ways, or out and in, None for a
        way that does not matter. The valve's delay comes on top.
    supply : float
        Supply pressure [Pa, absolute].
    catalogue : Catalogue, optional
        By default the bundled one, `lp.catalogue()`.
    kinds : tuple of str
        Kinds of valves to take: "5/2", "5/3 closed", "5/3 exhausted", "5/3 pressurized", "2 x 3/2".
    impact_energy, end_velocity : float, optional
        The most at the stop [J], [m/s].
    exhaust_pressure : float
        [Pa, absolute]
    clearance : float
        Volume that is left in a chamber at its end of the stroke, as a share of what the stroke sweeps there [-].
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Returns
    -------
    Sizing

    Raises
    ------
    ValueError
        A number out of its range, no way asked for, no cylinder or no valve of these kinds in the catalogue.

    Examples
    --------
    5 kg over 100 mm in 0.2 s, at 6 bar (gauge):

    >>> from ltvpneu import design
    >>> found = design.size(0.1, 5.0, 0.2, 7.01e5)
    >>> print(found.best.cylinder.name, found.best.valve.name, sep="; ")
    ISO 6432, 10 mm; CKD M4GA1
    """
    task = _Task(
        stroke=positive("stroke", stroke, "m"),
        load=load if isinstance(load, Load) else Load(mass=positive("load", load, "kg")),
        times=_times(time),
        supply=positive("supply", supply, "Pa"),
        exhaust=positive("exhaust_pressure", exhaust_pressure, "Pa"),
        clearance=positive("clearance", clearance),
        impact_energy=math.inf if impact_energy is None else positive("impact_energy", impact_energy, "J"),
        end_velocity=math.inf if end_velocity is None else positive("end_velocity", end_velocity, "m/s"),
    )
    if task.supply <= task.exhaust:
        raise ValueError(
            f"supply: found {task.supply:g} Pa, expected more than the exhaust pressure of {task.exhaust:g} Pa; both "
            "are absolute"
        )
    parts = (bundled() if catalogue is None else catalogue).of_kind(*kinds)
    valves = [valve for valve in parts.valves if valve.drives_both_ways]
    if not valves or not parts.cylinders:
        missing = "cylinder" if not parts.cylinders else f"valve for both chambers among the kinds {', '.join(kinds)}"
        raise ValueError(f"catalogue: found no {missing}, expected at least one")
    tried: list[Sized] = []
    pairs = cheapest_first(parts.cylinders, valves)
    for number, (cylinder, valve) in enumerate(pairs):
        if progress is not None:
            progress(f"{cylinder.name}; {valve.name}", number / len(pairs))
        tried.append(task.done_by(cylinder, valve))
        if tried[-1].does:
            return Sizing(best=tried[-1], tried=tuple(tried))
    # Which comes nearest, strokes tell, and not how fast they could be at best.
    for number, one in enumerate(tried):
        if progress is not None:
            progress("looking for the nearest", number / len(tried))
        if len(one.strokes) < len(task.times) and math.isfinite(one.share):
            tried[number] = task.done_by(one.cylinder, one.valve, follow=True)
    return Sizing(best=min(tried, key=lambda one: one.share), tried=tuple(tried))


def _times(time: Wanted) -> dict[Direction, float]:
    """Return the most time for each way that matters [s]."""
    given: tuple[float | None, ...] = time if isinstance(time, tuple) else (time, time)
    if len(given) != 2 or given == (None, None):
        raise ValueError(f"time: found {time!r}, expected a time [s], or one for each way, out and in")
    return {way: positive("time", one, "s") for way, one in zip(_WAYS, given, strict=True) if one is not None}


@final
@dataclass(frozen=True, kw_only=True)
class _Task:
    """What is asked for."""

    stroke: float
    load: Load
    times: dict[Direction, float]
    supply: float
    exhaust: float
    clearance: float
    impact_energy: float
    end_velocity: float

    def done_by(self, cylinder: CatalogueCylinder, valve: CatalogueValve, follow: bool = False) -> Sized:
        """Return what a cylinder with a valve does; strokes that cannot be in time are followed if told to."""
        machine = catalogue_drive(
            cylinder,
            valve,
            stroke=self.stroke,
            load=self.load,
            supply_pressure=self.supply,
            exhaust_pressure=self.exhaust,
            clearance=self.clearance,
        )
        strokes: dict[str, Stroke] = {}
        share, remark = 0.0, ""
        for way, most in self.times.items():
            least = self._least_time(machine, way)
            if least > most and (not follow or math.isinf(least)):
                share, remark = max(share, least / most), self._too_weak(way, least)
                continue
            try:
                found = stroke(machine, way)
            except LtvpneuError as error:
                share, remark = math.inf, str(error)
                break
            strokes[way] = found
            for name, value, bound in (
                ("takes", found.time, most),
                ("hits the stop with an energy of", found.impact_energy, self.impact_energy),
                ("meets the stop at", found.end_velocity, self.end_velocity),
            ):
                unit = {"takes": "s", "meets the stop at": "m/s"}.get(name, "J")
                part = value / bound if math.isfinite(value) else math.inf
                if part > share:
                    share = part
                    remark = found.remark or f"the stroke {way} {name} {value:.3g} {unit}, at most {bound:.3g} allowed"
        return Sized(
            cylinder=cylinder,
            valve=valve,
            machine=machine,
            strokes=strokes,
            share=share,
            remark=remark if share > 1.0 else "",
        )

    def _least_time(self, machine: Machine, way: Direction) -> float:
        """Return a time that no stroke stays below [s]; infinite where none begins, zero where nothing is known."""
        parts, load, sign = machine.cylinder, self.load, 1.0 if way == "out" else -1.0
        filled, other = parts.piston_area_1, parts.piston_area_2
        if way == "in":
            filled, other = other, filled
        ambient = machine.ambient_pressure * (filled - other)
        outside = sign * (load.force - load.mass * GRAVITY * math.sin(load.mounting))
        push = self.supply * filled - self.exhaust * other - ambient + outside
        held = self.supply * other - self.exhaust * filled + ambient - outside
        if load.spring_stiffness or load.spring_preload or held < 0:
            # The piston may start away from its stop, with less of a way to go.
            return 0.0
        if push <= max(load.stiction, load.dry_friction):
            return math.inf
        return math.sqrt(2 * load.mass * self.stroke / (push - load.dry_friction))

    @staticmethod
    def _too_weak(way: str, least: float) -> str:
        if math.isinf(least):
            return f"the push does not begin the stroke {way}"
        return f"the stroke {way} takes more than {1e3 * least:.3g} ms with any valve"
