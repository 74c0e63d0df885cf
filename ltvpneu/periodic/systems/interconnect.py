"""Periodic systems in series, in parallel and in feedback, with each other and with time-invariant ones."""

from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike

from ltvpneu._arrays import finite_array
from ltvpneu.periodic.systems.discrete import AnyPeriodicSystem, expect_periodic
from ltvpneu.periodic.systems.joined import System, in_feedback, in_parallel, in_series, side_by_side
from ltvpneu.periodic.systems.per_step import each_step


def series(first: Any, second: Any) -> AnyPeriodicSystem:
    """Return the second system driven by the first one's outputs, in order; as `control.series`.

    Parameters
    ----------
    first, second : PeriodicSystem, DiscretePeriodicSystem, control.StateSpace or array_like
        One at least periodic; the other may be a `control.StateSpace` of the same kind of time (in discrete time with
        dt the duration of the steps), or a constant gain (n_out, n_in).

    Returns
    -------
    PeriodicSystem or DiscretePeriodicSystem
        Inputs and levels of the first, outputs of the second.

    Raises
    ------
    ValueError
        Numbers of outputs and inputs that differ, or periods with no common multiple below 1000 of either.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> pulse = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[1.0], [0.0]], [0.1, 0.9])
    >>> lp.series(pulse, [[2.0]]).C.ravel()
    array([2., 2.])
    """
    return in_series(first, second, _lead(first, second))


def parallel(first: Any, second: Any) -> AnyPeriodicSystem:
    """Return both systems with the same inputs and the sum of their outputs; as `control.parallel`.

    Parameters
    ----------
    first, second : PeriodicSystem, DiscretePeriodicSystem, control.StateSpace or array_like
        One at least periodic, as in `series`.

    Returns
    -------
    PeriodicSystem or DiscretePeriodicSystem
        Names of inputs and outputs, and levels, of the first that is periodic.

    Raises
    ------
    ValueError
        Other numbers of inputs or outputs, other levels, or periods that are not commensurate.
    """
    return in_parallel(first, second, _lead(first, second))


def append(first: Any, second: Any) -> AnyPeriodicSystem:
    """Return both systems side by side, each with its own inputs and outputs; as `control.append`.

    Parameters
    ----------
    first, second : PeriodicSystem, DiscretePeriodicSystem, control.StateSpace or array_like
        One at least periodic, as in `series`.

    Raises
    ------
    ValueError
        Periods that are not commensurate.

    Examples
    --------
    >>> import ltvpneu as lp
    >>> pulse = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[1.0], [0.0]], [0.1, 0.9], B=[[[1.0]]] * 2)
    >>> lp.append(pulse, [[2.0]]).outputs
    ('z1', 'y1')
    """
    return side_by_side(first, second, _lead(first, second))


def feedback(first: Any, second: Any, sign: float = -1) -> AnyPeriodicSystem:
    """Return the first system with the second from its outputs back to its inputs; as `control.feedback`.

    Parameters
    ----------
    first, second : PeriodicSystem, DiscretePeriodicSystem, control.StateSpace or array_like
        One at least periodic, as in `series`.
    sign : float
        -1: negative feedback, u + sign * y_second goes in.

    Returns
    -------
    PeriodicSystem or DiscretePeriodicSystem
        Inputs, outputs and levels of the first.

    Raises
    ------
    ValueError
        Other numbers of outputs and inputs, periods that are not commensurate, or an algebraic loop without solution.
    """
    if sign not in (-1, 1):
        raise ValueError(f"sign: found {sign!r}, expected -1 or 1")
    return in_feedback(first, second, _lead(first, second), sign)


def state_feedback(system: System, K: ArrayLike) -> System:
    """Return the system under u = v - K z: static, periodic state feedback, with v in place of its inputs.

    Parameters
    ----------
    system : PeriodicSystem or DiscretePeriodicSystem
    K : array_like, shape (m, n) or (n_steps, m, n)

    Examples
    --------
    >>> import ltvpneu as lp
    >>> system = lp.PeriodicSystem.from_matrices([[[0.0]]] * 2, [[1.0], [0.0]], [0.1, 0.9], B=[[[1.0]]] * 2)
    >>> lp.state_feedback(system, [[[0.0]], [[2.0]]]).A.ravel()
    array([ 0., -2.])
    """
    expect_periodic(system)
    gains = finite_array("K", each_step("K", K, system.n_steps, len(system.inputs)), (None, None, system.n_states))
    return replace(
        system, A=system.A - system.B @ gains, C=system.C - system.D @ gains, name=f"{system.name}_state_feedback"
    )


def _lead(first: Any, second: Any) -> AnyPeriodicSystem:
    """Return the first operand that is periodic."""
    lead = next((x for x in (first, second) if isinstance(x, AnyPeriodicSystem)), None)
    if lead is None:
        kinds = f"{type(first).__name__} and {type(second).__name__}"
        raise TypeError(f"interconnection: found {kinds}, expected one PeriodicSystem at least, or a discrete one")
    return lead
