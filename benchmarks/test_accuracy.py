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
from ltvpneu.models.linear.modes import OperatingPoints
from ltvpneu.models.machine.dynamics import state_rate
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.piston import mode_of

SETTLES = {4.0: 6, 15.0: 20}
"""Valve periods in which the peer, that only waits, comes to 1e-6 of the orbit, by frequency [Hz]."""


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
    pieces, scales, record = pieces_of(machine.openings, 1 / frequency), machine.state_scales, machine.record
    state, low, high = machine.rest_state.copy(), np.inf, -np.inf
    for period in range(n_periods):
        for piece in range(pieces.size):
            areas, rate = pieces["areas"][piece, (0, 2), : len(machine.path_fields)].copy(), np.empty(3)

            def right_side(_t: float, z: np.ndarray, areas: np.ndarray = areas, rate: np.ndarray = rate) -> np.ndarray:
                state_rate(z, areas, mode_of(z, record), record, rate)
                return rate.copy()

            span = (pieces["begin"][piece], pieces["end"][piece])
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
            (f"rtol {r:g}", lambda r=r: solve_ivp_amplitude(table_1, frequency, r, SETTLES[frequency]))
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


class Tally:
    """What a linear model does over a grid of duty and frequency."""

    def __init__(self) -> None:
        self.periods: list[int] = []
        self.without: list[str] = []
        self.mislabelled: list[str] = []
        self.errors: list[tuple[float, float]] = []
        """True and estimated relative errors of the amplitude, where the orbit is unique and moves 1 mm or more."""

    def add(self, orbit: lp.Orbit | None, frequency: float, case: tuple[lp.Machine, OperatingPoints, int]) -> None:
        """Take in the model of one point, next to the nonlinear orbit if there is one."""
        machine, mode, n = case
        place = f"{frequency:.2f} Hz/{machine.duty:.3f}"
        try:
            model = lp.ltv_model(machine, frequency, n_steps=n, operating_points=mode)
        except lp.LtvpneuError:
            self.without.append(place)
            return
        self.periods.append(model.iterations)
        if orbit is None:
            return
        if (orbit.is_isolated, orbit.n_periods) != (model.orbit.is_isolated, model.orbit.n_periods):
            self.mislabelled.append(place)
        true = orbit.amplitude(0)
        if orbit.is_isolated and orbit.n_periods == 1 and true >= 1e-3:
            error = model.orbit.amplitude(0) / true - 1
            self.errors.append((error, model.error_estimate.relative_amplitude(0)))

    def text(self, least: float = 0.005) -> str:
        """Return a line of the table; estimates are judged where the true error is above `least`."""
        median, most = np.quantile(self.periods, [0.5, 1.0])
        judged = [(true, estimate) for true, estimate in self.errors if abs(true) > least]
        within = sum(0.5 <= estimate / true <= 2 for true, estimate in judged)
        share = f"{within} of {len(judged)}" if judged else "none above"
        worst = max(abs(true) for true, _ in self.errors)
        return (
            f"{median:7.0f} {most:6.0f} {len(self.without):8} {len(self.mislabelled):7} {100 * worst:9.2f} % "
            f"{share:>12}   {', '.join(self.without)}"
        )


def test_models_over_duty_and_frequency(benchmark: BenchmarkFixture, table_1: lp.Machine) -> None:
    """Iterations, kinds of orbits and how often the estimated error is right, on a 20 x 20 grid."""
    cases: tuple[tuple[OperatingPoints, int], ...] = (
        ("lti", 20),
        ("quasi-static", 20),
        ("fitted", 2),
        ("fitted", 20),
        ("self-consistent", 6),
        ("self-consistent", 20),
    )
    duties, frequencies = np.linspace(0.05, 0.95, 20), np.linspace(0.2, 20, 20)

    def grid() -> tuple[dict[str, int], dict[str, Tally]]:
        kinds: dict[str, int] = dict.fromkeys(("unique", "band", "subharmonic", "not settling"), 0)
        tallies = {f"{mode}, {n}": Tally() for mode, n in cases}
        for frequency in frequencies.tolist():
            for duty in duties.tolist():
                machine, orbit = table_1.with_duty(duty), None
                try:
                    orbit = lp.nonlinear_orbit(machine, frequency)
                    kind = "band" if not orbit.is_isolated else "subharmonic" if orbit.n_periods > 1 else "unique"
                except lp.NotSettledError:
                    kind = "not settling"
                kinds[kind] += 1
                for mode, n in cases:
                    tallies[f"{mode}, {n}"].add(orbit, frequency, (machine, mode, n))
        return kinds, tallies

    kinds, tallies = benchmark.pedantic(grid, rounds=1)
    print(f"\nnonlinear orbits: {', '.join(f'{count} {kind}' for kind, count in kinds.items())}")
    print("valve periods marched (median, most), models without a cycle, kinds unlike the nonlinear orbit's, worst")
    print("error of the amplitude, and how many estimates are within a factor of 2 where the error is above 0.5 %")
    for name, tally in tallies.items():
        print(f"{name:22}{tally.text()}")
        # A linear model about the LTI cycle knows neither bands nor subharmonics.
        if name.startswith(("fitted", "self-consistent")) and tally.mislabelled:
            print(f"{'':22}unlike: {', '.join(tally.mislabelled)}")
