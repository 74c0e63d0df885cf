"""What does accuracy cost? Error against time of every mode, beside the nonlinear orbit and solve_ivp, in one run.

Table 1 with its friction at 4 and 15 Hz. Each model is timed with its amplitude; the error is that of the amplitude
against the nonlinear orbit at 1e-11. A picture, work_precision.png, goes to the folder that pytest runs in if
LTVPNEU_PICTURES is set. Also: how many valve periods the models march over a 20 x 20 grid of duty and frequency.
"""

import os
import time
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.integrate import solve_ivp

import ltvpneu as lp
from benchmarks.conftest import ratio
from ltvpneu.models.dynamics import state_rate
from ltvpneu.models.events import mode_of
from ltvpneu.models.ltv import OperatingPoints
from ltvpneu.models.nonlinear import schedule_of


def best_time(function: Callable[[], object], repeats: int = 20) -> float:
    function()
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def solve_ivp_amplitude(machine: lp.Machine, frequency: float, rtol: float, n_periods: int) -> float:
    """Half the peak-to-peak of the last period of solve_ivp, restarted at every switch; stick as strong damping."""
    schedule, scales, arrays = schedule_of(machine, 1 / frequency), machine.state_scales, machine.arrays
    state, low, high = machine.rest_state.copy(), np.inf, -np.inf
    for period in range(n_periods):
        for piece in range(schedule.times.size - 1):
            areas, rate = schedule.areas[piece][[0, 2]].copy(), np.empty(3)

            def right_side(_t: float, z: np.ndarray, areas: np.ndarray = areas, rate: np.ndarray = rate) -> np.ndarray:
                state_rate(z, areas, mode_of(z, arrays), arrays, rate)
                return rate.copy()

            span = (schedule.times[piece], schedule.times[piece + 1])
            found = solve_ivp(right_side, span, state, method="LSODA", rtol=rtol, atol=rtol * scales, dense_output=True)
            state = found.y[:, -1]
            if period == n_periods - 1:
                path = found.sol(np.linspace(*span, 400))[0]
                low, high = min(low, path.min()), max(high, path.max())
    return (high - low) / 2


@pytest.mark.parametrize("frequency", [4.0, 15.0])
def test_work_and_precision(benchmark: BenchmarkFixture, table_1: lp.Machine, frequency: float) -> None:
    exact = lp.nonlinear_orbit(table_1, frequency, method=lp.DormandPrince(rtol=1e-11))
    target = exact.amplitude(0)

    def model(mode: OperatingPoints, n: int) -> Callable[[], float]:
        return lambda: lp.ltv_model(table_1, frequency, n_steps=n, operating_points=mode).orbit.amplitude(0)

    def nonlinear(rtol: float) -> Callable[[], float]:
        return lambda: lp.nonlinear_orbit(table_1, frequency, method=lp.DormandPrince(rtol=rtol)).amplitude(0)

    runs: dict[str, list[tuple[str, Callable[[], float]]]] = {
        "nonlinear orbit": [(f"rtol {r:g}", nonlinear(r)) for r in (1e-3, 1e-4, 1e-6, 1e-8)],
        "solve_ivp": [
            (f"rtol {r:g}", lambda r=r: solve_ivp_amplitude(table_1, frequency, r, exact.n_simulated))
            for r in (1e-3, 1e-5)
        ],
    }
    modes: tuple[OperatingPoints, ...] = ("lti", "quasi-static", "fitted", "self-consistent")
    for mode in modes:
        runs[mode] = [(f"N_s {n}", model(mode, n)) for n in (2, 6, 20, 80, 320)]
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.subplots()
    print(f"\n{frequency:g} Hz\n{'':18} {'':>10} {'time [ms]':>10} {'error':>10}")
    for name, points in runs.items():
        line: list[tuple[float, float]] = []
        for label, function in points:
            error = abs(function() / target - 1)
            line.append((best_time(function, 3 if name == "solve_ivp" else 10), max(error, 1e-8)))
            print(f"{name:18} {label:>10} {1e3 * line[-1][0]:10.3f} {error:10.1e}")
        axes.loglog(*zip(*line, strict=True), "o-", label=name)
    axes.set(xlabel="time [s]", ylabel="relative error of the amplitude", title=f"{table_1.name}, {frequency:g} Hz")
    axes.legend()
    if "LTVPNEU_PICTURES" in os.environ:
        figure.savefig(f"work_precision_{frequency:g}_Hz.png", dpi=120)
    benchmark(model("fitted", 2))


@pytest.mark.parametrize("frequency", [4.0, 15.0])
def test_fitted_with_two_steps_in_units_of_the_nonlinear_orbit(
    benchmark: BenchmarkFixture, table_1: lp.Machine, frequency: float
) -> None:
    def fitted() -> lp.LtvModel:
        return lp.ltv_model(table_1, frequency, operating_points="fitted")

    def nonlinear() -> lp.Orbit:
        return lp.nonlinear_orbit(table_1, frequency)

    times = ratio(fitted, nonlinear, rounds=25, inner=5)
    print(f"\nfitted, two steps, at {frequency:g} Hz: {times:.2f} times the nonlinear orbit")
    benchmark.extra_info["nonlinear orbits"] = times
    benchmark(fitted)


def test_valve_periods_marched_over_duty_and_frequency(benchmark: BenchmarkFixture, table_1: lp.Machine) -> None:
    duties, frequencies = np.linspace(0.05, 0.95, 20), np.linspace(0.2, 20, 20)

    def table() -> dict[str, list[float]]:
        found: dict[str, list[float]] = {}
        cases: tuple[tuple[OperatingPoints, int], ...] = (("fitted", 2), ("fitted", 20), ("self-consistent", 20))
        for name, n in cases:
            periods: list[float] = []
            for frequency in frequencies:
                for duty in duties:
                    try:
                        machine = table_1.with_duty(float(duty))
                        model = lp.ltv_model(machine, float(frequency), n_steps=n, operating_points=name)
                        periods.append(model.iterations)
                    except lp.LtvpneuError:
                        periods.append(np.nan)
            found[f"{name}, N_s = {n}"] = periods
        return found

    for name, periods in benchmark.pedantic(table, rounds=1).items():
        quantiles = np.nanquantile(periods, [0.5, 0.9, 1.0])
        print(f"\n{name}: valve periods marched, median {quantiles[0]:.0f}, 90 % {quantiles[1]:.0f}, ", end="")
        print(f"most {quantiles[2]:.0f}; without a cycle: {np.isnan(periods).sum()} of {len(periods)}")
