"""The linear model of a machine over a period: what `ltv_model` and `lti_model` return."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._values import Value
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.linear.error_estimate import ErrorEstimate, error_estimate
from ltvpneu.models.linear.linearize import Linearization
from ltvpneu.models.machine.machine import Machine
from ltvpneu.periodic.orbits.exponential import ExponentialTrajectory
from ltvpneu.periodic.orbits.orbit import Orbit
from ltvpneu.periodic.orbits.steady import periodic_states, steady_state
from ltvpneu.periodic.systems.system import PeriodicSystem

WELL_BEYOND = 0.1
"""Share of the stroke, or with one stop of the dead length, by which a mean lies well beyond a stop [-]."""


@final
@dataclass(frozen=True, kw_only=True)
class HeldBack(Value):
    """An operating point that was kept inside the range where the linearization means something.

    In a self-consistent model the point itself stays, and its slope is, in part, that of the chord from it to a
    source's pressure: then `used` is the latter.
    """

    step: int
    """Number of the step, from 0."""
    state: str
    asked: float
    used: float


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LtvModel(Value):
    """A machine as a periodic linear system: what `ltv_model` and `lti_model` return."""

    system: PeriodicSystem
    machine: Machine
    frequency: float
    """[Hz]"""
    operating_points: FloatArray
    """State that each step is linearized about, shape (n_steps, n)."""
    mode: str
    """How the operating points were chosen."""
    held_back: tuple[HeldBack, ...]
    """Operating points kept inside their range."""
    least_distance: float
    """Relative distance kept from pressures where the flow's slope is infinite [-]; results depend on it."""
    iterations: int
    """Cycles computed, or valve periods marched, to find the operating points."""
    own_cycle: Orbit | None = None
    """The cycle that the operating points belong to, where the model was found with it."""
    found: object = None
    """How it was found, for `parameter_sensitivity`."""

    def __repr__(self) -> str:
        outside = f", passes the end stops by {1e3 * self.beyond_stops:.3g} mm" if self.beyond_stops > 0 else ""
        return (
            f"<LtvModel of {self.machine.name} at {self.frequency:g} Hz: {self.system.n_steps} steps, operating points "
            f"{self.mode!r}, {len(self.held_back)} held back{outside}>"
        )

    @cached_property
    def orbit(self) -> Orbit:
        """The model's periodic cycle: the one its operating points belong to, else its steady state.

        Raises
        ------
        NoOrbitError, NonUniqueOrbitError
            As `steady_state`.
        """
        return steady_state(self.system) if self.own_cycle is None else self.own_cycle

    @cached_property
    def error_estimate(self) -> ErrorEstimate:
        """How far the model's amplitude, mean and extremes are off, and whether the nonlinear machine has its cycle.

        The machine is followed from the cycle's state to its own orbit there.

        Raises
        ------
        NoOrbitError, NonUniqueOrbitError
            The model has no cycle.
        """
        return error_estimate(self.machine, self.frequency, self.orbit)

    @cached_property
    def beyond_stops(self) -> float:
        """How far the model's cycle passes an end stop [m]; zero where it does not, or has no cycle.

        Steps with operating points of their own know no stops; "fitted" and "self-consistent" models stay within them.
        """
        low, high = self.machine.cylinder.lower_stop, self.machine.cylinder.upper_stop
        if not self.machine.has_stops:
            return 0.0
        try:
            orbit = self.orbit
        except LtvpneuError:
            return 0.0
        passed = max(low - orbit.minimum(0), orbit.maximum(0) - high)
        return passed if passed > 1e-9 * float(self.machine.state_scales[0]) else 0.0

    @cached_property
    def residual(self) -> float:
        """Largest difference between the operating pressures and the means of the model's own cycle over the steps [-].

        Relative to the supply pressure. Zero would mean that the model is linearized about its own cycle.
        """
        states = periodic_states(self.system) if self.own_cycle is None else self.own_cycle.step_states
        cycle = ExponentialTrajectory(system=self.system, step_states=states)
        differences = cycle.step_state_means()[:, 2:] - self.operating_points[:, 2:]
        return float(np.max(np.abs(differences))) / self.machine.supply_pressure


def warn_outside(model: LtvModel, mean_balance: float) -> LtvModel:
    """Return a model, with a warning if even the mean of its cycle lies well beyond an end stop.

    That is looked at where the mean of the positions that the spring alone would balance lies beyond one.
    """
    low, high = model.machine.cylinder.lower_stop, model.machine.cylinder.upper_stop
    reach = WELL_BEYOND * (high - low if np.isfinite(high - low) else float(model.machine.state_scales[0]))
    if low <= mean_balance <= high or model.machine.cylinder.is_absent:
        return model
    if model.beyond_stops > reach and not low - reach <= model.orbit.mean(0) <= high + reach:
        warnings.warn(
            f"the cycle of the linear model lies beyond the cylinder's end stops, of which operating points "
            f'{model.mode!r} know nothing (model.beyond_stops says by how far); take operating_points="fitted"',
            UserWarning,
            stacklevel=3,
        )
    return model


def assemble(machine: Machine, durations: FloatArray, linearization: Linearization, name: str) -> PeriodicSystem:
    """Return the steps as a `PeriodicSystem` whose inputs are the machine's."""
    N, n = linearization.r.shape
    outputs = np.zeros((N, n, n))
    outputs[:, range(n), range(n)] = 1.0
    return PeriodicSystem(
        durations=durations,
        A=linearization.A,
        B=linearization.B,
        r=linearization.r,
        C=outputs,
        D=np.zeros((N, n, len(machine.inputs))),
        q=np.zeros((N, n)),
        levels=machine.levels,
        states=machine.states,
        inputs=machine.inputs,
        outputs=machine.states,
        name=name,
    )
