"""Moves of the nonlinear machine in the least time, with the least air, or by an objective of one's own."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from ltvpneu._arrays import whole
from ltvpneu.design.moves.ends import Place
from ltvpneu.design.moves.expressions import Move
from ltvpneu.design.moves.search import MoveSearch, Objective
from ltvpneu.design.moves.solution import MoveSolution
from ltvpneu.design.progress import Progress
from ltvpneu.design.solving import Constraints
from ltvpneu.design.switching.goals import Wanted
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.machine.machine import Machine, expect_machine

MOST_SWITCHES = 4
"""Looked at where their number is not given."""
PAYS = 1e-3
"""Share of the objective that another switch has to save [-]."""


def optimize_move(  # noqa: PLR0913 - keyword-only, each with its default
    machine: Machine,
    start: Place,
    end: Place | Mapping[str, Wanted],
    *,
    switches: int | None = None,
    minimize: Objective = "time",
    constraints: Callable[[Move], Constraints] | None = None,
    maximum: Mapping[str, float] | None = None,
    minimum: Mapping[str, float] | None = None,
    speed: float | None = None,
    impact_energy: float | None = None,
    hold: bool | None = None,
    max_time: float | None = None,
    shortest_on: float | None = None,
    shortest_off: float | None = None,
    progress: Progress | None = None,
) -> MoveSolution:
    """Return when the valves have to switch for a move from rest to rest.

    Parameters
    ----------
    machine : Machine
        With one valve or several, each on or off. Delays and travel times are taken off the commands.
    start : float, mapping of str to float or array_like, shape (n_states,)
        A position [m], at rest by pressures that hold it there; states by name, the others as at rest at the position;
        or all states.
    end : float, mapping of str to float or (float or None, float or None), or array_like
        Likewise; states that are not named may be what they are. A position alone asks for rest, too, by pressures that
        friction or a stop holds.
    switches : int, optional
        How often valves may switch within the move. By default up to four, one more as long as it pays.
    minimize : {"time", "air", "impact"} or callable
        The time [s], the mass drawn from the supply [kg], the energy that a stop takes [J]; or a function from the move
        (`design.Move`) to a convex cvxpy expression of it.
    constraints : callable, optional
        From the move to cvxpy constraints of one's own, by name or in a sequence.
    maximum, minimum : mapping of str to float, optional
        Bounds of states on the way.
    speed, impact_energy : float, optional
        The most that is allowed [m/s], [J].
    hold : bool, optional
        Whether the last pressures have to hold the piston; by default where `end` is a position.
    max_time : float, optional
        The longest that a move may take [s]; by default three times the quickest way to the end.
    shortest_on, shortest_off : float, optional
        Least times for which a valve is on, and off, between two switches [s]; by default the valve's own.
    progress : callable, optional
        Called with a text and a share done, 0 to 1.

    Raises
    ------
    ValueError
        A start or an end that cannot be held, unknown states, a valve that is not on or off.
    NotConvexError
        Objective or constraints are not convex in the move's figures.
    LtvpneuError
        No move could be integrated.

    Examples
    --------
    Table 1's piston from rest at 20 mm to rest at 70 mm in the least time:

    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> found = design.optimize_move(lp.load_machine("kunt_singh_1990"), 0.02, 0.07, switches=2)
    >>> print(found)
    <MoveSolution: optimal, 20 to 70 mm in 84.742 ms with 2 switches>
    """
    expect_machine(machine)
    task = MoveSearch(machine, start, end, hold, (maximum, minimum, speed, impact_energy), minimize, constraints)
    task.limit(max_time, shortest_on, shortest_off)
    most = MOST_SWITCHES if switches is None else whole("switches", switches, 0)
    task.check(most)
    best: MoveSolution | None = None
    before: MoveSolution | None = None
    by_switches: dict[int, float] = {}
    for count in range(most + 1):
        try:
            found = task.solve(count, before, progress)
        except (LtvpneuError, ValueError, IndexError):
            if best is None and count == most:
                raise
            continue
        before = found
        by_switches[count] = found.objective if found.status != "infeasible" else math.nan
        pays = best is None or best.status == "infeasible"
        if best is not None and task.is_better(found, best):
            pays = pays or best.objective - found.objective > PAYS * abs(best.objective)
        if best is None or task.is_better(found, best):
            best = found
        if switches is None and not pays:
            break
    assert best is not None
    if best.status != "infeasible":
        best = task.tidied(best)
    if best.status == "stopped":
        best = task.along_kinks(best)
    return replace(best, n_simulations=task.n_simulations, n_looked_at=task.look.n_simulations, by_switches=by_switches)
