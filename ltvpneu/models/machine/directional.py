"""Directional valves by the names on their data sheets: which ports they join in which position."""

from typing import Literal, NamedTuple, get_args

from ltvpneu.models.machine.connections import CHAMBERS, FlowPath
from ltvpneu.physics.iso6358 import ISO6358
from ltvpneu.physics.on_off_valve import OnOffValve
from ltvpneu.physics.profile import TURN
from ltvpneu.physics.tube import Tube
from ltvpneu.physics.valve import Phase

Directional = Literal[
    "2/2 nc", "2/2 no", "3/2", "3/2 no", "5/2", "5/3 closed", "5/3 exhausted", "5/3 pressurized", "2 x 3/2"
]
DIRECTIONAL: tuple[Directional, ...] = get_args(Directional)


class _Way(NamedTuple):
    """A path of a directional valve; chamber "a" is that on which a valve with one outlet works."""

    source: str
    chamber: str
    opening: Phase
    coil: int = 0


_EXTEND = (_Way("supply", "1", "on"), _Way("exhaust", "2", "on"))
_RETRACT = (_Way("supply", "2", "on", 1), _Way("exhaust", "1", "on", 1))
_WAYS: dict[Directional, tuple[_Way, ...]] = {
    "2/2 nc": (_Way("supply", "a", "on"),),
    "2/2 no": (_Way("supply", "a", "off"),),
    "3/2": (_Way("supply", "a", "on"), _Way("exhaust", "a", "off")),
    "3/2 no": (_Way("supply", "a", "off"), _Way("exhaust", "a", "on")),
    "5/2": (*_EXTEND, _Way("exhaust", "1", "off"), _Way("supply", "2", "off")),
    "5/3 closed": (*_EXTEND, *_RETRACT),
    # In the middle neither coil is on: a chamber is shut off from its exhaust, or supply, by the one coil alone.
    "5/3 exhausted": (
        _Way("supply", "1", "on"), _Way("exhaust", "1", "off"),
        _Way("supply", "2", "on", 1), _Way("exhaust", "2", "off", 1),
    ),
    "5/3 pressurized": (
        _Way("supply", "1", "off", 1), _Way("exhaust", "1", "on", 1),
        _Way("supply", "2", "off"), _Way("exhaust", "2", "on"),
    ),
    "2 x 3/2": (
        _Way("supply", "1", "on"), _Way("exhaust", "1", "off"),
        _Way("supply", "2", "on", 1), _Way("exhaust", "2", "off", 1),
    ),
}  # fmt: skip


def n_coils(kind: Directional) -> int:
    """Return how many coils, each a valve of the machine, move a directional valve."""
    return 1 + max(way.coil for way in _WAYS[kind])


def has_both_outlets(kind: Directional) -> bool:
    """Whether a directional valve feeds both chambers."""
    return any(way.chamber == "2" for way in _WAYS[kind])


def second_coil(kind: Directional, first: OnOffValve) -> dict[str, float]:
    """Return how the second coil of a valve is switched unless told otherwise: its duty, and its start if it has one.

    Of "2 x 3/2" the second valve is on while the first is off; the second coil of a "5/3" stays off.
    """
    if kind == "2 x 3/2":
        return {"duty": 1.0 - first.duty, "start": first.start + TURN * first.duty}
    return {"duty": 0.0}


def directional_paths(
    kind: Directional,
    law: ISO6358 | float,
    *,
    exhaust: ISO6358 | float | None = None,
    silencer: ISO6358 | None = None,
    tubes: tuple[Tube | None, Tube | None] = (None, None),
    chamber: str = "chamber_1",
) -> tuple[FlowPath, ...]:
    """Return the flow paths of a directional valve.

    A valve of two coils ("5/3 ...", "2 x 3/2") takes two valves of the machine: its `valve`, which sends the piston
    out, and the first of its `more_valves`, which brings it back. "5/3 exhausted" and "2 x 3/2" are the same paths.

    Parameters
    ----------
    kind : str
        Such as "5/2": ports / positions. "nc" is shut, "no" open while the coil is off; of a "5/3" the middle.
    law : ISO6358 or float
        From the supply to a chamber; or the effective area C A of a nozzle there [m^2].
    exhaust : ISO6358 or float, optional
        From a chamber to the exhaust; by default as `law`. Air that goes the other way passes by the same numbers.
    silencer : ISO6358, optional
        Behind the exhaust ports.
    tubes : tuple of Tube or None
        To chamber 1 and to chamber 2.
    chamber : str
        On which chamber a valve with one outlet works.

    Examples
    --------
    >>> law = ISO6358(sonic_conductance=0.7e-8)
    >>> for path in directional_paths("3/2", law):
    ...     print(path.source, "to", path.chamber, path.opening)
    supply to chamber_1 on
    exhaust to chamber_1 off
    """
    if kind not in _WAYS:
        raise ValueError(f"kind: found {kind!r}, expected one of {', '.join(_WAYS)}")
    found: list[FlowPath] = []
    for way in _WAYS[kind]:
        place = chamber if way.chamber == "a" else f"chamber_{way.chamber}"
        tube = tubes[int(place[-1]) - 1] if place in CHAMBERS else None
        fixed = [] if tube is None else [tube.law]
        if way.source == "exhaust" and silencer is not None:
            fixed.append(silencer)
        passage = law if way.source == "supply" or exhaust is None else exhaust
        found.append(
            FlowPath(
                source=way.source,
                chamber=place,
                opening=way.opening,
                valve=way.coil,
                law=passage if isinstance(passage, ISO6358) else None,
                area=None if isinstance(passage, ISO6358) else passage,
                in_series=ISO6358.in_series(*fixed) if fixed else None,
            )
        )
    return tuple(found)
