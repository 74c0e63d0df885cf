r"""Periodic steady state (14), with a diagnosis where there is none or more than one.

z(T) = Phi z(0) + g, so the periodic state solves (I - Phi) z = g. A Floquet multiplier at one makes that singular:
then the part of g along its left eigenvector is a drift per period, and only if that vanishes is there an orbit, and
a whole family of them.
"""

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray
from ltvpneu.errors import NonUniqueOrbitError, NoOrbitError
from ltvpneu.periodic.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.propagate import StepMaps, states_from
from ltvpneu.periodic.system import PeriodicSystem, expect_system


def steady_state(system: PeriodicSystem, *, singular_below: float = 1e-12) -> Orbit:
    """Return the periodic steady state, eq. (14).

    Parameters
    ----------
    system : PeriodicSystem
    singular_below : float
        Smallest singular value of the balanced I - Phi, relative to its largest and to one, below which a multiplier
        counts as one.

    Returns
    -------
    Orbit
        Also for an unstable system: whether the orbit attracts is what `floquet` answers.

    Raises
    ------
    NoOrbitError
        Every period drifts; `.drift` says by how much.
    NonUniqueOrbitError
        A whole family of orbits; `.least_norm` is one, `.free_directions` lead to the others.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> integrator = lp.PeriodicSystem.from_matrices([[[0.0]], [[0.0]]], [[1.0], [-0.5]], [0.5, 0.5])
    >>> lp.steady_state(integrator)
    Traceback (most recent call last):
    ...
    ltvpneu.errors.NoOrbitError: no periodic steady state: a Floquet multiplier is one and every period drifts by z1
    +0.25...
    """
    expect_system(system)
    return _orbit(system, periodic_states(system, singular_below))


def periodic_states(system: PeriodicSystem, singular_below: float = 1e-12) -> FloatArray:
    """Return the periodic state at the start of every step and at the end of the last, shape (n_steps + 1, n).

    Raises as `steady_state` does.
    """
    maps = system.maps
    total = maps.over_period()
    n = system.n_states
    gap = np.eye(n) - total[:n, :n]
    forcing = total[:n, n] * maps.steps.unit
    left, values, right = np.linalg.svd(gap)
    null = values <= singular_below * max(1.0, values[0])
    if null.any():
        _raise_singular(system, maps, (left, values, right, null), forcing)
    return states_from(maps, maps.steps.scales * (right.T @ ((left.T @ forcing) / values)))


def _orbit(system: PeriodicSystem, reached: FloatArray) -> Orbit:
    scales = np.maximum(np.max(np.abs(reached), axis=0), np.finfo(float).tiny)
    return Orbit(
        system_period=system.period,
        n_periods=1,
        step_times=system.switching_times,
        step_states=reached[:-1],
        step_labels=tuple(f"step {m + 1}" for m in range(system.n_steps)),
        trajectory=ExponentialTrajectory(system=system, step_states=reached[:-1]),
        states=system.states,
        outputs=system.outputs,
        is_unique=True,
        residual=float(np.max(np.abs(reached[-1] - reached[0]) / scales)),
        n_simulated=0,
        name=system.name,
    )


def _raise_singular(
    system: PeriodicSystem,
    maps: StepMaps,
    decomposition: tuple[FloatArray, FloatArray, FloatArray, BoolArray],
    forcing: FloatArray,
) -> None:
    left, values, right, null = decomposition
    scales = maps.steps.scales
    left_null, right_null = left[:, null], right[null].T
    # Spectral projector: what a period adds along the directions that do not return.
    overlap = left_null.T @ right_null
    if abs(np.linalg.det(overlap)) > 1e-8:
        drift = right_null @ np.linalg.solve(overlap, left_null.T @ forcing)
    else:
        drift = left_null @ (left_null.T @ forcing)
    size = max(float(np.max(np.abs(maps.maps[:, :-1, -1])) * maps.steps.unit), np.finfo(float).tiny)
    if np.max(np.abs(drift)) > 1e-10 * size:
        drift = scales * drift
        shown = ", ".join(f"{name} {x:+.6g}" for name, x in zip(system.states, drift, strict=True) if x != 0)
        raise NoOrbitError(
            f"no periodic steady state: a Floquet multiplier is one and every period drifts by {shown}. "
            "A piston without a spring, or a chamber that nothing empties, does that; balance the forcing or add "
            "a restoring force.",
            drift=drift,
        )
    inverse = np.where(null, 0.0, 1.0 / np.where(null, 1.0, values))
    particular = scales * (right.T @ (inverse * (left.T @ forcing)))
    directions = np.linalg.qr(scales[:, None] * right_null)[0]
    least_norm = particular - directions @ (directions.T @ particular)
    gap = float(values[null].max() / max(1.0, values[0]))
    shown = "; ".join(
        ", ".join(f"{name} {x:+.3g}" for name, x in zip(system.states, direction, strict=True) if abs(x) > 1e-12)
        for direction in directions.T
    )
    raise NonUniqueOrbitError(
        f"I - Phi is singular to {gap:.1e}: a Floquet multiplier equals one, so the orbit is not unique. "
        f"Free direction: {shown}. A piston without a spring does that; the orbit nearest the origin is "
        "in .least_norm.",
        least_norm=least_norm,
        free_directions=directions,
    )
