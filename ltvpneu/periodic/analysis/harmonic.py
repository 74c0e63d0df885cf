r"""Harmonic transfer functions, in closed form.

The steady response to u = u_0 e^{s t} is y = sum over k of H_k(s) u_0 e^{(s + j k w) t} with w = 2 pi / T. Writing
z = p(t) e^{s t} u_0, the periodic p solves p' = (A - s I) p + B, a cyclic system over the steps, and

.. math:: H_k(s) = \frac1T \int_0^T (C p + D) e^{-j k w t} dt

whose integral over a step comes from one exponential of the augmented matrix of p e^{-j k w t}, e^{-j k w t} and the
integral itself. No harmonic is truncated: H_k(s) is right to rounding (to 1e-8 where rates are 1e9 times the slowest),
whatever k, where the usual block Toeplitz form [Wereley1990]_ converges like a power of the number of harmonics kept.

.. [Wereley1990] N. M. Wereley, S. R. Hall, "Frequency response of linear time periodic systems", Proc. 29th CDC, 1990.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import ComplexArray, FloatArray, finite_array
from ltvpneu.errors import StepOverflowError
from ltvpneu.periodic.algebra.cyclic import reduced
from ltvpneu.periodic.algebra.propagate import complex_exponentials
from ltvpneu.periodic.analysis.gramians import balanced_matrices
from ltvpneu.periodic.orbits.floquet import floquet, is_exponent
from ltvpneu.periodic.systems import bridge
from ltvpneu.periodic.systems.system import GROWTH, PeriodicSystem, expect_system

if TYPE_CHECKING:
    import control


def harmonic_transfer(system: PeriodicSystem, s: complex, harmonics: Sequence[int] | int = 0) -> ComplexArray:
    """Return H_k(s): from an input of e^{s t} to the output's part of e^{(s + j k w) t}, w = 2 pi / period.

    Parameters
    ----------
    system : PeriodicSystem
    s : complex
        [1/s]; no characteristic exponent, to within multiples of j w.
    harmonics : sequence of int
        k, of either sign.

    Returns
    -------
    ndarray of complex, shape (len(harmonics), n_outputs, n_inputs)

    Raises
    ------
    ValueError
        s is a characteristic exponent: the response has no such form.
    StepOverflowError
        The response grows further within the period than double precision can follow.

    Examples
    --------
    A system that does not vary has H_0 only, its transfer function 1 / (s + 1):

    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-1.0]]], [[0.0]] * 2, [0.3, 0.7], B=[[[1.0]]] * 2)
    >>> lp.harmonic_transfer(system, 1.0, [0, 1]).ravel().round(12)
    array([0.5+0.j, 0. +0.j])
    """
    expect_system(system)
    s = complex(s)
    if not np.isfinite(s):
        raise ValueError(f"s: found {s}, expected a finite number")
    wanted = _whole_numbers(harmonics)
    system = system.split(system.growing_pieces)
    A, B, C = balanced_matrices(system)
    shifted = A - s * np.eye(system.n_states)
    starts = _periodic_shape(system, shifted, B, s)
    w = 2 * np.pi / system.period
    found = [_coefficient(system, (shifted, B, C), starts, 1j * k * w) for k in wanted]
    return np.array(found).reshape(len(wanted), len(system.outputs), len(system.inputs))


def frequency_response(
    system: PeriodicSystem, omega: ArrayLike, harmonics: Sequence[int] | int = 0
) -> "control.FrequencyResponseData":
    """Return the harmonic transfer functions at s = j omega, as a `control.FrequencyResponseData`.

    Parameters
    ----------
    system : PeriodicSystem
    omega : array_like, shape (n_frequencies,)
        [rad/s]
    harmonics : sequence of int
        k; the outputs of each come one after the other, named "y1[k=+1]" and so on, without brackets for k = 0.

    Returns
    -------
    control.FrequencyResponseData
        `.plot()` and `.complex` are python-control's.

    Raises
    ------
    ValueError
        j omega is a characteristic exponent.
    StepOverflowError
        A step grows by more than double precision holds, or states are too stiff and too strongly coupled for it.
    """
    expect_system(system)
    frequencies = finite_array("omega", omega, (None,))
    wanted = _whole_numbers(harmonics)
    values = np.array([harmonic_transfer(system, 1j * x, wanted) for x in frequencies])
    stacked = values.reshape(len(frequencies), len(wanted) * len(system.outputs), len(system.inputs))
    names = [name if k == 0 else f"{name}[k={k:+d}]" for k in wanted for name in system.outputs]
    return bridge.frequency_response(frequencies, np.moveaxis(stacked, 0, -1), (names, system.inputs), system.name)


def _whole_numbers(harmonics: Sequence[int] | int) -> list[int]:
    given = np.atleast_1d(np.asarray(harmonics))
    if given.ndim != 1 or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"harmonics: found {harmonics!r}, expected whole numbers")
    return [int(k) for k in given]


def _periodic_shape(system: PeriodicSystem, shifted: ComplexArray, B: FloatArray, s: complex) -> ComplexArray:
    """Return p at the start of each step, (n_steps, n, m)."""
    N, n, m = B.shape
    augmented = np.zeros((N, n + m, n + m), dtype=np.complex128)
    augmented[:, :n, :n], augmented[:, :n, n:] = shifted, B
    pieces = np.ones(N, dtype=np.int64)
    with np.errstate(over="ignore", invalid="ignore"):
        maps = complex_exponentials(augmented * system.durations[:, None, None])
    # The shift by s may make a step grow that does not of itself.
    growing = ~(np.abs(maps[:, :n, :n]).max(axis=(1, 2), initial=0.0) <= GROWTH)
    if growing.any():
        pieces = np.where(growing, system.fine_pieces, 1)
        maps = complex_exponentials(augmented * (system.durations / pieces)[:, None, None])
        maps = np.repeat(maps, pieces, axis=0)
    ends = np.cumsum(pieces) - 1
    maps[ends, :n] = system.scaled_jumps[:, :n, :n] @ maps[ends, :n]
    one = reduced(maps[:, :n, :n], maps[:, :n, n:])
    gap = one.first + one.last
    values = np.linalg.svd(gap, compute_uv=False)
    if n and values[-1] <= 1e-13 * (np.abs(one.first).max() + np.abs(one.last).max()):
        found = floquet(system)
        shown = ", ".join(f"{x:.6g}" for x in found.exponents)
        if not is_exponent(found, s):
            raise StepOverflowError(
                f"the response to e^(s t) at s = {s:.6g} grows too far within the period, and comes back, for double "
                f"precision to follow, though s is no characteristic exponent (they are {shown}). Are A and the "
                "durations in the same units of time?"
            )
        raise ValueError(
            f"s: found {s:.6g}, a characteristic exponent but for multiples of j 2 pi / T (they are {shown}), where"
            " the response to e^(s t) grows without bound; move s off it"
        )
    start = np.linalg.solve(gap, one.rhs)
    return one.all_from(start, start)[:-1][np.cumsum(pieces) - pieces]


def _coefficient(
    system: PeriodicSystem, matrices: tuple[ComplexArray, FloatArray, FloatArray], starts: ComplexArray, turn: complex
) -> ComplexArray:
    """Return the mean of (C p + D) e^{-turn t} over the period, (p, m)."""
    shifted, B, C = matrices
    (N, n, m), p = B.shape, C.shape[1]
    block = np.zeros((N, n + m + p, n + m + p), dtype=np.complex128)
    block[:, :n, :n], block[:, :n, n : n + m] = shifted - turn * np.eye(n), B
    block[:, n : n + m, n : n + m] = -turn * np.eye(m)
    block[:, n + m :, :n], block[:, n + m :, n : n + m] = C, system.D
    integrals = complex_exponentials(block * system.durations[:, None, None])[:, n + m :]
    over_steps = integrals[:, :, :n] @ starts + integrals[:, :, n : n + m]
    phases = np.exp(-turn * system.switching_times[:-1])
    return np.einsum("k,kij->ij", phases, over_steps) / system.period
