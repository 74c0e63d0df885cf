r"""Steps of constant coefficients that stand for smooth ones, A(t), to a wanted accuracy.

Over a part of length h, with M_1 and M_2 the augmented matrices [[A, B, f], [0, 0, 0]] at Gauss's nodes,
h (1/2 -+ sqrt(3)/6), Magnus' expansion of fourth order [Blanes2009]_ has

.. math:: \Omega = \tfrac h2 (M_1 + M_2) + \tfrac{\sqrt3 h^2}{12} [M_2, M_1], \qquad z(h) = e^{\Omega} z(0)

so a step of the constant matrix Omega / h goes from end to end with an error of order h^5. A part is halved until
its map and that of its two halves differ by less than its share of the tolerance, fifteen times the error of the
halves.

.. [Blanes2009] S. Blanes, F. Casas, J. A. Oteo and J. Ros, "The Magnus expansion and some of its applications", Physics
   Reports 470, 2009, section 5.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array
from ltvpneu.errors import NotConvergedError
from ltvpneu.periodic.algebra.propagate import balancing_scales, forced_exponentials

NODE = np.sqrt(3) / 6
FIRST_PARTS = 16
MOST_ROUNDS = 30
MOST_PARTS = 200_000
ROUNDING = 1e-15
"""Difference of a map from that of its halves, relative to its size, that says nothing [-]."""

Function = Callable[[float], ArrayLike]
"""Of the time within the period [s]."""


def smooth_steps(
    A: Function, f: Function | None, B: Function | None, period: float, rtol: float
) -> tuple[FloatArray, FloatArray]:
    """Return durations (N,) and the constant [A, B, f] of each step, (N, n, n + m + 1).

    Raises
    ------
    NotConvergedError
        The coefficients change too fast, or jump, for `rtol` to be kept.
    """
    starts: FloatArray = np.arange(FIRST_PARTS, dtype=np.float64) * (period / FIRST_PARTS)
    lengths: FloatArray = np.full(FIRST_PARTS, period / FIRST_PARTS)
    errors: FloatArray = np.zeros(FIRST_PARTS)
    known: dict[float, FloatArray] = {}

    def at(times: FloatArray) -> FloatArray:
        for t in times.tolist():
            if t not in known:
                known[t] = _coefficients(A, f, B, t)
        return np.array([known[t] for t in times.tolist()])

    first = at(starts)
    n = first.shape[1]
    scales = balancing_scales(first[:, :, :n], lengths)
    units = np.maximum(np.abs(first[:, :, n:]).max(axis=(0, 1), initial=0.0), np.finfo(float).tiny) * period
    found: list[tuple[float, float, FloatArray]] = []
    for _ in range(MOST_ROUNDS):
        whole = _constants(at, starts, lengths)
        halves: FloatArray = np.stack([starts, starts + lengths / 2], axis=1)
        halved = np.repeat(lengths / 2, 2)
        both = _constants(at, halves.ravel(), halved)
        one = _maps(whole, lengths, scales, units)
        two = _maps(both, halved, scales, units)
        two = two[1::2] @ two[::2]
        sizes = np.maximum(np.abs(two).max(axis=(1, 2)), 1.0)
        missed = _scaled(_missed(at, starts, lengths), scales, units) * lengths[:, None, None]
        found_off = [np.abs(one - two).max(axis=(1, 2)) / sizes, np.abs(missed).max(axis=(1, 2))]
        errors = np.max(found_off, axis=0) / 15
        done = errors <= np.maximum(rtol * lengths / period, ROUNDING)
        for k in np.flatnonzero(done):
            found += [(halves[k, i], halved[2 * k], both[2 * k + i]) for i in (0, 1)]
        starts, lengths = halves[~done].ravel(), np.repeat(lengths[~done] / 2, 2)
        if starts.size == 0:
            found.sort(key=lambda part: part[0])
            return np.array([length for _, length, _ in found]), np.array([matrix for _, _, matrix in found])
        if len(found) + starts.size > MOST_PARTS:
            break
    raise NotConvergedError(
        f"from_function: {len(found) + starts.size} parts of the period did not keep rtol = {rtol:g}; the worst is at "
        f"t = {starts[0]:.9g} s, {lengths[0]:.3g} s long. Do the coefficients jump there? Put a step of from_matrices "
        "on each side of a jump, or allow a larger rtol",
        residual=float(errors.max()),
        iterations=MOST_ROUNDS,
    )


def step_means(name: str, function: Function, durations: FloatArray, columns: int) -> FloatArray:
    """Return the means of a smooth matrix over steps, from Gauss's nodes, (N, p, columns)."""
    starts = np.cumsum(durations) - durations

    def at(share: float) -> list[FloatArray]:
        times = (starts + share * durations).tolist()
        return [finite_array(f"{name}: at t = {t:.9g} s", function(t), (None, columns)) for t in times]

    first, second = at(0.5 - NODE), at(0.5 + NODE)
    rows = {len(matrix) for matrix in first + second}
    if len(rows) != 1:
        raise ValueError(f"{name}: found {min(rows)} and {max(rows)} rows at different times, expected as many always")
    return (np.array(first) + np.array(second)) / 2


def _coefficients(A: Function, f: Function | None, B: Function | None, t: float) -> FloatArray:
    """Return [A, B, f] at one time, (n, n + m + 1)."""
    matrix = finite_array(f"A: at t = {t:.9g} s", A(t), (None, None))
    n = len(matrix)
    if matrix.shape[1] != n:
        raise ValueError(f"A: found shape {matrix.shape} at t = {t:.9g} s, expected a square matrix")
    inputs = np.zeros((n, 0)) if B is None else finite_array(f"B: at t = {t:.9g} s", B(t), (n, None))
    forcing = np.zeros(n) if f is None else finite_array(f"f: at t = {t:.9g} s", f(t), (n,))
    return np.concatenate([matrix, inputs, forcing[:, None]], axis=1)


def _constants(at: Callable[[FloatArray], FloatArray], starts: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return Omega / h of parts, their upper rows, (n_parts, n, n + m + 1)."""
    first, second = (at(starts + lengths * (0.5 + sign * NODE)) for sign in (-1.0, 1.0))
    n = first.shape[1]
    # The commutator of augmented matrices, whose lower rows are zero.
    commutator = second[:, :, :n] @ first - first[:, :, :n] @ second
    return (first + second) / 2 + np.sqrt(3) / 12 * lengths[:, None, None] * commutator


def _missed(at: Callable[[FloatArray], FloatArray], starts: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return by how much Simpson's rule has another mean over parts than Gauss's, (n_parts, n, n + m + 1).

    Of the same order, from other times: a jump that hides between the nodes of whole and halves shows here.
    """
    gauss = (at(starts + lengths * (0.5 - NODE)) + at(starts + lengths * (0.5 + NODE))) / 2
    return (at(starts) + 4 * at(starts + lengths / 2) + at(starts + lengths)) / 6 - gauss


def _scaled(constants: FloatArray, scales: FloatArray, units: FloatArray) -> FloatArray:
    """Return [A, B, f] in balanced states and forcing of size one."""
    n = constants.shape[1]
    balanced = constants / scales[:, None]
    return np.concatenate([balanced[:, :, :n] * scales, constants[:, :, n:] / units], axis=2)


def _maps(constants: FloatArray, lengths: FloatArray, scales: FloatArray, units: FloatArray) -> FloatArray:
    """Return the maps of parts, in balanced states and forcing of size one, (n_parts, n + m + 1, n + m + 1)."""
    n, k = constants.shape[1:]
    matrices = np.zeros((len(constants), k, k))
    matrices[:, :n] = _scaled(constants, scales, units)
    return forced_exponentials(matrices * lengths[:, None, None], n)
