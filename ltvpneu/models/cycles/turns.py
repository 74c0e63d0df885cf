"""One turn of either model, and its differences: how its end and figures depend on start and parameters."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.errors import NotConvergedError
from ltvpneu.models.linear.march import march_period
from ltvpneu.models.linear.own_cycle import Question
from ltvpneu.models.linear.plan import Steps, new_steps
from ltvpneu.models.linear.repeat import STATE_STEP
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.parameters import moved
from ltvpneu.models.machine.piston import at_stop
from ltvpneu.models.nonlinear.integrator import OK, Record, joined
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run
from ltvpneu.models.nonlinear.stopped import raise_stopped
from ltvpneu.periodic.orbits.orbit import Trajectory

TOLERANCE = 1e-10
"""Of the integrations that are differenced [-]."""


Period = Callable[[FloatArray, Machine, float], tuple[FloatArray, Trajectory]]
"""From a start, a machine and a frequency to the end of the cycle and the way there."""


TurnFigures = Callable[[FloatArray, Machine, float], FloatArray]
"""Likewise, to figures of it."""


class Jacobians(NamedTuple):
    """Of figures of a turn; by default its end, minima, maxima and means, in this order, (4, n)."""

    by_state: FloatArray
    """Over the start, (4, n, n)."""
    by_parameter: FloatArray
    """With the start kept, (4, n, n_parameters)."""


def march_beside(
    start: FloatArray, question: Question, cells: FloatArray, n_periods: int
) -> tuple[FloatArray, list[Steps]]:
    """March a fitted or self-consistent model over some periods, tightly; return the end and each period's steps.

    Raises
    ------
    NotConvergedError
        The march did not come through.
    """
    plan = question.plan(cells, TOLERANCE)
    steps = new_steps(plan)
    scales = question.machine.state_scales
    state, parts = np.append(start / scales, 1.0), list[Steps]()
    for _ in range(n_periods):
        marched = march_period(state, plan, steps)
        if marched.status != OK:
            raise NotConvergedError(
                f"the march next to the {question.mode} model's cycle at {question.frequency:g} Hz did not come "
                "through, so it has no derivative here; take it elsewhere, or of the nonlinear model",
                residual=marched.defect,
                iterations=1,
            )
        parts.append(steps.cut_to(marched.n_steps))
        state = marched.state
    return state[:-1] * scales, parts


def nonlinear_turn(
    start: FloatArray, machine: Machine, frequency: float, n_periods: int, rtol: float = TOLERANCE
) -> tuple[FloatArray, Record]:
    """Integrate the nonlinear model over some periods; return where it gets to and the way there."""
    pieces = pieces_of(machine.openings, 1 / frequency)
    run = new_run(machine.record, integration_settings(machine, rtol), pieces)
    state, records = start, list[Record]()
    for number in range(n_periods):
        outcome = integrate_period(state, run)
        if outcome.status != OK:
            raise_stopped(machine, outcome.status, number / frequency + outcome.time, outcome.state)
        records.append(outcome.record)
        state = outcome.state
    return state, joined(records, 1 / frequency)


def figures_of(period: Period) -> TurnFigures:
    """Return the function that gives the end of a turn and its figures, one after the other."""

    def figures(start: FloatArray, machine: Machine, frequency: float) -> FloatArray:
        end, trajectory = period(start, machine, frequency)
        n = end.size
        extremes = np.array([trajectory.extremes(i) for i in range(n)])
        return np.array([end, extremes[:, 0], extremes[:, 1], trajectory.means()[:n]])

    return figures


def slopes_along_turn(
    figures: TurnFigures, at: tuple[Machine, float, FloatArray], parameters: Sequence[str]
) -> Jacobians:
    """Return how figures of a turn, of any shape, depend on its start and on parameters: one more axis, the last."""
    machine, frequency, start = at
    scales, n = machine.state_scales, len(machine.states)
    by_state: list[FloatArray] = []
    away = -at_stop(float(start[0]), machine.record)
    for j in range(n):
        move = np.zeros(n)
        move[j] = STATE_STEP * scales[j]
        if away and j < 2:
            # Beyond a stop there is no motion: the derivative is that into the stroke, of second order too.
            move *= away
            here, near, far = (figures(start + steps * move, machine, frequency) for steps in (0, 1, 2))
            by_state.append((4 * near - far - 3 * here) / (2 * move[j]))
            continue
        up, down = figures(start + move, machine, frequency), figures(start - move, machine, frequency)
        by_state.append((up - down) / (2 * move[j]))
    by_parameter: list[FloatArray] = []
    for name in parameters:
        (up, down), width = moved(machine, frequency, name)
        by_parameter.append((figures(start, *up) - figures(start, *down)) / width)
    empty = np.empty((*by_state[0].shape, 0))
    return Jacobians(np.stack(by_state, axis=-1), np.stack(by_parameter, axis=-1) if by_parameter else empty)
