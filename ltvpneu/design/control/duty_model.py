"""The sampled small-signal model of a machine whose duty is set each period.

It is the derivative of the nonlinear machine's map over one period about its orbit, stick and slip included, by central
differences of integrations at a tolerance of 1e-10.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ltvpneu.models.cycles.sensitivity import nonlinear_jacobians
from ltvpneu.models.cycles.turns import TOLERANCE
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.nonlinear.method import DormandPrince
from ltvpneu.models.nonlinear.orbits import nonlinear_orbit
from ltvpneu.periodic.systems import bridge

if TYPE_CHECKING:
    import control

INPUTS = {"duty": "duty", "supply_pressure": "supply_pressure", "load_force": "load.force"}
"""Inputs of the small-signal model, and the machine's parameters that they are."""


def duty_model(
    machine: Machine,
    frequency: float,
    duty: float | None = None,
    *,
    inputs: Sequence[str] = ("duty", "supply_pressure", "load_force"),
) -> "control.StateSpace":
    """Return how the machine answers to small changes from period to period, about its orbit.

    Parameters
    ----------
    machine : Machine
    frequency : float
        Switching frequency [Hz]; the model's dt is the period.
    duty : float, optional
        Operating point; the machine's own by default.
    inputs : sequence of str
        Of "duty", "supply_pressure" [Pa] and "load_force" [N], constant through each period.

    Returns
    -------
    control.StateSpace
        States: the machine's, at the start of each period. Outputs: "position" there [m], "mean_position" over the
        period [m], and "force", the mean push of the pressures on the piston [N]. All are deviations from the orbit.

    Raises
    ------
    NonUniqueOrbitError
        Stiction holds the piston: small changes do not move it.
    ValueError
        Unknown inputs, or an orbit that repeats only after several periods.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> model = design.duty_model(lp.load_machine("kunt_singh_1990"), 15.0, 0.5, inputs=["duty"])
    >>> print(f"{1e3 * model.dcgain()[1, 0]:.0f} mm per unit of duty")
    108 mm per unit of duty
    """
    expect_machine(machine)
    if duty is not None:
        machine = machine.with_duty(duty)
    for name in inputs:
        if name not in INPUTS:
            raise ValueError(f"inputs: found {name!r}, expected some of {', '.join(INPUTS)}")
    if not inputs:
        raise ValueError(f"inputs: found none, expected some of {', '.join(INPUTS)}")
    orbit = nonlinear_orbit(machine, frequency, method=DormandPrince(rtol=TOLERANCE))
    if orbit.n_periods > 1:
        raise ValueError(
            f"frequency: found an orbit that repeats every {orbit.n_periods} periods at {frequency:g} Hz and duty "
            f"{machine.duty:g}, about which there is no model of one period; choose another duty or frequency"
        )
    by_state, by_input = nonlinear_jacobians(machine, frequency, orbit, [INPUTS[name] for name in inputs])
    n = len(machine.states)
    pushes = np.zeros(n)
    pushes[2 : 2 + machine.n_volumes] = [volume.push_area for volume in machine.volume_fields]
    C = np.array([np.eye(n)[0], by_state[3][0], pushes @ by_state[3]])
    D = np.array([np.zeros(len(inputs)), by_input[3][0], pushes @ by_input[3]])
    names = machine.states, tuple(inputs), ("position", "mean_position", "force")
    name = f"{machine.identifier}_sampled"
    return bridge.state_space((by_state[0], by_input[0], C, D), names, name, 1 / frequency)
