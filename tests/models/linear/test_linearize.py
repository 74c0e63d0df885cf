"""The linearization (8) against finite differences of the nonlinear right-hand side, in every flow regime."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import ltvpneu as lp
from ltvpneu.models.linear.linearize import areas_at
from ltvpneu.models.machine.dynamics import state_rate
from tests.conftest import MACHINES

CRITICAL = lp.Gas().critical_pressure_ratio


def rate(machine: lp.Machine, state: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """The nonlinear right-hand side, dry friction of the sign of the velocity included."""
    found = np.empty(state.size)
    assert state_rate(state, areas, int(np.sign(state[1])), machine.record, found)
    return found


def difference(function, value: float, step: float) -> np.ndarray:
    """Central difference of sixth order."""
    weights = {1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
    return sum(w * (function(value + k * step) - function(value - k * step)) for k, w in weights.items()) / step


def differences(machine: lp.Machine, state: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Jacobian of the right-hand side over the state, by differences."""
    columns = []
    for i in range(state.size):

        def moved(value: float, i: int = i) -> np.ndarray:
            present = state.copy()
            present[i] = value
            return rate(machine, present, areas)

        # The rate is linear in the velocity, but for the sign of the dry friction, which a small step does not reach.
        step = {0: 1e-6, 1: 1e-3 if state[1] == 0 else 1e-2 * abs(state[1])}.get(i, 1e-5 * state[i])
        columns.append(difference(moved, state[i], step))
    return np.array(columns).T


def input_differences(machine: lp.Machine, state: np.ndarray, areas: np.ndarray) -> np.ndarray:
    from dataclasses import replace

    def at(index: int, value: float) -> np.ndarray:
        if index == 2:
            return rate(replace(machine, load=replace(machine.load, force=value)), state, areas)
        name = {0: "supply_pressure", 1: "exhaust_pressure", 3: "ambient_pressure"}[index]
        return rate(replace(machine, **{name: value}), state, areas)

    steps = (1e-5 * machine.supply_pressure, 1e-5 * machine.exhaust_pressure, 1.0, 1e-2 * machine.ambient_pressure)
    levels = machine.levels
    return np.array([difference(lambda v, i=i: at(i, v), levels[i], steps[i]) for i in range(4)]).T


def relative_error(found: np.ndarray, expected: np.ndarray, scales: np.ndarray) -> float:
    """Largest error of any entry, relative to the largest of its row in scaled coordinates: rounding acts on rows."""
    if found.shape[1] == scales.size:
        found, expected = found * scales, expected * scales
    size = np.max(np.abs(expected), axis=1, keepdims=True)
    return float(np.max(np.abs(found - expected) / np.where(size > 0, size, 1)))


def clear_of_borders(machine: lp.Machine, state: np.ndarray, areas: np.ndarray) -> bool:
    # A path open by a millionth drowns in the rounding of the other paths' flows.
    if ((areas > 0) & (areas < 1e-8)).any():
        return False
    for pressure in state[2:]:
        for source in (machine.supply_pressure, machine.exhaust_pressure):
            ratio = min(pressure, source) / max(pressure, source)
            if ratio > 1 - 1e-3 or abs(ratio - CRITICAL) < 1e-3:
                return False
    return True


states = st.tuples(
    st.floats(0.0, 0.03),
    st.floats(-1.0, 1.0),
    st.floats(0.3e5, 9e5),
    st.floats(0.3e5, 9e5),
    st.floats(0, 2 * math.pi),
)


@pytest.mark.parametrize("name", [n for n in MACHINES if "series" not in n])
@given(values=states)
def test_the_full_tangent_equals_differences_in_all_columns(name, values):
    machine = MACHINES[name]
    state = np.array(values[: len(machine.states)])
    areas = areas_at(machine, values[4])
    assume(clear_of_borders(machine, state, areas) and abs(state[1]) > 1e-3)
    found = lp.linearize(machine, state, angle=values[4], tangent="full")
    assert relative_error(found.A, differences(machine, state, areas), machine.state_scales) < 1e-6
    if machine.cylinder.polytropic_exponent_1 == 1:
        assert relative_error(found.B, input_differences(machine, state, areas), machine.state_scales) < 1e-6


@pytest.mark.parametrize("name", [n for n in MACHINES if "series" not in n])
@given(values=states)
def test_the_papers_tangent_equals_differences_at_rest_but_for_the_position(name, values):
    """Eq. (8): pressure columns, velocity column and B at rest; dry friction, without a derivative at rest, left out."""
    machine = MACHINES[name].without_dry_friction()
    state = np.array(values[: len(machine.states)])
    state[1] = 0.0
    areas = areas_at(machine, values[4])
    assume(clear_of_borders(machine, state, areas))
    found = lp.linearize(machine, state, angle=values[4], tangent="paper")
    expected = differences(machine, state, areas)
    assert relative_error(found.A[:, 1:], expected[:, 1:], machine.state_scales[1:]) < 1e-6
    assert (found.A[2:, 0] == 0).all()
    if machine.cylinder.polytropic_exponent_1 == 1:
        assert relative_error(found.B, input_differences(machine, state, areas), machine.state_scales) < 1e-6


@pytest.mark.parametrize("name", ["in series", "ramped in series"])
@pytest.mark.parametrize("pressure", [0.6e5, 1.3e5, 1.7e5, 2.5e5, 3.2e5, 3.9e5, 5e5])
def test_two_restrictions_in_series_have_the_tangent_of_their_common_flow(name, pressure):
    machine = MACHINES[name]
    state = np.array([0.02, 0.4, pressure])
    areas = areas_at(machine, 0.2)
    found = lp.linearize(machine, state, angle=0.2, tangent="full")
    # The common flow is solved for to rounding, which the difference magnifies.
    assert relative_error(found.A, differences(machine, state, areas), machine.state_scales) < 1e-6
    assert relative_error(found.B, input_differences(machine, state, areas), machine.state_scales) < 1e-6


@pytest.mark.parametrize("name", list(MACHINES))
@pytest.mark.parametrize("tangent", ["paper", "full"])
def test_the_model_agrees_with_the_machine_at_its_operating_point(name, tangent):
    machine = MACHINES[name].without_dry_friction()
    state = np.array([0.02, 0.0, 2.3e5, 3.1e5])[: len(machine.states)]
    found = lp.linearize(machine, state, angle=0.3, tangent=tangent)
    expected = rate(machine, state, areas_at(machine, 0.3))
    np.testing.assert_allclose(found.A @ state + found.f, expected, rtol=1e-9, atol=1e-9 * np.abs(found.f).max())


def test_the_papers_isothermal_model_has_no_remainder(table_1, double_acting):
    for machine in (table_1, double_acting):
        state = np.array([0.02, 0.1, 2.3e5, 3.1e5])[: len(machine.states)]
        assert (lp.linearize(machine, state).r == 0).all()


# Errata: each printed form fails where the corrected one holds
# ------------------------------------------------------------


def test_erratum_e3_and_e4_the_force_balance(table_1):
    """At equal pressures of 0.1 MPa the sides balance to 1.4 N, and the load accelerates as Newton says."""
    state = np.array([0.0, 0.0, 0.1e6])
    areas = areas_at(table_1, 0.1)
    acceleration = rate(table_1.without_dry_friction(), state, areas)[1]
    cylinder = table_1.cylinder
    net = (cylinder.piston_area_1 - cylinder.seal_friction_area) * 0.1e6
    net -= (cylinder.piston_area_2 + cylinder.seal_friction_area) * 0.1e6
    assert net == pytest.approx(1.4, abs=1e-9)
    assert acceleration == pytest.approx(net / table_1.load.mass, rel=1e-9)
    printed = (cylinder.piston_area_1 - cylinder.seal_friction_area) * 0.1e6
    printed += (cylinder.piston_area_2 + cylinder.seal_friction_area) * 0.1e6
    assert printed > 100
    # E3: as printed, (7a) sets the velocity, not the acceleration, to force over mass.
    assert rate(table_1.without_dry_friction(), state, areas)[0] == 0 != printed / table_1.load.mass


def test_erratum_e6_the_velocity_column(double_acting):
    """K_v1 needs the area, and chamber 2 shrinks as the position grows: entry (4,2) is positive."""
    machine = double_acting.without_dry_friction()
    state = np.array([0.01, 0.0, 2.3e5, 3.1e5])
    expected = differences(machine, state, areas_at(machine, 0.5))
    cylinder = machine.cylinder
    volume_1 = cylinder.dead_volume_1 + cylinder.piston_area_1 * 0.01
    volume_2 = cylinder.dead_volume_2 - cylinder.piston_area_2 * 0.01
    A = lp.linearize(machine, state, angle=0.5).A
    assert A[2, 1] == pytest.approx(-cylinder.piston_area_1 * 2.3e5 / volume_1, rel=1e-12)
    assert A[3, 1] == pytest.approx(+cylinder.piston_area_2 * 3.1e5 / volume_2, rel=1e-12)
    np.testing.assert_allclose(A[2:, 1], expected[2:, 1], rtol=1e-6)
    assert abs(-2.3e5 / volume_1 / expected[2, 1]) > 100
    assert np.sign(-cylinder.piston_area_2 * 3.1e5 / volume_2) != np.sign(expected[3, 1])


def test_erratum_e11_the_dead_volume_of_table_1(table_1):
    assert table_1.cylinder.dead_volume_1 == pytest.approx(0.5 * 0.0254**3, rel=1e-2)
    assert abs(0.82e-3 / (0.5 * 0.0254**3)) > 99


# Errors
# -------------------------------------------------------------------------------------------------------------------


def test_an_infinite_slope_is_refused_not_returned(table_1):
    with pytest.raises(ValueError, match="slope of the flow is infinite"):
        lp.linearize(table_1, [0.01, 0.0, 1e5], angle=4.0)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"state": [0.0, 0.0]}, r"state: found shape \(2,\), expected \(3\)"),
        ({"state": [0.0, math.nan, 2e5]}, r"state: found nan at index \(1,\)"),
        ({"state": [-1.0, 0.0, 2e5]}, "found a volume of chamber_1"),
        ({"state": [0.0, 0.0, -2e5]}, "found a pressure of chamber_1"),
        ({"state": [0.0, 0.0, 2e5], "angle": 0.0, "areas": [[1e-5, 1e-5], [1.0, 1.0]]}, "found both"),
        ({"state": [0.0, 0.0, 2e5], "areas": [1e-5]}, "areas: found"),
        ({"state": [0.0, 0.0, 2e5], "tangent": "half"}, "tangent: found 'half'"),
    ],
)
def test_bad_arguments_are_named(table_1, arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.linearize(table_1, **arguments)
