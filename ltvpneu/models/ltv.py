"""LTV model, eq. (8) on the staircase (10): a linear system on each step, about an operating point of its own."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import FloatArray, finite_array, not_negative, positive, whole
from ltvpneu.models.linearize import LtvModel, Tangent, assemble, linearize_steps
from ltvpneu.models.lti import lti_model_of_turn
from ltvpneu.models.machine import Machine
from ltvpneu.models.operating_points import LEAST_DISTANCE, Turn, held_inside, quasi_static_turn
from ltvpneu.models.own_cycle import Question, Spacing, own_cycle_model
from ltvpneu.models.staircase import staircase
from ltvpneu.periodic.exponential import ExponentialTrajectory
from ltvpneu.periodic.steady import periodic_states

OperatingPoints = Literal[
    "lti", "lti-position", "mean", "quasi-static", "quasi-static-steps", "fitted", "self-consistent"
]
MODES: tuple[OperatingPoints, ...] = (
    "lti", "lti-position", "mean", "quasi-static", "quasi-static-steps", "fitted", "self-consistent"
)  # fmt: skip


def ltv_model(
    machine: Machine,
    frequency: float,
    *,
    n_steps: int = 2,
    operating_points: OperatingPoints | NDArray[np.float64] = "lti",
    tangent: Tangent = "paper",
    least_distance: float = LEAST_DISTANCE,
    spacing: Spacing = "adaptive",
) -> LtvModel:
    """Return the linear time-varying model of a machine.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    n_steps : int
        N_s, steps of the staircase over one turn; at least the number of valve positions. A position that lasts across
        the start of the turn is cut in two there, and counts as one where no more steps are asked for than positions.
    operating_points : str or ndarray, shape (n_steps, n)
        "lti": means over each step of the LTI model's cycle (17), the position held at its mean over the turn, which
        the paper found more accurate; "lti-position": the position by (17) too; "mean": the cycle's means over the
        whole period (15); "quasi-static": the mean over the turn of the quasi-static states (15)-(16);
        "quasi-static-steps": those states themselves (16), in the wrong phase but at very low speed; or states
        [m, m/s, Pa], one row a step.
    tangent : {"paper", "full"}
        See `linearize`.
    least_distance : float
        Relative distance kept from pressures where the slope of the flow is infinite [-].

    Returns
    -------
    LtvModel
        Dry friction and stiction are neglected, as in the paper's section 6.

    Raises
    ------
    ValueError
        Arguments out of range, no spring where a quasi-static position is needed.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> print(f"{1e3 * lp.steady_state(model.system).amplitude('position'):.0f} mm")
    40 mm
    >>> model.system.steps[0].sys.input_labels
    ['supply_pressure', 'exhaust_pressure', 'load_force']
    """
    positive("frequency", frequency, "Hz")
    not_negative("least_distance", least_distance)
    iterations, mode, held_back = 0, "given", ()
    if operating_points == "fitted" or operating_points == "self-consistent":
        question = Question(
            machine=machine, frequency=float(frequency), mode=operating_points, distance=least_distance
        )
        return own_cycle_model(question, whole("n_steps", n_steps), spacing)
    if isinstance(operating_points, str):
        mode = operating_points
        turn = quasi_static_turn(machine, n_steps)
        stairs = turn.stairs
        iterations = 1 if mode in ("lti", "lti-position", "mean") else 0
        asked = _asked(machine, frequency, turn, operating_points, least_distance)
        points, held_back = held_inside(machine, turn, asked, least_distance)
    else:
        stairs = staircase(machine, n_steps)
        N = stairs.fractions.size - 1
        points = finite_array("operating_points", operating_points, (N, len(machine.states)))
    linearization = linearize_steps(machine, points, stairs.areas, tangent)
    return LtvModel(
        system=assemble(machine, np.diff(stairs.fractions) / frequency, linearization, f"{machine.identifier}_ltv"),
        machine=machine,
        frequency=float(frequency),
        operating_points=points,
        mode=mode,
        held_back=held_back,
        least_distance=least_distance,
        iterations=iterations,
    )


def _asked(machine: Machine, frequency: float, turn: Turn, mode: OperatingPoints, least_distance: float) -> FloatArray:
    """Return the operating points that a mode asks for, shape (n_steps, n)."""
    N = turn.stairs.areas.shape[0]
    if mode == "quasi-static":
        return np.tile(turn.mean, (N, 1))
    if mode == "quasi-static-steps":
        return turn.quasi_static.copy()
    if mode not in MODES:
        raise ValueError(f"operating_points: found {mode!r}, expected one of {', '.join(MODES)}, or an array of states")
    system = lti_model_of_turn(machine, frequency, turn, True, least_distance).system
    cycle = ExponentialTrajectory(system=system, step_states=periodic_states(system))
    means = cycle.step_state_means()
    if mode == "mean":
        return np.tile(np.diff(turn.stairs.fractions) @ means, (N, 1))
    if mode == "lti":
        means[:, 0] = turn.mean[0]
    return means
