"""Switching angles, frequency and any other number of a machine as variables of a design problem.

The user writes objective and constraints in cvxpy, on expressions of the linearized cycle: every figure is its value at
the present setting plus its exact derivative, through the refitted operating points, times the step. `solve` then goes
from convex problem to convex problem (`sequential`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from typing import Any, Literal, Protocol, cast, final

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite, finite_array, positive, whole
from ltvpneu.design.global_search import search_globally
from ltvpneu.design.sequential import Found, best_from, is_better
from ltvpneu.design.solving import Constraints, named_constraints
from ltvpneu.design.starts import Progress, best_starts
from ltvpneu.design.subproblem import BlockFigures, FigureBlock, Search, Subproblem, Task
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycle_figures import CycleFigures, Figure, LinearCycles
from ltvpneu.models.linearize import LtvModel
from ltvpneu.models.machine import Machine
from ltvpneu.models.machine_arrays import SUPPLY
from ltvpneu.models.nonlinear_figures import NonlinearCycles
from ltvpneu.models.own_cycle import OwnCycle
from ltvpneu.models.parameters import is_angle, present_value, pulse_edge, pulse_edges, with_values
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.physics.gas import GasState
from ltvpneu.physics.medium import path_flow

Bounds = tuple[float, float]
Scenario = Callable[[Machine], Machine]
NOMINAL = "nominal"
ModelKind = Literal["fitted", "self-consistent", "nonlinear"]
LEAST_WIDTH = 2e-3
"""Least share of the turn for a pulse, or between pulses, whatever is asked for: none of them vanishes [-]."""


_STARTS = {1: (161, 641), 2: (169, 441)}
"""Settings looked at first; more where that leads to no optimum."""


class Cycles(Protocol):
    """Cycles of some model of a machine: `LinearCycles` or `NonlinearCycles`."""

    def figures(
        self, values: Mapping[str, float], figures: Sequence[Figure], parameters: Sequence[str]
    ) -> CycleFigures:
        """Return figures and their derivatives."""
        ...


@final
class LinearizedCycle:
    """One scenario's cycle as cvxpy expressions, linearized about the present setting; SI units.

    Where figures are looked at, they are those of the refitted model at the present setting, to first order in a step.
    """

    def __init__(self, name: str, machine: Machine, blocks: list[FigureBlock], scales: dict[str, float]) -> None:
        self.name, self.machine, self._blocks, self._scales = name, machine, blocks, scales
        self._known: dict[tuple[object, ...], cp.Expression] = {}

    def size(self, signal: str) -> float:
        """Return the size by which changes of a signal are judged, in its own unit."""
        if signal != "air_use":
            self._state(signal)
        return self._scales[signal]

    def mean(self, signal: str) -> cp.Expression:
        """Return a state's time mean."""
        return self._block(("mean", signal), [Figure("mean", self._state(signal))], signal)[0]

    def maximum(self, signal: str) -> cp.Expression:
        """Return a state's greatest value; convex, for upper bounds."""
        return cp.max(self._extremes("maximum", signal))

    def minimum(self, signal: str) -> cp.Expression:
        """Return a state's least value; concave, for lower bounds."""
        return cp.min(self._extremes("minimum", signal))

    def amplitude(self, signal: str) -> cp.Expression:
        """Return half of a state's peak-to-peak; convex, for upper bounds."""
        return (self.maximum(signal) - self.minimum(signal)) / 2

    def affine_amplitude(self, signal: str) -> cp.Expression:
        """Return half the peak-to-peak, affine, for lower bounds and equations.

        At the extremes as they are now: where two draw level it has a kink that this does not see.
        """
        state = self._state(signal)
        found = self._block(("swing", signal), [Figure("minimum", state), Figure("maximum", state)], signal)
        return (found[1] - found[0]) / 2

    def at(self, signal: str, angles: ArrayLike) -> cp.Expression:
        """Return a state at angles of the turn [rad], shape (n_angles,), to track a wanted cycle."""
        turned = np.mod(finite_array("angles", np.atleast_1d(np.asarray(angles, dtype=np.float64)), (None,)), 2 * np.pi)
        state = self._state(signal)
        return self._block(("at", signal, *turned.tolist()), [Figure("at", state, angle) for angle in turned], signal)

    def air_use(self) -> cp.Expression:
        """Return the mean mass flow from the supply, by the law of the flow along the model's cycle [kg/s]."""
        return self._block(("air_use",), [Figure("air_use")], "air_use")[0]

    def _extremes(self, kind: Literal["minimum", "maximum"], signal: str) -> cp.Expression:
        state, n_pieces = self._state(signal), self.machine.openings.fractions.size - 1
        within = [Figure(kind, state, 0.0, piece) for piece in range(n_pieces)]
        return self._block((kind, signal), [Figure(kind, state), *within], signal)

    def _state(self, signal: str) -> int:
        states = self.machine.states
        if signal not in states:
            near = get_close_matches(str(signal), states, 1, 0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"signal: found {signal!r}, expected one of {', '.join(states)}{hint}")
        return states.index(signal)

    def _block(self, key: tuple[object, ...], figures: list[Figure], signal: str) -> cp.Expression:
        if key not in self._known:
            block = FigureBlock(scenario=self.name, figures=tuple(figures), scale=self._scales[signal])
            self._blocks.append(block)
            self._known[key] = block.scale * block.variable
        return self._known[key]


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DutySolution:
    """What a design of switching angles ended with."""

    status: str
    """"optimal": stationary, all constraints kept. "infeasible": no setting near keeps them; this is the nearest that
    was found. "edge": better settings next to this one have no cycle, as where stiction locks. "stopped": out of
    iterations, or where the residual stays large."""
    values: dict[str, float]
    """Of the variables."""
    objective: float
    """Of the model that was designed on; nan where infeasible."""
    constraints: dict[str, float]
    """By how much each is broken on that model, in its own unit; 0 where it is kept."""
    nonlinear_constraints: dict[str, float]
    """The same on the nonlinear machine; nan where that has no cycle."""
    nonlinear_objective: float
    """The same on the nonlinear machine; nan where it has no cycle, or where infeasible."""
    duals: dict[str, float]
    """Of the constraints: how fast the objective gets better as an inequality's bound is loosened, never below zero, or
    as the right side of an equation rises, in its own unit."""
    active: tuple[str, ...]
    """Constraints, and bounds of variables, that hold the design."""
    residual: float
    """Of the conditions of optimality, scaled [-]: the longest of the step that the convex problem with unit curvature
    still takes, the constraints' violation, and their duals times what is left to their bounds."""
    at_kink: bool
    """Whether the optimum lies on a kink of the model, as where the piston begins to rest within its cycle: then the
    residual is that of the slopes on both sides, mixed."""
    merits: tuple[tuple[float, float], ...]
    """Objective plus penalties before and after every step taken, each pair with the same penalty."""
    n_cycles: int
    """Cycles computed with derivatives."""
    n_failed: int
    """Settings tried where the model had no cycle."""
    spectral_radius: float
    """Of the cycle, the refit included: below one it is stable."""
    machine: Machine
    """As designed."""
    frequency: float
    """[Hz]"""
    commands: tuple[tuple[float, float], ...]
    """When to tell the valve to go on and off, each pulse, delays counted in [s]; below zero, in the period before."""
    model: LtvModel | None
    """The linear model designed on, if it was one."""
    scenario_machines: dict[str, Machine]
    """As designed, in every scenario."""
    nonlinear: dict[str, Orbit | str]
    """Cycle of the nonlinear machine in every scenario, or why it has none."""
    lower_bound: float = math.nan
    """Where the search was global: no setting makes the objective better, as far as the estimated curvature between the
    settings looked at holds; see `global_search`."""
    corrected: "DutySolution | None" = None
    """The same problem solved from here on the nonlinear machine, where that was asked for."""
    not_corrected: str = ""
    """Why it was not, where that was asked for."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {value:.6g}" for name, value in self.values.items())
        return f"<DutySolution: {self.status}, objective {self.objective:.6g}, {shown}, residual {self.residual:.1e}>"


@final
class DutyProblem:
    """A machine's switching as variables of a design problem; made by `duty_problem`.

    Attributes
    ----------
    machine : Machine
    frequency : float
        Where it is no variable [Hz].
    bounds : dict of (float, float)
        Of every variable.
    variables : dict of cvxpy.Expression
        By name, SI units, scalars.
    scenarios : dict of LinearizedCycle
        By name; "nominal" is the machine as it is.
    limits : dict of cvxpy.Constraint
        What every setting keeps: the variables' bounds, and pulses and pauses no shorter than asked for.
    """

    def __init__(
        self,
        machine: Machine,
        frequency: float,
        bounds: dict[str, Bounds],
        scenarios: Mapping[str, Scenario],
        valve: ValveLimits,
    ) -> None:
        self.machine, self.frequency, self.bounds, self.valve = machine, frequency, bounds, valve
        self._changes = scenarios
        self._step = cp.Variable(len(bounds))
        self._setting = cp.Variable(len(bounds))
        self.variables: dict[str, cp.Expression] = {
            name: low + (high - low) * self._setting[i] for i, (name, (low, high)) in enumerate(bounds.items())
        }
        self._blocks: list[FigureBlock] = []
        scales = {
            **dict(zip(machine.states, machine.state_scales.tolist(), strict=True)),
            "air_use": _flow_size(machine),
        }
        self.scenarios = {
            name: LinearizedCycle(name, self._changed(name, machine), self._blocks, scales)
            for name in (NOMINAL, *scenarios)
        }
        self.limits: dict[str, cp.Constraint] = {}

    def __repr__(self) -> str:
        return f"<DutyProblem of {self.machine.name}: {', '.join(self.bounds)}; {len(self.scenarios)} scenarios>"

    def _changed(self, name: str, machine: Machine) -> Machine:
        """Return what a scenario makes of the machine, with its variables set."""
        if name not in self._changes:
            return machine
        found: Any = self._changes[name](machine)
        if not isinstance(found, Machine):
            raise TypeError(f"scenarios: {name!r} returned {type(found).__name__}, expected the changed Machine")
        return found

    @property
    def nominal(self) -> LinearizedCycle:
        """The cycle of the machine as it is."""
        return self.scenarios[NOMINAL]

    def switching(self) -> cp.Expression:
        """Return how often the valves switch on [1/s]."""
        pulses = len(pulse_edges(self.machine)) // 2
        found = self.variables.get("frequency")
        return (pulses + len(self.machine.more_valves)) * (cp.Constant(self.frequency) if found is None else found)

    def solve(  # noqa: PLR0913 - keyword-only, each with its default
        self,
        objective: cp.Minimize | cp.Maximize,
        constraints: Constraints = (),
        *,
        model: ModelKind = "fitted",
        steps_per_position: int = 1,
        start: Mapping[str, float] | None = None,
        n_starts: int | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 100,
        globally: bool = False,
        progress: Progress | None = None,
    ) -> DutySolution:
        """Solve by sequential convex programming.

        Parameters
        ----------
        objective : cvxpy.Minimize or cvxpy.Maximize
        constraints : sequence or dict of cvxpy constraints
            Comparisons <=, >= and ==; duals come back under the dict's names.
        model : {"fitted", "self-consistent", "nonlinear"}
            What the figures are those of.
        steps_per_position : int
            Steps of a linear model in each position of the valve.
        start : mapping of str to float, optional
            Where to start; by default from the best few of `n_starts` settings.
        n_starts : int, optional
            Settings looked at first beside the machine's own. Default 161 for one variable, more
            where figures jump, and 169 for two, on an even grid, then 641 and 441 where these lead to no optimum; 16
            beyond, a Sobol sequence.
        tolerance : float
            Of `residual`.
        max_iterations : int
        globally : bool
            Look at every part of the bounds, for one or two variables, and return a lower bound too.
        progress : callable, optional
            Called with a text and a share done, 0 to 1.

        Raises
        ------
        NotConvexError
            cvxpy finds objective or constraints not to be convex in the figures.
        SolverError
            The solver failed on a convex problem.
        LtvpneuError
            No setting looked at has a cycle: the last one's reason.
        """
        search = self.search(objective, constraints, model, steps_per_position)
        if globally:
            found, lower = search_globally(search, tolerance, max_iterations, progress)
        else:
            lower, limits = math.nan, (tolerance, max_iterations)
            if start is not None:
                found = best_from(search, [self._given(start)], *limits, progress)
            else:
                counts = _STARTS.get(len(self.bounds), (16,)) if n_starts is None else (whole("n_starts", n_starts),)
                found = None
                for count in counts:
                    begin = best_starts(search, self.own_setting, count, progress)
                    other = best_from(search, begin, *limits, progress)
                    found = other if found is None or is_better(search, other, found) else found
                    if found.status == "optimal" or (found.status == "infeasible" and len(self.bounds) == 1):
                        break
                assert found is not None
        return self._solution(found, search.subproblem, lower)

    def search(
        self, objective: cp.Minimize | cp.Maximize, constraints: Constraints, model: ModelKind, steps_per_position: int
    ) -> Search:
        """Return the convex problem of a step, and where its figures come from; what `solve` searches with."""
        asked: Any = objective
        if not isinstance(asked, cp.Minimize | cp.Maximize):
            raise TypeError(f"objective: found {type(asked).__name__}, expected cvxpy.Minimize or cvxpy.Maximize")
        task = Task(
            step=self._step,
            setting=self._setting,
            blocks=tuple(self._blocks),
            objective=objective,
            constraints=named_constraints(constraints),
            limits=self.limits,
        )
        cycles = self._cycles(model, steps_per_position)
        return Search(subproblem=Subproblem(task), evaluate=lambda setting: self._evaluate(cycles, setting))

    @property
    def own_setting(self) -> FloatArray:
        """The machine's own values, as shares of the bounds."""
        return self._given({})

    def values_at(self, setting: FloatArray) -> dict[str, float]:
        """Return the variables at a setting, each as a share of its bounds."""
        return {
            name: low + (high - low) * float(share)
            for share, (name, (low, high)) in zip(setting, self.bounds.items(), strict=True)
        }

    def _cycles(self, model: ModelKind, steps_per_position: int) -> dict[str, Cycles]:
        if model not in ("fitted", "self-consistent", "nonlinear"):
            raise ValueError(f'model: found {model!r}, expected "fitted", "self-consistent" or "nonlinear"')
        whole("steps_per_position", steps_per_position)
        found: dict[str, Cycles] = {}
        for name in self.scenarios:
            change = partial(self._changed, name) if name in self._changes else None
            if model == "nonlinear":
                found[name] = NonlinearCycles(self.machine, self.frequency, change)
            else:
                mode: OwnCycle = model
                found[name] = LinearCycles(self.machine, self.frequency, mode, steps_per_position, change=change)
        return found

    def _evaluate(self, cycles: Mapping[str, Cycles], setting: FloatArray) -> list[BlockFigures]:
        """Return the figures of every block, with derivatives over the setting, in the blocks' scales."""
        values, widths = self.values_at(setting), np.array([high - low for low, high in self.bounds.values()])
        found: list[BlockFigures | None] = [None] * len(self._blocks)
        for name, cycle in cycles.items():
            mine = [i for i, block in enumerate(self._blocks) if block.scenario == name]
            asked = [figure for i in mine for figure in self._blocks[i].figures]
            figures = cycle.figures(values, asked, list(self.bounds))
            first = 0
            for i in mine:
                block = self._blocks[i]
                rows = slice(first, first + len(block.figures))
                first = rows.stop
                found[i] = BlockFigures(figures, rows, widths, block.scale)
        return [one for one in found if one is not None]

    def _given(self, start: Mapping[str, float]) -> FloatArray:
        for name, value in start.items():
            if name not in self.bounds:
                raise ValueError(f"start: found {name!r}, expected {', '.join(self.bounds)}")
            low, high = self.bounds[name]
            if not low <= finite(f"start[{name!r}]", value) <= high:
                raise ValueError(f"start: found {value:g} for {name!r}, expected {low:g} to {high:g}, its bounds")
        own = {name: present_value(self.machine, self.frequency, name) for name in self.bounds}
        return self._setting_of(own | dict(start))

    def _setting_of(self, values: Mapping[str, float]) -> FloatArray:
        shares = [(finite(name, values[name]) - low) / (high - low) for name, (low, high) in self.bounds.items()]
        return np.clip(np.array(shares), 0.0, 1.0)

    def _solution(self, found: Found, subproblem: Subproblem, lower: float) -> DutySolution:
        values = self.values_at(found.setting)
        machine, frequency = with_values(self.machine, values), float(values.get("frequency", self.frequency))
        objective, broken = subproblem.measured(found.setting, found.figures)
        checked = self._cycles("nonlinear", 1)
        orbits: dict[str, Orbit | str] = {}
        for name, cycle in checked.items():
            try:
                orbits[name] = cycle.orbit(values) if isinstance(cycle, NonlinearCycles) else ""
            except LtvpneuError as error:
                orbits[name] = str(error)
        try:
            nonlinear = subproblem.measured(found.setting, self._evaluate(checked, found.setting))
        except LtvpneuError:
            nonlinear = math.nan, dict.fromkeys(broken, math.nan)
        return DutySolution(
            status=found.status,
            values=values,
            objective=objective if found.status != "infeasible" else math.nan,
            constraints=broken,
            nonlinear_constraints=nonlinear[1],
            nonlinear_objective=nonlinear[0] if found.status != "infeasible" else math.nan,
            duals=found.duals,
            active=found.active + self._at_bounds(found.setting),
            residual=found.residual,
            at_kink=found.at_kink,
            merits=tuple(found.merits),
            n_cycles=found.n_cycles,
            n_failed=found.n_failed,
            spectral_radius=max((figures.cycle.spectral_radius for figures in found.figures), default=math.nan),
            machine=machine,
            frequency=frequency,
            commands=self._commands(machine, frequency),
            model=self._model(found.figures),
            scenario_machines={name: self._changed(name, machine) for name in self.scenarios},
            nonlinear=orbits,
            lower_bound=lower,
        )

    def _model(self, figures: Sequence[BlockFigures]) -> LtvModel | None:
        """Return the linear model of the machine as it is, where it was designed on one."""
        for block, one in zip(self._blocks, figures, strict=True):
            if block.scenario == NOMINAL and one.cycle.cycle is not None:
                return one.cycle.cycle.model
        return None

    def _commands(self, machine: Machine, frequency: float) -> tuple[tuple[float, float], ...]:
        edges = [edge / (2 * math.pi * frequency) for edge in pulse_edges(machine)]
        pairs = zip(edges[::2], edges[1::2], strict=True)
        return tuple((on - self.valve.opening_delay, off - self.valve.closing_delay) for on, off in pairs)

    def _at_bounds(self, setting: FloatArray) -> tuple[str, ...]:
        names: list[str] = []
        for share, (name, (low, high)) in zip(setting, self.bounds.items(), strict=True):
            if share < 1e-9 or share > 1 - 1e-9:
                names.append(f"{name} {'>=' if share < 0.5 else '<='} {low if share < 0.5 else high:g}")
        return tuple(names)


def duty_problem(
    machine: Machine,
    frequency: float | Bounds,
    variables: Mapping[str, Bounds] | None = None,
    *,
    scenarios: Mapping[str, Scenario] | None = None,
    valve: ValveLimits | None = None,
) -> DutyProblem:
    """Return a machine's switching as variables of a design problem.

    Parameters
    ----------
    machine : Machine
    frequency : float or (float, float)
        Switching frequency [Hz]; bounds make it a variable.
    variables : mapping of str to (float, float), optional
        Bounds of what is free: "duty", "offset_angle" [rad], edges of the valve's pulses "on_1", "off_1", "on_2", ...
        [rad], "more_valves.0.start" [rad], "supply_pressure" [Pa], or any number of the machine as in
        `parameter_sensitivity`. By default the duty, or, of a machine with several pulses, all edges but the first.
    scenarios : mapping of str to callable, optional
        Each takes the machine, its variables set, to what it may be instead: lower supply pressure, more friction,
        another load.
    valve : ValveLimits, optional
        Shortest commands, and delays: angles and duty are those at which the valve is open, `DutySolution.commands`
        what it has to be told.

    Returns
    -------
    DutyProblem

    Raises
    ------
    ValueError
        Unknown variables, bounds that contradict each other, shortest times that do not fit into a period.

    Examples
    --------
    The duty at which Table 1 swings about 45 mm at 8 Hz:

    >>> import cvxpy as cp
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> problem = design.duty_problem(lp.load_machine("kunt_singh_1990"), 8.0)
    >>> found = problem.solve(cp.Minimize((problem.nominal.mean("position") / 1e-3 - 45) ** 2))
    >>> print(f"{found.values['duty']:.2f} {1e3 * found.nonlinear['nominal'].mean('position'):.0f} mm")
    0.47 45 mm
    """
    valve = ValveLimits() if valve is None else valve
    bounds = dict(_default_variables(machine) if variables is None else variables)
    asked: Any = frequency
    if isinstance(asked, tuple | list):
        if "frequency" in bounds:
            raise ValueError("frequency: found bounds here and among the variables, expected them in one of the two")
        bounds["frequency"] = cast(Bounds, tuple(cast(Sequence[float], asked)))
    if "frequency" in bounds:
        _check_pair("frequency", bounds["frequency"])
        low, high = (positive("frequency", value, "Hz") for value in bounds["frequency"])
        present = math.sqrt(low * high)
    else:
        present = positive("frequency", cast(float, frequency), "Hz")
    if not bounds:
        raise ValueError("variables: found none, expected at least one")
    _expect_one_way_to_switch(machine, bounds)
    for name, pair in bounds.items():
        _check_bounds(machine, present, name, pair)
    problem = DutyProblem(machine, present, bounds, dict(scenarios or {}), valve)
    problem.limits.update(_pulse_limits(problem))
    return problem


def _default_variables(machine: Machine) -> dict[str, Bounds]:
    edges = pulse_edges(machine)
    if len(edges) == 2:
        return {"duty": (0.02, 0.98)}
    first = float(edges[0])
    names = [f"{'off' if i % 2 else 'on'}_{i // 2 + 1}" for i in range(1, len(edges))]
    return dict.fromkeys(names, (first, first + 2 * math.pi))


def _expect_one_way_to_switch(machine: Machine, bounds: Mapping[str, Bounds]) -> None:
    edges = [name for name in bounds if pulse_edge(name) is not None]
    ways = [name for name in ("duty", "offset_angle") if name in bounds] + edges[:1]
    if len(ways) > 1:
        raise ValueError(
            f"variables: found {' and '.join(map(repr, ways))}, which set the same switching; expected one of them"
        )
    n_pulses = len(pulse_edges(machine)) // 2
    if "duty" in bounds and n_pulses > 1:
        raise ValueError(f"variables: found 'duty' of a valve with {n_pulses} pulses, expected their edges, as 'off_1'")


def _check_pair(name: str, pair: Any) -> None:
    if not isinstance(pair, Sequence) or isinstance(pair, str) or len(cast(Sequence[Any], pair)) != 2:
        raise ValueError(f"variables: found {pair!r} for {name!r}, expected its least and its greatest value")
    low, high = (finite(name, value) for value in cast(Sequence[float], pair))
    if low >= high:
        raise ValueError(f"variables: found bounds {low:g} to {high:g} of {name!r}, expected the lower one first")


def _check_bounds(machine: Machine, frequency: float, name: str, pair: Bounds) -> None:
    _check_pair(name, pair)
    low, high = pair
    try:
        present_value(machine, frequency, name)
    except ValueError as error:
        known = ["duty", "frequency", "offset_angle", "on_1", "off_1", "supply_pressure", "exhaust_pressure"]
        near = get_close_matches(name, known, 1, 0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"variables: found {name!r}, which is no number of the machine ({error}){hint}") from None
    if name == "duty" and not (low >= 0 and high <= 1):
        raise ValueError(f"variables: found bounds {low:g} to {high:g} of 'duty', expected 0 to 1")
    if not is_angle(name) and name != "frequency":
        for value in (low, high):
            try:
                with_values(machine, {name: value})
            except ValueError as error:
                raise ValueError(f"variables: found {value:g} for {name!r}: {error}") from None


def _pulse_limits(problem: DutyProblem) -> dict[str, cp.Constraint]:
    """Return constraints that keep commanded pulses and pauses long enough, and the edges in order."""
    variables, machine, valve = problem.variables, problem.machine, problem.valve
    frequency: Any = variables.get("frequency", cp.Constant(problem.frequency))
    slowest = problem.bounds["frequency"][0] if "frequency" in variables else problem.frequency
    # A command shorter than the valve's delay does not reach it.
    shortest_on = max(valve.shortest_on, valve.opening_delay)
    shortest_off = max(valve.shortest_off, valve.closing_delay)
    if (shortest_on + shortest_off) * slowest > 1:
        raise ValueError(
            f"valve: found shortest times of {shortest_on:g} s on and {shortest_off:g} s off, delays counted in, more "
            f"than a period of {1 / slowest:g} s; expected shorter ones, or a lower frequency"
        )
    # Open times, less by the lag than what is commanded.
    least_on, least_off = (
        cp.maximum(time * frequency, LEAST_WIDTH) for time in (shortest_on - valve.lag, shortest_off + valve.lag)
    )
    if "duty" in variables:
        return {
            "shortest pulse": variables["duty"] >= least_on,
            "shortest pause": 1 - variables["duty"] >= least_off,
        }
    edges: list[Any] = [
        variables.get(f"{'off' if i % 2 else 'on'}_{i // 2 + 1}", cp.Constant(float(edge)))
        for i, edge in enumerate(pulse_edges(machine))
    ]
    if "offset_angle" in variables:
        # On while both windows are open: for half a turn less the offset, whichever way.
        edges = [cp.Constant(0.0), math.pi - cp.abs(variables["offset_angle"])]
    found: dict[str, cp.Constraint] = {}
    for i, (before, after) in enumerate(zip(edges, [*edges[1:], edges[0] + 2 * math.pi], strict=True)):
        if i % 2 and "offset_angle" in variables:
            # The pause is half a turn at least.
            break
        width, least = after - before, (least_off if i % 2 else least_on) * (2 * math.pi)
        name = f"shortest {'pause' if i % 2 else 'pulse'} {i // 2 + 1}"
        if width.variables() or least.variables():
            found[name] = width >= least
            continue
        open_for, asked = float(np.asarray(width.value)), float(np.asarray(least.value))
        if 0 < open_for < min(2 * math.pi, asked - 1e-9):
            raise ValueError(
                f"valve: the machine's {name[9:]} lasts {open_for / (2 * math.pi * slowest):g} s, which is shorter "
                "than the valve can be told to; expected it longer, or among the variables"
            )
    return found


def _flow_size(machine: Machine) -> float:
    """Return the size of flows from the supply: what the largest openings pass when choked [kg/s]."""
    areas = machine.openings.areas[:, 0][:, machine.arrays.paths[:, 1] == SUPPLY]
    arrays = machine.arrays
    largest = float(np.sum(np.max(areas, axis=0))) if areas.size else 0.0
    back = GasState(max(machine.exhaust_pressure, 0.4 * machine.supply_pressure), machine.gas.temperature)
    flow = path_flow(largest, math.inf, arrays.supply, back, arrays.medium)
    return flow or 1.0
