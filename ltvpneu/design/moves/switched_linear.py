r"""Switching times of a switched linear system, for the least quadratic cost of its way.

With the steps' order fixed and the state in one with the forcing, x = (z, 1), x' = A_m x on step m,

.. math:: J = \int_0^T x^T Q_m x \, dt + x(T)^T S x(T)

is a quadratic form of the start: P_m = \Phi_m^T P_{m+1} \Phi_m + V_m, all from matrix exponentials (Van Loan 1978). A
step that lasts dt longer costs, at its end x, x^T (Q_m + A_m^T P_{m+1} + P_{m+1} A_m) x dt: the exact derivative.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, minimize
from scipy.stats import qmc

from ltvpneu._arrays import FloatArray, finite_array, not_negative, positive, read_only, whole
from ltvpneu._values import Value
from ltvpneu.periodic.algebra.propagate import exponentials
from ltvpneu.periodic.systems.system import PeriodicSystem, expect_no_jumps, expect_system

LOCAL_SEARCHES = 6
ACCURATE = 1e-15
"""Change of the scaled cost at which a search ends [-]."""
KEPT_WITHIN = 1e-8
"""Scaled errors of end and whole time up to which they count as kept [-]."""
OPTIMAL = 1e-5
"""Scaled slope along what may be changed up to which a search counts as having ended [-]."""


@final
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SwitchingSolution(Value):
    """Switching times of a switched linear system."""

    system: PeriodicSystem
    """Its steps as long as found."""
    status: str
    """"optimal", "stopped" before the slopes were small, or "infeasible": the end is not reached in the time."""
    cost: float
    slopes: FloatArray
    """Of the cost over the steps' durations, (n_steps,)."""
    initial_state: FloatArray
    """(n_states,)"""
    end_state: FloatArray
    """(n_states,)"""
    residual: float
    """Largest scaled slope along what may be changed [-]."""
    n_evaluations: int
    """Of cost and slopes, each one product of exponentials."""

    def __repr__(self) -> str:
        times = ", ".join(f"{time:.6g}" for time in self.switching_times)
        return f"<SwitchingSolution: {self.status}, cost {self.cost:.10g}, switches at {times} s>"

    @property
    def durations(self) -> FloatArray:
        """Durations of the steps [s], (n_steps,)."""
        return self.system.durations

    @cached_property
    def switching_times(self) -> FloatArray:
        """Ends of all steps but the last, from the start [s], (n_steps - 1,)."""
        return read_only(np.cumsum(self.system.durations)[:-1])


class _Way(NamedTuple):
    """What durations lead to."""

    cost: float
    slopes: FloatArray
    """(n_steps,)"""
    end: FloatArray
    """(n_states,)"""
    end_slopes: FloatArray
    """(n_states, n_steps)"""


def optimize_switching(  # noqa: PLR0913 - keyword-only, each with its default
    system: PeriodicSystem,
    initial_state: ArrayLike,
    *,
    cost: ArrayLike | None = None,
    end_cost: ArrayLike | None = None,
    time_cost: float = 0.0,
    end: ArrayLike | None = None,
    duration: float | tuple[float, float] | None = None,
    shortest: float = 0.0,
    n_starts: int = 64,
) -> SwitchingSolution:
    """Return how long the steps of a switched linear system have to last.

    The system goes once through its steps, in their order, from a state; a step may last no time at all.

    Parameters
    ----------
    system : PeriodicSystem
        Without jumps. Its durations are not used but for `duration`.
    initial_state : array_like, shape (n_states,)
    cost : array_like, shape (n_states, n_states) or (n_steps, n_states, n_states), optional
        Q of the integral of z' Q z, on every step or step by step; by default the unit matrix.
    end_cost : array_like, shape (n_states, n_states), optional
        Of the last state; by default none.
    time_cost : float
        Of a second.
    end : array_like, shape (n_states,), optional
        The last state; nan where it may be what it is.
    duration : float or (float, float), optional
        Of the whole way [s], or its bounds; by default the system's period.
    shortest : float
        Least duration of a step [s].
    n_starts : int
        Durations that are looked at first; the best are where local searches begin.

    Returns
    -------
    SwitchingSolution

    Raises
    ------
    ValueError
        Shapes, bounds that contradict each other, a system with jumps.

    Examples
    --------
    Two modes over one second, one switch:

    >>> import numpy as np
    >>> import ltvpneu as lp
    >>> from ltvpneu import design
    >>> system = lp.PeriodicSystem.from_matrices([[[-1, 0], [1, 2]], [[1, 1], [1, -2]]], np.zeros((2, 2)), [0.5, 0.5])
    >>> found = design.optimize_switching(system, [1.0, 1.0])
    >>> print(f"{found.switching_times[0]:.6f} s, {found.cost:.10f}")
    0.264866 s, 5.2545429449
    """
    expect_system(system)
    expect_no_jumps(system, "system")
    task = _Task(system, initial_state, cost, end_cost, time_cost)
    N = system.n_steps
    if isinstance(duration, tuple):
        low, high = (not_negative("duration", duration[0], "s"), positive("duration", duration[1], "s"))
    else:
        low = high = positive("duration", system.period if duration is None else duration, "s")
    least = not_negative("shortest", shortest, "s")
    if low > high or N * least > high:
        raise ValueError(
            f"duration, shortest: found {low:g} to {high:g} s for {N} steps of at least {least:g} s each; they "
            "contradict each other"
        )
    target = np.full(system.n_states, np.nan)
    if end is not None:
        target = np.asarray(end, dtype=np.float64)
        if target.shape != target.shape[:1] or target.size != system.n_states:
            raise ValueError(f"end: found shape {target.shape}, expected ({system.n_states},)")
    goal = _Goal(task, target, (least, low, high))
    durations, missed = goal.best_of(_starts(N, whole("n_starts", n_starts), (max(low, N * least), high), least))
    way, residual = task.way(durations), goal.residual(durations)
    return SwitchingSolution(
        system=system.with_parts(durations, np.arange(N), np.ones(N, dtype=np.bool_)),
        status="infeasible" if missed > KEPT_WITHIN else "optimal" if residual <= OPTIMAL else "stopped",
        cost=way.cost,
        slopes=read_only(way.slopes),
        initial_state=read_only(task.first[:-1].copy()),
        end_state=read_only(way.end),
        residual=residual,
        n_evaluations=task.n_evaluations,
    )


class _Goal:
    """What durations have to keep, and the search for the best of them."""

    def __init__(self, task: "_Task", target: FloatArray, bounds: tuple[float, float, float]) -> None:
        self.task, self.target, self.bounds = task, target, bounds
        self.wanted = np.flatnonzero(np.isfinite(target))
        sizes = np.maximum(np.abs(task.first[:-1]), np.nan_to_num(np.abs(target), nan=0.0))
        self.sizes = np.where(sizes > 0, sizes, max(float(sizes.max()), 1e-300))
        self.unit = 1.0

    def off(self, durations: FloatArray) -> FloatArray:
        """Return the scaled errors of the end."""
        return (self.task.way(durations).end - self.target)[self.wanted] / self.sizes[self.wanted]

    def best_of(self, starts: FloatArray) -> tuple[FloatArray, float]:
        """Return the best durations to which local searches lead, and their scaled errors of end and whole time."""
        least, low, high = self.bounds
        costs = np.array([self.task.way(one).cost for one in starts])
        self.unit = max(float(np.median(np.abs(costs))), 1e-300)
        ranks = costs / self.unit + 10 * np.array([np.abs(self.off(one)).sum() for one in starts])
        best: tuple[tuple[bool, float], FloatArray, float] | None = None
        for number in np.argsort(ranks)[:LOCAL_SEARCHES]:
            found: OptimizeResult = minimize(
                lambda durations: self.task.way(durations).cost / self.unit,
                starts[number],
                jac=lambda durations: self.task.way(durations).slopes / self.unit,
                method="SLSQP",
                bounds=[(least, high)] * starts.shape[1],
                constraints=self._constraints(),
                options={"ftol": ACCURATE, "maxiter": 500},
            )
            durations = np.clip(found.x, least, high)
            total = float(durations.sum())
            missed = max(low - total, total - high, 0.0) / high + float(np.abs(self.off(durations)).max(initial=0.0))
            rank = missed > KEPT_WITHIN, missed if missed > KEPT_WITHIN else self.task.way(durations).cost
            if best is None or rank < best[0]:
                best = rank, durations, missed
        assert best is not None
        return best[1:]

    def _constraints(self) -> list[dict[str, Any]]:
        _, low, high = self.bounds
        found: list[dict[str, Any]] = []
        if low == high:
            found.append({"type": "eq", "fun": lambda d: d.sum() - high, "jac": lambda d: np.ones_like(d)})
        else:
            found.append({
                "type": "ineq",
                "fun": lambda d: np.array([d.sum() - low, high - d.sum()]),
                "jac": lambda d: np.stack([np.ones_like(d), -np.ones_like(d)]),
            })  # fmt: skip
        if self.wanted.size:
            found.append({
                "type": "eq",
                "fun": self.off,
                "jac": lambda d: self.task.way(d).end_slopes[self.wanted] / self.sizes[self.wanted, None],
            })  # fmt: skip
        return found

    def residual(self, durations: FloatArray) -> float:
        """Return the largest slope along what may be changed: with time and end held, away from the bounds."""
        (least, low, high), way = self.bounds, self.task.way(durations)
        free = durations > least + 1e-9 * high
        rows = [way.end_slopes[i] for i in self.wanted]
        total = float(durations.sum())
        if low == high or total >= high * (1 - 1e-9) or total <= low * (1 + 1e-9):
            rows.append(np.ones_like(durations))
        slopes = way.slopes[free] * high / self.unit
        if rows and slopes.size:
            along = np.array(rows)[:, free].T
            slopes = slopes - along @ np.linalg.lstsq(along, slopes, rcond=None)[0]
        return float(np.abs(slopes).max(initial=0.0))


class _Task:
    """The cost of a way, and its slopes."""

    def __init__(
        self,
        system: PeriodicSystem,
        initial_state: ArrayLike,
        cost: ArrayLike | None,
        end_cost: ArrayLike | None,
        time_cost: float,
    ) -> None:
        N, n = system.n_steps, system.n_states
        self.first = np.append(finite_array("initial_state", initial_state, (n,)), 1.0)
        self.A = np.zeros((N, n + 1, n + 1))
        self.A[:, :n, :n], self.A[:, :n, n] = system.A, system.f
        given = np.eye(n) if cost is None else np.asarray(cost, dtype=np.float64)
        given = finite_array("cost", given, (n, n) if given.ndim == 2 else (N, n, n))
        self.Q = np.zeros((N, n + 1, n + 1))
        self.Q[:, :n, :n] = (given + np.swapaxes(given, -1, -2)) / 2
        self.Q[:, n, n] = time_cost
        self.S = np.zeros((n + 1, n + 1))
        if end_cost is not None:
            last = finite_array("end_cost", end_cost, (n, n))
            self.S[:n, :n] = (last + last.T) / 2
        self.n_evaluations = 0
        self._known: tuple[bytes, _Way] | None = None

    def way(self, durations: FloatArray) -> _Way:
        """Return what durations lead to; the last is kept, as a search asks for each of its numbers by itself."""
        key = durations.tobytes()
        if self._known is None or self._known[0] != key:
            self._known = key, self._way(durations)
        return self._known[1]

    def _way(self, durations: FloatArray) -> _Way:
        self.n_evaluations += 1
        N, k = self.A.shape[:2]
        # Van Loan, IEEE Trans. Automatic Control 23 (1978) 395: one exponential gives map and integral.
        blocks = np.zeros((N, 2 * k, 2 * k))
        blocks[:, :k, :k], blocks[:, :k, k:] = -self.A.transpose(0, 2, 1), self.Q
        blocks[:, k:, k:] = self.A
        raised = exponentials(blocks * durations[:, None, None])
        maps = raised[:, k:, k:]
        costs = maps.transpose(0, 2, 1) @ raised[:, :k, k:]
        ends = np.empty((N, k))
        state = self.first
        for m in range(N):
            ends[m] = state = maps[m] @ state
        slopes, columns = np.empty(N), np.empty((N, k))
        after, left = np.eye(k), self.S
        for m in range(N - 1, -1, -1):
            rate = self.A[m] @ ends[m]
            slopes[m] = ends[m] @ self.Q[m] @ ends[m] + 2 * ends[m] @ left @ rate
            columns[m] = after @ rate
            left = maps[m].T @ left @ maps[m] + (costs[m] + costs[m].T) / 2
            after = after @ maps[m]
        return _Way(float(self.first @ left @ self.first), slopes, ends[-1, :-1].copy(), columns[:, :-1].T)


def _starts(n_steps: int, count: int, duration: tuple[float, float], least: float) -> FloatArray:
    """Return durations spread evenly over all that are allowed, (count, n_steps): equal ones first."""
    low, high = duration
    shares = qmc.Sobol(n_steps + 1, rng=0).random(1 << (count - 1).bit_length())[:count]
    # Spacings of exponential variables are uniform over the simplex.
    parts = -np.log(np.clip(shares[:, :-1], 1e-9, 1.0))
    parts = np.where(np.arange(count)[:, None] == 0, 1.0, parts)
    totals = low + (high - low) * shares[:, -1:]
    return least + parts / parts.sum(axis=1, keepdims=True) * (totals - n_steps * least)
