"""One step of a Runge-Kutta method on the nonlinear equations, compiled.

The Dormand-Prince pair of order 5(4), coefficients from scipy's RK45 with its quartic interpolant, and the paper's
classical method of fourth order, whose interpolant is the cubic through both states and rates.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import RK45

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined
from ltvpneu.models.machine.arrays import MachineArrays
from ltvpneu.models.machine.dynamics import state_rate
from ltvpneu.models.machine.openings import Schedule, write_areas


class Settings(NamedTuple):
    """How to integrate."""

    rtol: float
    """Tolerated error of a step relative to the state [-]; unused with a fixed step."""
    atol: FloatArray
    """The same, absolute, per state, shape (n_states,)."""
    fixed_step: float
    """Longest step of the fixed-step method [s]; 0 for the adaptive one."""
    max_steps: int
    """Steps a period may take."""


class Run(NamedTuple):
    """What is integrated, and how."""

    schedule: Schedule
    machine: MachineArrays
    settings: Settings


class Workspace(NamedTuple):
    """Arrays that the steps write into."""

    state: FloatArray
    """(n_states,)"""
    new: FloatArray
    """State at the end of the step that is tried, (n_states,)."""
    rate: FloatArray
    """(n_states,)"""
    stages: FloatArray
    """Rates at the stages; the first is that of the state, (7, n_states)."""
    coefficients: FloatArray
    """Interpolant in powers of the share of the step; the first row is the state, (5, n_states)."""
    areas: FloatArray
    """(2, n_paths)"""


# The last stage is the step's end, whose weights are the method's own: its rate starts the next step.
_STAGES = np.zeros((7, 6))
_STAGES[:6, :5] = RK45.A
_STAGES[6] = RK45.B
_NODES = np.append(RK45.C, 1.0)
_ERROR = RK45.E
_INTERPOLANT = RK45.P


@inlined
def copy(source: FloatArray, target: FloatArray) -> None:
    """Write one vector into another entry by entry: numba takes seconds to compile what checks the shapes of slices."""
    for i in range(source.size):
        target[i] = source[i]


@inlined
def _adaptive_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Try one Dormand-Prince step and return its scaled error; infinite where a stage left the equations' domain.

    Writes the new state, its rate as the seventh stage and, if the error is at most one, the interpolant.
    """
    state, new, stages, settings = space.state, space.new, space.stages, run.settings
    # Areas that do not change were written when the piece began.
    n, ramped = new.size, run.schedule.ramped[piece]
    for stage in range(1, 7):
        for i in range(n):
            total = 0.0
            for j in range(stage):
                total += _STAGES[stage, j] * stages[j, i]
            new[i] = state[i] + h * total
        if ramped:
            write_areas(time + _NODES[stage] * h, piece, run.schedule, space.areas)
        if not state_rate(new, space.areas, mode, run.machine, space.rate):
            return math.inf
        copy(space.rate, stages[stage])
    worst = 0.0
    for i in range(n):
        error = 0.0
        for j in range(7):
            error += _ERROR[j] * stages[j, i]
        scale = settings.atol[i] + settings.rtol * max(abs(state[i]), abs(new[i]))
        worst = max(worst, abs(h * error) / scale)
    if worst <= 1.0:
        for i in range(n):
            for power in range(4):
                total = 0.0
                for j in range(7):
                    total += _INTERPOLANT[j, power] * stages[j, i]
                space.coefficients[power + 1, i] = h * total
    return worst


@compiled
def _fixed_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Take one classical Runge-Kutta step of fourth order; return 0, or infinity as `_adaptive_step`.

    The interpolant is the cubic through both states and rates.
    """
    state, new, stages, coefficients = space.state, space.new, space.stages, space.coefficients
    for stage in range(1, 5):
        share = 0.5 if stage < 3 else 1.0
        for i in range(new.size):
            slope = stages[stage - 1, i]
            if stage == 4:
                slope = (stages[0, i] + 2.0 * stages[1, i] + 2.0 * stages[2, i] + stages[3, i]) / 6.0
            new[i] = state[i] + share * h * slope
        write_areas(time + share * h, piece, run.schedule, space.areas)
        if not state_rate(new, space.areas, mode, run.machine, space.rate):
            return math.inf
        copy(space.rate, stages[stage])
    # Where the next step looks for the rate of its start.
    copy(stages[4], stages[6])
    for i in range(new.size):
        rise, begin, end = new[i] - state[i], h * stages[0, i], h * stages[4, i]
        coefficients[1, i] = begin
        coefficients[2, i] = 3.0 * rise - 2.0 * begin - end
        coefficients[3, i] = begin + end - 2.0 * rise
        coefficients[4, i] = 0.0
    return 0.0


@compiled
def fixed_length(piece: int, run: Run) -> float:
    """Length of the fixed-step method's steps in a piece, a whole number of which fill it [s]."""
    length = run.schedule.times[piece + 1] - run.schedule.times[piece]
    return length / math.ceil(length / run.settings.fixed_step * (1.0 - 1e-12))


@inlined
def _scaled_size(values: FloatArray, state: FloatArray, settings: Settings) -> float:
    """Largest of some values in units of the tolerated error."""
    worst = 0.0
    for i in range(state.size):
        worst = max(worst, abs(values[i]) / (settings.atol[i] + settings.rtol * abs(state[i])))
    return worst


@compiled
def first_length(time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Length of the adaptive method's first step after a switch or an event [s].

    A short Euler step tells how fast the rate changes: in a time tau the rate, d in units of the tolerated error,
    becomes another. A method of fifth order then errs by about d tau (h / tau)^5 / 100 units, which is to be a small
    part of one.
    """
    period = run.schedule.times[-1]
    rate = _scaled_size(space.stages[0], space.state, run.settings)
    if rate == 0.0:
        return 1e-3 * period
    small = min(0.01 * _scaled_size(space.state, space.state, run.settings) / rate, 1e-4 * period)
    for i in range(space.state.size):
        space.new[i] = space.state[i] + small * space.stages[0, i]
    write_areas(time + small, piece, run.schedule, space.areas)
    if small == 0.0 or not state_rate(space.new, space.areas, mode, run.machine, space.rate):
        return 1e-6 * period
    for i in range(space.state.size):
        space.new[i] = (space.rate[i] - space.stages[0, i]) / small
    change = _scaled_size(space.new, space.state, run.settings)
    tau = rate / change if change > 0.0 else period
    return min(0.5 * tau * (100.0 / (rate * tau)) ** 0.2, period)


@inlined
def start_rate(time: float, piece: int, mode: int, run: Run, space: Workspace) -> bool:
    """Write the rate at the state as the first stage; False outside the equations' domain."""
    write_areas(time, piece, run.schedule, space.areas)
    inside = state_rate(space.state, space.areas, mode, run.machine, space.rate)
    copy(space.rate, space.stages[0])
    return inside


@inlined
def try_step(h: float, time: float, piece: int, mode: int, run: Run, space: Workspace) -> float:
    """Try a step of the method that the settings name; return its scaled error, accepted up to one."""
    if run.settings.fixed_step > 0.0:
        return _fixed_step(h, time, piece, mode, run, space)
    return _adaptive_step(h, time, piece, mode, run, space)
