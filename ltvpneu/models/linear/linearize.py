r"""Linearization of the machine's equations to G_m, B_m, f_m, eq. (8).

With source pressures, load force and ambient pressure as inputs u, step m is z' = G_m z + B_m u + r_m, and f_m = B_m u
+ r_m. M_f is homogeneous of degree one in its two pressures, so alpha + beta pbar = (dM_f/dp_i) p_i: in isothermal
chambers the paper's linearization needs no remainder, r_m = 0, and superposition holds in u. Errata E6, E7, E7b are
proved in the tests against finite differences of the nonlinear right-hand side.
"""

from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array
from ltvpneu._values import Value
from ltvpneu.models.machine.dynamics import gas_in_volume, is_in_range, state_rate
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.machine.tangent import tangents
from ltvpneu.physics.properties import IDEAL

Tangent = Literal["paper", "full"]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Linearization(Value):
    """z' = A z + B u + r near one state of the machine, or a stack of these."""

    A: FloatArray
    """G, (..., n, n)"""
    B: FloatArray
    """Over supply, exhaust pressure, load force, ambient pressure, (..., n, 4)"""
    r: FloatArray
    """(..., n)"""
    f: FloatArray
    """Forcing B u + r at the machine's input levels, (..., n)"""


def linearize(
    machine: Machine, state: ArrayLike, *, angle: float | None = None, areas: ArrayLike | None = None,
    tangent: Tangent = "paper",
) -> Linearization:  # fmt: skip
    """Return the machine's linear model near a state, eq. (8).

    Parameters
    ----------
    machine : Machine
    state : array_like, shape (n,)
        Operating point [m, m/s, Pa].
    angle : float, optional
        Valve angle that sets the openings [rad]; just after it, where they jump. Default 0.
    areas : array_like, shape (2, n_paths), optional
        Effective areas of the first and second restriction of each connection [m^2], instead of an angle; infinite
        where there is no second.
    tangent : {"paper", "full"}
        The paper's G (8b), whose pressure rows are those at rest and have no column for the position; or every
        derivative. Dry friction is neglected; so is, in B, that the reference of a polytropic chamber's temperature (4)
        moves with the exhaust pressure.

    Returns
    -------
    Linearization

    Raises
    ------
    ValueError
        An ideal gas's pressure equals that of a source which it is open to, where flow is never laminar: its slope is
        infinite there.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> machine = lp.load_machine("kunt_singh_1990")
    >>> lp.linearize(machine, [0.05, 0.0, 2.5e5]).A.shape
    (3, 3)
    """
    expect_machine(machine)
    point = finite_array("state", state, (len(machine.states),))
    if areas is None:
        openings = areas_at(machine, 0.0 if angle is None else angle)
    elif angle is not None:
        raise ValueError("angle, areas: found both, expected one of them")
    else:
        openings = np.array(areas, dtype=np.float64)
        if openings.shape != (2, len(machine.ends)) or np.isnan(openings).any() or (openings < 0).any():
            raise ValueError(
                f"areas: found {openings.tolist()}, expected numbers >= 0 of shape (2, {len(machine.ends)})"
            )
    found = linearize_steps(machine, point[None], openings[None], tangent)
    return Linearization(A=found.A[0], B=found.B[0], r=found.r[0], f=found.f[0])


def areas_at(machine: Machine, angle: float) -> FloatArray:
    """Return the effective areas at a valve angle [rad], shape (2, n_paths); infinite where there is no second."""
    first = [connection.first.at(angle) for connection in machine.connections]
    second = [np.inf if c.second is None else c.second.at(angle) for c in machine.connections]
    return np.array([first, second])


def linearize_steps(machine: Machine, states: FloatArray, areas: FloatArray, tangent: Tangent) -> Linearization:
    """Return the linear models near one state per step, shapes (n_steps, n) and (n_steps, 2, n_paths)."""
    if tangent not in ("paper", "full"):
        raise ValueError(f'tangent: found {tangent!r}, expected "paper" or "full"')
    full = tangent == "full"
    # Arrays of its own: to a kernel, one that may not be written to is another type.
    record, states, areas = machine.record, np.array(states, order="C"), np.array(areas, order="C")
    _check_domain(machine, states)
    A, B = tangents(states, areas, record, full)
    if not np.isfinite(A).all():
        step = int(np.argwhere(~np.isfinite(A))[0][0])
        where = ", ".join(f"{name} {value:.6g}" for name, value in zip(machine.states, states[step], strict=True))
        raise ValueError(
            f"operating point of step {step + 1}: found {where}, a pressure equal to that of a source it is open to, "
            "where the slope of the flow is infinite; expected pressures apart from the sources'"
        )
    levels = machine.levels
    # Homogeneous in the pressures, the flow of an ideal gas of constant temperature leaves no remainder.
    r = np.zeros(states.shape)
    if full or not machine.is_isothermal:
        for step, state in enumerate(states):
            point = state.copy()
            if not full:
                point[1] = 0.0
            rate = np.empty(point.size)
            # In slip direction 0 dry friction has no sign and no part.
            state_rate(point, areas[step], 0, record, rate)
            r[step] = rate - A[step] @ point - B[step] @ levels
    return Linearization(A=A, B=B, r=r, f=B @ levels + r)


def _check_domain(machine: Machine, states: FloatArray) -> None:
    fields, names = machine.volume_fields, machine.states
    volumes = np.array([v.size for v in fields]) + states[:, :1] * np.array([v.slope for v in fields])
    if (volumes <= 0).any():
        step, k = np.argwhere(volumes <= 0)[0]
        raise ValueError(
            f"operating point of step {step + 1}: found a volume of {machine.volumes[k]} of {volumes[step, k]:g} m^3 "
            f"(position {states[step, 0]:g} m), expected above zero"
        )
    if (states[:, 2:] <= 0).any():
        step, column = np.argwhere(states[:, 2:] <= 0)[0]
        k = column if column < machine.n_volumes else [v.temperature_place for v in fields].index(column + 2)
        what, unit = names[2 + column].split("_")[0], "Pa" if column < machine.n_volumes else "K"
        raise ValueError(
            f"operating point of step {step + 1}: found a {what} of {machine.volumes[k]} of "
            f"{states[step, 2 + column]:g} {unit}, expected above zero"
        )
    if machine.gas.kind != IDEAL:
        for step, state in enumerate(states):
            for k, name in enumerate(machine.volumes):
                here = gas_in_volume(k, state, machine.record)
                if not is_in_range(here, machine.record):
                    raise ValueError(
                        f"operating point of step {step + 1}: found {name} at {here.pressure:g} Pa and "
                        f"{here.temperature:g} K, expected it where the laws of the medium hold: {machine.gas.limits}"
                    )
