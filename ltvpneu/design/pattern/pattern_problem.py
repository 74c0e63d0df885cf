r"""Which of N equal slots the valve is on in, as a mixed-integer problem.

With the operating points frozen, a slot takes the state through its exact map, z_{j+1} = Phi_on z_j + g_on or that of
"off". The choice b_j is written with the state in two parts, of which one is zero (the convex hull of both),

.. math:: z_j = z_j^{on} + z_j^{off}, \quad b_j \underline z \le z_j^{on} \le b_j \overline z, \quad
          (1 - b_j) \underline z \le z_j^{off} \le (1 - b_j) \overline z

so means over a slot and the flow from the supply are linear, and HiGHS solves for the pattern, not for a rounding of
it.
"""

import math
import os
import sys
from functools import cache
from typing import Any, Literal, NamedTuple, cast

import cvxpy as cp
import highspy
import numpy as np
from cvxpy.error import SolverError as CvxpySolverError

from ltvpneu._arrays import BoolArray, FloatArray, finite, whole
from ltvpneu.design.pattern.slots import Slots, state_bounds
from ltvpneu.design.switching.goals import Wanted, wanted_bounds
from ltvpneu.errors import SolverError
from ltvpneu.models.machine.machine import Machine

OBJECTIVES = ("amplitude", "mean_error", "air_use", "switching")
RELATIVE_GAP = 1e-9
"""Asked of HiGHS."""


class Goal(NamedTuple):
    """What one state's mean or amplitude has to be."""

    name: str
    kind: Literal["mean", "amplitude"]
    state: str
    low: float
    """-inf where there is no lower bound."""
    high: float

    def missed_by(self, figure: float) -> float:
        """Return by how much a figure is outside the bounds."""
        return max(self.low - figure, figure - self.high, 0.0)

    def beyond(self, figures: FloatArray, within: float = 0.0) -> FloatArray:
        """Return by how much figures are, those within a tolerance not at all."""
        return np.maximum(np.maximum(self.low - figures, figures - self.high) - within, 0.0)


class Asked:
    """The goals, checked."""

    def __init__(  # noqa: PLR0913 - what the caller gave
        self,
        machine: Machine,
        minimize: str,
        mean: dict[str, Wanted],
        amplitude: dict[str, float],
        n_pulses: int | None,
        shortest: tuple[int, int],
        n_slots: int,
    ) -> None:
        if minimize not in OBJECTIVES:
            raise ValueError(f"minimize: found {minimize!r}, expected one of {', '.join(OBJECTIVES)}")
        if minimize == "mean_error" and not mean:
            raise ValueError('minimize: found "mean_error" without wanted means; give mean={"position": ...}')
        for name in (*mean, *amplitude):
            if name not in machine.states:
                raise ValueError(f"mean, amplitude: found {name!r}, expected one of {', '.join(machine.states)}")
        self.minimize, self.n_slots = minimize, n_slots
        self.states = machine.states
        self.scales = dict(zip(machine.states, machine.state_scales.tolist(), strict=True))
        self.mean = {name: wanted_bounds(f"mean[{name!r}]", wanted) for name, wanted in mean.items()}
        self.amplitude = {name: finite(f"amplitude[{name!r}]", most) for name, most in amplitude.items()}
        self.n_pulses = None if n_pulses is None else whole("n_pulses", n_pulses)
        self.shortest = whole("shortest_off", shortest[1]), whole("shortest_on", shortest[0])
        self.wanted_means = [
            Goal(f"mean {name}", "mean", name, -math.inf if low is None else low, math.inf if high is None else high)
            for name, (low, high) in self.mean.items()
        ]
        amplitudes = [
            Goal(f"amplitude {name}", "amplitude", name, -math.inf, most) for name, most in self.amplitude.items()
        ]
        # Where means are what is made small, they are no goals that could be broken.
        self.goals = amplitudes if minimize == "mean_error" else [*self.wanted_means, *amplitudes]
        if sum(self.shortest) > n_slots:
            raise ValueError(
                f"shortest_on, shortest_off: found {shortest[0]} and {shortest[1]} slots, more than n_slots = {n_slots}"
            )


class Solved(NamedTuple):
    """A pattern, (n_slots,), its objective, and the least that it could be were slots on in part."""

    status: str
    pattern: BoolArray
    value: float
    relaxation: float


def solved_pattern(ask: Asked, slots: Slots) -> Solved:
    """Solve for the pattern, and with parts of slots on for the bound that this gives."""
    best: tuple[float, BoolArray] | None = None
    written = _problem(ask, slots, boolean=True)
    on, N = written.on, ask.n_slots
    # A pattern and the same turned round are one: those that go on in the first slot stand for all but two.
    for ends in ([on[0] == 1, on[N - 1] == 0], [on == 0], [on == 1]):
        problem = cp.Problem(written.problem.objective, [*written.problem.constraints, *ends])
        if _run(problem) == "optimal":
            value = float(cast(float, problem.value))
            if best is None or value < best[0]:
                best = value, np.asarray(on.value, dtype=np.float64) > 0.5
    if best is None:
        return Solved("infeasible", np.zeros(0, dtype=np.bool_), np.nan, np.nan)
    return Solved("optimal", turned_first(best[1]), best[0] * written.unit, relaxation(ask, slots))


def relaxation(ask: Asked, slots: Slots) -> float:
    """Return the least objective if slots could be on in part."""
    relaxed = _problem(ask, slots, boolean=False)
    _run(relaxed.problem)
    return float(cast(float, relaxed.problem.value)) * relaxed.unit


def turned_first(pattern: BoolArray) -> BoolArray:
    """Return the pattern turned round so that, of all its turns, its slots on come first."""
    turns = [np.roll(pattern, -i) for i in range(pattern.size)]
    return max(turns, key=lambda turn: tuple(turn.tolist()))


class _Written(NamedTuple):
    problem: cp.Problem
    on: cp.Variable
    unit: float
    """Of the objective."""


def _problem(ask: Asked, slots: Slots, *, boolean: bool) -> _Written:
    N, n = ask.n_slots, slots.scales.size
    low, high = state_bounds(slots, N)
    on = cp.Variable(N, boolean=True) if boolean else cp.Variable(N)
    states, with_on = cp.Variable((N, n)), cp.Variable((N, n))
    with_off = states - with_on
    column = cp.reshape(on, (N, 1), order="C")
    following = (
        with_on @ slots.maps[1].T + column @ slots.moves[1][None]
        + with_off @ slots.maps[0].T + (1 - column) @ slots.moves[0][None]
    )  # fmt: skip
    every: list[Any] = [
        on >= 0, on <= 1,
        with_on >= column @ low[None], with_on <= column @ high[None],
        with_off >= (1 - column) @ low[None], with_off <= (1 - column) @ high[None],
        states[1:] == following[:-1], states[0] == following[-1],
    ]  # fmt: skip
    mean_on = with_on @ slots.mean_maps[1].T + column @ slots.mean_moves[1][None]
    mean_off = with_off @ slots.mean_maps[0].T + (1 - column) @ slots.mean_moves[0][None]
    means: Any = cp.sum(mean_on + mean_off, axis=0) / N
    flow = (
        cp.sum(mean_on @ slots.flow_rows[1] + on * slots.flow_offsets[1])
        + cp.sum(mean_off @ slots.flow_rows[0] + (1 - on) * slots.flow_offsets[0])
    ) / N  # fmt: skip

    def span(i: int) -> Any:
        return (cp.max(states[:, i]) - cp.min(states[:, i])) / 2

    for name, (least, most) in ask.mean.items():
        i = ask.states.index(name)
        if ask.minimize != "mean_error":
            every += [] if least is None else [means[i] >= least / slots.scales[i]]
            every += [] if most is None else [means[i] <= most / slots.scales[i]]
    for name, most in ask.amplitude.items():
        i = ask.states.index(name)
        every.append(span(i) <= most / slots.scales[i])
    rises = cp.Variable(N, nonneg=True)
    before = cp.hstack([on[N - 1 :], on[: N - 1]])
    every.append(rises >= on - before)
    if ask.n_pulses is not None:
        every.append(cp.sum(rises) <= ask.n_pulses)
    every += _long_enough(on, before, ask.shortest)
    unit, goal = 1.0, cast(Any, cp.sum(rises))
    if ask.minimize == "amplitude":
        unit, goal = float(slots.scales[0]), span(0)
    elif ask.minimize == "mean_error":
        off_by = cp.Variable(len(ask.mean), nonneg=True)
        for row, (name, (least, most)) in enumerate(ask.mean.items()):
            i = ask.states.index(name)
            every += [] if most is None else [off_by[row] >= means[i] - most / slots.scales[i]]
            every += [] if least is None else [off_by[row] >= least / slots.scales[i] - means[i]]
        goal = cp.sum(off_by)
    elif ask.minimize == "air_use":
        unit = float(np.max(np.abs(slots.flow_offsets), initial=0.0)) or 1.0
        goal = flow / unit
    return _Written(cp.Problem(cp.Minimize(goal), every), on, unit)


def _long_enough(on: cp.Variable, before: Any, shortest: tuple[int, int]) -> list[Any]:
    """Return constraints that a change of the valve lasts for some slots; first those after going off."""
    N, found = on.size, list[Any]()
    for ahead in range(1, max(shortest)):
        later = cp.hstack([on[ahead:], on[:ahead]]) if ahead < N else on
        if ahead < shortest[1]:
            found.append(later >= on - before)
        if ahead < shortest[0]:
            found.append(1 - later >= before - on)
    return found


@cache
def _quiet_highs() -> None:
    """Let HiGHS print what it does when it is first used in a process, whatever its options, to nowhere.

    Its text goes straight to the process's output, past Python's.
    """
    sys.stdout.flush()
    try:
        kept = os.dup(1)
    except OSError:
        # No output at all, as in a program with windows only.
        return
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            highspy.Highs()
        finally:
            os.dup2(kept, 1)
            os.close(kept)


def _run(problem: cp.Problem) -> str:
    _quiet_highs()
    try:
        problem.solve(solver=cp.HIGHS, mip_rel_gap=RELATIVE_GAP, output_flag=False)
    except CvxpySolverError as error:
        raise SolverError(f"HiGHS failed: {error}", status="solver_error") from None
    status = str(problem.status)
    if status not in ("optimal", "infeasible"):
        raise SolverError(f"HiGHS ended with status {status!r}: no pattern to trust", status=status)
    return status
