"""Switching angles, frequency and any other number of a machine as variables of a design problem.

The user writes objective and constraints in cvxpy, on expressions of the linearized cycle: every figure is its value at
the present setting plus its exact derivative, through the refitted operating points, times the step. `solve` then goes
from convex problem to convex problem (`sequential`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, Protocol, cast, final

import cvxpy as cp
import numpy as np

from ltvpneu._arrays import FloatArray, finite, positive, whole
from ltvpneu.design.progress import Progress
from ltvpneu.design.solving import Constraints, named_constraints
from ltvpneu.design.switching.cycle import LinearizedCycle, signal_scales
from ltvpneu.design.switching.duty_solution import DutySolution
from ltvpneu.design.switching.duty_variables import (
    Bounds,
    check_bounds,
    check_pair,
    default_variables,
    drawn_in,
    expect_one_way_to_switch,
    pulse_limits,
)
from ltvpneu.design.switching.global_search import search_globally
from ltvpneu.design.switching.local_search import search_locally
from ltvpneu.design.switching.nearest import nearest, ranges_of
from ltvpneu.design.switching.sequential import Found, best_from
from ltvpneu.design.switching.setting_slopes import setting_slopes
from ltvpneu.design.switching.subproblem import BlockFigures, FigureBlock, Search, Subproblem, Task
from ltvpneu.design.valve_limits import ValveLimits
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.figures import CycleFigures, Figure
from ltvpneu.models.cycles.linear_cycles import LinearCycles
from ltvpneu.models.cycles.nonlinear_cycles import NonlinearCycles
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.linear.own_cycle import OwnCycle
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.machine.parameters import present_value, pulse_edges, with_values
from ltvpneu.periodic.orbits.orbit import Orbit

Scenario = Callable[[Machine], Machine]
NOMINAL = "nominal"
KEPT_WITHIN = 0.01
"""Share of a goal that the nonlinear machine may break it by and still keeps it, see `DutySolution.tolerances` [-]."""
LOOK_RTOL, LOOK_PERIODS = 1e-5, 40
"""How settings are looked at before a search: integration tolerance, and valve periods simulated at most."""

ModelKind = Literal["fitted", "self-consistent", "nonlinear"]


class Cycles(Protocol):
    """Cycles of some model of a machine: `LinearCycles` or `NonlinearCycles`."""

    def figures(
        self, values: Mapping[str, float], figures: Sequence[Figure], parameters: Sequence[str]
    ) -> CycleFigures:
        """Return figures and their derivatives."""
        ...


@final
class DutyProblem:
    """A machine's switching as variables of a design problem; made by `duty_problem`.

    Attributes
    ----------
    machine : Machine
    frequency : float
        Where it is no variable [Hz].
    bounds : dict of (float, float)
        Of every variable; of the duty, drawn in to where the valve's ramps do not meet.
    variables : dict of cvxpy.Expression
        By name, SI units, scalars.
    scenarios : dict of LinearizedCycle
        By name; "nominal" is the machine as it is.
    limits : dict of cvxpy.Constraint
        What every setting keeps: the variables' bounds, and pulses and pauses no shorter than asked for, nor than the
        valve's ramps.
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
        scales = signal_scales(machine)
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
        steps_per_piece: int = 1,
        start: Mapping[str, float] | None = None,
        n_starts: int | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 100,
        globally: bool = False,
        slopes: Sequence[str] = (),
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
        steps_per_piece : int
            Steps of a linear model in each piece of the turn through which all openings are constant or linear.
        start : mapping of str to float, optional
            Where to start; by default from the best few of `n_starts` settings.
        n_starts : int, optional
            Settings of the nonlinear machine looked at first beside its own. Default 161 for one variable, more
            where figures jump, and 169 for two, on an even grid, then 641 and 441 where these lead to no optimum; 16
            beyond, a Sobol sequence.
        tolerance : float
            Of `residual`.
        max_iterations : int
        globally : bool
            Look at every part of the bounds, for one or two variables, and return a lower bound too.
        slopes : sequence of str
            Numbers of the machine, as in `parameter_sensitivity`, over which the best objective is differentiated:
            `DutySolution.slopes`; so are the best settings: `DutySolution.setting_slopes`.
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
        for name in slopes:
            present_value(self.machine, self.frequency, name)
        search = self.search(objective, constraints, model, steps_per_piece)
        if globally:
            found, lower = search_globally(search, tolerance, max_iterations, progress)
        else:
            lower, limits = math.nan, (tolerance, max_iterations)
            if start is not None:
                found = best_from(search, [self._given(start)], *limits, progress)
            else:
                found = search_locally(search, self.own_setting, n_starts, limits, progress)
        found = nearest(search, found, tolerance, max_iterations, progress)
        worth = self._value_slopes(found, search.subproblem, self._cycles(model, steps_per_piece), slopes)
        ranges = ranges_of(search.noted)

        def beside(machine: Machine, frequency: float) -> Search:
            cycles = self._cycles(model, steps_per_piece, machine, frequency)
            return replace(search, evaluate=partial(self._evaluate, cycles), noted=[])

        shares = setting_slopes(found, (self.machine, self.frequency), slopes, beside, tolerance)
        moves = {name: self._by_variable(one) for name, one in shares.items()}
        return self._solution(found, search.subproblem, lower, ranges, (worth, moves))

    def search(
        self, objective: cp.Minimize | cp.Maximize, constraints: Constraints, model: ModelKind, steps_per_piece: int
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
        return Search(
            subproblem=Subproblem(task),
            evaluate=partial(self._evaluate, self._cycles(model, steps_per_piece)),
            look=partial(self._evaluate, self._rough_cycles()),
        )

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

    def values_of(
        self, expressions: Sequence[Any], values: Mapping[str, float], model: ModelKind = "nonlinear"
    ) -> tuple[float, ...]:
        """Return what expressions of the figures are at a setting, on a model.

        Raises
        ------
        LtvpneuError
            The model has no cycle there.
        """
        setting = self._given(values)
        figures = self._evaluate(self._cycles(model, 1), setting)
        self._setting.value = setting
        for block, one in zip(self._blocks, figures, strict=True):
            block.variable.value = one.values
        return tuple(float(np.asarray(expression.value)) for expression in expressions)

    def _by_variable(self, shares: FloatArray) -> dict[str, float]:
        """Return changes of the settings in the variables' own units, from those as shares of the bounds."""
        return {
            name: (high - low) * float(share)
            for share, (name, (low, high)) in zip(shares, self.bounds.items(), strict=True)
        }

    def _cycles(
        self, model: ModelKind, steps_per_piece: int, machine: Machine | None = None, frequency: float | None = None
    ) -> dict[str, Cycles]:
        """Return the cycles of every scenario, of the machine as it is or of one beside it."""
        machine = self.machine if machine is None else machine
        frequency = self.frequency if frequency is None else frequency
        if model not in ("fitted", "self-consistent", "nonlinear"):
            raise ValueError(f'model: found {model!r}, expected "fitted", "self-consistent" or "nonlinear"')
        whole("steps_per_piece", steps_per_piece)
        found: dict[str, Cycles] = {}
        for name in self.scenarios:
            change = self._change_of(name)
            if model == "nonlinear":
                found[name] = NonlinearCycles(machine, frequency, change)
            else:
                mode: OwnCycle = model
                found[name] = LinearCycles(machine, frequency, mode, steps_per_piece, change=change)
        return found

    def _rough_cycles(self) -> dict[str, Cycles]:
        """Return the machine's own cycles, integrated loosely, for settings that are only looked at."""
        return {
            name: NonlinearCycles(self.machine, self.frequency, self._change_of(name), LOOK_RTOL, LOOK_PERIODS)
            for name in self.scenarios
        }

    def _change_of(self, name: str) -> Scenario | None:
        return partial(self._changed, name) if name in self._changes else None

    def _evaluate(self, cycles: Mapping[str, Cycles], setting: FloatArray) -> list[BlockFigures]:
        """Return the figures of every block, with derivatives over the setting, in the blocks' scales."""
        widths = np.array([high - low for low, high in self.bounds.values()])
        found = self._figures(cycles, self.values_at(setting), list(self.bounds))
        return [
            BlockFigures(figures, rows, widths, block.scale)
            for block, (figures, rows) in zip(self._blocks, found, strict=True)
        ]

    def _figures(
        self, cycles: Mapping[str, Cycles], values: Mapping[str, float], parameters: Sequence[str]
    ) -> list[tuple[CycleFigures, slice]]:
        """Return each block's scenario's figures, and which of them are the block's; one cycle for every scenario."""
        found: dict[int, tuple[CycleFigures, slice]] = {}
        for name, cycle in cycles.items():
            mine = [i for i, block in enumerate(self._blocks) if block.scenario == name]
            asked = [figure for i in mine for figure in self._blocks[i].figures]
            figures, first = cycle.figures(values, asked, parameters), 0
            for i in mine:
                rows = slice(first, first + len(self._blocks[i].figures))
                first, found[i] = rows.stop, (figures, rows)
        return [found[i] for i in range(len(self._blocks))]

    def _value_slopes(
        self, found: Found, subproblem: Subproblem, cycles: Mapping[str, Cycles], names: Sequence[str]
    ) -> dict[str, float]:
        """Return the derivatives of the best objective over parameters.

        By the envelope theorem they are those of the Lagrangian with the settings held: the figures' own derivatives,
        each times what one more unit of the figure costs.
        """
        if not names or found.status != "optimal" or found.at_kink:
            return dict.fromkeys(names, math.nan)
        values = self.values_at(found.setting)
        values |= {name: present_value(self.machine, self.frequency, name) for name in names if name not in values}
        total, first = np.zeros(len(names)), 0
        try:
            for block, (figures, rows) in zip(self._blocks, self._figures(cycles, values, names), strict=True):
                duals = found.figure_duals[first : first + len(block.figures)]
                first += len(block.figures)
                total += duals @ figures.jacobian[rows] / block.scale
        except (LtvpneuError, ValueError):
            # The optimum stands, also where a cycle beside it cannot be followed.
            return dict.fromkeys(names, math.nan)
        return {name: subproblem.in_user_units(float(one)) for name, one in zip(names, total, strict=True)}

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

    def _solution(
        self,
        found: Found,
        subproblem: Subproblem,
        lower: float,
        ranges: Mapping[str, float],
        slopes: tuple[dict[str, float], dict[str, dict[str, float]]],
    ) -> DutySolution:
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
        except (LtvpneuError, ValueError):
            nonlinear = math.nan, dict.fromkeys(broken, math.nan)
        sides = subproblem.magnitudes()
        tolerances = {
            name: max(KEPT_WITHIN * size, 0.1 * KEPT_WITHIN * ranges.get(name, 0.0)) for name, size in sides.items()
        }
        return DutySolution(
            status=found.status,
            values=values,
            objective=objective if found.status != "infeasible" else math.nan,
            constraints=broken,
            nonlinear_constraints=nonlinear[1],
            tolerances=tolerances,
            nonlinear_objective=nonlinear[0] if found.status != "infeasible" else math.nan,
            duals=found.duals,
            slopes=slopes[0],
            setting_slopes=slopes[1],
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
            if block.scenario == NOMINAL and one.cycle.find_model is not None:
                return one.cycle.find_model()
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
        [rad], of a second valve "duty_2" and "start_2" [rad], "supply_pressure" [Pa], or any number of the machine as
        in `parameter_sensitivity`. By default the duty, or, of a machine with several pulses, all edges but the first.
        Of a valve with ramps, pulses and pauses stay long enough for it to open and shut fully: bounds of the duty that
        reach further are drawn in, as `DutyProblem.bounds` shows.
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
        Unknown variables, bounds that contradict each other, shortest times that do not fit into a period, bounds of
        the duty between which the valve never opens, or never shuts, fully.

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
    asked: Any = frequency
    if not isinstance(asked, tuple | list):
        machine = machine.at(positive("frequency", cast(float, frequency), "Hz"))
    bounds = dict(default_variables(machine) if variables is None else variables)
    if isinstance(asked, tuple | list):
        if "frequency" in bounds:
            raise ValueError("frequency: found bounds here and among the variables, expected them in one of the two")
        bounds["frequency"] = cast(Bounds, tuple(cast(Sequence[float], asked)))
    if "frequency" in bounds:
        check_pair("frequency", bounds["frequency"])
        low, high = (positive("frequency", value, "Hz") for value in bounds["frequency"])
        present = math.sqrt(low * high)
    else:
        present = positive("frequency", cast(float, frequency), "Hz")
    if not bounds:
        raise ValueError("variables: found none, expected at least one")
    expect_one_way_to_switch(machine, bounds)
    for name, pair in bounds.items():
        check_bounds(machine, present, name, pair)
    slowest = bounds["frequency"][0] if "frequency" in bounds else present
    machine = machine.at(slowest)
    if machine.has_switching_times and (valve.opening_delay or valve.closing_delay):
        raise ValueError("valve: found delays here and in the machine's own valve, expected them in one of the two")
    if "duty" in bounds:
        bounds["duty"] = drawn_in(machine, bounds["duty"])
    problem = DutyProblem(machine, present, bounds, dict(scenarios or {}), valve)
    problem.limits.update(pulse_limits(machine, slowest, problem.variables, valve))
    return problem
