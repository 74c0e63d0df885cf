"""How much faster is a compiled nonlinear orbit than `solve_ivp` restarted at each switch, at equal accuracy?

Table 1 at 4 Hz from rest, amplitude right to 0.1 %, and to 1e-5 and 1e-7 beside it. The peer restarts at the switching
instants and at stick and slip, which it locates as events, over the same number of periods, and each side runs at the
loosest tolerance that is right enough. The peer runs twice: on a right-hand side written in Python, and on the
package's compiled one.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from scipy.integrate import solve_ivp

import ltvpneu as lp
from benchmarks.conftest import ratio
from ltvpneu.models.linear.error_estimate import error_estimate
from ltvpneu.models.linear.linearize import areas_at
from ltvpneu.models.machine.dynamics import STUCK, external_force, state_rate
from ltvpneu.models.machine.piston import mode_of

FREQUENCY, N_PERIODS = 4.0, 5
RHS = Callable[[float, np.ndarray, int, bool], np.ndarray]


def compiled_rhs(machine: lp.Machine) -> RHS:
    record, areas, out = (
        machine.record,
        {on: areas_at(machine, 0.0 if on else 4.0) for on in (True, False)},
        np.empty(3),
    )

    def rhs(_t: float, z: np.ndarray, mode: int, on: bool) -> np.ndarray:
        state_rate(z, areas[on], mode, record, out)
        return out.copy()

    return rhs


def python_rhs(machine: lp.Machine) -> RHS:
    g, RT = 1.4, 287.05 * 293.15
    unchoked = math.sqrt(2 * g / ((g - 1) * RT))
    choked, critical = math.sqrt(g / RT * (2 / (g + 1)) ** ((g + 1) / (g - 1))), (2 / (g + 1)) ** (g / (g - 1))
    load, cylinder = machine.load, machine.cylinder
    supply, exhaust = machine.supply_pressure, machine.exhaust_pressure

    def flux(up: float, down: float) -> float:
        r = down / up
        if r <= critical:
            return up * choked
        return up * unchoked * math.sqrt(max(r ** (2 / g) - r ** ((g + 1) / g), 0.0))

    def rhs(_t: float, z: np.ndarray, mode: int, on: bool) -> np.ndarray:
        x, v, p = z
        v = 0.0 if mode == STUCK else v
        flow = -3.88e-6 * flux(p, exhaust) if p >= exhaust else 3.88e-6 * flux(exhaust, p)
        if on:
            flow += 6.4e-6 * flux(supply, p) if supply >= p else -6.4e-6 * flux(p, supply)
        force = cylinder.push_area_1 * p + cylinder.push_area_2 * exhaust - load.spring_stiffness * x
        friction = load.viscous_damping * v + load.dry_friction * mode
        a = 0.0 if mode == STUCK else (force - friction) / load.mass
        volume = 8.2e-6 + cylinder.piston_area_1 * x
        return np.array([v, a, (RT * flow - p * cylinder.piston_area_1 * v) / volume])

    return rhs


def peer_amplitude(machine: lp.Machine, rhs: RHS, rtol: float) -> float:
    """Amplitude of the fifth period from rest by solve_ivp."""
    record, half = machine.record, 0.5 / FREQUENCY
    z = machine.rest_state.copy()
    atol = rtol * machine.state_scales
    low, high = math.inf, -math.inf

    def stops(_t: float, y: np.ndarray, mode: int, _on: bool) -> float:
        return mode * y[1] + 1e-12

    def breaks(_t: float, y: np.ndarray, _mode: int, _on: bool) -> float:
        return machine.load.stiction - abs(external_force(y, record))

    for event in (stops, breaks):
        event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    for _ in range(N_PERIODS):
        low, high = math.inf, -math.inf
        for on in (True, False):
            t = 0.0
            while t < half:
                mode = mode_of(z, record)
                event = breaks if mode == STUCK else stops
                found = solve_ivp(rhs, (t, half), z, rtol=rtol, atol=atol, events=event, args=(mode, on))
                t, z = float(found.t[-1]), found.y[:, -1].copy()
                # The extremes of the position lie where the piston stops, so they are among the ends of the pieces.
                low, high = min(low, found.y[0].min()), max(high, found.y[0].max())
                if found.status == 1:
                    z[1] = 0.0 if mode != STUCK else math.copysign(1e-9, external_force(z, record))
    return (high - low) / 2


def loosest(amplitude: Callable[[float], float], exact: float, accuracy: float) -> float:
    """Return the loosest tolerance whose amplitude is right to the accuracy, and stays so for all tighter ones."""
    rtol, good = 1e-11, 1e-11
    while rtol <= 1e-2 and abs(amplitude(rtol) / exact - 1) <= accuracy:
        good, rtol = rtol, 2 * rtol
    return good


@pytest.mark.parametrize("accuracy", [1e-3, 1e-5, 1e-7])
def test_nonlinear_orbit_against_solve_ivp(benchmark: BenchmarkFixture, table_1: lp.Machine, accuracy: float) -> None:
    exact = lp.nonlinear_orbit(table_1, FREQUENCY, method=lp.DormandPrince(rtol=1e-12)).amplitude("position")

    def ours(rtol: float) -> float:
        method = lp.DormandPrince(rtol=rtol)
        return lp.nonlinear_orbit(table_1, FREQUENCY, method=method).amplitude("position")

    our_rtol = loosest(ours, exact, accuracy)
    for name, rhs in (("Python", python_rhs(table_1)), ("compiled", compiled_rhs(table_1))):

        def peer(rtol: float, rhs: RHS = rhs) -> float:
            return peer_amplitude(table_1, rhs, rtol)

        rtol = loosest(peer, exact, accuracy)
        times = ratio(lambda f=peer, r=rtol: f(r), lambda: ours(our_rtol), rounds=9)
        errors = abs(ours(our_rtol) / exact - 1), abs(peer(rtol) / exact - 1)
        print(
            f"\nright to {accuracy:g}: ours rtol {our_rtol:.1e}, error {errors[0]:.1e}; solve_ivp with a {name} ",
            end="",
        )
        print(f"right-hand side rtol {rtol:.1e}, error {errors[1]:.1e}: {times:.0f} times ours")
        benchmark.extra_info[f"{name} right-hand side, times ours"] = times
    benchmark(lambda: ours(our_rtol))


@pytest.mark.parametrize("share", [1e-2, 1e-5, 1e-8])
def test_slow_machines_cost_what_fast_ones_do(benchmark: BenchmarkFixture, table_1: lp.Machine, share: float) -> None:
    """Table 1 without friction, with all its areas a share of what they are: as slow as that share is small."""
    assert isinstance(table_1.valve, lp.RotaryValve)
    ports = tuple(replace(port, area=share * port.area) for port in table_1.valve.ports)
    paths = tuple(replace(path, area=share * (path.area or 0.0)) for path in table_1.flow_paths)
    slow = replace(table_1, valve=replace(table_1.valve, ports=ports), flow_paths=paths).without_dry_friction()
    fast = table_1.without_dry_friction()
    times = ratio(lambda: lp.nonlinear_orbit(slow, 20.0), lambda: lp.nonlinear_orbit(fast, 20.0), rounds=9)
    n_simulated = lp.nonlinear_orbit(slow, 20.0).n_simulated
    print(f"\nareas times {share:g}: {n_simulated} periods simulated, {times:.1f} times the orbit of the whole areas")
    benchmark.extra_info["times the orbit of the whole areas"] = times
    benchmark(lambda: lp.nonlinear_orbit(slow, 20.0))


def test_a_model_of_two_steps_is_checked_in_about_its_own_time(
    benchmark: BenchmarkFixture, table_1: lp.Machine
) -> None:
    model = lp.ltv_model(table_1, 15.0, operating_points="fitted")

    def checked() -> bool:
        return error_estimate(table_1, 15.0, model.orbit).is_reliable

    times = ratio(checked, lambda: lp.ltv_model(table_1, 15.0, operating_points="fitted"), rounds=9)
    print(f"\nchecked on the machine in {times:.2f} times what the fitted model took")
    benchmark.extra_info["times the fitted model"] = times
    benchmark(checked)
