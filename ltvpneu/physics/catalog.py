"""A cylinder by what its catalog page says: bore, rod and stroke."""

import math
from typing import Literal

from ltvpneu._arrays import not_negative, positive
from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.tube import Tube

Acting = Literal["double", "push", "pull"]
LARGEST_BORE, LONGEST_STROKE = 1.0, 20.0
"""Beyond these a number is more likely in millimetres [m]."""


def catalog_cylinder(  # noqa: PLR0913 - one keyword for each line of a catalog page
    *,
    bore: float,
    stroke: float,
    rod: float = 0.0,
    through_rod: bool = False,
    acting: Acting = "double",
    clearance: float | None = None,
    dead_volume_1: float | None = None,
    dead_volume_2: float | None = None,
    tube_1: Tube | None = None,
    tube_2: Tube | None = None,
) -> Cylinder:
    """Return a cylinder whose position is 0 with the rod in and `stroke` with the rod out, with a stop at either end.

    Chamber 1 is the side without the rod; it pushes the rod out.

    Parameters
    ----------
    bore, rod : float
        Diameters [m]; `rod` 0 for a rodless cylinder.
    stroke : float
        [m]
    through_rod : bool
        Whether the rod leaves through both ends.
    acting : {"double", "push", "pull"}
        "push": chamber 1 alone, "pull": chamber 2 alone; the other side is open to the ambient air.
    clearance : float, optional
        Volume that is left in a chamber with the piston at its end, as a share of what the stroke sweeps there [-].
    dead_volume_1, dead_volume_2 : float, optional
        That volume itself, each at its own end [m^3], instead of `clearance`.
    tube_1, tube_2 : Tube, optional
        Tubes to the valve, whose volume is added to the chamber's. What they let through belongs to the flow paths.

    Examples
    --------
    >>> cylinder = catalog_cylinder(bore=0.032, rod=0.012, stroke=0.1, clearance=0.1)
    >>> print(f"{cylinder.piston_area_1 * 1e4:.2f} and {cylinder.piston_area_2 * 1e4:.2f} cm^2")
    8.04 and 6.91 cm^2
    """
    if positive("bore", bore, "m") > LARGEST_BORE:
        raise ValueError(f"bore: found {bore:g} m, expected at most {LARGEST_BORE:g} m (32 mm is 0.032 m)")
    if positive("stroke", stroke, "m") > LONGEST_STROKE:
        raise ValueError(f"stroke: found {stroke:g} m, expected at most {LONGEST_STROKE:g} m (100 mm is 0.1 m)")
    if not_negative("rod", rod, "m") >= bore:
        raise ValueError(f"rod: found a diameter of {rod:g} m, expected less than the bore of {bore:g} m")
    if through_rod and rod == 0.0:
        raise ValueError("through_rod: found it without a rod, expected the rod's diameter too")
    if acting not in ("double", "push", "pull"):
        raise ValueError(f'acting: found {acting!r}, expected "double", "push" or "pull"')
    face, rod_area = math.pi / 4 * bore**2, math.pi / 4 * rod**2
    areas = face - rod_area if through_rod else face, face - rod_area
    given, tubes = (dead_volume_1, dead_volume_2), (tube_1, tube_2)
    at_ends: list[float | None] = []
    for side, (area, volume, tube) in enumerate(zip(areas, given, tubes, strict=True), start=1):
        if side == {"push": 2, "pull": 1}.get(acting):
            if volume is not None or tube is not None:
                raise ValueError(
                    f'acting: found "{acting}" beside dead_volume_{side} or tube_{side}, expected neither of a side '
                    "that is open to the ambient air"
                )
            at_ends.append(None)
            continue
        if (volume is None) == (clearance is None):
            found = "neither" if volume is None else "both"
            raise ValueError(
                f"clearance, dead_volume_{side}: found {found}, expected one of them: what is left of the chamber with "
                "the piston at its end, such as a clearance of 10 %"
            )
        left = volume if volume is not None else not_negative("clearance", clearance or 0.0) * area * stroke
        at_ends.append(left + (0.0 if tube is None else tube.volume))
    first, second = at_ends
    return Cylinder(
        piston_area_1=areas[0],
        piston_area_2=areas[1],
        dead_volume_1=first,
        # Of the whole chamber 2, which is largest with the rod in.
        dead_volume_2=None if second is None else second + areas[1] * stroke,
        lower_stop=0.0,
        upper_stop=stroke,
        rod_area_1=rod_area if through_rod else 0.0,
        rod_area_2=rod_area,
    )
