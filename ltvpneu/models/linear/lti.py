r"""LTI model: the coefficients of G averaged over the turn at one operating point, the forcing kept periodic.

Averaging G alone leaves a spurious forcing (G_m - Gavg) zbar, so the model is built about zbar:
z' = Gavg z + f_m + (G_m - Gavg) zbar. The remainder of each step carries that term.
"""

import numpy as np

from ltvpneu._arrays import not_negative, positive
from ltvpneu.models.linear.linearize import Linearization, linearize_steps
from ltvpneu.models.linear.model import LtvModel, assemble, warn_outside
from ltvpneu.models.linear.operating_points import LEAST_DISTANCE, Turn, held_inside, quasi_static_turn
from ltvpneu.models.machine.machine import Machine, expect_machine


def lti_model(
    machine: Machine,
    frequency: float,
    *,
    n_steps: int | None = None,
    about_operating_point: bool = True,
    least_distance: float = LEAST_DISTANCE,
) -> LtvModel:
    """Return the LTI model: averaged coefficients about the mean quasi-static state, periodic forcing.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    n_steps : int, optional
        Steps of the forcing; by default as many as the openings have linear pieces.
    about_operating_point : bool
        Whether to add (G_m - Gavg) zbar to the forcing. Without it the averaging itself acts as a force.
    least_distance : float
        Relative distance kept from pressures where the slope of the flow is infinite [-].

    Returns
    -------
    LtvModel
        With the same A in every step.

    Raises
    ------
    ValueError
        No spring, frequency not above zero, or fewer steps than valve positions.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> orbit = lp.steady_state(lp.lti_model(lp.load_machine("kunt_singh_1990"), frequency=4.0).system)
    >>> print(f"{1e3 * orbit.amplitude('position'):.0f} mm")
    50 mm
    """
    expect_machine(machine)
    machine = machine.at(positive("frequency", frequency, "Hz"))
    turn = quasi_static_turn(machine, n_steps)
    model = lti_model_of_turn(machine, frequency, turn, about_operating_point, least_distance)
    return warn_outside(model, turn.mean_balance)


def lti_model_of_turn(
    machine: Machine, frequency: float, turn: Turn, about_operating_point: bool, least_distance: float
) -> LtvModel:
    """Return the LTI model for a turn whose quasi-static states are known."""
    positive("frequency", frequency, "Hz")
    not_negative("least_distance", least_distance)
    stairs = turn.stairs
    asked = np.empty_like(turn.quasi_static)
    asked[:] = turn.mean
    points, held_back = held_inside(machine, turn, asked, least_distance)
    each = linearize_steps(machine, points, stairs.areas, "paper")
    weights = np.diff(stairs.fractions)
    # From the first step's on, so that entries equal in all steps stay equal to the last bit.
    average = each.A[0] + np.sum(weights[:, None, None] * (each.A - each.A[0]), axis=0)
    r = each.r
    if about_operating_point:
        r = r + ((each.A - average) @ points[:, :, None])[:, :, 0]
    A = np.empty_like(each.A)
    A[:] = average
    averaged = Linearization(A=A, B=each.B, r=r, f=each.B @ machine.levels + r)
    return LtvModel(
        system=assemble(machine, np.diff(stairs.fractions) / frequency, averaged, f"{machine.identifier}_lti"),
        machine=machine,
        frequency=float(frequency),
        operating_points=points,
        mode="mean",
        held_back=held_back,
        least_distance=least_distance,
        iterations=0,
    )
