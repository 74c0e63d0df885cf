"""How long does an LTV model with its orbit and multipliers take, counted in exponentials of a 5 x 5 matrix?

From a machine: quasi-static states, LTI cycle, operating points, linearization, step maps, periodic state, multipliers.
The unit is one call of `scipy.linalg.expm`, timed in turn in the same run.
"""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.linalg import expm

import ltvpneu as lp
from benchmarks.conftest import ratio


@pytest.mark.parametrize("n_steps", [2, 6, 20])
def test_ltv_model_in_units_of_expm(benchmark: BenchmarkFixture, table_1: lp.Machine, n_steps: int) -> None:
    matrix = np.random.default_rng(0).normal(size=(5, 5))

    def design() -> float:
        model = lp.ltv_model(table_1, 4.0, n_steps=n_steps)
        orbit, found = lp.steady_state(model.system), lp.floquet(model.system)
        return float(orbit.initial_state[0]) + found.spectral_radius

    def exponentials() -> None:
        for _ in range(100):
            expm(matrix)

    calls = 100 / ratio(exponentials, design, rounds=25, inner=3)
    print(f"\nLTV model of {n_steps} steps, orbit and multipliers: the time of {calls:.0f} calls of expm")
    benchmark.extra_info["calls of expm"] = calls
    benchmark(design)
