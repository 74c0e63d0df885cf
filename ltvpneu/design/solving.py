"""One way into cvxpy: convexity checked, tight tolerances, statuses named, duals by name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast, final

import cvxpy as cp
import numpy as np
from cvxpy.error import SolverError as CvxpySolverError

from ltvpneu._values import Value
from ltvpneu.errors import NotConvexError, SolverError

Constraints = Sequence[cp.Constraint] | Mapping[str, cp.Constraint]

TIGHT = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}
"""Tolerances asked of Clarabel; it says "optimal_inaccurate" where it stopped short of them [-]."""
ACCEPTED = 1e-7
"""Violation of a constraint, relative to its size, up to which an answer is taken [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Solution(Value):
    """Status, value and duals; variables carry their values."""

    status: str
    value: float
    duals: dict[str, Any]


def named_constraints(constraints: Constraints) -> dict[str, cp.Constraint]:
    """Return constraints by name; a sequence's are called "constraint 1" and so on."""
    if isinstance(constraints, Mapping):
        found = dict(constraints)
    else:
        found = {f"constraint {i + 1}": constraint for i, constraint in enumerate(constraints)}
    items: dict[str, Any] = found
    for name, constraint in items.items():
        if isinstance(constraint, bool | np.bool_):
            raise ValueError(f"{name}: found {constraint}, a comparison of numbers; expected one of cvxpy expressions")
        if not isinstance(constraint, cp.Constraint):
            raise TypeError(f"{name}: found {type(constraint).__name__}, expected a cvxpy constraint")
    return found


def solve_convex(
    objective: cp.Minimize | cp.Maximize, constraints: dict[str, cp.Constraint], solver: str | None = None
) -> Solution:
    """Solve a convex problem; "optimal", "infeasible" and "unbounded" come back, all else is an error.

    Raises
    ------
    NotConvexError
        With cvxpy's reason.
    SolverError
        The solver failed, or what it calls optimal breaks a constraint by more than `ACCEPTED`.
    """
    asked: Any = objective
    if not isinstance(asked, cp.Minimize | cp.Maximize):
        raise TypeError(f"objective: found {type(asked).__name__}, expected cvxpy.Minimize or cvxpy.Maximize")
    problem = cp.Problem(objective, list(constraints.values()))
    if not problem.is_dcp():
        raise NotConvexError(why_not_convex(problem, objective, constraints))
    try:
        problem.solve(solver=cp.CLARABEL if solver is None else solver, **(TIGHT if solver is None else {}))
    except CvxpySolverError as error:
        raise SolverError(f"the solver failed: {error}", status="solver_error") from None
    status = str(problem.status)
    for word in ("infeasible", "unbounded"):
        if status == word:
            return Solution(status=word, value=np.nan, duals={})
    if status not in ("optimal", "optimal_inaccurate"):
        raise SolverError(f"the solver ended with status {status!r}: no figures to trust", status=status)
    for name, constraint in constraints.items():
        size = max([1e-300, *(float(np.max(np.abs(arg.value), initial=0.0)) for arg in constraint.args)])
        broken = float(np.max(constraint.violation(), initial=0.0))
        if broken > ACCEPTED * max(size, 1e-12):
            raise SolverError(
                f"the solver ended with status {status!r}, but its answer breaks {name} by {broken:.1e}", status=status
            )
    duals = {name: constraint.dual_value for name, constraint in constraints.items()}
    return Solution(status="optimal", value=float(cast(float, problem.value)), duals=duals)


def why_not_convex(problem: cp.Problem, objective: Any, constraints: dict[str, cp.Constraint]) -> str:
    """Return which parts are not convex, and cvxpy's reason."""
    wrong = [name for name, constraint in constraints.items() if not constraint.is_dcp()]
    if not objective.is_dcp():
        wrong.insert(0, "the objective")
    try:
        problem.get_problem_data(cp.CLARABEL)
        reason = ""
    except cp.DCPError as error:
        reason = str(error)
    return f"not convex: {', '.join(wrong)}. cvxpy says: {reason}"
