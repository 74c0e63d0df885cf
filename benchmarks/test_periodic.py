"""How do the periodic analyses grow with the number of steps, how far behind a compiled periodic Schur form are they?

Growth is the slope of the logarithm of time (and of peak memory) over that of the number of steps, 1,000 to 100,000, at
four states. The peer for multipliers is SLICOT's MB03VW and MB03BD, in C (ctrlsys), in the same run.
"""

import math
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import ctrlsys
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import ltvpneu as lp
from benchmarks.conftest import ratio
from ltvpneu._arrays import FloatArray

STEPS = (1_000, 10_000, 100_000)


def random_system(N: int) -> lp.PeriodicSystem:
    random = np.random.default_rng(N)
    A = random.normal(size=(N, 4, 4)) - 3 * np.eye(4)
    return lp.PeriodicSystem.from_matrices(A, random.normal(size=(N, 4)), np.full(N, 10.0 / N))


def orbit(system: lp.PeriodicSystem) -> float:
    return lp.steady_state(system).residual


def multipliers(system: lp.PeriodicSystem) -> float:
    return lp.floquet(system).spectral_radius


@pytest.mark.parametrize("analysis", [orbit, multipliers])
def test_growth_with_the_number_of_steps(
    benchmark: BenchmarkFixture, analysis: Callable[[lp.PeriodicSystem], float]
) -> None:
    analysis(random_system(100))
    times, peaks = [], []
    for N in STEPS:
        systems = [random_system(N) for _ in range(3)]
        seconds: list[float] = []
        for system in systems:
            start = time.perf_counter()
            analysis(system)
            seconds.append(time.perf_counter() - start)
        times.append(min(seconds))
        fresh = random_system(N)
        tracemalloc.start()
        analysis(fresh)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    decades = math.log(STEPS[-1] / STEPS[0])
    in_time, in_memory = (math.log(values[-1] / values[0]) / decades for values in (times, peaks))
    shown = ", ".join(f"{N}: {1e3 * t:.0f} ms {m / 1e6:.0f} MB" for N, t, m in zip(STEPS, times, peaks, strict=True))
    print(f"\n{analysis.__name__}: N^{in_time:.2f} in time, N^{in_memory:.2f} in memory ({shown})")
    benchmark.extra_info["exponent in time"] = in_time
    benchmark.extra_info["exponent in memory"] = in_memory
    system = random_system(STEPS[0])
    benchmark(analysis, system)


def slicot(factors: FloatArray) -> FloatArray:
    N, n = factors.shape[:2]
    stack, signs = np.asfortranarray(np.moveaxis(factors[::-1], 0, 2)), np.ones(N, dtype=np.int32)
    reduced, _, h, _ = ctrlsys.mb03vw("N", None, "A", n, N, 1, 1, n, signs, stack)
    _, _, real, imag, beta, scale, _, _ = ctrlsys.mb03bd("E", "C", "N", N, n, h, 1, n, signs, reduced)
    return np.log(np.hypot(real, imag)) - np.log(np.abs(beta)) + scale * math.log(2)


def orthogonal(N: int, n: int, random: np.random.Generator) -> FloatArray:
    """Factors whose product's multipliers all have modulus one: the slowest case for orthogonal iteration."""
    return np.asarray(np.linalg.qr(random.normal(size=(N, n, n)))[0], dtype=np.float64)


@pytest.mark.parametrize("kind", ["random", "near the identity", "orthogonal"])
def test_multipliers_against_a_compiled_periodic_schur_form(benchmark: BenchmarkFixture, kind: str) -> None:
    random = np.random.default_rng(0)
    N, n = 2_000, 20
    factors = {
        "random": lambda: random.normal(size=(N, n, n)),
        "near the identity": lambda: np.eye(n) + 0.01 * random.normal(size=(N, n, n)),
        "orthogonal": lambda: orthogonal(N, n, random),
    }[kind]()
    apart = np.max(np.abs(np.sort(lp.product_multipliers(factors).log_moduli) - np.sort(slicot(factors))))
    times = 1 / ratio(lambda: slicot(factors), lambda: lp.product_multipliers(factors), rounds=3, inner=1)
    print(f"\n{kind}: {times:.2f} times the compiled periodic Schur form, log moduli apart by {apart:.0e}")
    benchmark.extra_info["times the peer"] = times
    benchmark.pedantic(lp.product_multipliers, args=(factors,), rounds=3)


@pytest.mark.parametrize("rate", [1e3, 1e5, 1e7, 1e9])
def test_multipliers_of_stiff_steps_against_those_of_mild_ones(benchmark: BenchmarkFixture, rate: float) -> None:
    """Steps of a second in random coordinates, their rates spread evenly over the decades from one."""
    random = np.random.default_rng(0)
    N, n = 8, 5

    def system(fastest: float) -> lp.PeriodicSystem:
        turns = np.eye(n) + 0.3 * random.standard_normal((N, n, n))
        rates = np.eye(n) * -(fastest ** random.uniform(0, 1, (N, 1, n)))
        return lp.PeriodicSystem.from_matrices(turns @ rates @ np.linalg.inv(turns), np.zeros((N, n)), np.ones(N))

    mild, stiff = system(2.0), system(rate)
    times = 1 / ratio(lambda: multipliers(replace(mild)), lambda: multipliers(replace(stiff)), rounds=5, inner=5)
    print(f"\nrates to {rate:g} 1/s: {times:.1f} times a mild system")
    benchmark.extra_info["times a mild system"] = times
    benchmark(multipliers, stiff)
