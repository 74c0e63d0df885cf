"""A liquid's density, bulk modulus and flow."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import ltvpneu as lp
from ltvpneu.physics.liquid import liquid_flow_slopes, liquid_properties

OILS = [lp.Liquid(), lp.Liquid(entrained_gas=0.0), lp.Liquid(bulk_modulus_slope=0.0), lp.Liquid(entrained_gas=0.05)]
oils = st.sampled_from(OILS)
pressures = st.floats(0.2e5, 300e5)


def sixth(function, x: float, h: float) -> float:
    weights = {1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
    return sum(w * (function(x + k * h) - function(x - k * h)) for k, w in weights.items()) / h


@given(oil=oils, pressure=pressures)
def test_the_derivatives_of_the_density_equal_differences(oil, pressure):
    def density(p: float) -> float:
        return liquid_properties(p, oil.table).rho

    def slope(p: float) -> float:
        return liquid_properties(p, oil.table).rho_p

    found = liquid_properties(pressure, oil.table)
    # The density changes by some 1e-9 of itself over such a step, near rounding: a wider step for less of it.
    assert found.rho_p == pytest.approx(sixth(density, pressure, 2e-2 * pressure), rel=1e-4)
    assert found.rho_pp == pytest.approx(
        sixth(slope, pressure, 1e-3 * pressure), rel=1e-5, abs=1e-9 * found.rho_p / 1e5
    )


def test_without_gas_the_bulk_modulus_is_the_liquids_own():
    oil = lp.Liquid(entrained_gas=0.0)
    assert oil.effective_bulk_modulus(101325.0) == pytest.approx(1.4e9)
    assert oil.effective_bulk_modulus(201e5 + 1325) == pytest.approx(1.4e9 + 10 * 200e5, rel=1e-9)
    assert liquid_properties(101325.0, oil.table).rho == 860.0


def test_entrained_gas_softens_the_oil_at_low_pressure_and_less_so_at_high():
    """K_eff = v / (sum of v_i / K_i), the gas with K = n p: Merritt's series of springs."""
    oil, p = lp.Liquid(entrained_gas=0.01), 20e5
    liquid = 0.99 * (1 + 10 * (p - 101325) / 1.4e9) ** -0.1
    gas = 0.01 * (101325 / p) ** (1 / 1.4)
    series = (liquid + gas) / (liquid / (1.4e9 + 10 * (p - 101325)) + gas / (1.4 * p))
    assert oil.effective_bulk_modulus(p) == pytest.approx(series, rel=1e-12)
    assert oil.effective_bulk_modulus(2e5) < 0.05e9
    assert oil.effective_bulk_modulus(200e5) > 1.2e9


def test_the_flow_is_turbulent_far_from_equal_pressures_and_laminar_near():
    oil, area = lp.Liquid(), 1e-6
    flow = liquid_flow_slopes(area, 100e5, 50e5, oil.table)[0]
    density = liquid_properties(100e5, oil.table).rho
    assert flow == pytest.approx(area * math.sqrt(2 * density * 50e5), rel=1e-4)
    small, tiny = (liquid_flow_slopes(area, 50e5, 50e5 - fall, oil.table)[0] for fall in (20.0, 10.0))
    assert small == pytest.approx(2 * tiny, rel=1e-4)
    # Where the turbulent law has the critical Reynolds number, both laws have a part: 2^(-1/4) of it is left.
    diameter = math.sqrt(4 * area / math.pi)
    fall = (150 * 0.0275 / diameter) ** 2 / (2 * 860)
    found = liquid_flow_slopes(area, 50e5, 50e5 - fall, oil.table)[0]
    turbulent = area * math.sqrt(2 * liquid_properties(50e5, oil.table).rho * fall)
    assert found == pytest.approx(2**-0.25 * turbulent, rel=1e-9)


@given(oil=oils, up=pressures, share=st.floats(0.0, 1.0), area=st.floats(1e-8, 1e-5))
def test_the_flows_slopes_equal_differences(oil, up, share, area):
    down = up * share
    _, by_up, by_down = liquid_flow_slopes(area, up, down, oil.table)
    size = liquid_flow_slopes(area, up, 0.0, oil.table)[0] / up
    step = max(1.0, 1e-4 * (up - down))

    def over_up(p: float) -> float:
        return liquid_flow_slopes(area, p, down, oil.table)[0]

    def over_down(p: float) -> float:
        return liquid_flow_slopes(area, up, p, oil.table)[0]

    assert by_up == pytest.approx(sixth(over_up, up, step), rel=1e-5, abs=1e-6 * size)
    assert by_down == pytest.approx(sixth(over_down, down, step), rel=1e-5, abs=1e-6 * size)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"bulk_modulus": -1e9}, "bulk_modulus: found -1e.09 Pa"),
        ({"density": 0.0}, "density: found 0"),
        ({"entrained_gas": 1.0}, "entrained_gas: found 1, expected a share"),
        ({"viscosity": 32e-9}, "viscosity: found 3.2e-08 Pa s.*kinematic"),
        ({"vapor_pressure": 0.0}, "vapor_pressure: found 0"),
        ({"bulk_modulus": 1e5, "bulk_modulus_slope": 10.0}, "bulk modulus falls to zero above vacuum"),
        ({"gas_exponent": 0.0}, "gas_exponent: found 0"),
    ],
)
def test_impossible_liquids_are_refused(arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.Liquid(**arguments)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (
            {"heat_transfer_coefficient": 10.0},
            "wall_area, wall_temperature: found none beside heat_transfer_coefficient",
        ),
        ({"heat_transfer_coefficient": 10.0, "wall_area": 1e-3}, "wall_temperature: found none beside"),
        ({"wall_temperature": 300.0}, "heat_transfer_coefficient, wall_area: found none"),
        ({"heat_transfer_coefficient": -1.0}, "heat_transfer_coefficient: found -1"),
        (
            {"heat_transfer_coefficient": 1.0, "wall_area": 1.0, "wall_temperature": -3.0},
            "wall_temperature: found -3 K",
        ),
    ],
)
def test_heat_transfer_needs_all_its_data(arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.EnergyBalance(**arguments)
