"""`plot`: one function that draws any result. matplotlib is loaded on first use."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(result: object) -> "Figure":
    """Draw a result and return the figure.

    Parameters
    ----------
    result
        A `Machine` (its valve areas), `LtvModel` (areas and staircase), `PeriodicSystem` (its multipliers; in
        discrete time too), `Floquet` (multipliers on the unit circle), `Orbit`, a dict of label to `Orbit`, or
        `Attractors` (cycles, overlaid), `Stroke`, `DataSheet` (its strokes; its `.switching` is drawn alone),
        `AmplitudeResponse` (amplitude over frequency), `OrbitMap`, `ValidityMap`, `ParameterSensitivity`,
        `design.DutyMap`, `design.ClosedLoop`, `design.DutySolution`, `design.TradeOff`, `design.PatternSolution`,
        `design.StabilityMap`, `design.MoveSolution`, or a time or frequency response of python-control.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    TypeError
        No picture is known for what was given.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> figure = lp.plot(lp.load_machine("kunt_singh_1990"))
    """
    from ltvpneu.face import pictures

    return pictures.draw(result)
