r"""Periodic steady state (14), with a diagnosis where there is none or more than one.

The states at the step boundaries solve z_{k+1} = W_k z_k + g_k with z_N = z_0. What `cyclic` leaves of that is
A z(0) + B z(T) = g, the rows of z(T) = Phi z(0) + g in a mixture that stays well scaled where Phi does not. A Floquet
multiplier at one makes A + B singular: then the part of g along its left null vectors is a drift per period, and only
if that vanishes is there an orbit, and a whole family of them.
"""

from typing import NamedTuple

import numpy as np

from ltvpneu._arrays import BoolArray, FloatArray, IntArray
from ltvpneu.errors import NonUniqueOrbitError, NoOrbitError, StepOverflowError
from ltvpneu.periodic.algebra.cyclic import Reduced, reduced
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbits.floquet import floquet, is_exponent
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, HeldTrajectory, expect_periodic
from ltvpneu.periodic.systems.system import PeriodicSystem

TINY = float(np.finfo(float).tiny)


def steady_state(system: AnyPeriodicSystem, *, singular_below: float = 1e-12) -> Orbit:
    """Return the periodic steady state, eq. (14).

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    singular_below : float
        Smallest singular value of the balanced A + B, relative to the size of A and B, below which a multiplier counts
        as one.

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
    StepOverflowError
        The orbit grows further within the period than double precision can follow.

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
    expect_periodic(system)
    if isinstance(system, DiscretePeriodicSystem):
        states = _periodic_states(system, singular_below)
        starts, trajectory = np.arange(system.n_steps), HeldTrajectory(system=system, step_states=states)
        augmented, maps = system.maps.steps.augmented(states), system.maps
    else:
        finer, starts = _finer(system)
        states, maps = _periodic_states(finer, singular_below), finer.maps
        trajectory = ExponentialTrajectory(system=finer, step_states=states)
        augmented = trajectory.starts
    reached = maps.steps.physical((maps.maps @ augmented[:, :, None])[:, :, 0])
    following = np.concatenate([states[1:], states[:1]])
    scales = np.maximum(np.abs(states).max(axis=0), TINY)
    return Orbit(
        system_period=system.period,
        n_periods=1,
        step_times=system.switching_times,
        step_states=states[starts],
        step_labels=tuple(f"step {m + 1}" for m in range(system.n_steps)),
        trajectory=trajectory,
        states=system.states,
        outputs=system.outputs,
        is_isolated=True,
        residual=float((np.abs(reached - following) / scales).max(initial=0.0)),
        n_simulated=0,
        name=system.name,
    )


def periodic_states(system: PeriodicSystem, singular_below: float = 1e-12) -> FloatArray:
    """Return the periodic state at the start of every step, shape (n_steps, n); raises as `steady_state` does."""
    finer, starts = _finer(system)
    return _periodic_states(finer, singular_below)[starts]


def _finer(system: PeriodicSystem) -> tuple[PeriodicSystem, IntArray]:
    """Return the system with growing steps split, and the pieces at which its own steps start."""
    pieces = system.growing_pieces
    finer = system.split(pieces)
    return finer, np.arange(system.n_steps) if finer is system else np.cumsum(pieces) - pieces


def _periodic_states(system: AnyPeriodicSystem, singular_below: float) -> FloatArray:
    maps, n = system.maps, system.n_states
    one = reduced(maps.maps[:, :n, :n], maps.maps[:, :n, n:] * maps.steps.unit)
    gap = one.first + one.last
    size = np.abs(one.first).max(initial=0.0) + np.abs(one.last).max(initial=0.0)
    try:
        inverse = np.linalg.inv(gap)
    except np.linalg.LinAlgError:
        inverse = np.full_like(gap, np.inf)
    # No singular value of n x n entries is below one over n times the inverse's largest.
    with np.errstate(invalid="ignore", over="ignore"):
        is_regular = n * np.abs(inverse).max(initial=0.0) * size * singular_below < 1
    if is_regular:
        start = inverse @ one.rhs
        return one.all_from(start, start)[:-1, :, 0] * maps.steps.scales
    left, values, right = np.linalg.svd(gap)
    null = values <= singular_below * size
    if null.any():
        if not is_exponent(floquet(system), 0.0):
            raise StepOverflowError(
                "the periodic steady state grows too far within the period, and comes back, for double precision to "
                f"follow (to one part in {1 / singular_below:.0e}); no Floquet multiplier is one, so it exists. "
                "Are A and the durations in the same units of time?"
            )
        _raise_singular(system, one, _Null(left, values, right, null))
    start = right.T @ ((left.T @ one.rhs) / values[:, None])
    return one.all_from(start, start)[:-1, :, 0] * maps.steps.scales


class _Null(NamedTuple):
    """Singular values of A + B, its singular vectors, and which of the values count as zero."""

    left: FloatArray
    values: FloatArray
    right: FloatArray
    found: BoolArray


def _raise_singular(system: AnyPeriodicSystem, one: Reduced, null: _Null) -> None:
    maps = system.maps
    scales = maps.steps.scales
    left_null, right_null = null.left[:, null.found], null.right[null.found].T
    forcing = left_null.T @ one.rhs[:, 0]
    # Spectral projector: what a period adds along the directions that do not return.
    overlap = left_null.T @ one.last @ right_null
    if abs(np.linalg.det(overlap)) > 1e-8:
        drift = right_null @ np.linalg.solve(overlap, forcing)
    else:
        drift = np.linalg.pinv(one.last) @ left_null @ forcing
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
    inverse = np.where(null.found, 0.0, 1.0 / np.where(null.found, 1.0, null.values))
    particular = scales * (null.right.T @ (inverse * (null.left.T @ one.rhs[:, 0])))
    directions = np.linalg.qr(scales[:, None] * right_null)[0]
    least_norm = particular - directions @ (directions.T @ particular)
    gap = float(null.values[null.found].max())
    # Named in scaled states: in mixed units a pressure, being a large number, would always stand first.
    shown = "; ".join(
        ", ".join(f"{name} {x:+.3g}" for name, x in zip(system.states, direction, strict=True) if abs(x) > 1e-6)
        for direction in right_null.T
    )
    raise NonUniqueOrbitError(
        f"The periodic equation is singular to {gap:.1e}: a Floquet multiplier equals one, so the orbit is not unique. "
        f"Free direction: {shown} (in scaled states). A state that nothing brings back does that, such as the position "
        "of a piston without a spring; the orbit nearest the origin is in .least_norm.",
        least_norm=least_norm,
        free_directions=directions,
    )
