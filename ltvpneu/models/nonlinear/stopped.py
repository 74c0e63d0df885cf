"""Why an integration stopped, and what to do: each status of the integrator as an error with its figures."""

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.errors import CavitationError, ChamberVolumeError, GasRangeError, IntegrationError
from ltvpneu.models.machine.dynamics import gas_in_volume
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.integrator import LEFT_DOMAIN, STEP_TOO_SMALL, TOO_MANY_STEPS
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.real_gas import RealGas

NEAR_VAPOR = 1e-3
"""Share of the supply pressure within which a pressure that stopped an integration counts as that of vapor [-]."""
AT_EDGE = 1e-6
"""Relative distance from the end of a gas's range at which its state counts as having left it [-]."""


def raise_stopped(machine: Machine, status: int, time: float, state: FloatArray) -> None:
    """Raise the error that says why an integration stopped, and where."""
    where = ", ".join(f"{name} {value:.6g}" for name, value in zip(machine.states, state, strict=True))
    chambers = machine.volumes
    shares = np.array([1 + volume.slope * float(state[0]) / volume.size for volume in machine.volume_fields])
    # Near a vanishing volume the pressure's rate grows without bound, so the step size may give out first.
    if shares.min() < 1e-3:
        chamber = chambers[int(np.argmin(shares))]
        raise ChamberVolumeError(
            f"the volume of {chamber} would reach zero at t = {time:.6g} s ({where}). Give the cylinder end stops "
            f"(cylinder.lower_stop, cylinder.upper_stop), a larger cylinder.dead_volume_{chamber[-1]}, or a stiffer "
            "spring.",
            time=time,
            state=state,
        )
    if isinstance(machine.gas, Liquid) and status in (LEFT_DOMAIN, STEP_TOO_SMALL):
        lowest = int(np.argmin(state[2 : 2 + machine.n_volumes]))
        if state[2 + lowest] < 2 * machine.gas.vapor_pressure + NEAR_VAPOR * machine.supply_pressure:
            raise CavitationError(
                f"the liquid in {chambers[lowest]} would cavitate at t = {time:.6g} s ({where}): its pressure falls to "
                f"the vapor pressure {machine.gas.vapor_pressure:g} Pa. Raise the exhaust pressure or the area through "
                "which the chamber fills, or slow the load down; the liquid model has no vapor",
                time=time,
                state=state,
            )
    if isinstance(machine.gas, RealGas):
        insides = [gas_in_volume(k, state, machine.record) for k in range(machine.n_volumes)]
        rooms = [machine.gas.room(here) for here in insides]
        nearest = int(np.argmin(rooms))
        here = insides[nearest]
        # Held at the edge of its table, a state may stop an integration in other ways too.
        if status == LEFT_DOMAIN or rooms[nearest] < AT_EDGE:
            raise GasRangeError(
                f"the gas left the range of its properties at t = {time:.6g} s: found {chambers[nearest]} at "
                f"{here.pressure:.6g} Pa and {here.temperature:.6g} K, expected {machine.gas.limits} ({where}). Give "
                "RealGas a wider pressure_range or temperature_range (gas.pressure_range, gas.temperature_range)",
                pressure=here.pressure,
                temperature=here.temperature,
            )
    reasons = {
        STEP_TOO_SMALL: "the step size fell below rounding",
        TOO_MANY_STEPS: "it took too many steps",
        LEFT_DOMAIN: "within a step a pressure or a volume fell to zero; if the step is fixed, it is too long: raise "
        "steps_per_period",
    }
    reason = reasons[status]
    raise IntegrationError(
        f"the integration stopped at t = {time:.6g} s ({where}): {reason}. Is a volume or an area wrong by orders of "
        "magnitude?",
        time=time,
        state=state,
    )
