"""Response of a periodic system from an initial state, (10)-(13)."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, whole
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.algebra.propagate import forced_exponentials
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic

if TYPE_CHECKING:
    import control


def response(
    system: AnyPeriodicSystem,
    *,
    n_periods: int = 10,
    initial_state: ArrayLike | None = None,
    points_per_period: int = 200,
) -> "control.TimeResponseData":
    """Return the response over a number of periods, exact at every time returned.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    n_periods : int
    initial_state : array_like, shape (n,), optional
        Zero by default.
    points_per_period : int
        Least number of times per period; every step boundary is among them. Where an output jumps at a boundary, the
        value is the one just after it. In discrete time the starts of the steps are all that there are.

    Returns
    -------
    control.TimeResponseData
        With named states and outputs; `.plot()` and `.to_pandas()` are python-control's.

    Raises
    ------
    StepOverflowError
        The response grows by more than double precision holds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[1.0], [0.0]], [0.25, 0.75])
    >>> lp.response(system, n_periods=3).states.shape[0]
    1
    """
    expect_periodic(system)
    n_periods = whole("n_periods", n_periods)
    points_per_period = whole("points_per_period", points_per_period)
    start = np.zeros(system.n_states)
    if initial_state is not None:
        start = finite_array("initial_state", initial_state, (system.n_states,))
    if isinstance(system, DiscretePeriodicSystem):
        return _discrete_response(system, n_periods, start)
    steps = system.scaled
    state = steps.augmented(start)
    local_times = [
        np.linspace(0.0, duration, 1 + int(np.ceil(points_per_period * duration / system.period)))
        for duration in system.durations
    ]
    times, states, outputs = [], [], []
    with np.errstate(over="ignore", invalid="ignore"):
        maps = [
            forced_exponentials(matrix * times[:, None, None], system.n_states)
            for matrix, times in zip(steps.matrices, local_times, strict=True)
        ]
        for period in range(n_periods):
            for m, step in enumerate(maps):
                reached = step @ state
                state = system.scaled_jumps[m] @ reached[-1] if system.has_jumps else reached[-1]
                inside = steps.physical(reached[:-1])
                times.append(period * system.period + system.switching_times[m] + local_times[m][:-1])
                states.append(inside)
                outputs.append(inside @ system.C[m].T + system.output_bias[m])
            _expect_finite(state, (period + 1) * system.period)
    last = steps.physical(state)
    times.append(np.array([n_periods * system.period]))
    states.append(last[None])
    outputs.append(last[None] @ system.C[-1].T + system.output_bias[-1])
    return bridge.time_response(
        np.concatenate(times),
        (system.states, np.concatenate(states).T),
        (system.outputs, np.concatenate(outputs).T),
        system.name,
    )


def _discrete_response(system: DiscretePeriodicSystem, n_periods: int, state: FloatArray) -> "control.TimeResponseData":
    states = [state]
    with np.errstate(over="ignore", invalid="ignore"):
        for period in range(n_periods):
            for A, f in zip(system.A, system.f, strict=True):
                states.append(A @ states[-1] + f)
            _expect_finite(states[-1], (period + 1) * system.period)
    found = np.array(states)
    step = np.arange(len(found)) % system.n_steps
    outputs = (system.C[step] @ found[:, :, None])[:, :, 0] + system.output_bias[step]
    periods = np.arange(n_periods)[:, None] * system.period
    times = np.append((periods + system.switching_times[:-1]).ravel(), n_periods * system.period)
    return bridge.time_response(times, (system.states, found.T), (system.outputs, outputs.T), system.name)


def _expect_finite(state: FloatArray, time: float) -> None:
    if not np.isfinite(state).all():
        raise StepOverflowError(
            f"the response grows by more than double precision holds, up to t = {time:.6g} s; take fewer periods"
        )
