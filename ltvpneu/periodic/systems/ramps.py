r"""Steps whose coefficients ramp: A, B and r change linearly over a step, as with a valve that opens slowly.

With M(t) = [[A, f], [0, 0]] linear in time, of mean M_m and slope M' over a part of length h, Magnus' expansion of
fourth order [Blanes2009]_ has

.. math:: \Omega = h M_m + \tfrac{h^3}{12} [M', M_m], \qquad z(h) = e^{\Omega} z(0)

so an ordinary step with M_m + h^2/12 [M', M_m] gets from end to end of the part with an error of order h^5, h^4 after
all parts; with the mean alone, h^2. No step kind of its own is needed, and all that is known of piecewise-constant
systems holds: period maps, multipliers and the states between parts have that order. Inside a part the course is that
of another system, off by M' t (t - h) / 2 z, so means and extremes of states whose own rates ramp are right to h^2.

.. [Blanes2009] S. Blanes, F. Casas, J. A. Oteo and J. Ros, "The Magnus expansion and some of its applications", Physics
   Reports 470, 2009, sections 2 and 5.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from ltvpneu._arrays import FloatArray, IntArray, whole
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system

Order = Literal[2, 4]


def ramped(starts: PeriodicSystem, ends: PeriodicSystem, *, parts: int = 8, order: Order = 4) -> PeriodicSystem:
    """Return the system whose coefficients go linearly over each step from those of one system to those of another.

    Parameters
    ----------
    starts, ends : PeriodicSystem
        With the coefficients at the start and at the end of each step; same durations, levels and names.
    parts : int
        Ordinary steps that each ramped one is taken in; steps that do not change stay one.
    order : {4, 2}
        Of the error of the step maps, and so of the states between parts, in the length of the parts: with the
        commutator, or with means alone. Time means and extremes have order 2 either way.

    Returns
    -------
    PeriodicSystem
        Outputs have the means of C, D and q over each part.

    Raises
    ------
    ValueError
        The systems differ in more than their coefficients.

    Examples
    --------
    A leak that opens over one second and shuts over the next:

    >>> import ltvpneu as lp
    >>> shut, open_ = (lp.PeriodicSystem.from_matrices([[[a]], [[b]]], [[1.0], [1.0]], [1.0, 1.0])
    ...                for a, b in ((-0.1, -2.0), (-2.0, -0.1)))
    >>> print(f"{lp.steady_state(lp.ramped(shut, open_, parts=64)).mean('z1'):.4f}")
    0.9784
    """
    expect_system(starts)
    expect_system(ends)
    for kind in ("states", "inputs", "outputs"):
        if getattr(starts, kind) != getattr(ends, kind):
            raise ValueError(
                f"ends: found {kind} {getattr(ends, kind)}, expected those of starts: {getattr(starts, kind)}"
            )
    for kind in ("durations", "levels", "J", "j"):
        if not np.array_equal(getattr(starts, kind), getattr(ends, kind)):
            raise ValueError(f"ends: found other {kind} than in starts, expected the same")
    if order not in (2, 4):
        raise ValueError(f"order: found {order!r}, expected 2 or 4")
    parts = whole("parts", parts)
    fields = ("A", "B", "r", "C", "D", "q")
    changes = np.zeros(starts.n_steps, dtype=np.bool_)
    for field in fields:
        difference = getattr(ends, field) != getattr(starts, field)
        changes |= difference.reshape(starts.n_steps, -1).any(axis=1)
    counts = np.where(changes, parts, 1)
    step = np.repeat(np.arange(starts.n_steps), counts)
    number = np.concatenate([np.arange(count) for count in counts])
    middle = (number + 0.5) / counts[step]
    h = starts.durations[step] / counts[step]

    def between(field: str) -> FloatArray:
        at_start, at_end = getattr(starts, field)[step], getattr(ends, field)[step]
        return at_start + middle.reshape(-1, *[1] * (at_start.ndim - 1)) * (at_end - at_start)

    means = {field: between(field) for field in fields}
    if order == 4:
        # Of the matrix with B and r as further columns, whose lower rows are zero; over a part M' h = rise / count.
        n = starts.n_states
        M, rise = (np.concatenate([A, B, r[:, :, None]], axis=2) for A, B, r in _matrices(starts, ends, means, step))
        factor = (h / counts[step] / 12)[:, None, None]
        correction = factor * (rise[:, :, :n] @ M - M[:, :, :n] @ rise)
        means["A"] = means["A"] + correction[:, :, :n]
        means["B"] = means["B"] + correction[:, :, n:-1]
        means["r"] = means["r"] + correction[:, :, -1]
    return replace(starts.with_parts(h, step, number == counts[step] - 1), **means)


def _matrices(
    starts: PeriodicSystem, ends: PeriodicSystem, means: dict[str, FloatArray], step: IntArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]:
    """Return A, B and r in the middles of the parts, and their changes over the steps that the parts belong to."""
    rises = tuple(getattr(ends, field)[step] - getattr(starts, field)[step] for field in ("A", "B", "r"))
    return (means["A"], means["B"], means["r"]), (rises[0], rises[1], rises[2])
