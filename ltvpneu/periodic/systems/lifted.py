"""Time-invariant systems made of a periodic one: sampled once a period (lifted), and averaged over it."""

from typing import TYPE_CHECKING

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.bridge import CONSTANT_INPUT
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.held import held_maps
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_no_jumps, expect_system

if TYPE_CHECKING:
    import control


def lifted(system: AnyPeriodicSystem, *, stacked: bool = False) -> "control.StateSpace":
    """Return the map over one period, z(T) = Phi z(0) + Gamma u, as a discrete-time system with dt = period.

    Its poles are the Floquet multipliers.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    stacked : bool
        False: inputs constant over the period, outputs at its start. True: one value of each input a step, held over
        it, and every output at the start of every step, named "u1[1]", "u1[2]", ... and "y1[1]", ...

    Returns
    -------
    control.StateSpace
        The last input, "one", carries the affine terms r and q: hold it at 1.

    Raises
    ------
    StepOverflowError
        A step grows by more than double precision holds.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[1.0], [0.0]], [0.5, 0.5], B=[[[1.0]]] * 2)
    >>> lp.lifted(system).input_labels, lp.lifted(system, stacked=True).input_labels
    (['u1', 'one'], ['u1[1]', 'u1[2]', 'one'])
    """
    expect_periodic(system)
    N, n, m = system.B.shape
    maps = held_maps(system) if isinstance(system, PeriodicSystem) else system.input_maps
    # State at each step's start over (z(0), one u a step, one).
    rows = np.zeros((n, n + N * m + 1))
    rows[:, :n] = np.eye(n)
    outputs: list[FloatArray] = []
    for k in range(N):
        held = slice(n + k * m, n + (k + 1) * m)
        seen = system.C[k] @ rows
        seen[:, held] += system.D[k]
        seen[:, -1] += system.q[k]
        outputs.append(seen)
        rows = maps[k, :, :n] @ rows
        rows[:, held] += maps[k, :, n : n + m]
        rows[:, -1] += maps[k, :, -1]
    if stacked:
        # Each input's values side by side.
        order = [n + k * m + i for i in range(m) for k in range(N)]
        inputs = [f"{name}[{k + 1}]" for name in system.inputs for k in range(N)]
        seen = np.concatenate([step[[i]] for i in range(len(system.outputs)) for step in outputs])
        names = [f"{name}[{k + 1}]" for name in system.outputs for k in range(N)]
        B, D = rows[:, [*order, -1]], seen[:, [*order, -1]]
    else:
        inputs, names, seen = list(system.inputs), list(system.outputs), outputs[0]
        B, D = (_held_together(part, N, n) for part in (rows, seen))
    return bridge.state_space(
        (rows[:, :n], B, seen[:, :n], D),
        (system.states, [*inputs, CONSTANT_INPUT], names),
        f"{system.name}_lifted",
        dt=system.period,
    )


def averaged(system: PeriodicSystem) -> "control.StateSpace":
    """Return the time-invariant system of the coefficients' means over the period.

    A good model where every step is short against the system's own times, and only there.

    Raises
    ------
    ValueError
        The state jumps.

    Returns
    -------
    control.StateSpace
        In continuous time. The last input, "one", carries the affine terms r and q: hold it at 1.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-3.0]]], [[1.0], [0.0]], [0.5, 0.5])
    >>> lp.averaged(system).A
    array([[-2.]])
    """
    expect_system(system)
    expect_no_jumps(system, "averaged")
    weights = system.durations / system.period
    A, B, r, C, D, q = (
        np.tensordot(weights, part, axes=1) for part in (system.A, system.B, system.r, system.C, system.D, system.q)
    )
    return bridge.state_space(
        (A, np.column_stack([B, r]), C, np.column_stack([D, q])),
        (system.states, [*system.inputs, CONSTANT_INPUT], system.outputs),
        f"{system.name}_averaged",
    )


def _held_together(rows: FloatArray, N: int, n: int) -> FloatArray:
    """Return coefficients of inputs that are the same in every step, and of "one"."""
    each = rows[:, n:-1].reshape(len(rows), N, (rows.shape[1] - n - 1) // N).sum(axis=1)
    return np.column_stack([each, rows[:, -1]])
