"""Machines beyond the paper's: energy balances, the valve's inner volume, real gas, liquids, in all three models."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import ltvpneu as lp
from ltvpneu.errors import CavitationError, GasRangeError
from ltvpneu.models.linear.linearize import areas_at
from ltvpneu.models.linear.staircase import staircase
from ltvpneu.models.machine.dynamics import state_rate
from ltvpneu.models.machine.quasi_static import settled_states
from ltvpneu.models.machine.records import GENERAL, N_INPUTS
from ltvpneu.models.machine.tangent import state_tangent
from ltvpneu.physics.gas import GasState
from ltvpneu.physics.medium import path_flow, path_flow_slopes
from tests.conftest import EXTENSIONS, MACHINES
from tests.models.linear.test_linearize import differences, input_differences, rate, relative_error
from tests.models.twin import rods

GAS = [name for name in EXTENSIONS if not name.startswith("hydraulic")]
AIR = lp.Gas()


def states_of(machine: lp.Machine, values: tuple[float, ...]) -> np.ndarray:
    """A state from numbers between 0 and 1, pressures from below the exhaust to above the supply."""
    n = machine.n_volumes
    low, high = 0.6 * machine.exhaust_pressure, 1.3 * machine.supply_pressure
    state = np.array(values[: len(machine.states)])
    state[0] *= 0.03
    state[1] = 2 * state[1] - 1
    state[2 : 2 + n] = low + (high - low) * state[2 : 2 + n]
    state[2 + n :] = 220 + 160 * state[2 + n :]
    return state


def is_clear_of_equal_pressures(machine: lp.Machine, state: np.ndarray) -> bool:
    """Differences want room: around equal pressures and around choking the slopes have corners."""
    pressures = [*state[2 : 2 + machine.n_volumes], machine.supply_pressure, machine.exhaust_pressure]
    ratios = [min(a, b) / max(a, b) for i, a in enumerate(pressures) for b in pressures[:i]]
    return all(ratio < 1 - 1e-3 and abs(ratio - 0.5283) > 2e-3 for ratio in ratios)


@pytest.mark.parametrize("name", EXTENSIONS)
@given(values=st.tuples(*[st.floats(0, 1)] * 6), angle=st.floats(0, 2 * math.pi))
def test_the_full_tangent_equals_differences(name, values, angle):
    machine = EXTENSIONS[name]
    state, areas = states_of(machine, values), areas_at(machine, angle)
    assume(is_clear_of_equal_pressures(machine, state) and abs(state[1]) > 1e-3)
    # A path open by a millionth drowns in the rounding of the other paths' flows.
    assume(not ((areas > 0) & (areas < 1e-8)).any())
    found = lp.linearize(machine, state, angle=angle, tangent="full")
    assert relative_error(found.A, differences(machine, state, areas), machine.state_scales) < 1e-6
    if "polytropic" not in name:  # its reference state (4) moves with the exhaust pressure, of which B knows nothing
        assert relative_error(found.B, input_differences(machine, state, areas), machine.state_scales) < 1e-6
    # The model of the step agrees with the machine where it was taken.
    expected = rate(machine.without_dry_friction(), state, areas)
    sizes = np.abs(found.A * machine.state_scales).max(axis=1)
    error = np.abs(found.A @ state + found.f - expected)
    assert (error <= 1e-9 * sizes).all()


@pytest.mark.parametrize("name", ["table 1", "polytropic", "double-acting", "in series", "ramped"])
@given(values=st.tuples(*[st.floats(0, 1)] * 6), angle=st.floats(0, 2 * math.pi))
def test_the_short_cut_of_the_papers_case_equals_the_general_equations(name, values, angle):
    machine = MACHINES[name]
    state, areas = states_of(machine, values), areas_at(machine, angle)
    assert machine.is_plain
    general = machine.as_record(GENERAL)
    short, long = np.empty(state.size), np.empty(state.size)
    state_rate(state, areas, 1, machine.record, short)
    state_rate(state, areas, 1, general, long)
    # Where flows cancel, what is left of them is rounding.
    np.testing.assert_allclose(long, short, rtol=1e-9, atol=1e-9 * np.abs(short).max())
    if is_clear_of_equal_pressures(machine, state):
        n = state.size
        A, C = np.empty((n, n)), np.empty((n, n))
        B, D = np.empty((n, N_INPUTS)), np.empty((n, N_INPUTS))
        state_tangent(state, areas, machine.record, True, A, B)
        state_tangent(state, areas, general, True, C, D)
        assert relative_error(C, A, machine.state_scales) < 1e-9
        assert relative_error(D, B, machine.state_scales) < 1e-9


# Thermal models
# ---------------------------------------------------------------------------------------------------


def test_a_tank_fills_at_gamma_r_t_adiabatic_and_at_r_t_isothermal():
    """Through a choked orifice, at rest: p' = gamma R T m' / V against R T m' / V, T that of the supply."""
    one = EXTENSIONS["adiabatic"]
    state = np.array([0.05, 0.0, 1.5e5, 250.0])
    areas = areas_at(one, 0.1)
    areas[0, 1] = 0.0  # the bleed
    choked = 6.4e-6 * 4.1e5 * math.sqrt(1.4 / (287.05 * 293.15) * (2 / 2.4) ** 6)
    volume = 8.2e-6 + 0.59e-3 * 0.05
    adiabatic = rate(one, state, areas)[2]
    assert adiabatic == pytest.approx(1.4 * 287.05 * 293.15 * choked / volume, rel=1e-12)
    isothermal = rate(one.with_thermal("isothermal"), state[:3], areas)[2]
    assert isothermal == pytest.approx(287.05 * 293.15 * choked / volume, rel=1e-12)
    assert isothermal / adiabatic == pytest.approx(1 / 1.4)


@pytest.mark.parametrize("name", EXTENSIONS)
@pytest.mark.parametrize("frequency", [1.0, 4.0, 10.0])
def test_mass_and_energy_close_over_the_period(name, frequency):
    machine = EXTENSIONS[name]
    found = lp.balance(machine, lp.nonlinear_orbit(machine, frequency))
    assert found.mass_error < 1e-9
    if any("temperature" in state for state in machine.states):  # else the heat is what is left of the first law
        assert found.energy_error < 1e-9
    assert (found.mass_in > 0).all()


@pytest.mark.parametrize("name", ["table 1", "in series", "polytropic", "ramped", "double-acting", "end stops"])
def test_mass_closes_in_the_papers_models_too(name):
    machine = MACHINES[name]
    assert lp.balance(machine, lp.nonlinear_orbit(machine, 4.0)).mass_error < 1e-9


def test_a_good_wall_makes_the_chamber_isothermal_and_a_bad_one_adiabatic(table_1):
    amplitude = lp.nonlinear_orbit(table_1, 4.0).amplitude("position")
    adiabatic = lp.nonlinear_orbit(EXTENSIONS["adiabatic"], 4.0).amplitude("position")
    found = []
    for coefficient in (1e6, 1e-4):
        wall = lp.EnergyBalance(heat_transfer_coefficient=coefficient, wall_area=0.01, wall_temperature=293.15)
        found.append(lp.nonlinear_orbit(table_1.with_thermal(wall), 4.0).amplitude("position"))
    assert found == pytest.approx([amplitude, adiabatic], rel=1e-4)


def test_a_closed_adiabatic_chamber_follows_the_isentrope(table_1):
    """Shut, and moved by a load: p V^gamma stays, and so does the polytropic chamber of exponent gamma."""
    machine = replace(EXTENSIONS["adiabatic"].with_duty(0.0), flow_paths=()).without_dry_friction()
    start = np.array([0.05, 0.5, 2e5, 293.15])
    polytropic = replace(table_1.with_duty(0.0).with_thermal(1.4), flow_paths=()).without_dry_friction()
    one = lp.simulate(machine, 1.0, 1, start)
    two = lp.simulate(polytropic, 1.0, 1, start[:3])
    volumes = 8.2e-6 + 0.59e-3 * one.states[0]
    constant = one.states[2] * volumes**1.4
    np.testing.assert_allclose(constant / constant[0], 1.0, rtol=1e-6)
    np.testing.assert_allclose(one.states[2], two.states[2], rtol=1e-6)


class MassTwin:
    """Masses and internal energies as states, in plain Python: another formulation, with nothing of the package's."""

    def __init__(self, machine: lp.Machine) -> None:
        self.machine, self.g, self.R = machine, 1.4, 287.05
        self.cv = self.R / (self.g - 1)

    def flux(self, up: float, down: float, T: float) -> float:
        laminar = 1e-4  # relative difference of the pressures up to which the flow is proportional to it
        if down > (1 - laminar) * up:
            return (1 - down / up) / laminar * self.flux(up, (1 - laminar) * up, T)
        g, r = self.g, max(down / up, (2 / (self.g + 1)) ** (self.g / (self.g - 1)))
        return up * math.sqrt(2 * g / ((g - 1) * self.R * T) * max(r ** (2 / g) - r ** ((g + 1) / g), 0.0))

    def volumes(self, x: float) -> list[float]:
        c = self.machine.cylinder
        sizes = {"chamber_1": c.piston_area_1 * x, "chamber_2": -c.piston_area_2 * x}
        dead = {"chamber_1": c.dead_volume_1, "chamber_2": c.dead_volume_2}
        inner = {v.name: v.volume for v in self.machine.inner_volumes}
        return [inner[n] if n in inner else dead[n] + sizes[n] for n in self.machine.volumes]

    def pressures(self, x: float, m: np.ndarray, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        V = np.array(self.volumes(x))
        if any("temperature" in s for s in self.machine.states):
            return (self.g - 1) * U / V, U / (m * self.cv)
        return m * self.R * 293.15 / V, np.full(len(V), 293.15)

    def rate(self, t: float, y: np.ndarray, angle: float) -> np.ndarray:
        machine, n = self.machine, self.machine.n_volumes
        x, v, m, U = y[0], y[1], y[2 : 2 + n], y[2 + n :]
        p, T = self.pressures(x, m, U)
        load, c = machine.load, machine.cylinder
        sides = {name: p[k] for k, name in enumerate(machine.volumes)}
        force = load.force - load.spring_stiffness * x - load.viscous_damping * v
        force += (c.piston_area_1 - c.seal_friction_area) * sides.get("chamber_1", machine.ambient_pressure)
        force -= (c.piston_area_2 + c.seal_friction_area) * sides.get("chamber_2", machine.ambient_pressure)
        rod_1, rod_2 = rods(c)
        force += (rod_1 - rod_2) * machine.ambient_pressure
        dm, dU = np.zeros(n), np.zeros(n)
        known = {"supply": (machine.supply_pressure, 293.15), "exhaust": (machine.exhaust_pressure, 293.15)}
        known |= {name: (p[k], T[k]) for k, name in enumerate(machine.volumes)}
        for path in machine.connections:
            a, b = known[path.source], known[path.chamber]
            up, down, sign = (a, b, 1) if a[0] >= b[0] else (b, a, -1)
            flow = sign * path.first.at(angle) * self.flux(up[0], down[0], up[1])
            for name, way in ((path.chamber, 1), (path.source, -1)):
                if name in machine.volumes:
                    k = machine.volumes.index(name)
                    dm[k] += way * flow
                    dU[k] += way * flow * self.cv * self.g * up[1]
        for k, name in enumerate(machine.volumes):
            slope = {"chamber_1": c.piston_area_1, "chamber_2": -c.piston_area_2}.get(name, 0.0)
            balance = c.process(name)[1] if name.startswith("chamber") else None
            dU[k] -= p[k] * slope * v
            if balance is not None and balance.conductance:
                dU[k] += balance.conductance * (balance.wall_temperature - T[k])
        return np.concatenate([[v, force / load.mass], dm, dU])

    def run(self, frequency: float, n_periods: int) -> np.ndarray:
        """Simulate from rest without friction or stops; return position, velocity, pressures, temperatures."""
        machine, n = self.machine, self.machine.n_volumes
        V = np.array(self.volumes(0.0))
        m = machine.exhaust_pressure * V / (self.R * 293.15)
        y = np.concatenate([[0.0, 0.0], m, m * self.cv * 293.15])
        fractions = machine.openings.fractions
        for _ in range(n_periods):
            for begin, end in pairwise(fractions):
                angle = 2 * math.pi * (begin + end) / 2
                found = solve_ivp(
                    self.rate, (0, (end - begin) / frequency), y, args=(angle,), rtol=1e-9,
                    atol=1e-9 * np.concatenate([[0.01, 1.0], m, m * self.cv * 293.15]), method="DOP853",
                )  # fmt: skip
                y = found.y[:, -1]
        p, T = self.pressures(y[0], y[2 : 2 + n], y[2 + n :])
        return np.concatenate([y[:2], p, T[: len(machine.states) - 2 - n]])


@pytest.mark.parametrize("name", ["adiabatic", "walls", "dynamic", "dynamic, adiabatic"])
def test_a_twin_in_masses_and_energies_gets_to_the_same_state(name):
    machine = EXTENSIONS[name].without_dry_friction()
    stops = replace(machine.cylinder, lower_stop=-math.inf, upper_stop=math.inf)
    valve = machine.valve if isinstance(machine.valve, lp.RotaryValve) else replace(machine.valve, ramp=0.0)
    machine = replace(machine, cylinder=stops, valve=valve)
    expected = MassTwin(machine).run(25.0, 3)
    found = lp.simulate(machine, 25.0, 3).states[:, -1]
    np.testing.assert_allclose(found / machine.state_scales, expected / machine.state_scales, atol=1e-5)


def test_the_exponent_outside_one_to_gamma_warns_and_says_why(table_1):
    for exponent in (0.9, 1.5):
        with pytest.warns(UserWarning, match=f"polytropic_exponent_1: found {exponent}, outside 1 .isothermal. to 1.4"):
            table_1.with_thermal(exponent)


# The valve's inner volume
# --------------------------------------------------------------------------------------------------


def test_a_vanishing_inner_volume_is_two_restrictions_in_series(table_1):
    expected = lp.nonlinear_orbit(table_1.with_collapse("in_series"), 4.0).amplitude("position")
    errors = []
    for size in (4e-7, 4e-8):
        inner = (lp.InnerVolume(volume=size),)
        machine = replace(table_1, valve=replace(table_1.valve, inner_volumes=inner), collapse="dynamic")
        errors.append(abs(lp.nonlinear_orbit(machine, 4.0).amplitude("position") / expected - 1))
    assert errors[0] < 2e-3
    assert errors[1] < 0.15 * errors[0]


def test_an_inner_volume_needs_a_name_of_its_own(table_1):
    ports = tuple(replace(port, volume="chamber_1") for port in table_1.valve.ports)
    inner = (lp.InnerVolume(name="chamber_1", volume=1e-6),)
    with pytest.raises(ValueError, match="found an inner volume named 'chamber_1', expected a name of its own"):
        replace(table_1, collapse="dynamic", valve=lp.RotaryValve(ports=ports, inner_volumes=inner))


def test_several_inner_volumes_each_have_a_pressure_of_their_own(table_1):
    ports = []
    for port in table_1.valve.ports:
        ports += [replace(port, volume=name, area=port.area / 2) for name in ("left", "right")]
    inner = tuple(lp.InnerVolume(name=name, volume=2.05e-6) for name in ("left", "right"))
    machine = replace(table_1, valve=replace(table_1.valve, ports=tuple(ports), inner_volumes=inner))
    machine = machine.with_collapse("dynamic")
    assert machine.states == ("position", "velocity", "pressure_1", "pressure_left", "pressure_right")
    whole = lp.nonlinear_orbit(table_1.with_collapse("dynamic"), 4.0)
    found = lp.nonlinear_orbit(machine, 4.0)
    assert found.amplitude("position") == pytest.approx(whole.amplitude("position"), rel=1e-6)
    assert found.mean("pressure_left") == pytest.approx(whole.mean("pressure_valve"), rel=1e-6)
    model = lp.ltv_model(machine, 10.0, n_steps=40, operating_points="self-consistent")
    exact = lp.nonlinear_orbit(machine, 10.0).amplitude("position")
    assert model.orbit.amplitude("position") == pytest.approx(exact, rel=5e-3)


def test_volumes_shut_off_from_every_source_share_what_they_hold(table_1):
    """With the offset, the valve's volume is for a while open to the chamber alone, and then to nothing."""
    machine = replace(EXTENSIONS["dynamic, offset"], flow_paths=())
    start = np.array(machine.rest_state)
    # Supply 0 to 180 degrees, chamber -60 to 120: shut off from the supply, open to the chamber at 330 degrees.
    areas = areas_at(machine, math.radians(330))
    start[2], start[3] = 3e5, 1e5
    found = settled_states(areas[None], machine.record, start)[0]
    mean = (8.2e-6 * 3e5 + 4.1e-6 * 1e5) / 12.3e-6
    assert found[2:] == pytest.approx([mean, mean])


@pytest.mark.parametrize("name", EXTENSIONS)
def test_at_quasi_static_states_nothing_moves(name):
    machine = EXTENSIONS[name].without_dry_friction()
    stairs = staircase(machine, machine.openings.fractions.size - 1)
    states = settled_states(stairs.areas, machine.record, np.array(machine.rest_state))
    for state, areas in zip(states, stairs.areas, strict=True):
        found = rate(machine, state, areas)[2:] / machine.state_scales[2:]
        # Bisection to the last bit of a pressure, through flows with steep slopes. A real gas warms or cools a little
        # as it is throttled, which the quasi-static temperature leaves out.
        assert np.abs(found).max() < (0.1 if name.startswith("real") and "adiabatic" in name else 1e-3)


@pytest.mark.parametrize("gas", [AIR, lp.RealGas(fluid="Air"), lp.Liquid()], ids=["ideal", "real", "liquid"])
@pytest.mark.parametrize("ratio", [1e4, 1e6, 1e8, 1e10])
@pytest.mark.parametrize("narrow_first", [True, False])
def test_a_restriction_much_wider_than_the_other_is_none(table_1, gas, ratio, narrow_first):
    record = table_1.with_gas(gas).with_collapse("in_series").with_thermal("isothermal").as_record(GENERAL)
    law, medium = record["laws"][0], record["medium"]
    areas = (1e-6 / ratio, 1e-6) if narrow_first else (1e-6, 1e-6 / ratio)
    source = GasState(4e5, 293.15)
    for downstream in (1e5, 3.99e5, 4e5 * (1 - 3e-6)):
        chamber = GasState(downstream, 293.15)
        found = path_flow_slopes(*areas, source, chamber, law, medium)
        alone = path_flow_slopes(min(areas), math.inf, source, chamber, law, medium)
        np.testing.assert_allclose(found, alone, rtol=20 / ratio + 1e-6, atol=1e-7 * abs(alone[0]) / 4e5)


@pytest.mark.parametrize("gas", [AIR, lp.RealGas(fluid="Air")], ids=["ideal", "real"])
@pytest.mark.parametrize("collapse", ["minimum", "in_series"])
@pytest.mark.parametrize("share", [3e-6, 5e-5, 9e-5])
@pytest.mark.parametrize("reverse", [True, False])
def test_slopes_of_the_laminar_flow_equal_differences(table_1, gas, collapse, share, reverse):
    record = table_1.with_gas(gas).with_collapse(collapse).with_thermal("adiabatic").as_record(GENERAL)
    law, medium = record["laws"][0], record["medium"]
    areas = (3e-6, 2e-6) if collapse == "in_series" else (3e-6, math.inf)
    base = np.array([4e5, 4e5 * (1 - share), 280.0, 320.0])
    if reverse:
        base[:2] = base[1], base[0]

    def flow(values: np.ndarray) -> float:
        return path_flow(*areas, GasState(values[0], values[2]), GasState(values[1], values[3]), law, medium)

    steps = np.diag([0.02, 0.02, 0.1, 0.1])
    slopes = [(flow(base + step) - flow(base - step)) / (2 * step.max()) for step in steps]
    found = path_flow_slopes(*areas, GasState(base[0], base[2]), GasState(base[1], base[3]), law, medium)
    assert found[0] == pytest.approx(flow(base), rel=1e-12)
    np.testing.assert_allclose(found[1:3], slopes[:2], rtol=2e-5)
    assert found[3] == pytest.approx(slopes[3 if reverse else 2], rel=1e-5)


def test_what_stops_a_march_through_linear_steps_is_named_as_in_the_nonlinear_model():
    machine = lp.load_machine("hydraulic_4_2")
    machine = replace(machine, exhaust_pressure=1.5e5, gas=replace(machine.gas, entrained_gas=0.0))
    hot = EXTENSIONS["real, adiabatic"].with_gas(lp.RealGas(fluid="Air", temperature_range=(240.0, 330.0)))
    for one, frequency, error in ((machine, 5.0, CavitationError), (hot, 4.0, GasRangeError)):
        with pytest.raises(error) as exact:
            lp.nonlinear_orbit(one, frequency)
        with pytest.raises(error) as linear:
            lp.ltv_model(one, frequency, n_steps=8, operating_points="fitted")
        # "the liquid in chamber_1 would ...": the same volume, or the same range.
        assert str(linear.value).split(" at t = ")[0] == str(exact.value).split(" at t = ")[0]


# Linear models
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXTENSIONS)
def test_linear_models_converge_to_the_nonlinear_orbit(name):
    machine = EXTENSIONS[name]
    exact = lp.nonlinear_orbit(machine, 10.0, method=lp.DormandPrince(rtol=1e-10))
    errors = []
    for n_steps in (40, 160, 640):
        model = lp.ltv_model(machine, 10.0, n_steps=n_steps, operating_points="self-consistent", spacing="even")
        errors.append(abs(model.orbit.amplitude("position") / exact.amplitude("position") - 1))
        assert model.system.states == machine.states
    # Second order where smooth, about first where a pressure reaches a source's; errors may change their sign on the way.
    assert errors[2] < 0.1 * max(errors) + 2e-5
    assert errors[2] < 4e-4
    fitted = lp.ltv_model(machine, 10.0, n_steps=6, operating_points="fitted")
    assert fitted.orbit.amplitude("position") == pytest.approx(exact.amplitude("position"), rel=0.015)
    estimate = fitted.error_estimate
    error = fitted.orbit.amplitude("position") - exact.amplitude("position")
    assert estimate.amplitude("position") == pytest.approx(error, rel=0.25, abs=3e-4 * exact.amplitude("position"))


@pytest.mark.parametrize("name", ["adiabatic", "real, adiabatic"])
def test_the_order_is_two_where_the_motion_is_smooth(name):
    machine = EXTENSIONS[name].without_dry_friction()
    exact = lp.nonlinear_orbit(machine, 15.0, method=lp.DormandPrince(rtol=1e-11)).amplitude("position")
    errors = []
    for n_steps in (20, 40, 80, 160):
        model = lp.ltv_model(machine, 15.0, n_steps=n_steps, operating_points="self-consistent", spacing="even")
        errors.append(abs(model.orbit.amplitude("position") / exact - 1))
    order = -np.polyfit(np.log([20, 40, 80, 160]), np.log(errors), 1)[0]
    assert order > 1.8


@pytest.mark.parametrize("name", EXTENSIONS)
def test_the_papers_linear_models_are_built_and_stable(name):
    machine = EXTENSIONS[name]
    n_steps = 4 if "offset" in name else 2
    for model in (lp.lti_model(machine, 10.0), lp.ltv_model(machine, 10.0, n_steps=n_steps)):
        assert lp.floquet(model.system).is_stable
        assert math.isfinite(lp.steady_state(model.system).amplitude("position"))


@pytest.mark.parametrize("name", ["adiabatic", "dynamic", "hydraulic", "real"])
def test_multipliers_of_the_nonlinear_orbit_equal_those_of_a_fine_linear_model(name):
    machine = EXTENSIONS[name].without_dry_friction()
    exact = lp.orbit_floquet(machine, lp.nonlinear_orbit(machine, 15.0)).spectral_radius
    model = lp.ltv_model(machine, 15.0, n_steps=320, operating_points="self-consistent")
    assert lp.floquet(model.system).spectral_radius == pytest.approx(exact, rel=5e-3)


# Liquids
# --------------------------------------------------------------------------------------------------


def test_the_paper_is_right_that_linear_models_do_better_in_hydraulics(table_1):
    """Amplitudes without friction, by the paper's own models: root mean square of the errors over frequencies."""
    errors = {}
    for machine in (table_1, lp.load_machine("hydraulic_4_2")):
        free = machine.without_dry_friction()
        for frequency in (3.0, 5.0, 8.0, 10.0, 15.0):
            exact = lp.nonlinear_orbit(free, frequency).amplitude("position")
            models = {"lti": lp.lti_model(free, frequency), "ltv": lp.ltv_model(free, frequency)}
            for kind, model in models.items():
                found = lp.steady_state(model.system).amplitude("position")
                errors.setdefault((machine.name, kind), []).append(found / exact - 1)
    size = {key: math.sqrt(np.mean(np.square(found))) for key, found in errors.items()}
    for kind, least in (("lti", 0.05), ("ltv", 0.03)):
        assert size["Hydraulic 4/2", kind] < least
        assert size["Hydraulic 4/2", kind] < 0.3 * size["Kunt & Singh 1990", kind]


@pytest.mark.parametrize("duty", [0.3, 0.4, 0.5, 0.6])
def test_the_papers_model_of_a_hydraulic_drive_is_stable_and_near_at_every_duty(duty):
    """The change of the bulk modulus, times the rate at rest, would make it unstable below half."""
    machine = lp.load_machine("hydraulic_4_2").without_dry_friction().with_duty(duty)
    model = lp.ltv_model(machine, 5.0)
    assert lp.floquet(model.system).spectral_radius < 0.5
    exact = lp.nonlinear_orbit(machine, 5.0).amplitude("position")
    assert model.orbit.amplitude("position") == pytest.approx(exact, rel=0.025)


def test_temperatures_of_operating_points_are_those_of_the_cycle():
    """An adiabatic chamber is warm while it fills and cold while it empties; quasi-static, it would be neither."""
    model = lp.ltv_model(EXTENSIONS["adiabatic"], 10.0)
    filling, emptying = model.operating_points[:, 3]
    assert filling > 310
    assert emptying < 250
    assert "temperature_1" not in {held.state for held in model.held_back}


def test_a_liquid_that_would_cavitate_stops_with_its_name():
    machine = lp.load_machine("hydraulic_4_2")
    # Without entrained gas, which would give way.
    fast = replace(machine, exhaust_pressure=1.5e5, gas=replace(machine.gas, entrained_gas=0.0))
    with pytest.raises(lp.CavitationError, match=r"would cavitate at t = .*falls to the vapor pressure 2000 Pa"):
        lp.nonlinear_orbit(fast, 2.0)


# Bad input
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda one: one.with_thermal("warm"), "process: found 'warm'"),
        (lambda one: replace(one, valve=replace(one.valve, inner_volumes=())).with_collapse("dynamic"), "no size of"),
        (lambda one: one.with_collapse("point"), "collapse: found 'point'"),
        (lambda one: one.with_gas(lp.Liquid()).with_thermal(1.2), "a thermal process of a liquid"),
        (lambda one: one.with_gas(lp.Liquid()).with_thermal("adiabatic"), "a thermal process of a liquid"),
        (
            lambda one: replace(one.with_gas(lp.Liquid()), exhaust_pressure=1e3),
            "exhaust_pressure: found 1000 Pa, not above the liquid's vapor pressure",
        ),
        (lambda one: one.with_gas(lp.RealGas(fluid="Air", pressure_range=(0.5e5, 3e5))), "supply_pressure: found"),
        (
            lambda one: replace(one.cylinder, polytropic_exponent_1=1.2, energy_balance_1=lp.EnergyBalance()),
            "polytropic_exponent_1: found 1.2 beside energy_balance_1",
        ),
        (lambda one: lp.InnerVolume(volume=-1.0), "volume: found -1 m"),
        (
            lambda one: replace(one.valve, inner_volumes=(lp.InnerVolume(volume=1e-6, name="other"),)),
            "found the name 'other'",
        ),
        (lambda one: lp.FlowPath(source="chamber_1", chamber="chamber_1", area=1e-6), "the path's own chamber"),
        (
            lambda one: replace(one, flow_paths=(lp.FlowPath(source="chamber_2", chamber="chamber_1", area=1e-6),)),
            "found a path to 'chamber_2'",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(table_1, make, match):
    with pytest.raises(ValueError, match=match):
        make(table_1)


def test_a_start_outside_a_real_gass_range_is_refused_with_the_range():
    machine = EXTENSIONS["real, adiabatic"]
    with pytest.raises(ValueError, match="chamber_1 at 200000 Pa and 900 K, .* 175.89 to 527.67 K, the ranges of Air"):
        lp.simulate(machine, 4.0, 1, [0.0, 0.0, 2e5, 900.0])


def test_a_gas_that_leaves_its_range_says_so(table_1):
    narrow = lp.RealGas(fluid="Air", temperature_range=(285.0, 300.0))
    machine = table_1.with_collapse("dynamic").with_gas(narrow).with_thermal("adiabatic")
    with pytest.raises(lp.GasRangeError, match="the gas left the range of its properties at t = ") as caught:
        lp.nonlinear_orbit(machine, 4.0)
    # Of the two volumes, the one that left.
    assert min(abs(caught.value.temperature - edge) for edge in (285.0, 300.0)) < 1e-3


def test_the_balance_wants_an_orbit_of_the_same_machine(table_1):
    with pytest.raises(ValueError, match="orbit: found states position, velocity, pressure_1, expected"):
        lp.balance(EXTENSIONS["adiabatic"], lp.nonlinear_orbit(table_1, 4.0))


def test_balances_want_an_orbit_of_the_machine(table_1):
    orbit = lp.nonlinear_orbit(table_1, 4.0)
    for machine, other in ((table_1.with_supply_pressure(6e5), orbit), (table_1, lp.ltv_model(table_1, 4.0).orbit)):
        with pytest.raises(ValueError, match="to whose beginning the machine does not return"):
            lp.balance(machine, other)


def test_things_a_machine_cannot_be_are_named(table_1, double_acting):
    with pytest.raises(ValueError, match='collapse: found "dynamic" of a valve without inner volumes'):
        double_acting.with_collapse("dynamic")
    with pytest.raises(TypeError, match=r"medium: found 'Nitrogen', expected .*RealGas\(fluid=\"Nitrogen\"\)"):
        table_1.with_gas("Nitrogen")
    with pytest.raises(ValueError, match="process: found None, expected"):
        table_1.with_thermal(None)
    with pytest.raises(ValueError, match="cylinder.energy_balance_1: found a thermal process of a liquid"):
        table_1.with_gas(lp.Liquid()).with_thermal("adiabatic")
    with pytest.warns(UserWarning, match=r"gas.temperature: found 25 K, expected kelvin; was 25 degC meant"):
        table_1.with_gas(lp.Gas(temperature=25.0))
    with pytest.warns(UserWarning, match=r"cylinder.energy_balance_1.wall_temperature: found 20 K, expected kelvin"):
        table_1.with_thermal(lp.EnergyBalance(heat_transfer_coefficient=1.0, wall_area=1.0, wall_temperature=20.0))


def test_a_gas_that_leaves_its_table_is_named_with_its_volume(table_1):
    narrow = lp.RealGas(fluid="Air", temperature_range=(285.0, 300.0))
    with pytest.raises(GasRangeError, match=r"found chamber_1 at .* Pa and .* K, expected .*gas.temperature_range"):
        lp.nonlinear_orbit(table_1.with_gas(narrow).with_thermal(1.3), 4.0)


def test_paths_do_not_come_and_go_with_the_duty(table_1):
    for collapse in ("minimum", "in_series", "dynamic"):
        machine = table_1.with_collapse(collapse)
        assert len({len(machine.with_duty(duty).connections) for duty in (0.0, 0.5, 1.0)}) == 1


def test_the_default_steps_are_as_many_as_the_valve_has_positions(table_1):
    machine = table_1.with_collapse("dynamic").with_offset(math.radians(20))
    n_positions = lp.ltv_model(machine, 4.0).system.n_steps
    assert n_positions > 2
    with pytest.raises(ValueError, match=f"expected at least {n_positions}"):
        lp.ltv_model(machine, 4.0, n_steps=2)
    assert lp.ltv_model(machine, 4.0, rtol=0.05).system.n_steps >= n_positions
