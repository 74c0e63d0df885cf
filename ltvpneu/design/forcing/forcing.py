"""Forcing: orbits as cvxpy expressions of supply and exhaust pressure, load force or any other input, exact and convex.

With the switching schedule and the step matrices fixed, superposition holds: every sample, mean and Fourier coefficient
of the orbit is affine in the inputs, one value each or one a step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, final

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from ltvpneu._arrays import FloatArray, finite_array, whole
from ltvpneu._values import Value
from ltvpneu.design.air_use import with_air_use
from ltvpneu.design.forcing.affine import AffineOrbit
from ltvpneu.design.solving import Constraints, Solution, named_constraints, solve_convex
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.periodic.orbits.steady import periodic_states
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_system

Given = Mapping[str, float | ArrayLike | cp.Expression]


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ForcingSolution(Value):
    """What a forcing problem ended with. Where the status is not "optimal", the figures are nan."""

    status: str
    """"optimal", "infeasible" or "unbounded"."""
    value: float
    """Of the objective."""
    inputs: dict[str, FloatArray]
    """Value of every input, shape (), or (n_steps,) where it has one a step."""
    duals: dict[str, Any]
    """Of the constraints, by name: how fast the objective gets better as an inequality's bound is loosened, never below
    zero, or as the right side of an equation rises."""
    system: PeriodicSystem | None
    """With these inputs; `steady_state` of it is the orbit."""
    residual: float
    """Largest difference between the orbit predicted at the step boundaries and the system's own, relative [-]."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {np.array2string(v, precision=6)}" for name, v in self.inputs.items())
        return f"<ForcingSolution: {self.status}, objective {self.value:.6g}, {shown}>"


@final
class ForcingProblem:
    """A system's orbit as cvxpy expressions of its inputs; made by `forcing_problem`.

    Attributes
    ----------
    system : PeriodicSystem
    inputs : dict of cvxpy.Expression
        Every input by name, shape () or (n_steps,), in SI units: variables, or what was given.
    signals : tuple of str
    limits : dict of cvxpy.Constraint
        Constraints that every solution keeps beside the user's: of a machine, that the supply's pressure is not below
        the exhaust's, nor that below vacuum. A linear model would go there without a word. Take them out to look.
    """

    def __init__(
        self, system: PeriodicSystem, inputs: dict[str, cp.Expression], limits: dict[str, cp.Constraint]
    ) -> None:
        self.system = system
        self.inputs = inputs
        self.limits = limits
        self._affine = AffineOrbit(system=system)
        self.signals = self._affine.signals
        N = system.n_steps
        columns = [e if e.shape == (N,) else e * np.ones(N) for e in (inputs[name] for name in system.inputs)]
        # Step by step, the inputs of each together.
        self._all = cp.reshape(cp.vstack(columns), (N * len(columns),), order="F") if columns else None

    def __repr__(self) -> str:
        return f"<ForcingProblem of {self.system.name}: {', '.join(self.inputs)} -> {', '.join(self.signals)}>"

    def at(self, signal: str, angles: ArrayLike) -> cp.Expression:
        """Return a signal at angles of the period, 0 to 2 pi [rad]; shape (n_angles,), or () for one angle."""
        asked = np.asarray(angles, dtype=np.float64)
        turned = np.mod(finite_array("angles", np.atleast_1d(asked), (None,)), 2 * np.pi)
        rows = self._affine.sample(self._known(signal), turned / (2 * np.pi) * self.system.period)
        found = self._expression(rows)
        return found if asked.ndim else found[0]

    def samples(self, signal: str, n_points: int = 101) -> cp.Expression:
        """Return a signal at evenly spaced angles and at every switch, for bounds over the whole period."""
        even = np.linspace(0.0, 2 * np.pi, whole("n_points", n_points, 2), endpoint=False)
        switches = self.system.switching_times[:-1] * (2 * np.pi / self.system.period)
        return self.at(signal, np.union1d(even, switches))

    def mean(self, signal: str) -> cp.Expression:
        """Return a signal's time mean (15)."""
        return self._expression(self._affine.coefficient(self._known(signal), 0).real[None])[0]

    def fourier(self, signal: str, harmonic: int) -> tuple[cp.Expression, cp.Expression]:
        """Return real and imaginary part of a signal's Fourier coefficient, the mean of y e^{-j h 2 pi t / T}."""
        row = self._affine.coefficient(self._known(signal), whole("harmonic", harmonic, 0))
        return self._expression(row.real[None])[0], self._expression(row.imag[None])[0]

    def solve(
        self, objective: cp.Minimize | cp.Maximize, constraints: Constraints = (), *, solver: str | None = None
    ) -> ForcingSolution:
        """Solve for the inputs.

        Parameters
        ----------
        objective : cvxpy.Minimize or cvxpy.Maximize
        constraints : sequence or dict of cvxpy constraints
            Duals come back under the dict's names, else under "constraint 1", ...; those of `limits` under theirs.
        solver : str, optional
            One of cvxpy's; Clarabel at tolerances of 1e-11 by default.

        Raises
        ------
        NotConvexError
            cvxpy finds the problem not to be convex; its reason is in the message.
        SolverError
            The solver failed, or its answer does not hold when the orbit is computed anew.
        """
        named = named_constraints(constraints)
        for name in self.limits.keys() & named.keys():
            raise ValueError(f"constraints: found {name!r}, which is the name of one of the limits; expected another")
        solution = solve_convex(objective, self.limits | named, solver)
        return self._solution(solution)

    def _solution(self, solution: Solution) -> ForcingSolution:
        if solution.status != "optimal":
            nothing = {name: np.full(e.shape, np.nan) for name, e in self.inputs.items()}
            return ForcingSolution(
                status=solution.status, value=np.nan, inputs=nothing, duals={}, system=None, residual=np.nan
            )
        inputs = {name: np.asarray(e.value, dtype=np.float64) for name, e in self.inputs.items()}
        system = with_inputs(self.system, inputs)
        states = periodic_states(system)
        times = system.switching_times[:-1]
        w = np.append(np.asarray(self._all.value) if self._all is not None else [], 1.0)
        predicted = np.array([self._affine.sample(name, times) @ w for name in system.states]).T
        sizes = np.maximum(np.abs(states).max(axis=0), np.finfo(float).tiny)
        return ForcingSolution(
            status=solution.status,
            value=solution.value,
            inputs=inputs,
            duals=solution.duals,
            system=system,
            residual=float(np.max(np.abs(predicted - states) / sizes)),
        )

    def _known(self, signal: str) -> str:
        if signal not in self.signals:
            near = get_close_matches(str(signal), self.signals, 1, 0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"signal: found {signal!r}, expected one of {', '.join(self.signals)}{hint}")
        return signal

    def _expression(self, rows: FloatArray) -> cp.Expression:
        if self._all is None:
            return cp.Constant(rows[:, -1])
        return rows[:, :-1] @ self._all + rows[:, -1]


def forcing_problem(
    system: PeriodicSystem | LtvModel,
    *,
    free: Sequence[str] | None = None,
    per_step: Sequence[str] = (),
    given: Given | None = None,
) -> ForcingProblem:
    """Return a system's orbit as cvxpy expressions of its inputs.

    Parameters
    ----------
    system : PeriodicSystem or LtvModel
        Of a model, the output "air_use" is among the signals [kg/s].
    free : sequence of str, optional
        Inputs that are variables; by default all but the ambient pressure, which is nobody's choice.
    per_step : sequence of str
        Those of the free inputs that have one value a step instead of one for all.
    given : mapping of str to number or cvxpy.Expression, optional
        Inputs to be so much: a number, n_steps of them, or an affine expression, such as 0.9 times the supply pressure
        of another problem, which makes a scenario of it. Inputs neither free nor given stay at the system's levels.

    Returns
    -------
    ForcingProblem

    Raises
    ------
    ValueError
        An unknown input, or one both free and given.
    NoOrbitError, NonUniqueOrbitError
        The system has no orbit, or not one only.

    Examples
    --------
    The lowest supply pressure that holds a mean position of 45 mm:

    >>> import cvxpy as cp
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> model = lp.ltv_model(lp.load_machine("kunt_singh_1990"), 10.0, n_steps=2)
    >>> problem = design.forcing_problem(model, free=["supply_pressure"])
    >>> supply = problem.inputs["supply_pressure"]
    >>> found = problem.solve(cp.Minimize(supply), {"position": problem.mean("position") >= 0.045})
    >>> print(f"{found.inputs['supply_pressure'] / 1e5:.3f} bar")
    3.863 bar
    """
    of_machine = isinstance(system, LtvModel)
    if isinstance(system, LtvModel):
        system = with_air_use(system)
    expect_system(system)
    given = {} if given is None else given
    chosen = [name for name in system.inputs if name not in given and name != "ambient_pressure"]
    wanted = chosen if free is None else list(free)
    for what, names in (("free", wanted), ("per_step", list(per_step)), ("given", list(given))):
        for name in names:
            if name not in system.inputs:
                near = get_close_matches(str(name), system.inputs, 1, 0.4)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise ValueError(f"{what}: found {name!r}, expected one of {', '.join(system.inputs)}{hint}")
    for name in given:
        if name in wanted:
            raise ValueError(f"given: found {name!r}, which is free too; expected it in one of them")
    for name in per_step:
        if name not in wanted:
            raise ValueError(f"per_step: found {name!r}, which is not free; expected one of {', '.join(wanted)}")
    inputs: dict[str, cp.Expression] = {}
    for name, level in zip(system.inputs, system.levels, strict=True):
        if name in wanted:
            shape = (system.n_steps,) if name in per_step else ()
            # A variable of about one, whatever the unit.
            inputs[name] = (abs(float(level)) or 1.0) * cp.Variable(shape, name=name)
        else:
            inputs[name] = _given(name, given[name] if name in given else float(level), system.n_steps)
    return ForcingProblem(system, inputs, _limits(inputs) if of_machine else {})


def _limits(inputs: dict[str, cp.Expression]) -> dict[str, cp.Constraint]:
    supply, exhaust = inputs["supply_pressure"], inputs["exhaust_pressure"]
    found: dict[str, cp.Constraint] = {}
    if exhaust.variables():
        found["exhaust above vacuum"] = exhaust >= 0
    if inputs["ambient_pressure"].variables():
        found["ambient above vacuum"] = inputs["ambient_pressure"] >= 0
    if supply.variables() or exhaust.variables():
        found["supply above exhaust"] = supply >= exhaust
    return found


def with_inputs(system: PeriodicSystem, inputs: Mapping[str, FloatArray]) -> PeriodicSystem:
    """Return a system with inputs of one value, shape (), or of one a step, (n_steps,).

    Levels are the time means; what a step differs from them by is in its remainder and output offset.
    """
    values = np.array([np.broadcast_to(inputs[name], (system.n_steps,)) for name in system.inputs]).reshape(
        len(system.inputs), system.n_steps
    )
    weights = system.durations / system.period
    levels = np.array([v[0] if np.ptp(v) == 0 else weights @ v for v in values])
    differences = (values - levels[:, None]).T
    return replace(
        system,
        levels=levels,
        r=system.r + np.einsum("knm,km->kn", system.B, differences),
        q=system.q + np.einsum("kpm,km->kp", system.D, differences),
    )


def _given(name: str, value: Any, n_steps: int) -> cp.Expression:
    if not isinstance(value, cp.Expression):
        array = finite_array(f"given[{name!r}]", np.asarray(value))
        value = cp.Constant(array)
    if not value.is_affine():
        raise ValueError(f"given: found an expression of curvature {value.curvature} for {name!r}, expected an affine")
    if value.shape not in ((), (n_steps,)):
        raise ValueError(f"given: found shape {value.shape} for {name!r}, expected () or ({n_steps},)")
    return value
