r"""Controllers that regulate an estimated state: `lqr` and `kalman` in one periodic system.

Regulator and estimator are designed apart, and the closed loop has the multipliers of both (the separation principle).
In discrete time that is exact. In continuous time the gains vary within a step, and a system of steps can only follow
them in parts; there the same principle tells how many parts are needed.
"""

from dataclasses import replace

import numpy as np

from ltvpneu._arrays import ComplexArray, FloatArray, positive, solved
from ltvpneu.errors import NotConvergedError
from ltvpneu.periodic.analysis.estimator import Estimator
from ltvpneu.periodic.analysis.regulator import Regulator
from ltvpneu.periodic.orbits.floquet import floquet
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, sampled
from ltvpneu.periodic.systems.interconnect import feedback
from ltvpneu.periodic.systems.system import PeriodicSystem

FIRST_PARTS, MOST_PARTS = 4, 4096
"""Of each step."""


def observer_controller(regulator: Regulator, estimator: Estimator, *, rtol: float = 1e-4) -> AnyPeriodicSystem:
    """Return the controller from outputs y to inputs u that regulates the estimated state, u = -K z_hat.

    Its states are the estimates, its inputs the system's outputs, its outputs the system's inputs, all of them
    distances from an orbit. `feedback(system, controller, sign=1)` is the closed loop.

    Parameters
    ----------
    regulator : Regulator
    estimator : Estimator
        Of the same system, sampled if the regulator is.
    rtol : float
        In continuous time, largest error of the closed loop's multipliers, relative to the largest one's modulus or to
        one: gains are held over parts of the steps. Where both are sampled the controller is exact.

    Returns
    -------
    PeriodicSystem or DiscretePeriodicSystem
        In discrete time where both are sampled; it closes the loop round `sampled(system)`.

    Raises
    ------
    ValueError
        Regulator and estimator are of different systems, or one only is sampled.
    NotConvergedError
        Thousands of parts of a step do not keep `rtol`.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[0.5]], [[-1.0]]], [[0.0]] * 2, [0.5, 0.5], B=[[[1.0]]] * 2)
    >>> regulator, estimator = lp.lqr(system, [[1.0]], [[1.0]]), lp.kalman(system, [[1.0]], [[1.0]])
    >>> controller = lp.observer_controller(regulator, estimator)
    >>> lp.floquet(lp.feedback(system, controller, sign=1)).verdict
    'stable'
    """
    rtol = positive("rtol", rtol)
    system = regulator.system
    if system != estimator.system:
        raise ValueError(f"estimator: found one of {estimator.system!r}, expected one of {system!r}, as the regulator")
    if regulator.is_sampled != estimator.is_sampled:
        raise ValueError("estimator: found one only of regulator and estimator sampled, expected both or none")
    name = f"{system.name}_observer"
    if isinstance(system, DiscretePeriodicSystem):
        return replace(_discrete(system, regulator.step_gains, estimator.step_gains), name=name)
    if regulator.is_sampled:
        long = system.durations > 0
        found = _discrete(sampled(system), regulator.step_gains[long], estimator.step_gains[long])
        return replace(found, name=name)
    parts, expected = FIRST_PARTS, np.concatenate([regulator.multipliers, estimator.multipliers])
    gap = np.inf
    while parts <= MOST_PARTS:
        found = _continuous(regulator, estimator, parts)
        gap = _gap(floquet(feedback(system, found, sign=1)).multipliers, expected)
        if gap <= rtol * max(1.0, float(np.max(np.abs(expected), initial=0.0))):
            return replace(found, name=name)
        parts *= 2
    raise NotConvergedError(
        f"observer_controller: with {MOST_PARTS} parts a step the multipliers of the closed loop are {gap:.2g} off, "
        f"more than rtol = {rtol:g}; the gains change too fast within a step for that",
        residual=gap,
        iterations=MOST_PARTS,
    )


def _discrete(system: DiscretePeriodicSystem, K: FloatArray, L: FloatArray) -> DiscretePeriodicSystem:
    """Return the controller in discrete time, which corrects its estimate by a measurement before it acts.

    z^+ = z + L (y - C z - D u) with u = -K z^+, then (A - B K) z^+ is the estimate that the next step starts with.
    """
    n, p = system.n_states, len(system.outputs)
    after = solved(np.eye(n) - L @ system.D @ K, np.concatenate([np.eye(n) - L @ system.C, L], axis=2))
    onward, acting = (system.A - system.B @ K) @ after, -K @ after
    return replace(
        system, A=onward[:, :, :n], B=onward[:, :, n:], C=acting[:, :, :n], D=acting[:, :, n:],
        r=np.zeros_like(system.r), q=np.zeros((system.n_steps, len(system.inputs))), levels=np.zeros(p),
        states=tuple(f"{state}_hat" for state in system.states), inputs=system.outputs, outputs=system.inputs,
    )  # fmt: skip


def _continuous(regulator: Regulator, estimator: Estimator, parts: int) -> PeriodicSystem:
    """Return z_hat' = A z_hat + B u + L (y - C z_hat - D u), u = -K z_hat, with the gains in the middles of parts."""
    assert isinstance(regulator.system, PeriodicSystem)
    system = regulator.system.split(np.full(regulator.system.n_steps, parts))
    middles = system.switching_times[:-1] + system.durations / 2
    K, L = regulator.gain(middles), estimator.gain(middles)
    return replace(
        system, A=system.A - system.B @ K - L @ (system.C - system.D @ K), B=L, C=-K,
        D=np.zeros((system.n_steps, len(system.inputs), len(system.outputs))), r=np.zeros_like(system.r),
        q=np.zeros((system.n_steps, len(system.inputs))), levels=np.zeros(len(system.outputs)),
        states=tuple(f"{state}_hat" for state in system.states), inputs=system.outputs, outputs=system.inputs,
    )  # fmt: skip


def _gap(found: ComplexArray, expected: ComplexArray) -> float:
    """Return by how much two sets of numbers differ, each paired with the nearest one left."""
    left, worst = list(expected), 0.0
    for value in found:
        nearest = int(np.argmin(np.abs(np.array(left) - value)))
        worst = max(worst, abs(left.pop(nearest) - value))
    return worst
