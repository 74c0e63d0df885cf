"""What a drive does, on one page: its strokes, its air, and what its duty can hold."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ltvpneu._arrays import FloatArray, finite, positive, read_only
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.orbit_map import OrbitMap, orbit_map
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.mass_drawn import mass_drawn
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stroke import Stroke, stroke
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.proportional import ProportionalValve

PRICE = 0.02
"""Of a cubic metre of compressed air at ANR, where none is given: an example, not a tariff."""
N_DUTIES = 9
"""Duties at which the orbits are looked at."""
CLOSE_DUTY = 1e-7
"""Step at which the duty of balance is taken as found [-]."""
MOST_PERIODS = 4000
"""Periods that an orbit may take to settle; what creeps for longer is left to the maps."""
COARSE = 0.02
"""Step of the duty with which a jump of the piston is looked at [-]; a map for its own sake looks closer."""


@final
@dataclass(frozen=True, kw_only=True)
class AirUse(Value):
    """Air of a double stroke, both chambers filled each time, and of strokes that follow each other at once."""

    mass: float
    """Of a double stroke [kg]."""
    double_stroke_time: float
    """Both strokes, with the valve's delays [s]; infinite where the piston does not arrive."""
    exergy: float
    """Work that the air of a double stroke could do down to the ambient pressure, at its temperature [J]."""
    work: float
    """That the pressures do on the piston in a double stroke [J]."""
    price: float
    """Of a cubic metre at ANR."""

    @property
    def volume(self) -> float:
        """Of a double stroke, in its volume at ANR [m^3]."""
        return self.mass / ANR_DENSITY

    @property
    def volume_per_minute(self) -> float:
        """Of strokes without a pause, in its volume at ANR [m^3/min]."""
        return 60 * self.volume / self.double_stroke_time

    @property
    def air_power(self) -> float:
        """Of strokes without a pause [W]."""
        return self.exergy / self.double_stroke_time

    @property
    def efficiency(self) -> float:
        """Work on the piston over the air's exergy [-]; friction and impact are part of that work."""
        return self.work / self.exergy if self.exergy > 0 else 0.0

    @property
    def cost_per_hour(self) -> float:
        """Of strokes without a pause, in the price's currency."""
        return 60 * self.volume_per_minute * self.price


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Switching(Value):
    """What a drive does whose valve switches at a frequency all the time."""

    frequency: float
    """[Hz]"""
    duty_band: tuple[float, float]
    """Commanded duties between which the valve works: beyond, its delays leave it shut or open, or commands are too
    short for it [-]."""
    balance_duty: float
    """Commanded duty at which the pressures balance the load with the piston at mid-stroke [-]; nan where none does."""
    balance_open_share: float
    """Share of the period for which the valve is open then [-]."""
    orbits: OrbitMap
    """Over the duties of the band."""
    mass_flows: FloatArray
    """Of air at the map's duties [kg/s], (n_duties,); nan where there is no orbit."""
    shortest_life: float
    """Hours until the valve has made `life` switches; nan where no life was given."""

    @property
    def switches_per_hour(self) -> float:
        """How often the valve is switched on in an hour."""
        return 3600 * self.frequency

    @property
    def unheld(self) -> tuple[float, float] | None:
        """Mean positions that no duty holds, from and to [m]; None where all between those found are held."""
        return self.orbits.unheld(self.frequency)

    @property
    def remark(self) -> str:
        """What no duty holds, with the remedy, in a sentence; empty where all is held."""
        return self.orbits.remark(self.frequency)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class DataSheet(Value):
    """What a drive does."""

    machine: Machine
    strokes: dict[str, Stroke]
    """By direction, "out" and "in"."""
    air: AirUse | None
    """None of a liquid."""
    switching: Switching | None
    """Where a frequency was given."""
    remarks: tuple[str, ...]
    """What is not as expected, in sentences."""

    def __repr__(self) -> str:
        times = ", ".join(f"{name} {1e3 * one.time:.4g} ms" for name, one in self.strokes.items())
        return f"<DataSheet of {self.machine.name}: {times}>"

    def to_json(self) -> str:
        """Return all figures as JSON, in SI units; what is infinite or missing as null."""
        found: dict[str, Any] = {
            "machine": self.machine.name,
            "strokes": {name: _stroke_figures(one) for name, one in self.strokes.items()},
            "remarks": list(self.remarks),
        }
        if self.air is not None:
            names = ("mass", "volume", "double_stroke_time", "volume_per_minute", "exergy", "air_power", "work",
                     "efficiency", "price", "cost_per_hour")  # fmt: skip
            found["air"] = {name: getattr(self.air, name) for name in names}
        if self.switching is not None:
            found["switching"] = _switching_figures(self.switching)
        return json.dumps(_plain(found), indent=2)


def data_sheet(
    machine: Machine,
    frequency: float | None = None,
    *,
    price: float = PRICE,
    life: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> DataSheet:
    """Return what a drive does: strokes, air and, at a switching frequency, what its duty can hold.

    Parameters
    ----------
    machine : Machine
        With both end stops and a valve that switches.
    frequency : float, optional
        Switching frequency [Hz].
    price : float
        Of a cubic metre of air at ANR.
    life : float, optional
        Switches that the valve is good for.
    progress : callable, optional
        Called with 1 after each of `N_DUTIES` duties.

    Raises
    ------
    ValueError
        No end stops, a proportional valve, arguments out of range.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> found = lp.data_sheet(lp.load_machine("double_acting_5_2"))
    >>> print(f"{found.air.volume * 1e3:.2f} normal litres a double stroke")
    0.95 normal litres a double stroke
    """
    expect_machine(machine)
    positive("price", price)
    strokes = {"out": stroke(machine, "out"), "in": stroke(machine, "in")}
    remarks = [f"Stroke {name}: {one.remark}." for name, one in strokes.items() if one.remark]
    switching = None
    if frequency is not None:
        at_stops = np.array([one.states[:, 0] for one in strokes.values()])
        switching = _switching(machine.at(positive("frequency", frequency, "Hz")), frequency, at_stops, life, progress)
        if switching.remark:
            remarks.append(switching.remark)
        remarks += _narrow_band(switching)
    return DataSheet(
        machine=machine,
        strokes=strokes,
        air=_air_use(machine, strokes, price),
        switching=switching,
        remarks=tuple(remarks),
    )


def _air_use(machine: Machine, strokes: dict[str, Stroke], price: float) -> AirUse | None:
    gas = machine.gas
    if isinstance(gas, Liquid):
        return None
    out, back = strokes["out"], strokes["in"]
    mass = out.air_mass + back.air_mass
    ratio = machine.supply_pressure / machine.ambient_pressure if machine.ambient_pressure else math.inf
    return AirUse(
        mass=mass,
        double_stroke_time=sum(one.time + one.delay for one in strokes.values()),
        exergy=mass * gas.specific_gas_constant * gas.temperature * math.log(ratio),
        work=out.work + back.work,
        price=float(price),
    )


def _switching(
    machine: Machine,
    frequency: float,
    starts: FloatArray,
    life: float | None,
    progress: Callable[[int], object] | None,
) -> Switching:
    low, high = duty_band(machine, frequency)
    duties = np.linspace(low, high, N_DUTIES) if low < high else np.array([0.5])
    orbits = orbit_map(
        machine, duties, [frequency], starts=starts, fine=COARSE, max_periods=MOST_PERIODS, progress=progress
    )
    balance = balance_duty(machine, frequency)
    return Switching(
        frequency=frequency,
        duty_band=(low, high),
        balance_duty=balance,
        balance_open_share=math.nan if math.isnan(balance) else machine.with_duty(balance).open_share(frequency),
        orbits=orbits,
        mass_flows=read_only(np.array([_mass_flow(machine.with_duty(float(duty)), frequency) for duty in duties])),
        shortest_life=math.nan if life is None else positive("life", life) / (3600 * frequency),
    )


def duty_band(machine: Machine, frequency: float) -> tuple[float, float]:
    """Return the commanded duties between which the machine's valve works at a frequency [Hz]."""
    valve = machine.valve
    if not isinstance(valve, OnOffValve):
        return 0.0, 1.0
    return valve.duty_band(frequency)


def balance_duty(machine: Machine, frequency: float, position: float | None = None) -> float:
    """Return the commanded duty at which the mean forces on a piston held at a position balance [-].

    Whether a duty holds the piston there is another matter: without a spring the balance is mostly unstable.

    Parameters
    ----------
    machine : Machine
    frequency : float
        [Hz]
    position : float, optional
        [m]; by default in the middle between the stops.

    Returns
    -------
    float
        nan where no duty balances the load.
    """
    expect_machine(machine)
    if isinstance(machine.valve, ProportionalValve):
        raise ValueError("machine: found a proportional valve, expected one that switches")
    middle = (machine.cylinder.lower_stop + machine.cylinder.upper_stop) / 2
    place = middle if position is None else finite("position", position, "m")
    if not math.isfinite(place):
        raise ValueError("position: found none, and a cylinder without both end stops; expected a position [m]")
    start = np.array(machine.rest_state)
    start[0] = place
    # So much stiction that it stays where it is put.
    held = replace(machine.at(frequency), load=replace(machine.load, stiction=1e12))

    def mean_force(duty: float) -> float:
        orbit = nonlinear_orbit(held.with_duty(duty), frequency, start)
        means = np.array([orbit.mean(name) for name in held.states])
        means[0] = start[0]
        return external_force(means, held.record)

    low, high = duty_band(machine, frequency)
    if low >= high:
        return math.nan
    # At the band's ends the valve does not open, or shut.
    low, high = low + 1e-9, high - 1e-9
    at_low, at_high, duty = mean_force(low), mean_force(high), math.nan
    if at_low * at_high > 0:
        return math.nan
    # All but a straight line: regula falsi, with the weight of an end that stays halved, closes in at once.
    while high - low > CLOSE_DUTY:
        before, duty = duty, low + (high - low) * at_low / (at_low - at_high)
        value = mean_force(duty)
        if value == 0 or abs(duty - before) < CLOSE_DUTY:
            break
        if (value > 0) == (at_low > 0):
            low, at_low, at_high = duty, value, at_high / 2
        else:
            high, at_high, at_low = duty, value, at_low / 2
    return duty


def _mass_flow(machine: Machine, frequency: float) -> float:
    """Return the mean mass flow from the supply at the orbit from rest [kg/s]; nan where there is none."""
    try:
        orbit = nonlinear_orbit(machine, frequency)
    except LtvpneuError:
        return math.nan
    period = 1 / frequency
    run = new_run(machine.record, integration_settings(machine, 1e-8), pieces_of(machine.openings, period))
    state, total = np.array(orbit.initial_state), 0.0
    for _ in range(orbit.n_periods):
        outcome = integrate_period(state, run)
        total += mass_drawn(outcome.record, machine, frequency)
        state = outcome.state
    return total / orbit.period


def _narrow_band(found: Switching) -> list[str]:
    low, high = found.duty_band
    if low < high:
        return []
    return [
        f"At {found.frequency:.4g} Hz the valve's delays take up the whole period: no duty makes it open and shut. "
        f"Choose less than {found.frequency / (1 + low - high):.4g} Hz, or a faster valve."
    ]


def _stroke_figures(one: Stroke) -> dict[str, Any]:
    names = ("time", "delay", "first_motion", "end_velocity", "impact_energy", "greatest_force", "air_mass", "work",
             "start_position", "end_position")  # fmt: skip
    return {name: getattr(one, name) for name in names}


def _switching_figures(found: Switching) -> dict[str, Any]:
    orbits = found.orbits
    return {
        "frequency": found.frequency,
        "duty_band": list(found.duty_band),
        "balance_duty": found.balance_duty,
        "balance_open_share": found.balance_open_share,
        "duties": orbits.duties.tolist(),
        "mean_positions": orbits.means[0].tolist(),
        "ripples": orbits.amplitudes[0].tolist(),
        "kinds": list(orbits.kinds[0]),
        "mass_flows": found.mass_flows.tolist(),
        "unheld_positions": None if found.unheld is None else list(found.unheld),
        "switches_per_hour": found.switches_per_hour,
        "life_hours": found.shortest_life,
    }


def _plain(value: Any) -> Any:
    """Return what JSON can hold: no number that is infinite or missing."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
