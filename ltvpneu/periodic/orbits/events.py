r"""Steps that end where the state reaches a threshold, c z = level: a diode, a check valve, an impact.

The orbit and the durations of such steps are solved for together, by Newton's method with exact derivatives. About
that orbit a disturbance passes the end of such a step by a saltation matrix [Leine2004]_,

.. math:: S = J + \frac{(f^+ - J f^-)\, c'}{c' f^-}

with f^- and f^+ the rates before and after, and J the jump that the step has anyway. So the linearized system is one of
fixed durations whose state jumps: multipliers, norms, derivatives, regulators are those of any other.

.. [Leine2004] R. I. Leine, H. Nijmeijer, "Dynamics and Bifurcations of Non-Smooth Mechanical Systems", Springer 2004,
   chapter 7.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite, finite_array
from ltvpneu.errors import NotConvergedError
from ltvpneu.periodic.algebra.propagate import forced_exponentials
from ltvpneu.periodic.algebra.small import root_time
from ltvpneu.periodic.systems.signals import signal_index
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system

MOST_NEWTON = 50
MOST_PERIODS = 2000
"""Simulated where Newton's method does not get there from the durations given."""
CLOSED = 1e-13
"""Residual, relative to the states' sizes, at which an orbit is found [-]."""
GRID = 64
"""Samples of a step among which the first crossing is looked for; more where the state swings faster."""
GRAZING = 1e-9
"""Rate of c z, relative to the size of its terms, below which a threshold is grazed, not crossed [-]."""


class _Event(NamedTuple):
    step: int
    row: FloatArray
    """Balanced augmented (n + 1): zero at the threshold."""
    taker: int
    """The step that takes up the time."""
    name: str


def with_state_events(
    system: PeriodicSystem,
    events: Mapping[int, tuple[str | ArrayLike, float]],
    *,
    initial_state: ArrayLike | None = None,
) -> PeriodicSystem:
    """Return the system linearized about its orbit, some of whose steps end where the state reaches a threshold.

    Its durations are those of the orbit, and at thresholds its state jumps by the saltation matrix. So `steady_state`
    of it is the orbit, `floquet` has the orbit's multipliers, and `sensitivity` the derivatives of the orbit's states
    and of their means (not those of its multipliers, and not by the duration of a step that an event ends).

    Parameters
    ----------
    system : PeriodicSystem
        Durations of steps with an event are guesses.
    events : mapping from int to (str or array_like of shape (n,), float)
        From the number of a step, the first being 0, to (c, level): the step ends where c z = level; the name of a
        state stands for its row. The first step after it without an event takes up the time, so that later switches
        keep theirs.
    initial_state : array_like, shape (n,), optional
        At the start of the period, where simulation begins if the guesses are too far off; zero by default.

    Raises
    ------
    NotConvergedError
        No orbit with these steps in this order was found; the message says which threshold is not reached.
    ValueError
        No such step, or none that takes up its time before the period ends.

    Examples
    --------
    A boost converter whose diode stops conducting within the period (discontinuous conduction): switch on, off while
    the current flows, and off without current.

    >>> import numpy as np
    >>> import ltvpneu as lp
    >>> L, C, R, T = 10e-6, 100e-6, 12.0, 5e-5
    >>> idle, flows = [[0.0, 0.0], [0.0, -1 / (R * C)]], [[0.0, -1 / L], [1 / C, -1 / (R * C)]]
    >>> steps = lp.PeriodicSystem.from_matrices(
    ...     [idle, flows, idle], [[5 / L, 0.0], [5 / L, 0.0], [0.0, 0.0]], [0.583 * T, 0.2 * T, 0.217 * T])
    >>> orbit = lp.with_state_events(steps, {1: ("z1", 0.0)})
    >>> print(f"{lp.steady_state(orbit).mean('z2'):.4f} V", lp.floquet(orbit).multipliers.real.round(4))
    18.6596 V [0.9057 0.    ]
    """
    expect_system(system)
    start = np.zeros(system.n_states) if initial_state is None else finite_array("initial_state", initial_state)
    start = finite_array("initial_state", start, (system.n_states,))
    found = _events(system, events)
    guess = system.scaled.augmented(start)
    durations = system.durations.copy()
    solved = _newton(system, found, guess, durations)
    if solved is None:
        guess, durations = _marched(system, found, guess, durations)
        solved = _newton(system, found, guess, durations)
    if solved is None:
        raise NotConvergedError(
            f"events: no orbit of {system.name} was found whose steps end as given; give durations nearer to it, or an "
            "initial_state",
            residual=np.inf,
            iterations=MOST_NEWTON,
        )
    return _linearized(system, found, *solved)


def _events(system: PeriodicSystem, events: Mapping[int, tuple[str | ArrayLike, float]]) -> list[_Event]:
    """Return the events in the order of their steps, checked."""
    n, scaled = system.n_states, system.scaled
    found: list[_Event] = []
    given: Any = events
    if not isinstance(given, Mapping):
        raise TypeError(f"events: found {type(given).__name__}, expected a mapping, such as {{1: ('z1', 0.0)}}")
    for step in sorted(events):
        if not 0 <= step < system.n_steps:
            raise ValueError(f"events: found step {step}, expected 0 to {system.n_steps - 1}")
        pair: Any = events[step]
        if not isinstance(pair, tuple | list) or len(cast(Any, pair)) != 2:
            raise ValueError(f"events[{step}]: found {pair!r}, expected (c, level), such as ('z1', 0.0)")
        c, level = events[step]
        row = np.eye(n)[signal_index(system.states, c)] if isinstance(c, str) else c
        row = finite_array(f"events[{step}]: c", row, (n,))
        taker = next((k for k in range(step + 1, system.n_steps) if k not in events), None)
        if taker is None:
            raise ValueError(
                f"events: found one at the end of step {step} and none that takes up its time; expected a step without "
                "an event between it and the end of the period"
            )
        terms = [f"{value:+.6g} {name}" for name, value in zip(system.states, row, strict=True) if value]
        level = finite(f"events[{step}]: level", level)
        balanced = np.append(row * scaled.scales, -level / scaled.unit)
        found.append(_Event(step, balanced, taker, f"{' '.join(terms)} = {level:g}"))
    if not found:
        raise ValueError("events: found none, expected one or more, such as {1: ('z1', 0.0)}")
    return found


def _newton(
    system: PeriodicSystem, events: list[_Event], start: FloatArray, durations: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return the balanced augmented start and the durations of an orbit with these events, or None."""
    n, state, durations = system.n_states, start.copy(), durations.copy()
    residual, slopes, sizes = _residual(system, events, state, durations)
    for _ in range(MOST_NEWTON):
        error = _largest(residual, sizes)
        if not np.isfinite(slopes).all():
            return None
        if error <= CLOSED:
            break
        try:
            change = np.linalg.solve(slopes, -residual)
        except np.linalg.LinAlgError:
            return None
        share = 1.0
        while share > 1e-6:
            trial, lengths = state.copy(), durations.copy()
            trial[:n] += share * change[:n]
            for event, more in zip(events, share * change[n:] * system.period, strict=True):
                lengths[event.step] += more
                lengths[event.taker] -= more
            if (lengths >= 0).all():
                tried = _residual(system, events, trial, lengths)
                if _largest(tried[0], tried[2]) < error or (share == 1.0 and error < 1e-9):
                    break
            share /= 2
        else:
            return None
        before = error
        state, durations, (residual, slopes, sizes) = trial, lengths, tried
        # Rounding leaves no more to gain.
        if before < 1e-10 and _largest(residual, sizes) > before / 4:
            break
    if not _largest(residual, sizes) <= 1e-9 or not _are_first(system, events, state, durations):
        return None
    return state, durations


def _largest(residual: FloatArray, sizes: FloatArray) -> float:
    with np.errstate(invalid="ignore", over="ignore"):
        return float(np.max(np.abs(residual) / sizes, initial=0.0))


def _residual(
    system: PeriodicSystem, events: list[_Event], start: FloatArray, durations: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return by how much a period misses to close and its thresholds, derivatives, and the sizes to compare with.

    Unknowns: the balanced start (n), and the durations of the events' steps over the period.
    """
    n, matrices, jumps = system.n_states, system.scaled.matrices, system.scaled_jumps
    with np.errstate(over="ignore", invalid="ignore"):
        maps = forced_exponentials(matrices * durations[:, None, None], n)
        state, slopes = start, np.eye(n, n + len(events))
        sizes, missed, rows, largest = np.abs(start[:n]), list[float](), list[FloatArray](), list[float]()
        for k in range(system.n_steps):
            state, slopes = maps[k] @ state, maps[k, :n, :n] @ slopes
            rate = (matrices[k] @ state)[:n]
            for i, event in enumerate(events):
                if k in (event.step, event.taker):
                    slopes[:, n + i] += (1 if k == event.step else -1) * rate * system.period
                if k == event.step:
                    missed.append(float(event.row @ state))
                    rows.append(event.row[:n] @ slopes)
                    largest.append(float(np.max(np.abs(event.row * state))))
            sizes = np.maximum(sizes, np.abs(state[:n]))
            state, slopes = jumps[k] @ state, jumps[k, :n, :n] @ slopes
    slopes = slopes - np.eye(n, n + len(events))
    tiny = np.finfo(float).tiny
    thresholds = [
        max(float(np.abs(event.row[:n]) @ sizes), size, tiny) for event, size in zip(events, largest, strict=True)
    ]
    return (
        np.append(state[:n] - start[:n], missed),
        np.concatenate([slopes, np.array(rows)]),
        np.append(np.maximum(sizes, tiny), thresholds),
    )


def _are_first(system: PeriodicSystem, events: list[_Event], state: FloatArray, durations: FloatArray) -> bool:
    """Return whether no threshold is crossed before its step ends."""
    maps = forced_exponentials(system.scaled.matrices * durations[:, None, None], system.n_states)
    by_step = {event.step: event for event in events}
    for k in range(system.n_steps):
        if k in by_step:
            first = _first_crossing(system.scaled.matrices[k], state, by_step[k].row, (1 - 1e-6) * durations[k])
            if first is not None:
                return False
        state = system.scaled_jumps[k] @ maps[k] @ state
    return True


def _first_crossing(matrix: FloatArray, state: FloatArray, row: FloatArray, longest: float) -> float | None:
    """Return when row times the state first changes its sign, after the start, or None [s]."""
    if longest <= 0:
        return None
    swings = float(np.max(np.abs(np.linalg.eigvals(matrix).imag), initial=0.0)) * longest
    count = GRID + min(int(8 * swings / np.pi), 100_000)
    small = forced_exponentials(matrix[None] * (longest / count), len(matrix) - 1)[0]
    values, at = np.empty(count + 1), state
    with np.errstate(over="ignore", invalid="ignore"):
        for i in range(count + 1):
            values[i] = row @ at
            at = small @ at
    # A start on the threshold is not a crossing.
    values[0] = 0.0 if abs(values[0]) <= 1e-12 * np.abs(row * state).max(initial=0.0) else values[0]
    signs = np.sign(values)
    first = int(np.argmax(signs != 0))
    changes = np.flatnonzero(signs[first:] * signs[first] < 0)
    if not changes.size:
        return None
    i = first + int(changes[0])

    low = (i - 1) * longest / count
    at_low = forced_exponentials(matrix[None] * low, len(matrix) - 1)[0] @ state
    after = root_time(matrix, at_low, row, longest / count)
    # Computed another way, a root at a sample may show no change of sign.
    return low + (after if math.isfinite(after) else longest / count)


def _marched(
    system: PeriodicSystem, events: list[_Event], state: FloatArray, durations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return start and durations after as many simulated periods as bring them near to an orbit.

    Raises
    ------
    NotConvergedError
        A threshold is not reached in the time that there is for it.
    """
    n, matrices, jumps = system.n_states, system.scaled.matrices, system.scaled_jumps
    given, by_step = durations.copy(), {event.step: event for event in events}
    missed: _Event | None = None
    for _ in range(MOST_PERIODS):
        begin, missed, durations = state, None, given.copy()
        for k in range(system.n_steps):
            if k in by_step:
                event = by_step[k]
                longest = durations[k : event.taker + 1].sum()
                found = _first_crossing(matrices[k], state, event.row, longest)
                missed = event if found is None else missed
                change = (longest if found is None else found) - durations[k]
                durations[k] += change
                # What the steps between have, they keep as long as there is time.
                for later in range(event.taker, k, -1):
                    given_up = min(change, durations[later])
                    durations[later], change = durations[later] - given_up, change - given_up
            with np.errstate(over="ignore", invalid="ignore"):
                state = jumps[k] @ forced_exponentials(matrices[k][None] * durations[k], n)[0] @ state
            if not np.isfinite(state).all():
                return begin, durations
        if np.max(np.abs(state - begin)[:n], initial=0.0) <= 1e-8 * np.max(np.abs(state[:n]), initial=0.0):
            break
    if missed is not None:
        raise NotConvergedError(
            f"events: step {missed.step} does not reach {missed.name} in the time that it and the steps up to "
            f"{missed.taker} have; the system runs through its steps in another order, so describe that one",
            residual=np.inf,
            iterations=MOST_PERIODS,
        )
    return state, durations


def _linearized(
    system: PeriodicSystem, events: list[_Event], state: FloatArray, durations: FloatArray
) -> PeriodicSystem:
    """Return the system of the orbit's durations with saltation matrices for jumps."""
    n, matrices, scaled = system.n_states, system.scaled.matrices, system.scaled
    jumps, by_step = system.scaled_jumps.copy(), {event.step: event for event in events}
    for k in range(system.n_steps):
        state = forced_exponentials(matrices[k][None] * durations[k], n)[0] @ state
        before, after = state, system.scaled_jumps[k] @ state
        if k in by_step:
            row, jump = by_step[k].row[:n], system.scaled_jumps[k, :n, :n]
            rate = (matrices[k] @ before)[:n]
            following = (matrices[k + 1] @ after)[:n]
            crossing = float(row @ rate)
            if abs(crossing) <= GRAZING * float(np.abs(row) @ np.abs(rate)):
                raise NotConvergedError(
                    f"events: step {k} grazes {by_step[k].name} instead of crossing it, and there a disturbance has no "
                    "linear law",
                    residual=abs(crossing),
                    iterations=0,
                )
            jumps[k, :n, :n] = jump + np.outer(following - jump @ rate, row) / crossing
            # So that the orbit is the one found.
            jumps[k, :n, n] = (after[:n] - jumps[k, :n, :n] @ before[:n]) / scaled.unit
        state = after
    scales = scaled.scales
    return replace(
        system,
        durations=durations,
        J=jumps[:, :n, :n] * scales[:, None] / scales,
        j=jumps[:, :n, n] * scales * scaled.unit,
    )
