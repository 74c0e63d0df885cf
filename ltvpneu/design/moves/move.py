"""Moves of the nonlinear machine in the least time, with the least air, or by an objective of one's own.

A move is a row of parts, in each of which the valves stand still. Its variables are how long they last; figures of its
end have exact derivatives over them (`passage`), and sequential convex programming finds the best, as for cycles. Which
positions follow each other, and how often valves switch, is found by looking at all orders on a grid (`looking`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, final

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import FloatArray, finite, positive, whole
from ltvpneu._values import Value
from ltvpneu.design.moves.ends import End, Place, end_of, push_slopes, start_state
from ltvpneu.design.moves.expressions import Move, end_rows, figure_of
from ltvpneu.design.moves.looking import Candidate, Look
from ltvpneu.design.progress import Progress
from ltvpneu.design.solving import Constraints, named_constraints
from ltvpneu.design.switching.goals import Wanted
from ltvpneu.design.switching.sequential import Found, best_from
from ltvpneu.design.switching.subproblem import BlockFigures, Search, Subproblem, Task
from ltvpneu.errors import LtvpneuError, NotSettledError
from ltvpneu.models.cycles.figures import CycleFigures, Slopes
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine, expect_machine
from ltvpneu.models.nonlinear.passage import Passage, Position, passage, positions_of
from ltvpneu.periodic.systems import bridge
from ltvpneu.physics.on_off_valve import OnOffValve

if TYPE_CHECKING:
    import control

Objective = Literal["time", "air", "impact"] | Callable[[Move], Any]
MOST_SWITCHES = 4
"""Looked at where their number is not given."""
PAYS = 1e-3
"""Share of the objective that another switch has to save [-]."""
N_STARTS = 6
SHORTEST = 1e-6
"""Of a part [s]."""
STEP = 1e-4
"""Of a difference, as a share of a part, for figures that are no last values [-]."""
KEPT_WITHIN = 1e-6
"""Share of a figure's size by which a goal may be missed and still counts as kept [-]."""
FIRST_SPAN, LONGEST_SPAN = 0.25, 64.0
"""How long a machine is followed to see when it gets to the end [s]."""
TIMES_LONGER = 3.0
"""How much longer than the quickest way there a move may take."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MoveSolution(Value):
    """A move of the nonlinear machine."""

    machine: Machine
    status: str
    """"optimal": to the conditions of optimality, of the best that was found. "stopped": the end and all bounds are
    kept, and no step makes it better, but the conditions are not met, as where the optimum lies on a kink. "infeasible":
    no move was found that ends where it should; this one is nearest."""
    objective: float
    order: tuple[Position, ...]
    """Whether each valve is on, the machine's own first, part by part."""
    durations: FloatArray
    """Of the parts [s], (n_parts,)."""
    figures: dict[str, float]
    """Time [s], last states, greatest speed [m/s], air mass [kg], impact energy [J]."""
    missed: dict[str, float]
    """By how much each constraint is broken, in its own unit; 0 where it is kept."""
    duals: dict[str, float]
    """Of the constraints: what one more unit of each bound saves."""
    residual: float
    """Of the conditions of optimality, scaled [-]."""
    way: Passage
    delays: tuple[tuple[float, float], ...]
    """Of each valve, from a command until it has opened and shut [s]."""
    n_simulations: int
    """Moves that were integrated in the search, those for slopes included."""
    n_looked_at: int
    """Parts that were integrated on the grid of switching times."""
    by_switches: dict[int, float]
    """The best objective with so many switches; nan where none ended where it should."""

    def __repr__(self) -> str:
        place = f"{1e3 * self.way.start[0]:.4g} to {1e3 * self.way.end[0]:.4g} mm"
        missed = f", misses {', '.join(self.broken)}" if self.broken else ""
        return (
            f"<MoveSolution: {self.status}, {place} in {1e3 * self.time:.6g} ms with {self.n_switches} switches{missed}>"
        )

    @property
    def time(self) -> float:
        """From the first opening to the end [s]."""
        return float(np.sum(self.durations))

    @property
    def n_switches(self) -> int:
        """Within the move, the first position not counted."""
        return len(self.order) - 1

    @property
    def switching_times(self) -> FloatArray:
        """When valves have switched, from the start of the move [s], (n_switches,)."""
        return np.cumsum(self.durations)[:-1]

    @property
    def broken(self) -> tuple[str, ...]:
        """Constraints that are not kept."""
        return tuple(name for name, by in self.missed.items() if by > 0)

    @property
    def commands(self) -> tuple[tuple[tuple[float, bool], ...], ...]:
        """What each valve has to be told, and when, its delays taken off [s]."""
        begins = [0.0, *self.switching_times.tolist()]
        found: list[tuple[tuple[float, bool], ...]] = []
        for valve, (opening, closing) in enumerate(self.delays):
            told: list[tuple[float, bool]] = []
            for begin, position in zip(begins, self.order, strict=True):
                on = position[valve]
                if not told or told[-1][1] != on:
                    told.append((begin - (opening if on else closing), on))
            found.append(tuple(told))
        return tuple(found)

    @property
    def end_state(self) -> FloatArray:
        """(n_states,)"""
        return self.way.end

    @cached_property
    def response(self) -> "control.TimeResponseData":
        """All states over the move, by name."""
        even = np.linspace(0.0, self.time, 400)
        times = np.union1d(even, self.switching_times)
        named = self.machine.states, self.way.at(times)
        return bridge.time_response(times, named, named, self.machine.name)


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
        How often valves switch within the move. By default found, up to four: one more as long as it pays.
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
    """
    expect_machine(machine)
    task = _Wish(machine, start, end, hold, (maximum, minimum, speed, impact_energy), minimize, constraints)
    task.limit(max_time, shortest_on, shortest_off)
    counts = range(MOST_SWITCHES + 1) if switches is None else [whole("switches", switches, 0)]
    best: MoveSolution | None = None
    reason: Exception | None = None
    by_switches: dict[int, float] = {}
    for count in counts:
        try:
            found = task.solve(count, best, progress)
        except (LtvpneuError, ValueError) as error:
            if best is None and count == counts[-1]:
                raise
            reason = error
            continue
        by_switches[count] = found.objective if found.status != "infeasible" else math.nan
        if best is None or _is_better(found, best):
            pays = best is None or best.status == "infeasible" or (
                best.objective - found.objective > PAYS * abs(best.objective)
            )
            best = found
            if pays:
                continue
        if best.status != "infeasible":
            break
    if best is None:
        assert reason is not None
        raise reason
    return replace(
        best, n_simulations=task.n_simulations, n_looked_at=task.look.n_simulations, by_switches=by_switches
    )


def _is_better(one: MoveSolution, other: MoveSolution) -> bool:
    if (one.status == "infeasible") != (other.status == "infeasible"):
        return other.status == "infeasible"
    if one.status == "infeasible":
        return sum(one.missed.values()) < sum(other.missed.values())
    return one.objective < other.objective


class _Wish:
    """What is wanted of a move, and the searches for it."""

    def __init__(  # noqa: PLR0913 - what the caller gave
        self,
        machine: Machine,
        start: Place,
        end: Any,
        hold: bool | None,
        bounds: tuple[Mapping[str, float] | None, Mapping[str, float] | None, float | None, float | None],
        minimize: Objective,
        constraints: Callable[[Move], Constraints] | None,
    ) -> None:
        self.given = machine
        self.valves = [_on_off(valve) for valve in (machine.valve, *machine.more_valves)]
        prompt = [_prompt(valve) for valve in (machine.valve, *machine.more_valves)]
        self.machine = replace(machine, valve=prompt[0], more_valves=tuple(prompt[1:]), switching_frequency=None)
        self.positions = positions_of(self.machine)
        self.start = start_state(self.machine, self.positions, start)
        self.end: End = end_of(self.machine, end, hold)
        self.maximum, self.minimum, self.speed, self.impact_energy = bounds
        self.minimize, self.own = minimize, constraints
        if not callable(minimize) and minimize not in ("time", "air", "impact"):
            raise ValueError(f'minimize: found {minimize!r}, expected "time", "air", "impact" or a function of the move')
        self.n_simulations = 0

    def limit(self, max_time: float | None, shortest_on: float | None, shortest_off: float | None) -> None:
        """Set the longest time of a move, and the shortest ones of parts."""
        self.shortest = [
            (
                own_on if shortest_on is None else positive("shortest_on", shortest_on, "s"),
                own_off if shortest_off is None else positive("shortest_off", shortest_off, "s"),
            )
            for _, _, own_on, own_off in self.valves
        ]
        least = max(SHORTEST, *(min(pair) for pair in self.shortest))
        given = None if max_time is None else positive("max_time", max_time, "s")
        self.max_time = self._longest() if given is None else given
        self.look = Look(
            positions=self.positions, start=self.start, end=self.end, max_time=self.max_time, shortest=least
        )

    def _longest(self) -> float:
        """Return how long a move may take, from how long the machine takes to get to the place it should end at."""
        low, high = self.end.bounds.get("position", (None, None))
        goal = low if low is not None else high
        quickest, span = math.inf, FIRST_SPAN
        while math.isinf(quickest) and span <= LONGEST_SPAN:
            for held in self.positions.values():
                way = passage([held], np.array([span]), self.start, 1e-6)
                times = np.linspace(0.0, span, 2000)
                way_there = way.at(times)[0]
                if goal is None:
                    continue
                there = np.flatnonzero((way_there - goal) * (self.start[0] - goal) <= 0)
                if there.size:
                    quickest = min(quickest, float(times[max(there[0], 1)]))
            if goal is None or abs(self.start[0] - goal) < 1e-12:
                break
            span *= 4
        return TIMES_LONGER * quickest if math.isfinite(quickest) else 4 * FIRST_SPAN

    def solve(self, n_switches: int, before: MoveSolution | None, progress: Progress | None) -> MoveSolution:
        """Return the best move of so many switches."""
        candidates = self.look.at_moves(n_switches, N_STARTS, progress)
        if before is not None and before.n_switches == n_switches - 1:
            candidates = [*_with_one_more(before, self.positions), *candidates]
        if not candidates:
            raise NotSettledError("no move of so many switches could be integrated", residual=math.inf)
        best: MoveSolution | None = None
        reason: Exception | None = None
        for number, candidate in enumerate(candidates):
            if progress is not None:
                progress(f"moves of {n_switches} switches", number / len(candidates))
            try:
                found = self._from(candidate)
            except (LtvpneuError, ValueError) as error:
                reason = error
                continue
            if best is None or _is_better(found, best):
                best = found
        if best is None:
            assert reason is not None
            raise reason
        return best

    def _from(self, candidate: Candidate) -> MoveSolution:
        """Go from a move that was looked at to the best of its order."""
        n = len(candidate.order)
        low, width = SHORTEST, self.max_time - SHORTEST
        setting, step = cp.Variable(n), cp.Variable(n)
        move = Move(self.machine, low + width * setting)
        objective = cp.Minimize(self._objective(move))
        constraints = self._constraints(move)
        # A figure has to be there for slopes to be asked of: the last position is one in any move.
        move.end("position")
        task = Task(
            step=step, setting=setting, blocks=tuple(move.blocks), objective=objective, constraints=constraints,
            limits=self._limits(move, candidate.order),
        )  # fmt: skip
        machines = [self.positions[position] for position in candidate.order]
        evaluate = partial(self._evaluate, machines, move, (low, width))
        search = Search(subproblem=Subproblem(task), evaluate=evaluate, look=evaluate)
        begin = np.clip((candidate.durations - low) / width, 0.0, 1.0)
        found = best_from(search, [begin], 1e-6, 100, None)
        return self._solution(found, search.subproblem, candidate.order, low + width * found.setting)

    def _objective(self, move: Move) -> Any:
        if callable(self.minimize):
            return self.minimize(move)
        return {"time": lambda: move.time, "air": move.air_mass, "impact": move.impact_energy}[self.minimize]()

    def _constraints(self, move: Move) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, (low, high) in self.end.bounds.items():
            if low is not None and low == high:
                found[f"end {name}"] = move.end(name) == low
                continue
            if low is not None:
                found[f"least end {name}"] = move.end(name) >= low
            if high is not None:
                found[f"most end {name}"] = move.end(name) <= high
        if self.end.force is not None:
            slopes = push_slopes(self.machine)
            force = external_force(self.start, self.machine.record) - float(slopes @ self.start)
            push = force + sum(
                float(slope) * move.end(name)
                for name, slope in zip(self.machine.states, slopes, strict=True)
                if slope
            )
            least, most = self.end.force
            if least == most:
                found["end force"] = push == least
            else:
                found |= {"least end force": push >= least} if math.isfinite(least) else {}
                found |= {"most end force": push <= most} if math.isfinite(most) else {}
        for name, bound in (self.maximum or {}).items():
            found[f"maximum {name}"] = move.maximum(name) <= finite(f"maximum[{name!r}]", bound)
        for name, bound in (self.minimum or {}).items():
            found[f"minimum {name}"] = move.minimum(name) >= finite(f"minimum[{name!r}]", bound)
        if self.speed is not None:
            found["speed"] = move.speed() <= positive("speed", self.speed, "m/s")
        if self.impact_energy is not None:
            found["impact energy"] = move.impact_energy() <= positive("impact_energy", self.impact_energy, "J")
        return found | (named_constraints(self.own(move)) if self.own is not None else {})

    def _limits(self, move: Move, order: tuple[Position, ...]) -> dict[str, Any]:
        """Return constraints that parts and the whole move are as long as they have to be."""
        found: dict[str, Any] = {"time": move.time <= self.max_time}
        for valve, (shortest_on, shortest_off) in enumerate(self.shortest):
            ways = [position[valve] for position in order]
            edges = [0, *(i for i in range(1, len(ways)) if ways[i] != ways[i - 1])]
            # What follows the move is not known: the last command may last.
            for number, (first, after) in enumerate(zip(edges, edges[1:], strict=False)):
                least = shortest_on if ways[first] else shortest_off
                opening, closing = self.valves[valve][:2]
                least -= (opening - closing) if ways[first] else (closing - opening)
                if least > SHORTEST:
                    found[f"valve {valve + 1}, command {number + 1}"] = cp.sum(move.durations[first:after]) >= least
        return found

    def _evaluate(
        self, machines: list[Machine], move: Move, spans: tuple[float, float], setting: FloatArray
    ) -> list[BlockFigures]:
        low, width = spans
        durations = np.maximum(low + width * setting, SHORTEST)
        way = self._way(machines, durations)
        asked = [block.figures[0] for block in move.blocks]

        def differentiate() -> Slopes:
            rows = end_rows(way, asked)
            others = [number for number in range(len(asked)) if number not in rows]
            jacobian = np.zeros((len(asked), durations.size))
            for number, row in rows.items():
                jacobian[number] = row
            if others:
                for part in range(durations.size):
                    step = max(STEP * durations[part], SHORTEST / 4)
                    beside: list[FloatArray] = []
                    for sign in (1, -1):
                        moved = durations.copy()
                        moved[part] += sign * step
                        there = self._way(machines, moved)
                        beside.append(np.array([figure_of(there, asked[number]) for number in others]))
                    jacobian[others, part] = (beside[0] - beside[1]) / (2 * step)
            return Slopes(jacobian, np.zeros((0, 0)))

        figures = CycleFigures(
            machine=self.machine,
            frequency=1 / way.duration,
            values=np.array([figure_of(way, one) for one in asked]),
            initial_state=self.start,
            n_periods=1,
            differentiate=differentiate,
        )
        widths = np.full(durations.size, width)
        return [
            BlockFigures(figures, slice(number, number + 1), widths, block.scale)
            for number, block in enumerate(move.blocks)
        ]

    def _way(self, machines: list[Machine], durations: FloatArray) -> Passage:
        self.n_simulations += 1
        return passage(machines, durations, self.start)

    def _solution(
        self, found: Found, sub: Subproblem, order: tuple[Position, ...], durations: FloatArray
    ) -> MoveSolution:
        objective, broken = sub.measured(found.setting, found.figures)
        sizes = sub.sizes
        missed = {name: by if by > KEPT_WITHIN * sizes[name] else 0.0 for name, by in broken.items()}
        durations = np.maximum(durations, SHORTEST)
        way = self._way([self.positions[position] for position in order], durations)
        figures = {"time": way.duration, **{f"end {name}": float(x) for name, x in zip(self.machine.states, way.end, strict=True)}}
        velocity = self.machine.states.index("velocity")
        figures["speed"] = max(way.extreme(velocity, greatest=True), -way.extreme(velocity, greatest=False))
        figures["air_mass"], figures["impact_energy"] = way.air_mass, way.impact_energy
        return MoveSolution(
            machine=self.given,
            status="infeasible" if any(missed.values()) else found.status,
            objective=objective,
            order=order,
            durations=durations,
            figures=figures,
            missed=missed,
            duals=dict(found.duals),
            residual=found.residual,
            way=way,
            delays=tuple((opening, closing) for opening, closing, _, _ in self.valves),
            n_simulations=0,
            n_looked_at=0,
            by_switches={},
        )


def _on_off(valve: Any) -> tuple[float, float, float, float]:
    """Return a valve's delays of opening and closing, and its shortest commands on and off [s]."""
    if isinstance(valve, OnOffValve):
        # As in a stroke, half the travel counts as delay.
        opening = valve.opening_delay + valve.opening_time / 2
        return opening, valve.closing_delay + valve.closing_time / 2, valve.shortest_on, valve.shortest_off
    return 0.0, 0.0, 0.0, 0.0


def _prompt(valve: Any) -> Any:
    """Return a valve that switches at once."""
    if not isinstance(valve, OnOffValve):
        return valve
    return replace(
        valve, pulses=None, start=0.0, ramp=0.0, opening_delay=0.0, closing_delay=0.0, opening_time=0.0, closing_time=0.0
    )


def _with_one_more(before: MoveSolution, positions: Mapping[Position, Machine]) -> list[Candidate]:
    """Return a move with another short part before it, and after it."""
    found: list[Candidate] = []
    short = np.array([0.02 * before.time])
    for position in positions:
        if position != before.order[0]:
            found.append(Candidate(0.0, (position, *before.order), np.concatenate([short, before.durations])))
        if position != before.order[-1]:
            found.append(Candidate(0.0, (*before.order, position), np.concatenate([before.durations, short])))
    return found
