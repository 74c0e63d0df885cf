"""Quantities with units, as they stand in a machine file: "0.41 MPa", "8.2 cm^3", "20 degC", "3.1 bar(g)".

Plain numbers are SI. Pressures are absolute; the suffix (g) marks a gauge pressure, over the ambient pressure.
"""

import math
import re
from typing import Literal

from ltvpneu.physics.cylinder import ATMOSPHERE

INCH, POUND_FORCE = 0.0254, 4.4482216152605

Dimension = Literal[
    "pressure", "length", "area", "volume", "mass", "force", "stiffness", "damping", "temperature", "angle",
    "gas constant", "heat transfer coefficient", "density", "viscosity", "sonic conductance",
    "volume flow", "mass flow", "time", "number",
]  # fmt: skip

_UNITS: dict[Dimension, dict[str, float]] = {
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5, "mbar": 1e2, "atm": ATMOSPHERE,
        "psi": POUND_FORCE / INCH**2,
    },
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": INCH},
    "area": {"m^2": 1.0, "cm^2": 1e-4, "mm^2": 1e-6, "in^2": INCH**2},
    "volume": {
        "m^3": 1.0, "dm^3": 1e-3, "cm^3": 1e-6, "mm^3": 1e-9, "l": 1e-3, "ml": 1e-6, "in^3": INCH**3
    },
    "mass": {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237},
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": POUND_FORCE},
    "stiffness": {"N/m": 1.0, "kN/m": 1e3, "N/mm": 1e3, "N/cm": 1e2, "lbf/in": POUND_FORCE / INCH},
    "damping": {
        "N s/m": 1.0, "kN s/m": 1e3, "N s/mm": 1e3, "kg/s": 1.0, "lbf s/in": POUND_FORCE / INCH
    },
    "temperature": {"K": 1.0, "degC": 1.0, "degF": 5 / 9},
    "angle": {"rad": 1.0, "deg": 0.017453292519943295, "turn": 6.283185307179586},
    "gas constant": {"J/(kg K)": 1.0, "kJ/(kg K)": 1e3},
    "heat transfer coefficient": {"W/(m^2 K)": 1.0, "kW/(m^2 K)": 1e3},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3, "kg/l": 1e3},
    "viscosity": {"Pa s": 1.0, "mPa s": 1e-3, "cP": 1e-3},
    "sonic conductance": {
        "m^3/(s Pa)": 1.0, "dm^3/(s bar)": 1e-8, "l/(s bar)": 1e-8, "l/(min bar)": 1e-8 / 60, "cm^3/(s bar)": 1e-11,
    },
    "volume flow": {
        "m^3/s": 1.0, "m^3/h": 1 / 3600, "dm^3/s": 1e-3, "l/s": 1e-3, "l/min": 1 / 60000, "Nl/min": 1 / 60000,
        "m^3/min": 1 / 60,
    },
    "mass flow": {"kg/s": 1.0, "g/s": 1e-3, "g/min": 1e-3 / 60, "kg/min": 1 / 60, "kg/h": 1 / 3600},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "number": {"": 1.0, "%": 1e-2},
}  # fmt: skip
_ZERO_POINTS = {"K": 0.0, "degC": 273.15, "degF": 459.67 * 5 / 9}
_EXAMPLES: dict[Dimension, str] = {
    "pressure": "0.41 MPa", "length": "80 mm", "area": "16 mm^2", "volume": "8.2 cm^3", "mass": "1.75 kg",
    "force": "26.6 N", "stiffness": "2.1 kN/m", "damping": "43.7 N s/m", "temperature": "20 degC", "angle": "180 deg",
    "gas constant": "287.05 J/(kg K)",
    "heat transfer coefficient": "60 W/(m^2 K)", "density": "860 kg/m^3", "viscosity": "27.5 mPa s",
    "sonic conductance": "0.7 dm^3/(s bar)", "volume flow": "500 l/min", "mass flow": "2 g/s", "time": "12 ms",
    "number": "0.5",
}  # fmt: skip
LARGEST = 1e30
"""No quantity of a machine in SI units is beyond it."""
LONGEST_SHOWN = 80
"""Characters of a value in a message."""
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+\s*(?:[^\d\s,]|$)")
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|nan))\s*(.*?)\s*$")


def pressure_shown(pressure: float, ambient: float) -> str:
    """Return a pressure as people speak of it, absolute and over the ambient one [Pa].

    >>> pressure_shown(7.01325e5, 1.01325e5)
    '7.013 bar(a) = 6 bar(g)'
    """
    # Rounding leaves no pressure just beside the ambient one.
    gauge = round((pressure - ambient) / 1e5, 4) + 0.0
    return f"{pressure / 1e5:.4g} bar(a) = {gauge:.4g} bar(g)"


def parse(value: object, dimension: Dimension, ambient: float = ATMOSPHERE) -> float:
    """Return a quantity of a machine file in SI units.

    Parameters
    ----------
    value : int, float or str
        A plain number is SI; a string is a number and a unit.
    dimension : str
        What it must be.
    ambient : float
        What a gauge pressure is counted from [Pa].

    Raises
    ------
    ValueError
        No number, no unit, an unknown unit, or one of another dimension.

    Examples
    --------
    >>> round(parse("8.2 cm^3", "volume"), 9), parse("20 degC", "temperature"), parse("3.1 bar(g)", "pressure")
    (8.2e-06, 293.15, 411325.0)
    """
    hint = f"expected {_a(dimension)}, such as {_EXAMPLES[dimension]!r} or a plain number in SI units"
    if isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) > LARGEST and value not in (math.inf, -math.inf):
            raise ValueError(f"found {cut(value)}, {hint}, not beyond {LARGEST:g}")
        return float(value)
    if not isinstance(value, str):
        raise ValueError(f"found {cut(value)}, {hint}")
    match = _QUANTITY.match(value)
    if match is None:
        raise ValueError(f"found {cut(value)}, which does not begin with a number, {hint}")
    if _DECIMAL_COMMA.match(value):
        raise ValueError(f"found {cut(value)} with a decimal comma; write a point: {cut(value.replace(',', '.', 1))}")
    number, unit = float(match[1]), _normal(match[2])
    if LARGEST < abs(number) < math.inf:
        raise ValueError(f"found {cut(value)}, {hint}, not beyond {LARGEST:g}")
    offset = 0.0
    if unit.endswith("(g)") or unit in ("barg", "psig"):
        unit, offset = (unit[:-3] if unit.endswith("(g)") else unit[:-1]), ambient
    elif unit.endswith("(a)"):
        unit = unit[:-3]
    unit = unit.strip()
    if unit == "" and dimension != "number":
        raise ValueError(f"found {cut(value)} without a unit, {hint}")
    if (offset or match[2].endswith("(a)")) and unit not in _UNITS["pressure"]:
        raise ValueError(f"found {cut(value)}: only a pressure is gauge (g) or absolute (a); {hint}")
    if unit in _UNITS[dimension]:
        return number * _UNITS[dimension][unit] + offset + (_ZERO_POINTS[unit] if dimension == "temperature" else 0.0)
    for other, units in _UNITS.items():
        if unit in units:
            raise ValueError(f"found {cut(value)}, {_a(other)}, {hint}")
    raise ValueError(
        f"found {cut(value)} with the unknown unit {cut(unit)}, {hint}; known: {', '.join(_UNITS[dimension])}"
    )


def cut(value: object) -> str:
    """Return how a value is written, cut to a readable length."""
    # Of a whole number of thousands of digits Python refuses to tell them.
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"a whole number of about {round(value.bit_length() * math.log10(2))} digits"
    written = repr(value)
    return written if len(written) <= LONGEST_SHOWN else f"{written[: LONGEST_SHOWN - 4]} ..."


def example_of(kind: object) -> str:
    """Return a quantity of a dimension as it stands in a machine file; of another kind, an empty table."""
    if kind == "number":
        return _EXAMPLES["number"]
    for dimension, example in _EXAMPLES.items():
        if kind == dimension:
            return f'"{example}"'
    return "{}"


def units_of() -> dict[str, tuple[str, ...]]:
    """Return the known units of each dimension."""
    return {dimension: tuple(unit for unit in units if unit) for dimension, units in _UNITS.items()}


def _normal(unit: str) -> str:
    """Spell a unit as in the table: powers with ^, products with a space."""
    unit = unit.replace("²", "^2").replace("³", "^3").replace("**", "^").replace("µ", "u").replace("°", "deg")
    unit = re.sub(r"\s*[·*⋅]\s*", " ", unit)
    unit = re.sub(r"(?<=[NJ])-(?=s|m)", " ", unit)
    unit = re.sub(r"\s+\(([ga])\)$", r"(\1)", unit)
    # mm2 and dm3 are common where no keyboard has a superscript; flows may say that they are at ANR.
    unit = re.sub(r"(?<=m)([23])(?![0-9])", r"^\1", unit).replace("(ANR)", "").strip()
    return re.sub(r"\s*/\s*", "/", unit)


def _a(dimension: str) -> str:
    return f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"
