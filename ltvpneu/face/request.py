"""What `ltvpneu optimize` is asked for: goals, bounds, lists and ranges from the command line."""

import re
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from ltvpneu._arrays import FloatArray
from ltvpneu.face.machine_text import nearest
from ltvpneu.face.units import Dimension, example_of, parse, units_of
from ltvpneu.models.machine.machine import Machine
from ltvpneu.physics.cylinder import ATMOSPHERE
from ltvpneu.physics.iso6358 import ANR_DENSITY
from ltvpneu.physics.liquid import Liquid

Bounds = tuple[float, float]
DIMENSIONS: dict[str, Dimension] = {
    "duty": "number", "frequency": "number", "offset_angle": "angle", "supply_pressure": "pressure",
    "exhaust_pressure": "pressure", "ambient_pressure": "pressure", "load.force": "force", "load.mass": "mass",
    "load.dry_friction": "force",
    "load.stiction": "force", "load.spring_stiffness": "stiffness", "load.viscous_damping": "damping",
    "position": "length", "amplitude": "length",
}  # fmt: skip
"""Of what the options name; pressures of chambers too, all else is a plain number in SI units."""
SAMPLES = 80
"""Points of a wanted sine."""


class Request(NamedTuple):
    """What was asked for, parsed."""

    frequency: float | Bounds
    variables: dict[str, Bounds] | None
    mean: dict[str, float | tuple[float | None, float | None]]
    amplitude: dict[str, float]
    maximum: dict[str, float]
    minimum: dict[str, float]
    named: dict[str, Any]
    """Air use, speed, impact energy and life, as of `Goals`."""
    minimize: str
    scenarios: dict[str, dict[str, float]]
    """Name to factors by parameter."""
    valve: dict[str, float]
    pulses: int | None
    cycle: tuple[FloatArray, FloatArray] | None
    """Angles [rad], and the positions wanted there [m]."""
    choices: dict[str, list[Any]]
    ranges: dict[str, Any]


def parse_request(machine: Machine, options: Any) -> Request:
    """Return the goals that the options name.

    Raises
    ------
    ValueError
        With the option, what was found and what was expected.
    """
    around = machine.ambient_pressure
    mean: dict[str, float | tuple[float | None, float | None]] = {}
    for text in options.mean:
        name, value = _named("--mean", text, machine.states)
        mean[name] = _range("--mean", name, value, around) if ".." in value else quantity("--mean", name, value, around)
    amplitude, maximum, minimum, named = _bounds(machine, options)
    variables: dict[str, Bounds] = {}
    for text in options.free:
        name, value = _named("--free", text, ())
        variables[name] = _range("--free", name, value, around)
    scenarios: dict[str, dict[str, float]] = {}
    for text in options.scenario:
        name, value = _named("--scenario", text, ())
        match = re.fullmatch(r"([+-]\d+\.?\d*)\s*%", value.strip())
        if match is None:
            raise ValueError(f"--scenario {text}: found {value!r}, expected a change such as -10%")
        scenarios[f"{name} {value}"] = {name: 1 + float(match[1]) / 100}
    valve = {
        name: 1e-3 * getattr(options, name)
        for name in ("shortest_on", "shortest_off", "opening_delay", "closing_delay")
        if getattr(options, name)
    }
    frequency = _frequency(options.frequency)
    cycle = None if options.follow is None else wanted_cycle(options.follow)
    minimize = options.minimize or ("amplitude" if cycle is None else "tracking")
    return Request(
        frequency, variables or None, mean, amplitude, maximum, minimum, named, minimize, scenarios, valve,
        options.pulses, cycle, {name: entries for name, entries in map(partial(_choices, around), options.choose)},
        {name: span for name, span in map(partial(_varied, around), options.range)},
    )  # fmt: skip


def _bounds(
    machine: Machine, options: Any
) -> tuple[dict[str, float], dict[str, float], dict[str, float], dict[str, Any]]:
    """Return the most of amplitudes and states, the least of states, and what `Goals` has of its own."""
    around = machine.ambient_pressure
    amplitude, maximum = dict[str, float](), dict[str, float]()
    named: dict[str, Any] = {}
    for text in options.max:
        name, value = _named("--max", text, ("amplitude", "air_use", "speed", "impact_energy", *machine.states))
        if name == "amplitude":
            amplitude["position"] = quantity("--max", name, value, around)
        elif name == "air_use":
            named["air_use"] = _flow("--max", name, value, isinstance(machine.gas, Liquid))
        elif name == "speed":
            named["speed"] = (None, quantity("--max", "velocity", value, around))
        elif name == "impact_energy":
            named["impact_energy"] = _plain("--max", name, re.sub(r"\s*J$", "", value))
        else:
            maximum[name] = quantity("--max", name, value, around)
    minimum = dict[str, float]()
    for text in options.min:
        name, value = _named("--min", text, ("speed", "life", *machine.states))
        if name == "speed":
            most = named.get("speed", (None, None))[1]
            named["speed"] = (quantity("--min", "velocity", value, around), most)
            continue
        if name == "life":
            hours = _plain("--min", name, re.sub(r"\s*h$", "", value))
            if options.life is None:
                raise ValueError(
                    "--min: found life without the switches that the valve is good for, expected --life too"
                )
            named["life"] = hours, options.life
            continue
        minimum[name] = quantity("--min", name, value, around)
    return amplitude, maximum, minimum, named


def _choices(around: float, text: str) -> tuple[str, list[Any]]:
    """Return a list to choose from, by its name."""
    name, value = _named("--choose", text, ())
    parts = [part.strip() for part in value.split(",")]
    if name == "valve":
        return name, parts
    if name == "pulses":
        return name, [int(part) if part.isdigit() else part for part in parts]
    if name == "bore":
        return name, [quantity("--choose", "position", part, around) for part in parts]
    if name == "frequency":
        return name, [_frequency([part]) for part in parts]
    return name, [quantity("--choose", name, part, around) for part in parts]


def _varied(around: float, text: str) -> tuple[str, Any]:
    """Return the range of what is not known well, by its name."""
    name, value = _named("--range", text, ())
    if value.startswith("+-"):
        return name, value
    if ".." not in value:
        raise ValueError(f"--range: found {value!r} for {name}, expected a part such as +-10%, or 0N..50N")
    return name, _range("--range", name, value, around)


def wanted_cycle(text: str) -> tuple[FloatArray, FloatArray]:
    """Return a wanted cycle of the position: angles [rad] and positions [m], of a sine or out of a file.

    Raises
    ------
    ValueError
        What was found and what was expected.
    """
    match = re.fullmatch(r"(.+?)\+-(.+)", text.strip())
    if match is not None:
        mean, amplitude = (quantity("--follow", "position", part.strip()) for part in match.groups())
        angles = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
        return angles, mean + amplitude * np.sin(angles)
    try:
        with open(text, encoding="utf-8") as file:
            lines = [line for line in file if line.strip()]
        titles = int(bool(lines) and not _is_number(lines[0].partition(",")[0]))
        table = np.loadtxt(lines[titles:], delimiter=",", ndmin=2)
    except OSError as error:
        raise ValueError(
            f"--follow: found {text!r}, expected a sine as 45mm+-10mm, or a file ({error.strerror or error})"
        ) from None
    except ValueError as error:
        raise ValueError(f"--follow {text}: expected rows of two numbers, degrees,mm ({error})") from None
    if table.shape[1] != 2:
        raise ValueError(f"--follow {text}: found {table.shape[1]} columns, expected two: degrees,mm")
    if len(table) < 3 or (np.diff(table[:, 0]) <= 0).any() or table[0, 0] < 0 or table[-1, 0] >= 360:
        raise ValueError(f"--follow {text}: expected three or more rows, with degrees rising from 0 to below 360")
    # Between few points the piston would be free: the curve through them is wanted.
    places, values = np.radians(table[:, 0]), 1e-3 * table[:, 1]
    if places.size >= SAMPLES:
        return places, values
    turns = [places - 2 * np.pi, places, places + 2 * np.pi]
    angles = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    return angles, PchipInterpolator(np.concatenate(turns), np.tile(values, 3))(angles)


def _frequency(values: Sequence[str]) -> float | Bounds:
    text = values[0]
    if ".." in text:
        return _range("--frequency", "frequency", text)
    return _plain("--frequency", "frequency", re.sub(r"\s*Hz$", "", text))


def _named(option: str, text: str, known: Sequence[str]) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    name = name.strip()
    if not equals or not value.strip():
        raise ValueError(f"{option}: found {text!r}, expected NAME=VALUE, such as position=45mm")
    if known and name not in known:
        raise ValueError(f"{option}: found {name!r}{nearest(name, tuple(known))}; expected one of {', '.join(known)}")
    return name, value.strip()


def dimension_of(name: str) -> Dimension:
    """Return what kind of quantity an option names; a plain number where it is not known."""
    if name.startswith("pressure"):
        return "pressure"
    if name.startswith("temperature"):
        return "temperature"
    if re.fullmatch(r"(on|off)_\d+", name) or name.endswith((".start", ".width")):
        return "angle"
    return DIMENSIONS.get(name, "number")


def _plain(option: str, name: str, text: str) -> float:
    if not _is_number(text):
        raise ValueError(f"{option}: found {text!r} for {name}, expected a number")
    return float(text)


def quantity(option: str, name: str, text: str, ambient: float = ATMOSPHERE) -> float:
    """Return a quantity of a state or a parameter that a command line gives, with its unit, in SI units."""
    dimension = dimension_of(name)
    if name == "velocity":
        factor = 1e-3 if text.endswith("mm/s") else 1.0
        return factor * _plain(option, name, re.sub(r"\s*m?m/s$", "", text))
    if dimension == "number":
        return _plain(option, name, text)
    # A plain number would be in m and Pa, where the tables printed speak in mm and bar: it has to say which is meant.
    if _is_number(text):
        if float(text) == 0 and dimension not in ("pressure", "temperature"):
            return 0.0
        raise ValueError(
            f"{option}: {name}: found {text!r} without a unit, expected {example_of(dimension)} or the like: "
            f"{', '.join(units_of()[dimension])}"
        )
    try:
        return parse(text, dimension, ambient)
    except ValueError as error:
        raise ValueError(f"{option}: {name}: {error}") from None


def _flow(option: str, name: str, text: str, is_liquid: bool) -> float:
    """Return a mass flow [kg/s]; of gases its volume at ANR says it too."""
    if _is_number(text):
        normal = "" if is_liquid else ' or "100 Nl/min"'
        raise ValueError(f'{option}: {name}: found {text!r} without a unit, expected "2 g/s"{normal}')
    try:
        if not is_liquid and re.search(r"(l|m\^?3|m³)\s*/", text):
            return parse(text, "volume flow") * ANR_DENSITY
        return parse(text, "mass flow")
    except ValueError as error:
        normal = "" if is_liquid else ' or "100 Nl/min"'
        raise ValueError(f"{option}: {name}: {error}{normal}") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _range(option: str, name: str, text: str, ambient: float = ATMOSPHERE) -> Any:
    low, _, high = text.partition("..")
    found = [
        None if not part.strip() else quantity(option, name, re.sub(r"\s*Hz$", "", part), ambient)
        for part in (low, high)
    ]
    if option != "--mean" and None in found:
        raise ValueError(
            f"{option}: found {text!r} for {name}, expected its least and greatest value, such as 0.1..0.9"
        )
    return found[0], found[1]
