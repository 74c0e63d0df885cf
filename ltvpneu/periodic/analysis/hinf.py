r"""Hinf norm, the L2-induced gain, of a periodic system.

For gamma above every sigma(D) and a stable system, gamma exceeds the norm just when the game

.. math:: \sup_u \int_0^\infty |y|^2 - \gamma^2 |u|^2\, dt = z_0' X z_0

stays finite over every horizon: the periodic Riccati equation of bounded-real form has a stabilizing solution
[Colaneri2000]_. Its steps are those of a regulator with -B B' / gamma^2 in place of B R^-1 B', so the scattering form
(`scattering`) composes them, doubling within steps and over periods; the horizon on which the game breaks shows as an
eigenvalue of I + G H that is not above zero. Nothing grows, however stiff a step is, and a horizon of 2^60 periods
takes 60 rounds: bisection on gamma.

.. [Colaneri2000] P. Colaneri, "Continuous-time periodic systems in H2 and Hinf", Kybernetika 36, 2000.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray, positive, solved
from ltvpneu.periodic.algebra.propagate import balancing_scales
from ltvpneu.periodic.analysis.gramians import balanced_matrices, gramians
from ltvpneu.periodic.analysis.scattering import Scattering, bounded_period, bounded_steps, free_steps
from ltvpneu.periodic.orbits.floquet import floquet
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, DiscretePeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.system import PeriodicSystem


def hinf_norm(system: AnyPeriodicSystem, *, rtol: float = 1e-14) -> float:
    """Return the Hinf norm: the largest ratio of the output's to the input's energy, square root taken.

    It takes some fifty bisections, each as long as a solution of a Riccati equation: ten times as long as the H2 norm,
    which is one sum. A larger `rtol` takes fewer, three for each digit.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    rtol : float
        Relative width of the last bracket.

    Returns
    -------
    float
        Infinite if the system is not stable.

    Raises
    ------
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-2.0]], [[-2.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> round(lp.hinf_norm(system), 12)
    0.5
    """
    expect_periodic(system)
    rtol = positive("rtol", rtol)
    if not floquet(system).is_stable:
        return math.inf
    feedthrough = 0.0
    if min(system.D.shape) > 0:
        feedthrough = float(
            np.max(np.linalg.norm(system.D, ord=2, axis=(1, 2)), where=system.durations > 0, initial=0.0)
        )
    # Both are at most the norm; at the feedthrough itself the game is singular.
    low = max(feedthrough * (1 + 1e-13), float(np.max(gramians(system).hankel_singular_values, initial=0.0)))
    if low == 0.0 or system.n_states == 0:
        return feedthrough
    high = 2 * low
    while not _is_bound(system, high):
        low, high = high, 2 * high
    while high / low - 1 > rtol:
        middle = low + (high - low) / 2
        if middle in (low, high):
            break
        low, high = (low, middle) if _is_bound(system, middle) else (middle, high)
    return low + (high - low) / 2


def _is_bound(system: AnyPeriodicSystem, gamma: float) -> bool:
    """Return whether gamma exceeds the norm."""
    steps = _discrete_game(system, gamma) if isinstance(system, DiscretePeriodicSystem) else _steps(system, gamma)
    if steps is None:
        return False
    total = bounded_period(steps)
    if total is None:
        return False
    for _ in range(60):
        if not total.is_bounded_with(total):
            return False
        total = total.then(total)
        if np.max(np.abs(total.E), initial=0.0) < 1e-20:
            return True
    # Neither broken nor forgotten after 2^60 periods: the norm itself, to rounding.
    return True


def _steps(system: PeriodicSystem, gamma: float) -> Scattering | None:
    """Return the game's steps with the jumps at their ends, or None where it breaks within one."""
    A, G, Q, jumps = _game(system, gamma)
    steps = bounded_steps(A, G, Q, system.durations)
    if steps is None:
        return None
    if system.has_jumps:
        steps = steps.then(free_steps(jumps))
    return steps


def _discrete_game(system: DiscretePeriodicSystem, gamma: float) -> Scattering:
    """Return the game's steps in discrete time.

    Over a step the input u = R^-1 (D' C z + B' p_1) with R = gamma^2 I - D' D is the worst for costates p.
    """
    A, B, C = system.balanced
    D = system.D / gamma
    C = C / gamma
    Bt, Ct, Dt = (np.swapaxes(part, 1, 2) for part in (B, C, D))
    R: FloatArray = np.eye(D.shape[2]) - Dt @ D
    by_state, by_costate = solved(R, Dt @ C), solved(R, Bt)
    return Scattering(E=A + B @ by_state, G=-B @ by_costate, H=Ct @ (C + D @ by_state))


def _balanced_with_ports(system: PeriodicSystem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return A, B, C and the jumps in states that balance what inputs do to them with what they do to outputs.

    Where A couples states but weakly, it alone says little about their units.
    """
    A, B, C = balanced_matrices(system)
    N, n = A.shape[:2]
    ports = np.zeros((N, n + 1, n + 1))
    ports[:, :n, :n] = A
    ports[:, :n, n], ports[:, n, :n] = np.abs(B).max(axis=2), np.abs(C).max(axis=1)
    scales = balancing_scales(ports, system.durations)
    states = scales[:n] / scales[n]
    turned = states / states[:, None]
    return A * turned, B / states[:, None], C * states, system.scaled_jumps[:, :n, :n] * turned


def _game(system: PeriodicSystem, gamma: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return balanced A, G, Q of each step for outputs over gamma, and the jumps at their ends."""
    A, B, C, jumps = _balanced_with_ports(system)
    D = system.D / gamma
    Bt, Ct, Dt = (np.swapaxes(part, 1, 2) for part in (B, C, D))
    inputs = np.asarray(np.linalg.inv(np.eye(D.shape[2]) - Dt @ D), dtype=np.float64)
    outputs = np.asarray(np.linalg.inv(np.eye(D.shape[1]) - D @ Dt), dtype=np.float64)
    return A + B @ inputs @ Dt @ C / gamma, -B @ inputs @ Bt / gamma, Ct @ outputs @ C / gamma, jumps
