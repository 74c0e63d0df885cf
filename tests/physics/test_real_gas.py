"""Real gases: tables against CoolProp and an independent maximization, slopes against differences, and refusals."""

import math
import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar

from ltvpneu.errors import GasRangeError
from ltvpneu.physics import gas_table
from ltvpneu.physics.gas_table import (
    in_table,
    real_critical_ratio,
    real_flux,
    real_flux_slopes,
    real_properties,
)
from ltvpneu.physics.real_gas import RealGas

CoolProp = pytest.importorskip("CoolProp")

FLUIDS = ["Air", "Nitrogen", "Helium", "CO2"]
fluids = pytest.mark.parametrize("fluid", FLUIDS)


def states(gas: RealGas, n: int, seed: int) -> np.ndarray:
    """Pressures and temperatures inside the table, off its edges by the step of a difference."""
    shares = np.random.default_rng(seed).random((n, 2)) * 0.98 + 0.01
    low, high = np.transpose([gas.pressure_range, gas.temperature_limits])
    return low + shares * (high - low)


def looked_up(fluid: str, name: str, p: float, T: float) -> float:
    return CoolProp.CoolProp.PropsSI(name, "P", p, "T", T, fluid)


class Nozzle:
    """The maximum over throat pressures, by CoolProp's own flash at pressure and entropy."""

    def __init__(self, fluid: str, p: float, T: float) -> None:
        self.p = p
        self.state = CoolProp.AbstractState("HEOS", fluid)
        self.state.update(CoolProp.DmassT_INPUTS, looked_up(fluid, "D", p, T), T)
        self.h, self.s = self.state.hmass(), self.state.smass()

    def flux(self, throat: float) -> float:
        state = self.state
        state.update(CoolProp.PSmass_INPUTS, throat, self.s)
        state.update(CoolProp.DmassT_INPUTS, state.rhomass(), state.T())
        # dh = T ds + dp / rho takes away what the flash left of s and p: 1e-9, much of a small difference of pressure.
        h = state.hmass() + state.T() * (self.s - state.smass()) + (throat - state.p()) / state.rhomass()
        return state.rhomass() * math.sqrt(2 * (self.h - h))

    def largest(self, downstream: float) -> tuple[float, float]:
        """Flux, and the throat pressure where it is."""
        low = max(downstream, 0.3 * self.p)
        best = minimize_scalar(
            lambda throat: -self.flux(throat),
            bounds=(low, self.p * (1 - 1e-9)),
            method="bounded",
            options={"xatol": 1e-5 * self.p},
        )
        # The bounded search never tries its ends.
        return max((-best.fun, best.x), (self.flux(low), low))


@fluids
def test_density_and_energy_obey_maxwells_relation_though_their_series_know_nothing_of_each_other(fluid):
    gas = RealGas(fluid=fluid)
    for p, T in states(gas, 50, seed=1):
        found = real_properties(p, T, gas.table)
        # du/dp at constant T is -T dv/dT - p dv/dp. Slopes lose n^2 of the tolerance 2e-10, n = 20.
        expected = (T * found.rho_T + p * found.rho_p) / found.rho**2
        assert found.u_p == pytest.approx(expected, rel=0, abs=1e-7 * gas.specific_gas_constant * T / p)


@fluids
def test_flux_falls_with_the_downstream_pressure_and_does_not_jump_at_the_critical_ratio(fluid):
    gas = RealGas(fluid=fluid)
    for p, T in states(gas, 20, seed=2):
        critical = real_critical_ratio(p, T, gas.table)
        flows = [real_flux(p, share * p, T, gas.table) for share in np.linspace(critical, 1, 30)]
        assert (np.diff(flows) < 0).all()
        assert real_flux(p, 0.0, T, gas.table) == pytest.approx(flows[0], rel=1e-14)
        # The slope is zero there: a step of 1e-6 lowers the flow by (1e-6 / (1 - r_c))^2 / 2, some 2e-12.
        assert real_flux(p, (critical + 1e-6) * p, T, gas.table) == pytest.approx(flows[0], rel=5e-12)


@fluids
def test_density_and_energy_are_coolprops_to_the_stated_error(fluid):
    gas = RealGas(fluid=fluid)
    stated = gas.interpolation_error
    assert stated.density < 1e-8
    assert stated.energy < 1e-8
    for p, T in states(gas, 100, seed=3):
        found = real_properties(p, T, gas.table)
        RT = gas.specific_gas_constant * T
        # Twice what was found at 400 other states.
        assert found.rho == pytest.approx(looked_up(fluid, "D", p, T), rel=2 * stated.density)
        assert found.u == pytest.approx(looked_up(fluid, "U", p, T), rel=0, abs=2 * stated.energy * RT)


@fluids
def test_slopes_of_density_and_energy_are_coolprops(fluid):
    gas = RealGas(fluid=fluid)
    state = CoolProp.AbstractState("HEOS", fluid)
    D, U, P, T_ = CoolProp.iDmass, CoolProp.iUmass, CoolProp.iP, CoolProp.iT
    for p, T in states(gas, 20, seed=4):
        state.update(CoolProp.PT_INPUTS, p, T)
        found = real_properties(p, T, gas.table)
        RT = gas.specific_gas_constant * T
        # Scaled by rho, R T, p and T. First slopes lose n^2 of the tolerance 2e-10 and second ones n^4 / 3, n = 10 to 20,
        # at the very edge of the table.
        first = [
            (found.rho_p - state.first_partial_deriv(D, P, T_)) * p / found.rho,
            (found.rho_T - state.first_partial_deriv(D, T_, P)) * T / found.rho,
            (found.u_p - state.first_partial_deriv(U, P, T_)) * p / RT,
            (found.u_T - state.first_partial_deriv(U, T_, P)) * T / RT,
        ]
        second = [
            (found.rho_pp - state.second_partial_deriv(D, P, T_, P, T_)) * p**2 / found.rho,
            (found.rho_pT - state.second_partial_deriv(D, P, T_, T_, P)) * p * T / found.rho,
            (found.rho_TT - state.second_partial_deriv(D, T_, P, T_, P)) * T**2 / found.rho,
            (found.u_pp - state.second_partial_deriv(U, P, T_, P, T_)) * p**2 / RT,
            (found.u_pT - state.second_partial_deriv(U, P, T_, T_, P)) * p * T / RT,
            (found.u_TT - state.second_partial_deriv(U, T_, P, T_, P)) * T**2 / RT,
        ]
        assert_allclose(first, 0, atol=1e-7)
        assert_allclose(second, 0, atol=1e-5)


@fluids
def test_flux_is_the_maximum_over_throat_pressures_to_the_stated_error(fluid):
    gas = RealGas(fluid=fluid)
    stated = gas.interpolation_error
    assert stated.flux < 1e-7
    assert stated.critical_ratio < 1e-7
    ratios = np.random.default_rng(5).random(12)
    for (p, T), ratio in zip(states(gas, 12, seed=6), [*ratios[:10], 0.999, 0.2], strict=True):
        nozzle = Nozzle(fluid, p, T)
        expected, throat = nozzle.largest(ratio * p)
        # Twice what was found at 400 other states. The search leaves 1e-10 of the maximum: the square of its 1e-5.
        assert real_flux(p, ratio * p, T, gas.table) == pytest.approx(expected, rel=2 * stated.flux + 1e-9)
        choked = real_critical_ratio(p, T, gas.table)
        if ratio < choked - 1e-3:
            # The place of a flat maximum is known to the root of the digits of the flux.
            assert throat / p == pytest.approx(choked, abs=1e-4)


@fluids
def test_slopes_of_density_and_energy_equal_central_differences(fluid):
    gas = RealGas(fluid=fluid)
    h = 2e-5
    for p, T in states(gas, 20, seed=7):
        found = real_properties(p, T, gas.table)
        over_p, over_T = (
            np.subtract(real_properties(p + a, T + b, gas.table), real_properties(p - a, T - b, gas.table))
            / (2 * (a + b))
            for a, b in ((h * p, 0.0), (0.0, h * T))
        )
        value, by_p, by_T, _pp, _pT, _TT, u, u_by_p, u_by_T, *_ = range(12)
        rho, RT = found.rho, gas.specific_gas_constant * T
        pairs = [
            (found.rho_p, over_p[value], rho / p),
            (found.rho_T, over_T[value], rho / T),
            (found.rho_pp, over_p[by_p], rho / p**2),
            (found.rho_pT, over_p[by_T], rho / p / T),
            (found.rho_pT, over_T[by_p], rho / p / T),
            (found.rho_TT, over_T[by_T], rho / T**2),
            (found.u_p, over_p[u], RT / p),
            (found.u_T, over_T[u], RT / T),
            (found.u_pp, over_p[u_by_p], RT / p**2),
            (found.u_pT, over_p[u_by_T], RT / p / T),
            (found.u_pT, over_T[u_by_p], RT / p / T),
            (found.u_TT, over_T[u_by_T], RT / T**2),
        ]
        # h^2 times a third slope, 100 near carbon dioxide's dew line, and rounding of 1e-15 / h.
        for exact, difference, scale in pairs:
            assert exact == pytest.approx(difference, rel=0, abs=1e-7 * scale)


@fluids
@pytest.mark.parametrize("share", [-0.5, 0.05, 0.4, 0.8, 0.98])
def test_slopes_of_the_flux_equal_central_differences(fluid, share):
    gas = RealGas(fluid=fluid)
    h = 1e-5
    for p, T in states(gas, 10, seed=8):
        critical = real_critical_ratio(p, T, gas.table)
        down = p * (critical + (1 - critical) * share)
        flux, by_up, by_down, by_T = real_flux_slopes(p, down, T, gas.table)
        assert flux == pytest.approx(real_flux(p, down, T, gas.table), rel=1e-14)
        differences = [
            (real_flux(p + a, down + b, T + c, gas.table) - real_flux(p - a, down - b, T - c, gas.table))
            / (2 * (a + b + c))
            for a, b, c in ((h * p, 0.0, 0.0), (0.0, h * p, 0.0), (0.0, 0.0, h * T))
        ]
        scales = flux / np.array([p, p, T])
        # At share 0.98, where the flow is a root of (p - down) / p = 0.0094: (h / 0.0094)^2 / 8. And rounding of 1e-16 / h.
        assert_allclose([by_up, by_down, by_T] / scales, differences / scales, rtol=3e-7, atol=1e-8)


@fluids
def test_no_flow_and_infinite_slopes_between_equal_pressures(fluid):
    table = RealGas(fluid=fluid).table
    assert real_flux(4e5, 4e5, 293.15, table) == 0
    assert real_flux_slopes(4e5, 4e5, 293.15, table) == (0.0, math.inf, -math.inf, 0.0)
    # A pressure found by iteration may end a last digit above the one upstream: the root of 2e-16, not of a negative number.
    assert 0 < real_flux(4e5, math.nextafter(4e5, math.inf), 293.15, table) < 1e-4


@fluids
def test_flux_keeps_its_digits_where_the_pressures_almost_agree(fluid):
    table = RealGas(fluid=fluid).table
    # Expansion near r = 1: M = sqrt(2 rho dp) (1 + O(dp / p)). 2^-10 Pa is exact in the difference.
    dp = 2.0**-10
    rho = real_properties(1e5, 300.0, table).rho
    assert real_flux(1e5, 1e5 - dp, 300.0, table) == pytest.approx(math.sqrt(2 * rho * dp), rel=2e-8)


@fluids
def test_a_thin_gas_is_ideal(fluid):
    """At 1 kPa and 300 K the virial terms are below 1e-4 and the flow is the ideal one of the gamma at hand."""
    gas = RealGas(fluid=fluid, pressure_range=(500.0, 2e3))
    found = real_properties(1e3, 300.0, gas.table)
    assert found.rho * gas.specific_gas_constant * 300.0 / 1e3 == pytest.approx(1, abs=1e-4)

    def gamma(p: float, T: float) -> float:
        return looked_up(fluid, "C", p, T) / looked_up(fluid, "O", p, T)

    def ideal(g: float) -> float:
        return 1e3 * math.sqrt(g / (gas.specific_gas_constant * 300) * (2 / (g + 1)) ** ((g + 1) / (g - 1)))

    # gamma rises on the way to the throat, in carbon dioxide by 3 %: the flow is between those of its two ends.
    at_rest = gamma(1e3, 300.0)
    low, high = ideal(at_rest), ideal(gamma(500.0, 600.0 / (at_rest + 1)))
    assert low * (1 - 1e-4) <= real_flux(1e3, 0.0, 300.0, gas.table) <= high * (1 + 1e-4)


def test_helium_is_nearly_ideal_and_fills_more_than_its_share():
    gas = RealGas(fluid="Helium")
    assert gas.heat_capacity_ratio == pytest.approx(5 / 3, abs=1e-3)
    found = real_properties(10e5, 293.15, gas.table)
    Z = 10e5 / (found.rho * gas.specific_gas_constant * 293.15)
    assert 1.002 < Z < 1.01
    # Energy of a monatomic gas: 3/2 R T, up to a constant.
    assert found.u_T == pytest.approx(1.5 * gas.specific_gas_constant, rel=2e-3)


def test_choked_flow_of_air_at_4_bar_is_0_19_percent_above_the_ideal_gas():
    gas = RealGas(fluid="Air")
    gamma, R, p, T = 1.4, 287.05, 4.1e5, 293.0
    ideal = p * math.sqrt(gamma / (R * T) * (2 / (gamma + 1)) ** ((gamma + 1) / (gamma - 1)))
    # Digits as printed: 0.19 % and 0.52765.
    assert real_flux(p, 1e5, T, gas.table) / ideal - 1 == pytest.approx(0.0019, abs=5e-5)
    assert real_critical_ratio(p, T, gas.table) == pytest.approx(0.52765, abs=1e-5)


def test_ratios_of_air_at_standard_pressure():
    gas = RealGas(fluid="Air", temperature=300.0)
    # CoolProp's own, to all digits; r_c of the ideal gas of that gamma to its deviation from one.
    gamma = looked_up("Air", "C", 101325, 300) / looked_up("Air", "O", 101325, 300)
    assert gas.heat_capacity_ratio == pytest.approx(gamma, rel=1e-10)
    assert gas.critical_pressure_ratio == pytest.approx((2 / (gamma + 1)) ** (gamma / (gamma - 1)), rel=1e-3)
    assert gas.specific_gas_constant == pytest.approx(8.31451 / 0.02896546, rel=1e-12)


def test_by_default_carbon_dioxide_may_get_no_colder_than_a_nozzle_at_20_bar_allows():
    coldest, hottest = RealGas(fluid="CO2").temperature_limits
    # The isentrope from 20 bar meets the dew line at r_c from 272.4 K on; the table ends one per cent and a step above.
    assert 273 < coldest < 278
    assert hottest == pytest.approx(1.8 * 293.15)
    warmer = RealGas(fluid="CO2", pressure_range=(0.2e5, 8e5)).temperature_limits[0]
    assert warmer < coldest - 5


def test_equal_gases_share_one_read_only_table():
    one, two = RealGas(fluid="Air"), RealGas(fluid="Air", pressure_range=[20000, 2000000])
    assert one == two
    assert hash(one) == hash(two)
    assert one.table is two.table
    assert pickle.loads(pickle.dumps(one)).table is one.table
    assert one.table.dtype == np.float64
    assert one.table.ndim == 1
    with pytest.raises(ValueError, match="read-only"):
        one.table[0] = 1.0


def test_in_table_means_inside_both_ranges():
    table = RealGas(fluid="Nitrogen", temperature_range=(250.0, 400.0)).table
    assert in_table(0.2e5, 250.0, table)
    assert in_table(20e5, 400.0, table)
    assert not in_table(0.19e5, 300.0, table)
    assert not in_table(20.1e5, 300.0, table)
    assert not in_table(1e5, 249.0, table)
    assert not in_table(1e5, 401.0, table)
    assert not in_table(math.nan, 300.0, table)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fluid": "Nitrogne"}, r"fluid: found 'Nitrogne'.*nearest: Nitrogen"),
        ({"fluid": "Karbon dioxide"}, r"nearest: CarbonDioxide"),
        ({"fluid": "qqqqqq"}, r"nearest: Air, Nitrogen, Helium, CO2"),
        ({"fluid": "Nitrogen&Oxygen"}, r"fluid: found 'Nitrogen&Oxygen'.*only air"),
        ({"fluid": 5}, r"fluid: found 5"),
        ({"temperature": -20.0}, r"temperature: found -20 K"),
        ({"pressure_range": (6e5, 1e5)}, r"pressure_range: found 600000 to 100000 Pa, expected a range that rises"),
        ({"pressure_range": (0.0, 1e5)}, r"pressure_range: found 0 to 100000 Pa"),
        ({"pressure_range": 5e5}, r"pressure_range: found 500000.0, expected two numbers"),
        ({"pressure_range": (1e5, 2e5, 3e5)}, r"pressure_range: .*expected two numbers"),
        ({"pressure_range": (1e5, math.inf)}, r"pressure_range: .*expected two numbers.*finite"),
        ({"temperature_range": (400.0, 250.0)}, r"temperature_range: found 400 to 250 K"),
        ({"temperature_range": (-20.0, 60.0)}, r"temperature_range: found -20 to 60 K.*[Aa]bsolute"),
        ({"temperature_range": ("cold", 300.0)}, r"temperature_range: .*expected two numbers"),
    ],
)
def test_wrong_input_is_refused_with_its_name(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        RealGas(**{"fluid": "Air", **changes})
    assert not isinstance(caught.value, GasRangeError)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"temperature_range": (300.0, 400.0)}, r"temperature: found 293.15 K, expected 300 to 400 K"),
        ({"temperature": 3000.0}, r"ends at 2000 K"),
        ({"temperature": 30.0}, r"Air at .* 30 K: .*CoolProp finds none"),
        ({"pressure_range": (0.2e5, 300e5), "temperature_range": (250.0, 400.0)}, r"denser there than at its critical"),
        ({"fluid": "Water"}, r"Water at 20000 Pa and 293.15 K: expected a gas.*liquid"),
        ({"fluid": "CO2", "pressure_range": (1e5, 60e5)}, r"CO2 at 6e\+06 Pa and 293.15 K: .*liquid"),
        ({"fluid": "CO2", "temperature_range": (265.0, 400.0)}, r"CO2 at 2e\+06 Pa and 265 K: .*nozzle.*condenses"),
        ({"fluid": "CO2", "temperature_range": (230.0, 400.0)}, r"CO2 at .* 230 K: .*nozzle.*cools below 216.592 K"),
    ],
)
def test_what_is_no_gas_is_refused_with_its_state(changes, message):
    with pytest.raises(GasRangeError, match=message) as caught:
        RealGas(**{"fluid": "Air", **changes})
    assert caught.value.pressure > 0
    assert caught.value.temperature > 0


def test_a_range_too_rough_for_the_nodes_at_hand_is_refused(monkeypatch):
    monkeypatch.setattr(gas_table, "NODES", ((8, 6),))
    gas = replace(RealGas(fluid="CO2"), pressure_range=(0.3e5, 20e5))
    with pytest.raises(GasRangeError, match="series do not die away"):
        _ = gas.table


def test_without_coolprop_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "CoolProp", None)
    # A temperature that no other test has, for what was checked once is remembered.
    with pytest.raises(ImportError, match=r"pip install 'ltvpneu\[gas\]'"):
        RealGas(fluid="Air", temperature=291.0)


def test_a_vapour_far_below_one_atmosphere_is_taken_at_its_own_pressures(table_1):
    steam = RealGas(fluid="Water", temperature=350.0, pressure_range=(200.0, 800.0), temperature_range=(340.0, 400.0))
    assert steam.reference_pressure == 800.0
    assert steam.heat_capacity_ratio == pytest.approx(1.33, abs=0.01)
    machine = replace(table_1, gas=steam, supply_pressure=700.0, exhaust_pressure=300.0)
    assert machine.gas is steam
