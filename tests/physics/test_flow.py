"""Flow laws: limits, slopes against differences, and the errata of (5) and (8k-n)."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ltvpneu.physics.flow import (
    intermediate_pressure,
    mass_flow,
    mass_flow_slopes,
    mass_flux,
    mass_flux_slope,
)
from ltvpneu.physics.gas import Gas, GasState

AIR = Gas().constants
GAMMA, R, T = 1.4, 287.05, 293.15
CRITICAL = (2 / (GAMMA + 1)) ** (GAMMA / (GAMMA - 1))
pressures = st.floats(0.5e5, 10e5)
areas = st.floats(1e-7, 1e-4)


def signed_flux(p_i: float, p_k: float) -> float:
    """Eq. (6): into chamber k from source i, per effective area."""
    return mass_flux(p_i, p_k, T, AIR) if p_i >= p_k else -mass_flux(p_k, p_i, T, AIR)


@given(pressures, pressures, st.floats(0.1, 10))
def test_mass_flux_is_homogeneous_of_degree_one_in_the_pressures(p_1, p_2, factor):
    up, down = max(p_1, p_2), min(p_1, p_2)
    # The root near equal pressures magnifies the rounding of the scaled pressures.
    assume(down < up * (1 - 1e-9))
    assert mass_flux(factor * up, factor * down, T, AIR) == pytest.approx(
        factor * mass_flux(up, down, T, AIR), rel=1e-6
    )


@given(pressures, st.floats(0, 1))
def test_mass_flux_falls_as_the_downstream_pressure_rises_and_is_never_negative(up, share):
    down = share * up
    assert mass_flux(up, down, T, AIR) >= mass_flux(up, down + (up - down) / 2, T, AIR) >= 0


def test_no_flow_between_equal_pressures_and_the_choked_constant_of_air():
    assert mass_flux(4e5, 4e5, T, AIR) == 0
    # 0.040415 sqrt(K) s/m is the textbook constant of air, with four printed digits.
    assert mass_flux(1.0, 0.2, 1.0, AIR) == pytest.approx(0.040415, abs=5e-7)


def test_mass_flux_of_eq_5_equals_its_formula_evaluated_plainly():
    up, down = 4.1e5, 3.3e5
    r = down / up
    plain = up * math.sqrt(2 * GAMMA / ((GAMMA - 1) * R * T) * (r ** (2 / GAMMA) - r ** ((GAMMA + 1) / GAMMA)))
    assert mass_flux(up, down, T, AIR) == pytest.approx(plain, rel=1e-14)


def test_mass_flux_keeps_its_digits_where_the_pressures_almost_agree():
    # Expansion near r = 1: M = sqrt(2 p dp / (R T)) (1 + O(dp / p)).
    assert mass_flux(1e5, 1e5 - 1e-4, T, AIR) == pytest.approx(math.sqrt(2 * 1e5 * 1e-4 / (R * T)), rel=1e-6)


@pytest.mark.parametrize("ratio", [0.0, 0.2, CRITICAL - 1e-3, CRITICAL + 1e-3, 0.7, 0.9, 1 - 1e-3])
def test_slope_over_the_downstream_pressure_equals_a_central_difference(ratio):
    up = 4.1e5
    down, h = ratio * up, 10.0
    low = max(down - h, 0.0)
    difference = (mass_flux(up, down + h, T, AIR) - mass_flux(up, low, T, AIR)) / (down + h - low)
    # Third derivative over the step, largest at the root near r = 1.
    assert mass_flux_slope(up, down, T, AIR) == pytest.approx(difference, rel=1e-4, abs=1e-12)


def test_slope_is_infinite_at_equal_pressures():
    assert mass_flux_slope(3e5, 3e5, T, AIR) == -math.inf


@given(areas, areas, pressures, pressures)
def test_the_pressure_between_two_restrictions_passes_the_same_flow_through_both(first, second, p_1, p_2):
    up, down = max(p_1, p_2), min(p_1, p_2)
    assume(down < 0.999 * up)
    middle = intermediate_pressure(first, second, up, down, T, AIR)
    assert down <= middle <= up
    into, out = first * mass_flux(up, middle, T, AIR), second * mass_flux(middle, down, T, AIR)
    # The flow's slope over the middle pressure bounds how well the two can agree in double precision.
    slope = abs(first * mass_flux_slope(up, middle, T, AIR)) + second * mass_flux(middle, down, T, AIR) / middle * 10
    slope += abs(second * mass_flux_slope(middle, down, T, AIR))
    assert abs(into - out) <= 1e-12 * max(into, out) + 1e-14 * up * min(slope, 1.0)


@given(areas, areas, pressures, pressures)
def test_flow_through_two_in_series_is_less_than_through_either_and_odd_in_direction(first, second, p_1, p_2):
    assume(abs(p_1 - p_2) > 10)
    a, b = GasState(p_1, T), GasState(p_2, T)
    flow = mass_flow(first, second, a, b, AIR)
    assert abs(flow) <= abs(mass_flow(first, math.inf, a, b, AIR)) * (1 + 1e-9)
    assert abs(flow) <= abs(mass_flow(second, math.inf, a, b, AIR)) * (1 + 1e-9)
    assert mass_flow(second, first, b, a, AIR) == pytest.approx(-flow, rel=1e-12)


@pytest.mark.parametrize("second", [math.inf, 0.4e-5])
@pytest.mark.parametrize(("p_i", "p_k"), [(4.1e5, 3.3e5), (4.1e5, 1.5e5), (1.0e5, 1.4e5), (1.0e5, 3.0e5)])
def test_slopes_of_the_flow_equal_central_differences_in_every_regime(p_i, p_k, second):
    first, h = 0.64e-5, 1.0

    def flow(source: float, chamber: float) -> float:
        return mass_flow(first, second, GasState(source, T), GasState(chamber, T), AIR)

    by_source, by_chamber = mass_flow_slopes(first, second, GasState(p_i, T), GasState(p_k, T), AIR)
    scale = abs(flow(p_i, p_k)) / max(p_i, p_k)
    assert by_source == pytest.approx((flow(p_i + h, p_k) - flow(p_i - h, p_k)) / (2 * h), rel=1e-7, abs=1e-7 * scale)
    assert by_chamber == pytest.approx((flow(p_i, p_k + h) - flow(p_i, p_k - h)) / (2 * h), rel=1e-7, abs=1e-7 * scale)


@given(pressures, pressures)
def test_euler_makes_the_forcing_linear_in_the_source_pressure(p_i, p_k):
    """Fact behind f_m = B_m u: alpha + beta pbar = (dM/dp_i) p_i."""
    assume(abs(p_i - p_k) > 1e-6 * p_i)
    source, chamber = GasState(p_i, T), GasState(p_k, T)
    by_source, by_chamber = mass_flow_slopes(1.0, math.inf, source, chamber, AIR)
    alpha = mass_flow(1.0, math.inf, source, chamber, AIR)
    assert alpha - by_chamber * p_k == pytest.approx(by_source * p_i, rel=1e-9, abs=1e-9 * abs(alpha))


# Errata: each printed form fails where the corrected one holds
# ------------------------------------------------------------


def test_erratum_e1_the_printed_factor_density_has_not_the_units_of_mass_flux():
    """Twice the units of length: a flux per area must not depend on them, nor p on which of rho R T = p is meant."""
    up, down = 4.1e5, 3.3e5
    r = down / up
    bracket = r ** (2 / GAMMA) - r ** ((GAMMA + 1) / GAMMA)
    printed = up / (R * T) * math.sqrt(2 * GAMMA / (R * T * (GAMMA - 1))) * bracket
    # Independent: isentropic expansion, mass flux = density times velocity at the throat.
    throat_density = up / (R * T) * r ** (1 / GAMMA)
    velocity = math.sqrt(2 * GAMMA / (GAMMA - 1) * R * T * (1 - r ** ((GAMMA - 1) / GAMMA)))
    assert mass_flux(up, down, T, AIR) == pytest.approx(throat_density * velocity, rel=1e-12)
    assert abs(printed / (throat_density * velocity) - 1) > 0.5


def test_erratum_e2_the_branches_meet_only_at_the_corrected_critical_ratio():
    def unchoked(r: float) -> float:
        return math.sqrt(2 * GAMMA / ((GAMMA - 1) * R * T) * (r ** (2 / GAMMA) - r ** ((GAMMA + 1) / GAMMA)))

    choked = mass_flux(1.0, 0.1, T, AIR)
    assert unchoked(Gas().critical_pressure_ratio) == pytest.approx(choked, rel=1e-14)
    printed = (2 / (GAMMA + 1)) ** (1 / (GAMMA - 1))
    assert abs(unchoked(printed) / choked - 1) > 0.01


@pytest.mark.parametrize(("p_i", "p_k"), [(4.1e5, 3.3e5), (4.1e5, 1.5e5)])
def test_erratum_e7_beta_of_an_inflow(p_i, p_k):
    difference = -(signed_flux(p_i, p_k + 1) - signed_flux(p_i, p_k - 1)) / 2
    beta = -mass_flow_slopes(1.0, math.inf, GasState(p_i, T), GasState(p_k, T), AIR)[1]
    assert beta == pytest.approx(difference, rel=1e-7, abs=1e-12)
    r, g = p_k / p_i, GAMMA
    if r > CRITICAL:
        numerator = 2 / g * r ** (2 - 1 / g) - (g + 1) / g * r ** (1 / g)
        printed = numerator / math.sqrt(2 * R * T * (g - 1) / g * (r ** (2 / g) - r ** ((g + 1) / g)))
    else:
        printed = math.sqrt(g / (R * T) * (2 / (g + 1)) ** ((g + 1) / (g - 1)))
    assert abs(printed - difference) > 0.1 * abs(printed)


@pytest.mark.parametrize(("p_i", "p_k"), [(1.0e5, 1.4e5), (1.0e5, 3.0e5)])
def test_erratum_e7b_alpha_and_beta_of_an_outflow(p_i, p_k):
    alpha = mass_flow(1.0, math.inf, GasState(p_i, T), GasState(p_k, T), AIR)
    beta = -mass_flow_slopes(1.0, math.inf, GasState(p_i, T), GasState(p_k, T), AIR)[1]
    outflow = mass_flux(p_k, p_i, T, AIR)
    difference = (mass_flux(p_k + 1, p_i, T, AIR) - mass_flux(p_k - 1, p_i, T, AIR)) / 2
    assert alpha == -outflow
    assert beta == pytest.approx(+difference, rel=1e-7)
    r, g = p_i / p_k, GAMMA
    if r > CRITICAL:
        # The printed braces are right, the heading's sign is not.
        braces = (2 * r ** (2 / g) - r ** ((g + 1) / g)) / math.sqrt(
            2 * R * T * g / (g - 1) * (r ** (2 / g) - r ** ((g + 1) / g))
        )
        assert beta == pytest.approx(braces, rel=1e-12)
    else:
        # A choked exhaust feels no source: alpha + beta pbar = 0, which the printed positive alpha breaks.
        assert alpha + beta * p_k == pytest.approx(0, abs=1e-9 * outflow)
        assert outflow + beta * p_k > outflow
    assert not np.isclose(beta, -difference)
