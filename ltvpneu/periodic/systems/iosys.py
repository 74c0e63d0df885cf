"""`to_iosys`: a periodic system among python-control's blocks."""

from typing import TYPE_CHECKING

from ltvpneu.periodic.systems.system import PeriodicSystem, expect_no_jumps, expect_system

if TYPE_CHECKING:
    import control


def to_iosys(system: PeriodicSystem, *, name: str | None = None) -> "control.NonlinearIOSystem":
    """Return the system as a `control.NonlinearIOSystem`, for `control.interconnect` and simulation.

    Its inputs are the system's own, in their own units: B u is as given to python-control, not around the system's
    levels; r and q are built in. The period begins at t = 0.

    Parameters
    ----------
    system : PeriodicSystem
    name : str, optional
        The system's by default.

    Raises
    ------
    ValueError
        The state jumps, which no python-control block can.

    Returns
    -------
    control.NonlinearIOSystem
        Simulate it with `solve_ivp_method=ltvpneu.SwitchAware`, which stops at every switch. Under any other solver it
        raises `SkippedStepError` if a whole step was jumped over. `linearize` is exact, for the step in force at `t`.

    Examples
    --------
    >>> import control as ct
    >>> import ltvpneu as lp
    >>> pulse = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[100.0], [0.0]], [0.01, 0.99], C=[[[1.0]]] * 2)
    >>> block = lp.to_iosys(pulse)
    >>> found = ct.input_output_response(block, [0, 1], initial_state=[0], solve_ivp_method=lp.SwitchAware)
    >>> print(f"{float(found.states[0, -1]):.6f}")
    0.369725
    """
    from ltvpneu.periodic.systems.block import PeriodicIOSystem

    expect_system(system)
    expect_no_jumps(system, "to_iosys")
    return PeriodicIOSystem(system, name or system.name)
