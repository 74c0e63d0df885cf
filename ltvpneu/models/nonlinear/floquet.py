"""Floquet analysis of the nonlinear model's own orbit: how a small disturbance fares over it (`variation`)."""

import numpy as np

from ltvpneu._arrays import read_only
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.nonlinear.integrator import Record, log_of
from ltvpneu.models.nonlinear.orbits import mode_labelled
from ltvpneu.models.nonlinear.polynomial import PolynomialTrajectory
from ltvpneu.models.nonlinear.variation import turn_maps
from ltvpneu.periodic.orbits.floquet import Floquet, orbit_multipliers
from ltvpneu.periodic.orbits.modes import Maps
from ltvpneu.periodic.orbits.orbit import Orbit

PARTS = 4
"""Parts that each interval of the integrator is taken in."""
NEUTRAL = 1e-6
"""Distance of a modulus from 1 within which a disturbance neither grows nor decays [-]."""


def orbit_floquet(machine: Machine, orbit: Orbit) -> Floquet:
    """Return the Floquet multipliers of an orbit found by `nonlinear_orbit`, with saltation where the piston sticks.

    Where stiction holds the piston its position stays where it is put: a multiplier of one. Where it is pressed on an
    end stop, a disturbance into the stroke returns, and its multiplier is zero.

    Parameters
    ----------
    machine : Machine
        The orbit's.
    orbit : Orbit

    Raises
    ------
    TypeError
        The orbit is a linear model's; `cycle_floquet` of the model is what is wanted there.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> print(f"{lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, 8.0)).spectral_radius:.3f}")
    0.224
    """
    expect_machine(machine)
    trajectory = orbit.trajectory
    if not isinstance(trajectory, PolynomialTrajectory):
        raise TypeError(
            f"orbit: found one of {orbit.name}, a linear model; expected one of nonlinear_orbit. Of a linear model, "
            "take lp.cycle_floquet(model)"
        )
    machine = machine.at(1 / orbit.system_period)
    return orbit_multipliers(orbit, _maps(machine, orbit, trajectory), NEUTRAL)


def _maps(machine: Machine, orbit: Orbit, trajectory: PolynomialTrajectory) -> Maps:
    """Return the maps of a disturbance over an orbit, in scaled states."""
    starts, spans, period = trajectory.starts, trajectory.spans, orbit.system_period
    pieces, scales = pieces_of(machine.openings, period), np.array(machine.state_scales)
    step = np.searchsorted(orbit.step_times, starts + 1e-9 * spans, side="right") - 1
    step = np.clip(step, 0, len(orbit.step_labels) - 1)
    # A creep to the edge of a stiction band is rest: set beside it, within the band, the piston stays.
    labels = orbit.step_labels if orbit.is_isolated else ("stuck",) * len(orbit.step_labels)
    modes = np.array([mode_labelled(label) for label in labels])[step]
    middles = starts + 0.5 * spans
    turns = np.floor(middles / period).astype(np.int64)
    within = np.searchsorted(pieces["begin"], middles - turns * period, side="right") - 1
    log = log_of(Record(starts, spans, modes, turns * pieces.size + within, trajectory.coefficients))
    found = turn_maps(log, machine.record, pieces, scales, PARTS, True)
    begins = np.append(True, step[1:] != step[:-1])
    return Maps(
        factors=read_only(found.factors.copy()),
        durations=read_only(found.durations.copy()),
        starts=found.firsts[begins].copy(),
        scales=machine.state_scales,
    )
