"""How signals are shown in pictures: units and colours."""

from typing import NamedTuple

import matplotlib as mpl

# Told apart by the colour-blind too. Colours are given outright: "C0" would be looked up in the user's style when
# drawn.
PALETTE = mpl.color_sequences["petroff10"]


class Unit(NamedTuple):
    """How a signal is shown."""

    factor: float
    symbol: str


def objective_unit(objective: str) -> Unit:
    """Return the factor from SI and the unit in which a design's objective is shown."""
    kind, _, signal = objective.partition(" ")
    if kind == "air_use":
        return Unit(1e3, "g/s")
    if kind == "switching":
        return Unit(1.0, "1/s")
    return unit_of(signal or "position") if kind == "amplitude" else Unit(1.0, "")


def unit_of(signal: str) -> Unit:
    """Return the factor from SI and the unit in which a signal is shown."""
    if signal == "position":
        return Unit(1e3, "mm")
    if signal == "velocity":
        return Unit(1.0, "m/s")
    if signal.startswith("pressure"):
        return Unit(1e-5, "bar")
    if signal.startswith("temperature"):
        return Unit(1.0, "K")
    return Unit(1.0, "")
