"""One step of a Runge-Kutta method on the nonlinear equations, compiled.

The Dormand-Prince pair of order 5(4), coefficients from scipy's RK45 with its quartic interpolant, and the paper's
classical method of fourth order, whose interpolant is the cubic through both states and rates.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import RK45

from ltvpneu._arrays import FloatArray, layout
from ltvpneu._compiled import by_field, compiled, inlined
from ltvpneu.models.machine.dynamics import state_rate
from ltvpneu.models.machine.openings import PieceRecord, Pieces, write_areas
from ltvpneu.models.machine.records import MAX_STATES, MachineRecord


class AdaptiveSettings(NamedTuple):
    """How to integrate with step control."""

    rtol: float
    """Tolerated error of a step relative to the state [-]."""
    max_steps: int
    """Steps that a period may take."""
    atol: Annotated[FloatArray, MAX_STATES]
    """As `rtol`, but absolute, per state."""


class FixedSettings(NamedTuple):
    """How to integrate with a fixed step."""

    longest: float
    """Longest step [s]."""
    max_steps: int
    """Steps that a period may take."""


Settings = AdaptiveSettings | FixedSettings


class Progress:
    """How far an integration has got."""

    status: int
    mode: int
    """Of the piston."""
    piece: int
    """Number of the piece of the valve period."""
    time: float
    """[s]"""
    steps: int
    """Taken in this period."""
    kind: int
    """Kind of the event that it stopped at; below zero where it reached the end."""
    n_logged: int
    """Intervals logged."""
    budget: int
    """Steps that may be taken before the kernel returns, so that a caller can stop it; it goes on when called again."""
    ended: int
    """Why a march of periods ended; zero where it has not."""
    done: int
    """Periods since its start."""
    simulated: int
    """Periods all told."""
    sequence: int
    """Stands for the last period's sequence of events."""
    repeats: int
    """Periods after which the state repeats."""
    change: float
    """Scaled change over so many periods, or the least over any number [-]."""


class RunRecord:
    """What is integrated, how, and how far that has got, as the compiled kernels read it.

    There are four types of it, by the type of the machine and of the settings.
    """

    machine: MachineRecord
    settings: AdaptiveSettings
    period: float
    """[s]"""
    progress: Progress


class FixedRun:
    """A run with a fixed step, as far as the kernels of that method read it."""

    machine: MachineRecord
    settings: FixedSettings
    progress: Progress


UNBOUNDED = 2**62
"""A budget of steps without an end."""


class Run(NamedTuple):
    """What is integrated, and how."""

    records: NDArray[Any]
    """One `RunRecord`, shape (1,)."""
    pieces: Pieces


def new_run(machine: MachineRecord, settings: Settings, pieces: Pieces) -> Run:
    """Return a run of a machine through the pieces of its valve period."""
    record: Any = machine
    records = np.zeros(1, layout(RunRecord, machine=record.dtype, settings=layout(type(settings))))
    records["machine"], records["period"] = record, pieces["end"][-1]
    records["progress"]["budget"] = UNBOUNDED
    for name, value in settings._asdict().items():
        target = records["settings"][name]
        target[(0, *map(slice, np.shape(value)))] = value
    return Run(records, pieces)


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


def _adaptive_step(h: float, piece: PieceRecord, run: RunRecord, space: Workspace) -> float:
    """Try one Dormand-Prince step and return its scaled error; infinite where a stage left the equations' domain.

    Writes the new state, its rate as the seventh stage and, if the error is at most one, the interpolant.
    """
    # Taken out of their records and tuples once: within the loop each reading would count references.
    state, new, rate, stages, areas = space.state, space.new, space.rate, space.stages, space.areas
    settings, machine, mode, ramped = run.settings, run.machine, run.progress.mode, piece.ramped
    n, time, coefficients = new.size, run.progress.time, space.coefficients
    for stage in range(1, 7):
        for i in range(n):
            total = 0.0
            for j in range(stage):
                total += _STAGES[stage, j] * stages[j, i]
            new[i] = state[i] + h * total
        # Areas that do not change were written when the piece began.
        if ramped:
            write_areas(time + _NODES[stage] * h, piece, areas)
        if not state_rate(new, areas, mode, machine, rate):
            return math.inf
        for i in range(n):
            stages[stage, i] = rate[i]
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
                coefficients[power + 1, i] = h * total
    return worst


def _fixed_step(h: float, piece: PieceRecord, run: FixedRun, space: Workspace) -> float:
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
        write_areas(run.progress.time + share * h, piece, space.areas)
        if not state_rate(new, space.areas, run.progress.mode, run.machine, stages[stage]):
            return math.inf
    # Where the next step looks for the rate of its start.
    copy(stages[4], stages[6])
    for i in range(new.size):
        rise, begin, end = new[i] - state[i], h * stages[0, i], h * stages[4, i]
        coefficients[1, i] = begin
        coefficients[2, i] = 3.0 * rise - 2.0 * begin - end
        coefficients[3, i] = begin + end - 2.0 * rise
        coefficients[4, i] = 0.0
    return 0.0


try_step = by_field("settings.longest", "run", _fixed_step, _adaptive_step)
"""Try a step of the run's method, from its present time; return its scaled error, accepted up to one."""


def _controls_steps(run: RunRecord) -> bool:
    return True


TIGHT = 1e-9
"""Relative tolerance below which steps end where a flow reverses [-]."""


def _keeps_steps(run: FixedRun) -> bool:
    return False


is_adaptive = by_field("settings.longest", "run", _keeps_steps, _controls_steps)
"""Whether the run's method chooses its steps by their error."""


def _is_tight(run: RunRecord) -> bool:
    return run.settings.rtol < TIGHT


is_tight = by_field("settings.longest", "run", _keeps_steps, _is_tight)
"""Whether steps are to end where a pressure passes that of a source."""


@compiled
def _scaled_size(values: FloatArray, state: FloatArray, settings: AdaptiveSettings) -> float:
    """Largest of some values in units of the tolerated error."""
    worst = 0.0
    for i in range(state.size):
        worst = max(worst, abs(values[i]) / (settings.atol[i] + settings.rtol * abs(state[i])))
    return worst


def _first_length(piece: PieceRecord, run: RunRecord, space: Workspace) -> float:
    """Length of the first step after a switch or an event, from the rate there as the first stage [s].

    A short Euler step tells how fast the rate changes: in a time tau the rate, d in units of the tolerated error,
    becomes another. A method of fifth order then errs by about d tau (h / tau)^5 / 100 units, which is to be a small
    part of one.
    """
    period = run.period
    rate = _scaled_size(space.stages[0], space.state, run.settings)
    if rate == 0.0:
        return 1e-3 * period
    small = min(0.01 * _scaled_size(space.state, space.state, run.settings) / rate, 1e-4 * period)
    for i in range(space.state.size):
        space.new[i] = space.state[i] + small * space.stages[0, i]
    write_areas(run.progress.time + small, piece, space.areas)
    if small == 0.0 or not state_rate(space.new, space.areas, run.progress.mode, run.machine, space.rate):
        return 1e-6 * period
    for i in range(space.state.size):
        space.new[i] = (space.rate[i] - space.stages[0, i]) / small
    change = _scaled_size(space.new, space.state, run.settings)
    tau = rate / change if change > 0.0 else period
    return min(0.5 * tau * (100.0 / (rate * tau)) ** 0.2, period)


def _fixed_length(piece: PieceRecord, run: FixedRun, space: Workspace) -> float:
    """Length of the fixed-step method's steps in a piece, a whole number of which fill it [s]."""
    length, longest = piece.end - piece.begin, run.settings.longest
    return length / math.ceil(length / longest * (1.0 - 1e-12))


first_length = by_field("settings.longest", "run", _fixed_length, _first_length)
"""Length of the first step in a piece, or after an event [s]."""


@inlined
def start_rate(piece: PieceRecord, run: RunRecord, space: Workspace) -> bool:
    """Write the rate at the state as the first stage; False outside the equations' domain."""
    write_areas(run.progress.time, piece, space.areas)
    return state_rate(space.state, space.areas, run.progress.mode, run.machine, space.stages[0])
