"""LTV model, eq. (8) on the staircase (10): a linear system on each step, about an operating point of its own."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ltvpneu._arrays import FloatArray, finite_array, not_negative, positive, whole
from ltvpneu._clock import Watch, deadline
from ltvpneu.models.linear.linearize import Tangent, linearize_steps
from ltvpneu.models.linear.lti import lti_model_of_turn
from ltvpneu.models.linear.model import LtvModel, assemble, warn_outside
from ltvpneu.models.linear.modes import MODES, OperatingPoints
from ltvpneu.models.linear.operating_points import LEAST_DISTANCE, Turn, held_inside, quasi_static_turn
from ltvpneu.models.linear.own_cycle import Question, Spacing, model_to_tolerance, own_cycle_model
from ltvpneu.models.linear.staircase import default_steps, staircase
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbits.steady import periodic_states
from ltvpneu.periodic.systems.ramps import ramped
from ltvpneu.periodic.systems.system import PeriodicSystem
from ltvpneu.physics.liquid import Liquid

Hold = Literal["zero", "first"]


def ltv_model(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    frequency: float,
    *,
    n_steps: int | None = None,
    operating_points: OperatingPoints | NDArray[np.float64] | None = None,
    tangent: Tangent | None = None,
    least_distance: float = LEAST_DISTANCE,
    spacing: Spacing = "adaptive",
    rtol: float | None = None,
    hold: Hold = "zero",
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> LtvModel:
    """Return the linear time-varying model of a machine.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz].
    n_steps : int, optional
        N_s, steps of the staircase over one turn; at least the number of valve positions, by default that or 2. A
        position that lasts across the start of the turn is cut in two there, and counts as one where no more steps are
        asked for than positions. "fitted" and "self-consistent" models are also cut where the piston stops, reverses or
        breaks away, and where no operating point is found for a whole step.
    operating_points : str or ndarray, shape (n_steps, n), optional
        "lti", the default: means over each step of the LTI model's cycle (17), the position held at its mean over the
        turn, which the paper found more accurate; "lti-position": the position by (17) too; "mean": the cycle's means
        over the whole period (15); "quasi-static": the mean over the turn of the quasi-static states (15)-(16);
        "quasi-static-steps": those states themselves (16), in the wrong phase but at very low speed; or states
        [m, m/s, Pa], one row a step.

        "self-consistent": full tangents about the means of the model's own cycle over its steps, with dry friction and
        stiction; tends to the nonlinear model as steps are added. "fitted": likewise, but the pressure rates are fitted
        over what each step visits (equivalent linearization), which is accurate with few steps. Of liquids, which swing
        many times within a step, take "self-consistent". The multipliers of such a model's system are those of its
        steps as they are; those of its cycle, whose steps follow it, come from `cycle_floquet`.
    tangent : {"paper", "full"}, optional
        See `linearize`; "paper" by default. Not for "fitted" and "self-consistent", which have their own.
    least_distance : float
        Relative distance kept from pressures where the slope of the flow is infinite [-].
    spacing : {"adaptive", "even"}
        Of the steps of "fitted" and "self-consistent" models beyond the valve's positions: where each step's error is
        largest, or even in time.
    rtol : float, optional
        Instead of `n_steps`: take as many steps, up to 2048, as make the estimated relative error of the position's
        amplitude no larger. For "fitted", then the default of gases, and "self-consistent", that of liquids.
    hold : {"zero", "first"}
        What an opening does over a step: stays at its mean, the staircase (10), or ramps as it does in the machine
        (`ramped`), which has an error of fourth instead of second order in the steps' length, in the states between
        steps (in means and extremes of pressures, and with two restrictions in series, of second order too). Then as
        many steps are needed as the openings have linear pieces. Not for "fitted" and "self-consistent", whose
        operating points leave an error of second order anyway.
    max_seconds : float, optional
        Time after which to give up the search for the cycle of a "fitted" or "self-consistent" model [s]; by default
        never.
    progress : callable, optional
        Called with 1 after each valve period of that search, such as the `update` of a tqdm bar.

    Returns
    -------
    LtvModel
        Dry friction, stiction and end stops are neglected, as in the paper's section 6, but in "fitted" and
        "self-consistent" models. `.error_estimate` says how far off it is, `.beyond_stops` how far it passes a stop;
        where even its mean lies well beyond one, a `UserWarning` says so.

    Raises
    ------
    ValueError
        Arguments out of range or at odds, no spring where a quasi-static position is needed.
    NotConvergedError
        An operating point or the model's cycle was not found, or `rtol` not reached; carries the residual.
    TimeLimitError
        `max_seconds` are over.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0)
    >>> print(f"{1e3 * lp.steady_state(model.system).amplitude('position'):.0f} mm")
    40 mm
    >>> model.system.steps[0].sys.input_labels
    ['supply_pressure', 'exhaust_pressure', 'load_force', 'ambient_pressure']

    With dry friction, as accurate as asked for:

    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=4.0, rtol=0.01)
    >>> print(f"{1e3 * model.orbit.amplitude('position'):.1f} mm")
    35.2 mm
    """
    expect_machine(machine)
    machine = machine.at(positive("frequency", frequency, "Hz"))
    not_negative("least_distance", least_distance)
    if spacing not in ("adaptive", "even"):
        raise ValueError(f'spacing: found {spacing!r}, expected "adaptive" or "even"')
    if operating_points is None:
        own = "self-consistent" if isinstance(machine.gas, Liquid) else "fitted"
        operating_points = "lti" if rtol is None else own
    if isinstance(operating_points, str) and operating_points in ("fitted", "self-consistent"):
        if tangent is not None:
            raise ValueError(f"tangent: found {tangent!r}, but {operating_points!r} operating points have their own")
        if hold != "zero":
            raise ValueError(
                f"hold: found {hold!r}, which is for operating points that do not follow the model's cycle"
            )
        question = Question(
            machine=machine, frequency=float(frequency), mode=operating_points, distance=float(least_distance)
        )
        return _following_its_cycle(
            question, n_steps, spacing, rtol, Watch(end=deadline(max_seconds), progress=progress)
        )
    if rtol is not None:
        raise ValueError(
            f"rtol: found {rtol:g} with operating points {operating_points!r}, whose error more steps do not mend; "
            'expected "fitted" or "self-consistent"'
        )
    if spacing != "adaptive":
        raise ValueError(f"spacing: found {spacing!r}, which is for fitted and self-consistent models")
    if hold not in ("zero", "first"):
        raise ValueError(f'hold: found {hold!r}, expected "zero" or "first"')
    n_steps, tangent = default_steps(machine) if n_steps is None else n_steps, "paper" if tangent is None else tangent
    iterations, mode, held_back, mean_balance = 0, "given", (), 0.0
    if isinstance(operating_points, str):
        mode = operating_points
        turn = quasi_static_turn(machine, n_steps)
        stairs, mean_balance = turn.stairs, turn.mean_balance
        iterations = 1 if mode in ("lti", "lti-position", "mean") else 0
        asked = _asked(machine, frequency, turn, operating_points, least_distance)
        points, held_back = held_inside(machine, turn, asked, least_distance)
    else:
        stairs = staircase(machine, n_steps)
        N = stairs.fractions.size - 1
        points = finite_array("operating_points", operating_points, (N, len(machine.states)))
    if hold == "first":
        system = _with_ramps(machine, frequency, stairs.fractions, points, tangent)
    else:
        linearization = linearize_steps(machine, points, stairs.areas, tangent)
        system = assemble(machine, np.diff(stairs.fractions) / frequency, linearization, f"{machine.identifier}_ltv")
    model = LtvModel(
        system=system,
        machine=machine,
        frequency=float(frequency),
        operating_points=points,
        mode=mode,
        held_back=held_back,
        least_distance=least_distance,
        iterations=iterations,
    )
    return warn_outside(model, mean_balance)


def _following_its_cycle(
    question: Question, n_steps: int | None, spacing: Spacing, rtol: float | None, watch: Watch
) -> LtvModel:
    if rtol is None:
        n_steps = whole("n_steps", default_steps(question.machine) if n_steps is None else n_steps)
        return own_cycle_model(question, n_steps, spacing, watch)
    if n_steps is not None:
        raise ValueError(f"n_steps, rtol: found {n_steps} and {rtol:g}, expected one of them")
    if positive("rtol", rtol) >= 1:
        raise ValueError(f"rtol: found {rtol:g}, expected a relative error below 1, such as 0.01")
    return model_to_tolerance(question, rtol, spacing, watch)


def _with_ramps(
    machine: Machine, frequency: float, fractions: FloatArray, points: FloatArray, tangent: Tangent
) -> PeriodicSystem:
    """Return the system whose openings ramp over each step as the machine's do."""
    table = machine.openings
    if np.union1d(table.fractions, fractions).size != fractions.size:
        n_pieces = table.fractions.size - 1
        raise ValueError(
            f'n_steps: found {fractions.size - 1}, expected at least {n_pieces} with hold="first": a step each for the '
            "linear pieces of the openings"
        )
    durations, name = np.diff(fractions) / frequency, f"{machine.identifier}_ltv"
    pieces = table.pieces_at((fractions[:-1] + fractions[1:]) / 2)
    starts, ends = (
        assemble(machine, durations, linearize_steps(machine, points, table.areas_at(shares, pieces), tangent), name)
        for shares in (fractions[:-1], fractions[1:])
    )
    return ramped(starts, ends, parts=1)


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
