"""Duty optimization by sequential convex programming against scipy's SLSQP with finite differences.

The same machine, edges, goals and start: least air use at a mean of 45 mm and a largest amplitude. SLSQP works on the
nonlinear orbit, compiled and warm-started, and on the same refitted linear model, values only. One pulse has one free
edge, n pulses 2 n - 1: the first edge only shifts the cycle in time. Run with

    pytest benchmarks/test_design.py --benchmark-only -s
"""

import math
import time
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import minimize

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.solving import TIGHT
from ltvpneu.design.switching.subproblem import stacked
from ltvpneu.errors import LtvpneuError
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.cycles.linear_cycles import LinearCycles
from ltvpneu.models.cycles.nonlinear_cycles import NonlinearCycles
from ltvpneu.models.machine.parameters import present_value

MEAN = 0.045


def pulsed(n_pulses: int) -> tuple[lp.Machine, float, list[str]]:
    """Pulses of uneven width, evenly spaced; slow enough that the piston follows each."""
    machine, turn = lp.load_machine("kunt_singh_1990"), 2 * math.pi / n_pulses
    if n_pulses == 1:
        return machine.with_duty(0.55), 8.0, ["duty"]
    widths = 0.45 + 0.1 * np.sin(np.arange(n_pulses))
    machine = machine.with_pulses([(i * turn, (i + width) * turn) for i, width in enumerate(widths)])
    names = [f"{kind}_{i + 1}" for i in range(n_pulses) for kind in ("on", "off")][1:]
    return machine, 8.0 / n_pulses, names


def by_slsqp(
    cycles: LinearCycles | NonlinearCycles, machine: lp.Machine, frequency: float, names: list[str], most: float
) -> tuple[float, float, int]:
    """Minimize by SLSQP over the edges as shares of the turn; values are kept for the constraints' sake."""
    figures = [Figure("mean", 0), Figure("minimum", 0), Figure("maximum", 0), Figure("air_use")]
    size = 1.0 if names == ["duty"] else 2 * math.pi
    start = np.array([present_value(machine, frequency, name) for name in names]) / size
    kept: dict[bytes, np.ndarray] = {}

    def values(x: Any) -> Any:
        key = x.tobytes()
        if key not in kept:
            try:
                found = cycles.figures(dict(zip(names, (x * size).tolist(), strict=True)), figures, []).values
                kept[key] = np.array([found[0], (found[2] - found[1]) / 2, found[3]])
            except (LtvpneuError, ValueError):
                kept[key] = np.array([0.0, 1.0, 1.0])
        return kept[key]

    ordered = [{"type": "ineq", "fun": lambda x, i=i: x[i + 1] - x[i] - 2e-3} for i in range(len(names) - 1)]
    found = minimize(
        lambda x: 1e3 * values(x)[2],
        start,
        method="SLSQP",
        bounds=[(2e-3, 0.998)] * len(names),
        constraints=[
            {"type": "eq", "fun": lambda x: (values(x)[0] - MEAN) * 1e2},
            {"type": "ineq", "fun": lambda x: (most - values(x)[1]) * 1e2},
            *ordered,
        ],
        options={"ftol": 1e-9, "maxiter": 40, "eps": 1e-6},
    )
    mean, amplitude, air_use = values(found.x)
    return air_use, max(abs(mean - MEAN), amplitude - most, 0.0), len(kept)


def timed(function: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    best, result = math.inf, None
    for _ in range(repeats):
        begin = time.perf_counter()
        result = function()
        best = min(best, time.perf_counter() - begin)
    return best, result


@pytest.mark.parametrize("n_pulses", [1, 2, 4, 8])
def test_edges(benchmark: BenchmarkFixture, n_pulses: int) -> None:
    machine, frequency, names = pulsed(n_pulses)
    most = 25e-3

    def ours() -> Any:
        problem = design.duty_problem(machine, frequency)
        cycle = problem.nominal
        return problem.solve(
            cp.Minimize(cycle.air_use()),
            {"mean": cycle.mean("position") == MEAN, "ripple": cycle.amplitude("position") <= most},
            start={},
        )

    ours()
    seconds, found = timed(ours)
    on_linear, linear = timed(
        lambda: by_slsqp(LinearCycles(machine, frequency), machine, frequency, names, most), repeats=2
    )
    on_nonlinear, nonlinear = timed(
        lambda: by_slsqp(NonlinearCycles(machine, frequency), machine, frequency, names, most), repeats=2
    )
    broken = max(found.constraints.values())
    print(
        f"\n{n_pulses} pulses, {len(names)} free edges: {1e3 * seconds:.0f} ms, {found.n_cycles} cycles, "
        f"{found.status}, {1e3 * found.objective:.5f} g/s, off by {1e6 * broken:.2g} um, residual {found.residual:.1e}"
    )
    for name, took, (air_use, off, count) in (
        ("linear model", on_linear, linear), ("nonlinear", on_nonlinear, nonlinear)
    ):  # fmt: skip
        print(
            f"  SLSQP, {name}: {1e3 * took:.0f} ms ({took / seconds:.1f} times), {count} cycles, "
            f"{1e3 * air_use:.5f} g/s, off by {1e6 * off:.2g} um"
        )
    benchmark.pedantic(ours, rounds=1)


def test_a_re_solve_against_cvxpy_alone(benchmark: BenchmarkFixture) -> None:
    """The convex problem with new numbers, against a bare parametrized problem of the same size and kind."""
    machine, frequency, names = pulsed(4)
    problem = design.duty_problem(machine, frequency)
    cycle = problem.nominal
    objective = cp.Minimize(cycle.air_use())
    constraints: dict[str, Any] = {
        "mean": cycle.mean("position") == MEAN,
        "ripple": cycle.amplitude("position") <= 25e-3,
    }
    search = problem.search(objective, constraints, "fitted", 1)
    sub, begin = search.subproblem, problem.own_setting
    figures = search.evaluate(begin)
    sub.scale(begin, figures)
    linear, p = stacked(figures, len(names)), len(names)

    def ours() -> Any:
        return sub.ask(begin, linear, np.eye(p), 0.1, 10.0)

    m = linear[0].size
    d, y, t = cp.Variable(p), cp.Variable(m), cp.Variable(3, nonneg=True)
    values, slopes, root = cp.Parameter(m), cp.Parameter((m, p)), cp.Parameter((p, p))
    n = (m - 2) // 2
    bare = cp.Problem(
        cp.Minimize(y[0] + 10 * cp.sum(t) + 0.5 * cp.sum_squares(root @ d)),
        [
            y == values + slopes @ d, cp.abs(d) <= 0.1, y[1] == t[0] - t[1],
            (cp.max(y[2 : 2 + n]) - cp.min(y[2 + n : 2 + 2 * n])) / 2 - 1 <= t[2],
            begin + d >= 0, begin + d <= 1, np.diff(np.eye(p), axis=0) @ (begin + d) >= 0.002,
        ],
    )  # fmt: skip

    def alone() -> Any:
        values.value, slopes.value, root.value = linear[0], linear[1], np.eye(p)
        return bare.solve(solver=cp.CLARABEL, **TIGHT)

    ours()
    alone()
    one, two = timed(lambda: [ours() for _ in range(20)])[0], timed(lambda: [alone() for _ in range(20)])[0]
    print(f"\nre-solve: {50 * one:.2f} ms, bare cvxpy {50 * two:.2f} ms, ratio {one / two:.2f}")
    benchmark.pedantic(ours, rounds=1)


def test_a_front_against_one_optimum(benchmark: BenchmarkFixture) -> None:
    """Twenty points of air against ripple, with the nonlinear machine's figures, against one optimum, corrected."""
    machine, bounds, mean = lp.load_machine("kunt_singh_1990"), (6.0, 18.0), {"position": MEAN}

    def optimum() -> Any:
        return design.optimize_duty(machine, bounds, mean=mean, minimize="air_use", correct=True)

    def front() -> design.TradeOff:
        return design.trade_off(machine, bounds, mean=mean, minimize=("air_use", "amplitude"), points=20)

    optimum()
    one, _ = timed(optimum)
    twenty, found = timed(front)
    print(f"\na front of {len(found.values)} points: {twenty:.2f} s, one optimum {one:.2f} s, ratio {twenty / one:.1f}")
    assert len(found.values) == 20
    benchmark.pedantic(optimum, rounds=1)


def test_an_optimum_against_slsqp(benchmark: BenchmarkFixture) -> None:
    """The README's optimum with its look around and its correction, against SLSQP on orbits from one good start."""
    machine, bounds, most = lp.load_machine("kunt_singh_1990"), (10.0, 30.0), 2e-3

    def ours() -> Any:
        goals: Any = {"mean": {"position": MEAN}, "amplitude": {"position": most}}
        return design.optimize_duty(machine, bounds, minimize="air_use", correct=True, **goals)

    def slsqp() -> Any:
        kept: dict[bytes, Any] = {}

        def values(x: Any) -> Any:
            if x.tobytes() not in kept:
                changed = machine.with_duty(float(x[0]))
                orbit = lp.nonlinear_orbit(changed, bounds[0] + (bounds[1] - bounds[0]) * float(x[1]))
                air = 1e3 * design.air_use(changed, orbit)
                kept[x.tobytes()] = orbit.mean("position"), orbit.amplitude("position"), air
            return kept[x.tobytes()]

        return minimize(
            lambda x: values(x)[2],
            [0.417, 0.75],
            method="SLSQP",
            bounds=[(0.02, 0.98), (0.0, 1.0)],
            constraints=[
                {"type": "eq", "fun": lambda x: (values(x)[0] - MEAN) * 1e2},
                {"type": "ineq", "fun": lambda x: (most - values(x)[1]) * 1e2},
            ],
            options={"ftol": 1e-9, "maxiter": 40, "eps": 1e-6},
        )

    ours()
    slsqp()
    one, found = timed(ours)
    other, reference = timed(slsqp)
    print(
        f"\noptimum {one:.2f} s, {1e3 * found.corrected.objective:.6f} g/s; SLSQP {other:.2f} s, "
        f"{reference.fun:.6f} g/s; ratio {one / other:.2f}"
    )
    benchmark.pedantic(ours, rounds=1)


def test_scenarios_against_one(benchmark: BenchmarkFixture) -> None:
    """Eight scenarios more than none."""
    machine, bounds = lp.load_machine("kunt_singh_1990"), (6.0, 18.0)
    wanted: Any = {"mean": {"position": (0.04, 0.05)}, "amplitude": {"position": 4e-3}, "minimize": "air_use"}

    def weaker(share: float) -> Any:
        return lambda one: one.with_supply_pressure(share * one.supply_pressure)

    several = {f"{share:.2f}": weaker(share) for share in np.linspace(0.97, 1.04, 8)}

    def alone() -> Any:
        return design.optimize_duty(machine, bounds, **wanted)

    def together() -> Any:
        return design.optimize_duty(machine, bounds, scenarios=several, **wanted)

    alone()
    together()
    one, many = timed(alone)[0], timed(together)[0]
    print(f"\none scenario {one:.2f} s, nine {many:.2f} s, ratio {many / one:.1f}")
    benchmark.pedantic(alone, rounds=1)
