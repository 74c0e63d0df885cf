r"""Certificates of stability for whole sets of step matrices, whatever the switching.

One quadratic Lyapunov function z' P z with

.. math:: A_i' P + P A_i \preceq -2 \alpha P, \qquad P \succ 0

for all i proves that every switching between the A_i, at any duty cycle, pattern and frequency, decays at least as
e^{-\alpha t}; being linear in A_i, it proves so for their convex hull too [Boyd1994]_. Where there is none but each A_i
is stable by itself, functions P_i prove it for all switching that stays in each step at least for T, if

.. math:: A_i' P_i + P_i A_i \prec 0, \qquad e^{A_i' T} P_j e^{A_i T} \prec P_i \quad (j \ne i)

[Geromel2006]_: the function in force falls from switch to switch. T is closed in on by bisection. It starts
from ln(mu) / (2 alpha), mu the largest eigenvalue of any P_j^{-1} P_i with rates alpha [Morse1996]_, which is longer.

The problem is solved in balanced coordinates and its answer checked by eigenvalues: the rate reported is the one that
P itself shows, less what rounding may do.

.. [Boyd1994] S. Boyd et al., "Linear Matrix Inequalities in System and Control Theory", SIAM, 1994, section 5.1.
.. [Geromel2006] J. C. Geromel, P. Colaneri, "Stability and stabilization of continuous-time switched linear systems",
   SIAM J. Control Optim. 45(5), 2006.
.. [Morse1996] A. S. Morse, "Supervisory control of families of linear set-point controllers", IEEE Trans. Autom.
   Control 41, 1996, lemma 2.
"""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, cast, final

import cvxpy as cp
import numpy as np
from cvxpy.error import SolverError as CvxpySolverError
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from ltvpneu._arrays import FloatArray, finite_array, read_only
from ltvpneu._values import Value
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.periodic.algebra.propagate import balancing_scales, exponentials
from ltvpneu.periodic.systems.system import PeriodicSystem

Systems = PeriodicSystem | LtvModel | Sequence[PeriodicSystem | LtvModel] | ArrayLike

BISECTIONS = 30
"""Rounds in which the decay rate is closed in on."""
RATE_TOLERANCE = 1e-3
"""Relative gap between rates that were and were not certified, at which the search ends [-]."""
DWELL_TOLERANCE = 1e-4
"""Likewise, of dwell times [-]."""
MOST_MATRICES = 24
"""Number of matrices up to which the dwell time is closed in on: every pair is a constraint."""
CONDITION = 1e8
"""Condition of P in balanced coordinates up to which a function is looked for [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Certificate(Value):
    """A proof of stability that was checked, or the outcome that none was found."""

    kind: str
    """"common" (any switching), "dwell time" (switching that stays long enough), or "none"."""
    decay_rate: float
    """Rate alpha that the functions themselves show, less what rounding may do [1/s]: above zero; nan if none."""
    dwell_time: float
    """Time between switches that is proved to be enough [s]: 0 for a common function, nan if there is none.

    The shortest that quadratic functions, one for each matrix, show, to one part in 10,000; a shorter one may do.
    """
    functions: FloatArray
    """P of the common function, (1, n, n), or of each matrix, (n_matrices, n, n), in the states' units."""
    upper_bound: float
    """No certificate can show a rate above this: the slowest single matrix's own [1/s]."""
    matrices: FloatArray
    """What the certificate is for, (n_matrices, n, n)."""

    def __repr__(self) -> str:
        if self.kind == "none":
            return (
                f"<Certificate: none found for {len(self.matrices)} matrices; best single rate {self.upper_bound:.3g}>"
            )
        stay = f", dwell time {self.dwell_time:.4g} s" if self.kind == "dwell time" else ""
        return f"<Certificate: {self.kind}, decay rate {self.decay_rate:.4g} 1/s{stay}, {len(self.matrices)} matrices>"

    @property
    def is_stable(self) -> bool:
        """Whether stability is proved for every switching, without a dwell time."""
        return self.kind == "common"


def common_lyapunov(systems: Systems) -> Certificate:
    """Look for one quadratic Lyapunov function of a set of step matrices, else for a dwell time.

    Parameters
    ----------
    systems : PeriodicSystem, LtvModel, a sequence of these, or array_like, shape (n_matrices, n, n)
        All step matrices of all of them. Of a machine over a box of operating points: `operating_box`.

    Returns
    -------
    Certificate
        Its kind is "common", "dwell time" or "none"; every figure is checked after the solver.

    Raises
    ------
    ValueError
        No matrices, or matrices of different sizes.

    Examples
    --------
    Two stable matrices that share no function, since switching between them can be unstable:

    >>> from ltvpneu import design
    >>> design.common_lyapunov([[[-1.0, 10.0], [-0.1, -1.0]], [[-1.0, 0.1], [-10.0, -1.0]]]).kind
    'dwell time'
    """
    matrices = step_matrices(systems)
    # All together, each as long as it is fast: durations do not matter for any switching.
    scales = balancing_scales(matrices, 1.0 / np.maximum(np.abs(matrices).sum(axis=(1, 2)), np.finfo(float).tiny))
    balanced = matrices * (scales / scales[:, None])
    speed = float(np.abs(balanced).sum(axis=2).max(initial=0.0)) or 1.0
    unit = balanced / speed
    bounds = -np.max(np.linalg.eigvals(unit).real, axis=1)
    upper = float(bounds.min())

    def outcome(kind: str, functions: FloatArray, rate: float, dwell: float) -> Certificate:
        return Certificate(
            kind=kind,
            decay_rate=rate * speed,
            dwell_time=dwell / speed,
            functions=read_only(functions / scales / scales[:, None]),
            upper_bound=upper * speed,
            matrices=matrices,
        )

    nothing = outcome("none", np.empty((0, *unit.shape[1:])), np.nan, np.nan)
    if upper <= 0:
        return nothing
    common = _best(unit, upper)
    if common is not None:
        return outcome("common", common[0][None], common[1], 0.0)
    found = [_best(matrix[None], float(bound)) for matrix, bound in zip(unit, bounds, strict=True)]
    kept = [each for each in found if each is not None]
    if len(kept) < len(found):
        return nothing
    functions = np.array([P for P, _ in kept])
    rate = min(rate for _, rate in kept)
    # Rounded up by what the eigenvalues may be off.
    jumps = [float(eigh(P, Q, eigvals_only=True)[-1]) for P, Q in product(functions, functions)]
    dwell = np.log(max(jumps) * (1 + 1e-9)) / (2 * rate)
    best, functions = _least_dwell(unit, max(float(dwell), 0.0), functions)
    rate = min(verified_rate(matrix[None], P) for matrix, P in zip(unit, functions, strict=True))
    return outcome("dwell time", functions, rate, best)


def _least_dwell(matrices: FloatArray, dwell: float, functions: FloatArray) -> tuple[float, FloatArray]:
    """Return the least dwell time found below one that functions show, and the functions that show it."""
    N, n = matrices.shape[:2]
    if N > MOST_MATRICES:
        return dwell, functions
    P, identity = [cp.Variable((n, n), symmetric=True) for _ in range(N)], np.eye(n)
    slack = cp.Variable()
    fixed: list[cp.Constraint] = [limit for Q in P for limit in (Q >> identity / CONDITION, Q << identity)]
    fixed += [A.T @ Q + Q @ A << -slack * identity for A, Q in zip(matrices, P, strict=True)]
    low, high = 0.0, dwell
    while high - low > DWELL_TOLERANCE * high:
        middle = 0.5 * (low + high)
        maps = exponentials(matrices * middle)
        falls = [maps[i].T @ P[j] @ maps[i] - P[i] << -slack * identity for i, j in permutations(range(N), 2)]
        _solve(cp.Problem(cp.Maximize(slack), fixed + falls))
        values = [np.asarray(Q.value, dtype=np.float64) for Q in P if Q.value is not None]
        found = np.array([0.5 * (value + value.T) for value in values])
        if len(values) == N and _shows_dwell(matrices, maps, found):
            high, functions = middle, found
        else:
            low = middle
    return high, functions


def _shows_dwell(matrices: FloatArray, maps: FloatArray, functions: FloatArray) -> bool:
    """Whether functions fall along their own matrices, and from each to any other over the maps, beyond rounding."""
    if not all(verified_rate(A[None], P) > 0 for A, P in zip(matrices, functions, strict=True)):
        return False
    n = matrices.shape[1]
    for i, j in permutations(range(len(matrices)), 2):
        after = maps[i].T @ functions[j] @ maps[i]
        values = np.linalg.eigvalsh(functions[i])
        size = np.linalg.norm(maps[i], 2) ** 2 * np.linalg.norm(functions[j], 2) + values[-1]
        rounding = 32 * n * np.finfo(float).eps * size / values[0]
        if not float(eigh(0.5 * (after + after.T), functions[i], eigvals_only=True)[-1]) < 1 - rounding:
            return False
    return True


def step_matrices(systems: Systems) -> FloatArray:
    """Return all step matrices of one or more systems, each once, (n_matrices, n, n)."""
    items: list[Any] = list(cast(Any, systems)) if isinstance(systems, list | tuple) else [systems]
    if items and all(isinstance(item, PeriodicSystem | LtvModel) for item in items):
        parts = [(item.system if isinstance(item, LtvModel) else item).A for item in items]
        sizes = {part.shape[1] for part in parts}
        if len(sizes) > 1:
            raise ValueError(f"systems: found {sorted(sizes)} states, expected as many in each")
        stacked = np.concatenate(parts)
    else:
        stacked = finite_array("systems", cast(ArrayLike, systems), (None, None, None))
    if stacked.shape[0] == 0 or stacked.shape[1] != stacked.shape[2]:
        raise ValueError(f"systems: found shape {stacked.shape}, expected (n_matrices, n, n) with at least one")
    return read_only(np.unique(stacked, axis=0))


def verified_rate(matrices: FloatArray, P: FloatArray) -> float:
    """Return the decay rate that P shows for every matrix, less a bound on rounding; -inf if P is not positive."""
    P = 0.5 * (P + P.T)
    if not (np.diag(P) > 0).all():
        return -np.inf
    # Powers of two: the states may be in any units.
    scales = 2.0 ** np.round(-0.5 * np.log2(np.diag(P)))
    P, matrices = P * scales * scales[:, None], matrices * (scales / scales[:, None])
    values = np.linalg.eigvalsh(P)
    if not values[0] > 1e-12 * values[-1]:
        return -np.inf
    rates: list[float] = []
    for A in matrices:
        decrease = A.T @ P + P @ A
        slowest = float(eigh(decrease, P, eigvals_only=True)[-1])
        # Of the product, and of the generalized eigenvalue: backward errors of its size over the smallest of P.
        n = len(P)
        rounding = 8 * n * np.finfo(float).eps * (2 * np.linalg.norm(A, 2) + abs(slowest)) * values[-1] / values[0]
        rates.append(-0.5 * (slowest + float(rounding)))
    return min(rates)


def _best(matrices: FloatArray, upper: float) -> tuple[FloatArray, float] | None:
    """Return the function of the highest rate found, and the rate it shows, if that is above zero."""
    n = matrices.shape[1]
    P = cp.Variable((n, n), symmetric=True)
    slack, rate = cp.Variable(), cp.Parameter(nonneg=True)
    identity = np.eye(n)
    limits: list[cp.Constraint] = [P >> identity / CONDITION, P << identity]
    # Times the parameter, the variable P stays DPP.
    limits += [A.T @ P + P @ A + 2 * rate * P << -slack * identity for A in matrices]
    problem = cp.Problem(cp.Maximize(slack), limits)
    best: tuple[FloatArray, float] | None = None
    low, high = 0.0, upper
    for attempt in range(BISECTIONS):
        rate.value = 0.0 if attempt == 0 else 0.5 * (low + high)
        shown = _attempt(problem, P, matrices)
        if shown is not None and shown[1] > max(low, 0.0):
            best, low = shown, shown[1]
        elif attempt == 0:
            return None
        else:
            high = float(rate.value)
        if high - low <= RATE_TOLERANCE * upper:
            break
    return best


def _solve(problem: cp.Problem) -> None:
    """Solve a problem as far as that goes; what comes of it, or is left of the one before, is checked afterwards."""
    with suppress(CvxpySolverError), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Solution may be inaccurate", UserWarning)
        problem.solve(solver=cp.CLARABEL)


def _attempt(problem: cp.Problem, P: cp.Variable, matrices: FloatArray) -> tuple[FloatArray, float] | None:
    _solve(problem)
    if P.value is None:
        return None
    value = np.asarray(P.value, dtype=np.float64)
    value = 0.5 * (value + value.T)
    return value, verified_rate(matrices, value)
