"""What does each extension cost, and does the paper's case pay for them?

Table 1 at 4 Hz: nonlinear orbits, as ratios to the isothermal ideal-gas chamber. That case runs on short cuts through
the general equations; run through the latter instead, it shows what the short cuts spare.
"""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import ltvpneu as lp
from benchmarks.conftest import ratio
from ltvpneu.models.linear.own_cycle import OwnCycle
from ltvpneu.models.machine.openings import pieces_of
from ltvpneu.models.machine.records import GENERAL
from ltvpneu.models.nonlinear.method import integration_settings
from ltvpneu.models.nonlinear.periods import integrate_period
from ltvpneu.models.nonlinear.runge_kutta import new_run

FREQUENCY = 4.0


def extended(machine: lp.Machine) -> dict[str, lp.Machine]:
    dynamic, air = machine.with_collapse("dynamic"), lp.RealGas(fluid="Air")
    return {
        "polytropic": machine.with_thermal(1.3),
        "adiabatic": machine.with_thermal("adiabatic"),
        "in series": machine.with_collapse("in_series"),
        "dynamic": dynamic,
        "dynamic, adiabatic": dynamic.with_thermal("adiabatic"),
        "real air": machine.with_gas(air),
        "real air, adiabatic": machine.with_gas(air).with_thermal("adiabatic"),
        "CO2": machine.with_gas(lp.RealGas(fluid="CO2")),
    }


def test_orbits_of_the_extensions(benchmark: BenchmarkFixture, table_1: lp.Machine) -> None:
    print()
    for name, machine in extended(table_1).items():
        times = ratio(
            lambda m=machine: lp.nonlinear_orbit(m, FREQUENCY), lambda: lp.nonlinear_orbit(table_1, FREQUENCY), rounds=9
        )
        print(f"{name:20} {times:6.1f} times the isothermal ideal gas")
        benchmark.extra_info[name] = times
    benchmark(lambda: lp.nonlinear_orbit(table_1, FREQUENCY))


def test_what_the_short_cuts_spare(benchmark: BenchmarkFixture, table_1: lp.Machine) -> None:
    pieces, settings = pieces_of(table_1.openings, 1 / FREQUENCY), integration_settings(table_1, 1e-8)
    start = np.array(table_1.rest_state)
    short = new_run(table_1.record, settings, pieces)
    general = new_run(table_1.as_record(GENERAL), settings, pieces)
    times = ratio(lambda: integrate_period(start, general), lambda: integrate_period(start, short), rounds=25)
    print(f"\none period through the general equations: {times:.2f} times the paper's case")
    benchmark.extra_info["general over short"] = times
    benchmark(lambda: integrate_period(start, short))


@pytest.mark.parametrize("mode", ["fitted", "self-consistent"])
def test_linear_models_of_the_extensions(benchmark: BenchmarkFixture, table_1: lp.Machine, mode: OwnCycle) -> None:
    n_steps = 2 if mode == "fitted" else 40

    def model(machine: lp.Machine) -> lp.LtvModel:
        return lp.ltv_model(machine, FREQUENCY, n_steps=n_steps, operating_points=mode)

    print()
    for name, machine in extended(table_1).items():
        times = ratio(lambda m=machine: model(m), lambda: model(table_1), rounds=5)
        print(f"{mode}, {name:20} {times:6.1f} times the isothermal ideal gas")
        benchmark.extra_info[name] = times
    benchmark(lambda: model(table_1))
