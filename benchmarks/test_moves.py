"""Moves against scipy's SLSQP with finite differences, and patterns against trying all of them.

The same machine, order of valve positions and starts: Table 1 from rest at 20 mm to rest at 70 mm in the least time.
Run with

    pytest benchmarks/test_moves.py --benchmark-only -s
"""

import time
from typing import Any

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.optimize import minimize

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.moves.search import MoveSearch
from ltvpneu.design.pattern import pattern as pattern_module
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.nonlinear.passage import passage

N_STARTS = 12
OFF = 0.2
"""By which the starts' durations are off, as a share."""


def test_moves_against_slsqp(benchmark: BenchmarkFixture) -> None:
    """Simulations and time of a search; SLSQP asks for each of its functions by itself."""
    machine = lp.load_machine("kunt_singh_1990")
    best = design.optimize_move(machine, 0.02, 0.07)
    search = MoveSearch(machine, 0.02, 0.07, None, (None, None, None, None), "time", None)
    search.limit(None, None, None)
    machines = [search.positions[position] for position in best.order]
    scales, hold = machine.state_scales, machine.load.stiction
    random = np.random.default_rng(1)
    starts = [best.durations * random.uniform(1 - OFF, 1 + OFF, best.durations.size) for _ in range(N_STARTS)]
    ours: list[tuple[int, float, bool]] = []
    theirs: list[tuple[int, float, bool]] = []
    for start in starts:
        search.n_simulations, begin = 0, time.perf_counter()
        found = search.best_of(best.order, [start])
        is_best = abs(found.time / best.time - 1) < 1e-6 and not found.broken
        ours.append((search.n_simulations, time.perf_counter() - begin, is_best))
        count, begin = 0, time.perf_counter()

        def end(durations: Any) -> Any:
            nonlocal count
            count += 1
            return passage(machines, np.maximum(durations, 1e-6), search.start).end

        def equations(durations: Any, end: Any = end) -> Any:
            return (end(durations)[:2] - [0.07, 0.0]) / scales[:2]

        def inequalities(durations: Any, end: Any = end) -> Any:
            push = external_force(end(durations), machine.record) / hold
            return np.array([1 - push, 1 + push])

        other = minimize(
            lambda durations: 10 * float(np.sum(durations)), start, method="SLSQP", bounds=[(1e-6, 0.25)] * 3,
            constraints=[{"type": "eq", "fun": equations}, {"type": "ineq", "fun": inequalities}],
            options={"ftol": 1e-9, "maxiter": 200},
        )  # fmt: skip
        is_best = bool(other.success) and abs(float(np.sum(other.x)) / best.time - 1) < 1e-6
        theirs.append((count, time.perf_counter() - begin, is_best))
    both = [(own, other) for own, other in zip(ours, theirs, strict=True) if own[2] and other[2]]
    print(f"\nmoves: found by us {sum(one[2] for one in ours)} of {N_STARTS}, by SLSQP {sum(one[2] for one in theirs)}")
    ratio = np.median([other[0] / own[0] for own, other in both])
    print(f"where both find it: {ratio:.0f} times fewer simulations than SLSQP (median)")
    all_ours, all_theirs = (sum(one[0] for one in each) for each in (ours, theirs))
    found_ours, found_theirs = (max(sum(one[2] for one in each), 1) for each in (ours, theirs))
    print(f"simulations for each optimum found: {all_ours / found_ours:.0f} against {all_theirs / found_theirs:.0f}")
    benchmark(search.best_of, best.order, [starts[0]])


def test_patterns_against_trying_all(benchmark: BenchmarkFixture, monkeypatch: Any) -> None:
    """Sixteen slots, 4,116 patterns."""
    machine, goals = lp.load_machine("kunt_singh_1990"), {"position": (0.04, 0.05)}
    design.optimize_pattern(machine, 4.0, 8, mean=goals)
    found = benchmark(design.optimize_pattern, machine, 4.0, 16, mean=goals)
    begin = time.perf_counter()
    design.optimize_pattern(machine, 4.0, 16, mean=goals)
    took = time.perf_counter() - begin
    monkeypatch.setattr(pattern_module, "MOST_ENUMERATED", 1 << 30)
    begin = time.perf_counter()
    best = design.optimize_pattern(machine, 4.0, 16, mean=goals)
    everything = time.perf_counter() - begin
    print(
        f"\npatterns: {everything / took:.0f} times faster than trying all, {found.n_tried} of {found.n_allowed} tried"
    )
    assert abs(found.nonlinear_value / best.nonlinear_value - 1) < 1e-9
