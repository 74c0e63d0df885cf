"""The search for a move: its parts' durations by sequential convex programming, from moves on a coarse grid.

A move is a row of parts, in each of which the valves stand still. Its variables are how long they last; figures of its
end have exact derivatives over them (`passage`). Which positions follow each other, and how often valves switch, is
found by looking at all orders on a grid (`looking`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import FloatArray, finite, not_negative, positive
from ltvpneu.design.moves.ends import End, Place, end_of, push_slopes, start_state
from ltvpneu.design.moves.expressions import Move, end_rows, figure_of
from ltvpneu.design.moves.looking import Candidate, Look
from ltvpneu.design.moves.solution import MoveSolution
from ltvpneu.design.progress import Progress
from ltvpneu.design.solving import Constraints, named_constraints
from ltvpneu.design.switching.sequential import Found, best_from
from ltvpneu.design.switching.subproblem import BlockFigures, Search, Subproblem, Task
from ltvpneu.errors import IntegrationError, LtvpneuError
from ltvpneu.models.cycles.figures import CycleFigures, Slopes
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.passage import Passage, Position, passage, positions_of, without_delays
from ltvpneu.physics.on_off_valve import OnOffValve

Objective = Literal["time", "air", "impact"] | Callable[[Move], Any]
N_STARTS = 6
TOLERANCE, MOST_ITERATIONS = 1e-6, 100
"""Of the residual of optimality [-], and of one search."""
SHORTEST = 1e-6
"""Of a part [s]."""
TIDY = 10.0
"""Times that: what counts as nothing [-]."""
AS_GOOD = 1e-4
"""Share of the objective by which a move without such parts may be worse [-]."""
STEP = 1e-4
"""Of a difference, as a share of a part, for figures that are no last values [-]."""
KEPT_WITHIN = 1e-6
"""Share of a figure's size by which a goal may be missed and still counts as kept [-]."""
FIRST_SPAN, LONGEST_SPAN = 0.25, 64.0
"""How long a machine is followed to see when it gets to the end [s]."""
TIMES_LONGER = 3.0
"""How much longer than the quickest way there a move may take."""


class MoveSearch:
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
        self.machine = without_delays(machine)
        self.positions = positions_of(self.machine)
        self.start = start_state(self.machine, self.positions, start)
        self.end: End = end_of(self.machine, end, hold)
        self.maximum, self.minimum, self.speed, self.impact_energy = bounds
        self.minimize, self.own = minimize, constraints
        if not callable(minimize) and minimize not in ("time", "air", "impact"):
            raise ValueError(
                f'minimize: found {minimize!r}, expected "time", "air", "impact" or a function of the move'
            )
        self.n_simulations = 0

    def limit(self, max_time: float | None, shortest_on: float | None, shortest_off: float | None) -> None:
        """Set the longest time of a move, and the shortest ones of parts."""
        self.shortest = [
            (
                own_on if shortest_on is None else not_negative("shortest_on", shortest_on, "s"),
                own_off if shortest_off is None else not_negative("shortest_off", shortest_off, "s"),
            )
            for _, _, own_on, own_off in self.valves
        ]
        least = max(SHORTEST, *(min(pair) for pair in self.shortest))
        given = None if max_time is None else positive("max_time", max_time, "s")
        self.max_time = self._longest() if given is None else given
        self.look = Look(
            positions=self.positions, start=self.start, end=self.end, bounds=self._bounds(), max_time=self.max_time,
            shortest=least,
        )  # fmt: skip

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest values of the states on the way, (n_states,)."""
        states = self.machine.states
        low, high = np.full(len(states), -np.inf), np.full(len(states), np.inf)
        for bounds, given, what in ((high, self.maximum, "maximum"), (low, self.minimum, "minimum")):
            for name, bound in (given or {}).items():
                if name not in states:
                    raise ValueError(f"{what}: found {name!r}, expected one of {', '.join(states)}")
                bounds[states.index(name)] = finite(f"{what}[{name!r}]", bound)
        if np.any(low > high):
            worst = states[int(np.argmax(low - high))]
            raise ValueError(f"minimum, maximum: found bounds of {worst!r} that contradict each other")
        if self.speed is not None:
            fastest = positive("speed", self.speed, "m/s")
            low[1], high[1] = max(low[1], -fastest), min(high[1], fastest)
        return low, high

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

    def check(self, n_switches: int) -> None:
        """Write the problem of so many switches down, so that what is wrong with it is said before any search."""
        positions = list(self.positions)
        self._search(tuple(positions[part % len(positions)] for part in range(n_switches + 1)))

    def solve(self, n_switches: int, before: MoveSolution | None, progress: Progress | None) -> MoveSolution:
        """Return the best move of so many switches."""
        candidates = self.look.at_moves(n_switches, N_STARTS, progress)
        if before is not None and before.n_switches == n_switches - 1:
            candidates = [*_with_one_more(before, self.positions), *candidates]
        if not candidates:
            raise IntegrationError(f"no move of {n_switches} switches could be integrated", time=0.0, state=self.start)
        orders: dict[tuple[Position, ...], list[FloatArray]] = {}
        for candidate in candidates:
            orders.setdefault(candidate.order, []).append(candidate.durations)
        best: MoveSolution | None = None
        reason: Exception | None = None
        for number, (order, starts) in enumerate(orders.items()):
            if progress is not None:
                progress(f"moves of {n_switches} switches", number / len(orders))
            try:
                found = self.best_of(order, starts)
            except (LtvpneuError, ValueError, IndexError) as error:
                # An index beyond the parts that there are: the objective or a constraint is of more of them.
                reason = error
                continue
            if best is None or self.is_better(found, best):
                best = found
        if best is None:
            assert reason is not None
            raise reason
        if best.status == "infeasible":
            # The one that was looked at may be nearer than where a search ended.
            nearest = self._looked_at(min(candidates, key=lambda one: one.rank))
            best = nearest if self.is_better(nearest, best) else best
        return best

    def is_better(self, one: MoveSolution, other: MoveSolution) -> bool:
        """Whether a move keeps what is asked better, or as well and has the better objective."""
        if (one.status == "infeasible") != (other.status == "infeasible"):
            return other.status == "infeasible"
        if one.status == "infeasible":
            return self._distance(one) < self._distance(other)
        return one.objective < other.objective

    def _distance(self, one: MoveSolution) -> float:
        return float(self.look.missed(one.end_state[:, None])[0])

    def best_of(self, order: tuple[Position, ...], starts: list[FloatArray]) -> MoveSolution:
        """Go from moves of one order of positions to the best of it."""
        search = self._search(order)
        found = best_from(search, [self._setting(one) for one in starts], TOLERANCE, MOST_ITERATIONS, None)
        return self._solution(found, search.subproblem, order)

    def along_kinks(self, one: MoveSolution) -> MoveSolution:
        """Go on from where a search stopped, by slopes on both sides of kinks; return the better."""
        search = replace(self._search(one.order), mixes=True)
        found = best_from(search, [self._setting(one.durations)], TOLERANCE, MOST_ITERATIONS, None)
        other = self._solution(found, search.subproblem, one.order)
        return one if self.is_better(one, other) else other

    def tidied(self, one: MoveSolution) -> MoveSolution:
        """Return a move without the parts that have shrunk to nothing, where it is as good."""
        kept = one.durations > TIDY * SHORTEST
        if kept.all() or not kept.any():
            return one
        order: list[Position] = []
        durations: list[float] = []
        for position, duration in zip(np.array(one.order)[kept].tolist(), one.durations[kept].tolist(), strict=True):
            if order and order[-1] == tuple(position):
                durations[-1] += duration
            else:
                order.append(tuple(position))
                durations.append(duration)
        try:
            other = self.best_of(tuple(order), [np.array(durations)])
        except (LtvpneuError, ValueError):
            return one
        as_good = other.status != "infeasible" and other.objective <= one.objective + AS_GOOD * abs(one.objective)
        return other if as_good else one

    def _looked_at(self, one: Candidate) -> MoveSolution:
        """Return a move as it was looked at."""
        search, setting = self._search(one.order), self._setting(one.durations)
        figures = search.evaluate(setting)
        search.subproblem.scale(setting, figures)
        return self._solution(Found(setting=setting, figures=figures), search.subproblem, one.order)

    def _setting(self, durations: FloatArray) -> FloatArray:
        """Return the durations of parts as shares of their bounds."""
        return np.clip((durations - SHORTEST) / (self.max_time - SHORTEST), 0.0, 1.0)

    def _durations(self, setting: Any) -> Any:
        return SHORTEST + (self.max_time - SHORTEST) * setting

    def _search(self, order: tuple[Position, ...]) -> Search:
        n = len(order)
        setting, step = cp.Variable(n), cp.Variable(n)
        move = Move(self.machine, self._durations(setting))
        objective = cp.Minimize(self._objective(move))
        constraints = self._constraints(move)
        # A figure has to be there for slopes to be asked of: the last position is one in any move.
        move.end("position")
        task = Task(
            step=step, setting=setting, blocks=tuple(move.blocks), objective=objective, constraints=constraints,
            limits=self._limits(move, order),
        )  # fmt: skip
        evaluate = partial(self._evaluate, [self.positions[position] for position in order], move)
        return Search(subproblem=Subproblem(task), evaluate=evaluate, look=evaluate, mixes=False)

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
                float(slope) * move.end(name) for name, slope in zip(self.machine.states, slopes, strict=True) if slope
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
            for number, (first, after) in enumerate(pairwise(edges)):
                least = shortest_on if ways[first] else shortest_off
                opening, closing = self.valves[valve][:2]
                least -= (opening - closing) if ways[first] else (closing - opening)
                if least > SHORTEST:
                    found[f"valve {valve + 1}, command {number + 1}"] = cp.sum(move.durations[first:after]) >= least
        return found

    def _evaluate(self, machines: list[Machine], move: Move, setting: FloatArray) -> list[BlockFigures]:
        durations = np.maximum(self._durations(setting), SHORTEST)
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
        widths = np.full(durations.size, self.max_time - SHORTEST)
        return [
            BlockFigures(figures, slice(number, number + 1), widths, block.scale)
            for number, block in enumerate(move.blocks)
        ]

    def _way(self, machines: list[Machine], durations: FloatArray) -> Passage:
        self.n_simulations += 1
        return passage(machines, durations, self.start)

    def _solution(self, found: Found, sub: Subproblem, order: tuple[Position, ...]) -> MoveSolution:
        objective, broken = sub.measured(found.setting, found.figures)
        sizes = sub.sizes
        missed = {name: by if by > KEPT_WITHIN * sizes[name] else 0.0 for name, by in broken.items()}
        durations = np.maximum(self._durations(found.setting), SHORTEST)
        way = self._way([self.positions[position] for position in order], durations)
        ends = zip(self.machine.states, way.end.tolist(), strict=True)
        figures = {"time": way.duration, **{f"end {name}": value for name, value in ends}}
        velocity = self.machine.states.index("velocity")
        figures["speed"] = max(way.extreme(velocity, greatest=True), -way.extreme(velocity, greatest=False))
        figures["air_mass"], figures["impact_energy"] = way.air_mass, way.impact_energy
        return MoveSolution(
            machine=self.given,
            status="infeasible" if any(missed.values()) else "optimal" if found.status == "optimal" else "stopped",
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


def _with_one_more(before: MoveSolution, positions: Mapping[Position, Machine]) -> list[Candidate]:
    """Return a move with another short part before it, and after it."""
    found: list[Candidate] = []
    short = np.array([0.02 * before.time])
    for position in positions:
        if position != before.order[0]:
            found.append(Candidate(math.inf, (position, *before.order), np.concatenate([short, before.durations])))
        if position != before.order[-1]:
            found.append(Candidate(math.inf, (*before.order, position), np.concatenate([before.durations, short])))
    return found
