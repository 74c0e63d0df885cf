r"""Response of a periodic system to inputs that change in time, held or linear between samples.

Between two neighbouring instants, of the samples and of the switches, u(t) = v + s t with constant v and s, so that

.. math:: \frac{d}{dt} \begin{bmatrix} z \\ u \\ s \\ 1 \end{bmatrix}
          = \begin{bmatrix} A & B & 0 & r \\ 0 & 0 & I & 0 \\ 0 & 0 & 0 & 0 \\ 0 & 0 & 0 & 0 \end{bmatrix}
            \begin{bmatrix} z \\ u \\ s \\ 1 \end{bmatrix}

and one exponential gets from the first to the second exactly.
"""

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import BoolArray, FloatArray, IntArray, finite_array
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.algebra.propagate import forced_exponentials
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system

if TYPE_CHECKING:
    import control

SAME_TIME = 1e-12
"""Share of the period within which an instant counts as that of a switch."""
CHUNK = 4096
"""Intervals whose exponentials are taken at once."""


def forced_response(
    system: PeriodicSystem,
    timepts: ArrayLike,
    inputs: ArrayLike,
    *,
    initial_state: ArrayLike | None = None,
    interpolation: Literal["linear", "held"] = "linear",
) -> "control.TimeResponseData":
    """Return the response to inputs u(t) given at instants, exact there; as `control.forced_response`.

    The inputs take the place of the system's levels; r and q stay. A period begins at t = 0.

    Parameters
    ----------
    system : PeriodicSystem
    timepts : array_like, shape (n_times,)
        Rising [s]; they need not meet the switches.
    inputs : array_like, shape (m, n_times), or (n_times,) for one input
    initial_state : array_like, shape (n,), optional
        At the first of the times; zero by default.
    interpolation : {"linear", "held"}
        Between the samples: on straight lines, or as a hold keeps the last one.

    Returns
    -------
    control.TimeResponseData
        Where the state or an output jumps, the value is the one just after it.

    Raises
    ------
    ValueError
        Times that do not rise, or another number of inputs or samples.
    StepOverflowError
        The response grows by more than double precision holds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[0.0]] * 2, [0.5, 0.5], B=[[[1.0]]] * 2)
    >>> lp.forced_response(system, [0.0, 1.0, 2.0], [0.0, 1.0, 1.0]).states.round(6)
    array([[0.      , 0.233596, 0.378365]])
    """
    expect_system(system)
    if interpolation not in ("linear", "held"):
        raise ValueError(f"interpolation: found {interpolation!r}, expected 'linear' or 'held'")
    times = finite_array("timepts", timepts, (None,))
    if times.size < 2 or (np.diff(times) <= 0).any():
        raise ValueError(f"timepts: found {times.size} times, not all rising, expected two or more that rise")
    m, n = len(system.inputs), system.n_states
    given = finite_array("inputs", np.reshape(inputs, (1, -1)) if m == 1 and np.ndim(inputs) == 1 else inputs)
    values = finite_array("inputs", given, (m, times.size)).T
    start = np.zeros(n) if initial_state is None else finite_array("initial_state", initial_state, (n,))
    system = system.without_empty_steps()
    instants, step, is_sample = _instants(system, times)
    held = np.searchsorted(times, instants, side="right") - 1
    slopes = np.zeros((times.size, m))
    if interpolation == "linear":
        slopes[:-1] = np.diff(values, axis=0) / np.diff(times)[:, None]
    at_instants = values[held] + slopes[held] * (instants - times[held])[:, None]
    states = _states(system, start, (instants, step), (at_instants, slopes[held]))
    if not np.isfinite(states).all():
        worst = float(instants[int(np.argwhere(~np.isfinite(states))[0][0])])
        raise StepOverflowError(f"the response grows by more than double precision holds, up to t = {worst:.6g} s")
    seen, at = states[is_sample], step[is_sample]
    outputs = np.einsum("tij,tj->ti", system.C[at], seen) + np.einsum("tij,tj->ti", system.D[at], values)
    outputs += system.q[at]
    return bridge.time_response(times, (system.states, seen.T), (system.outputs, outputs.T), system.name)


def _instants(system: PeriodicSystem, times: FloatArray) -> tuple[FloatArray, IntArray, BoolArray]:
    """Return all samples and switches in order, the step that begins or goes on there, and which are samples."""
    period, first = system.period, math.floor(times[0] / system.period)
    n_periods = math.ceil(times[-1] / period) - first + 1
    starts = (np.arange(n_periods)[:, None] + first) * period + system.switching_times[:-1]
    switches = starts.ravel()
    numbers = np.tile(np.arange(system.n_steps), n_periods)
    # A sample that meets a switch but for rounding is that instant.
    near = np.clip(np.searchsorted(switches, times), 1, switches.size - 1)
    near -= times - switches[near - 1] < switches[near] - times
    tolerance = SAME_TIME * max(period, float(np.abs(times).max()))
    meets = np.abs(switches[near] - times) <= tolerance
    inside = (switches > times[0] + tolerance) & (switches < times[-1] - tolerance)
    inside[near[meets]] = False
    instants = np.concatenate([times, switches[inside]])
    at_samples = numbers[np.where(meets, near, np.searchsorted(switches, times, side="right") - 1)]
    order = np.argsort(instants, kind="stable")
    steps = np.concatenate([at_samples, numbers[inside]])[order]
    return instants[order], steps, order < times.size


def _states(
    system: PeriodicSystem,
    start: FloatArray,
    at: tuple[FloatArray, IntArray],
    driven: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the states at all instants (K, n), from those instants and their steps, inputs and slopes there."""
    (instants, step), (inputs, slopes) = at, driven
    n, m, scales = system.n_states, len(system.inputs), system.scaled.scales
    lengths = np.diff(instants)
    # The state jumps where a step has ended, also where the next one is the same step of the next period.
    jumps = system.jumps_at[step[:-1]] & _ends(system, instants, step)
    found = np.empty((instants.size, n))
    found[0] = state = start / scales
    matrices = np.zeros((system.n_steps, n + 2 * m + 1, n + 2 * m + 1))
    matrices[:, :n, :n] = system.scaled.matrices[:, :n, :n]
    matrices[:, :n, n : n + m] = system.B / scales[:, None]
    matrices[:, :n, -1] = system.r / scales
    matrices[:, n : n + m, n + m : -1] = np.eye(m)
    driving = np.concatenate([inputs, slopes, np.ones((instants.size, 1))], axis=1)
    for begin in range(0, lengths.size, CHUNK):
        part = slice(begin, min(begin + CHUNK, lengths.size))
        pairs = np.stack([step[:-1][part].astype(np.float64), lengths[part]], axis=1)
        kinds, which = np.unique(pairs, axis=0, return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            maps = forced_exponentials(matrices[kinds[:, 0].astype(np.int64)] * kinds[:, 1, None, None], n)[:, :n]
            gained = np.einsum("kij,kj->ki", maps[which][:, :, n:], driving[:-1][part])
            for i, kind in enumerate(which):
                k = begin + i
                state = maps[kind, :, :n] @ state + gained[i]
                if jumps[k] and system.J is not None and system.j is not None:
                    state = (system.J[step[k]] @ (state * scales) + system.j[step[k]]) / scales
                found[k + 1] = state
    return found * scales


def _ends(system: PeriodicSystem, instants: FloatArray, step: IntArray) -> BoolArray:
    """Return whether a step ends where each interval does."""
    if system.n_steps > 1:
        return step[1:] != step[:-1]
    turns = instants / system.period
    return np.floor(turns[1:] + SAME_TIME) > np.floor(turns[:-1] + SAME_TIME)
