"""Dry friction that grows with the chambers' pressures, in every model."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.machine.piston import hold_of
from tests.models.twin import Twin

STEP = 1e-6


@pytest.fixture(scope="module")
def pressed(double_acting: lp.Machine) -> lp.Machine:
    """The drive with lip seals: 3.6 N and 1.64 N a bar on either side."""
    load = replace(double_acting.load, dry_friction=3.6, stiction=6.0, friction_area_1=16.4e-6, friction_area_2=16.4e-6)
    return replace(double_acting, load=load)


@pytest.fixture(scope="module")
def one_chamber(table_1: lp.Machine) -> lp.Machine:
    return replace(table_1, load=replace(table_1.load, dry_friction=4.0, stiction=6.0, friction_area_1=30e-6))


def test_friction_is_that_of_the_measured_line(pressed: lp.Machine) -> None:
    """NAPN lip seal of 25 mm: 3.6 N + 1.64 N/bar over the ambient pressure; here on both sides."""
    ambient = pressed.ambient_pressure
    state = np.array([0.0, 0.0, ambient + 3e5, ambient + 1e5])
    assert hold_of(state, pressed.record) == pytest.approx(6.0 + 16.4e-6 * 4e5)


@pytest.mark.parametrize("frequency", [9.0, 12.0])
def test_orbit_is_that_of_the_twin(pressed: lp.Machine, one_chamber: lp.Machine, frequency: float) -> None:
    for machine in (pressed, one_chamber):
        orbit = lp.nonlinear_orbit(machine, frequency)
        found = Twin(machine).orbit(frequency, orbit.n_periods, start=orbit.initial_state)
        assert found["closure"] < 2e-6
        for number, name in enumerate(machine.states):
            scale = machine.state_scales[number]
            assert orbit.maximum(name) == pytest.approx(found["max"][number], abs=1e-4 * scale)
            assert orbit.mean(name) == pytest.approx(found["mean"][number], abs=1e-4 * scale)


def test_friction_matters(pressed: lp.Machine) -> None:
    constant = replace(pressed, load=replace(pressed.load, friction_area_1=0.0, friction_area_2=0.0))
    amplitudes = [lp.nonlinear_orbit(machine, 12.0).amplitude("position") for machine in (pressed, constant)]
    assert amplitudes[0] < 0.98 * amplitudes[1]


@pytest.mark.parametrize("frequency", [8.0, 15.0])
def test_multipliers_are_those_of_differences(one_chamber: lp.Machine, frequency: float) -> None:
    orbit = lp.nonlinear_orbit(one_chamber, frequency, method=lp.DormandPrince(rtol=1e-12), tolerance=1e-11)
    found = np.sort(np.abs(lp.orbit_floquet(one_chamber, orbit).multipliers))
    method, scales = lp.DormandPrince(rtol=1e-12), one_chamber.state_scales
    columns = []
    for j in range(3):
        ends = []
        for sign in (1, -1):
            start = orbit.initial_state.copy()
            start[j] += sign * STEP * scales[j]
            ends.append(np.asarray(lp.simulate(one_chamber, frequency, 1, start, method=method).states)[:, -1])
        columns.append((ends[0] - ends[1]) / (2 * STEP * scales[j]) / scales * scales[j])
    expected = np.sort(np.abs(np.linalg.eigvals(np.array(columns).T)))
    assert found == pytest.approx(expected, abs=1e-4)


def test_fitted_model_tends_to_the_orbit(pressed: lp.Machine) -> None:
    orbit = lp.nonlinear_orbit(pressed, 8.0)
    errors = []
    for n_steps in (16, 64):
        model = lp.ltv_model(pressed, 8.0, n_steps=n_steps, operating_points="fitted")
        errors.append(abs(model.orbit.amplitude("position") / orbit.amplitude("position") - 1))
    assert errors[1] < 1e-3
    assert errors[1] < errors[0]


def test_stiction_band_is_where_the_seals_hold(one_chamber: lp.Machine) -> None:
    machine = replace(one_chamber, load=replace(one_chamber.load, stiction=25.0)).with_duty(0.7)
    band = lp.stiction_band(machine, 20.0)
    assert band.exists
    for place in (band.lowest, band.highest):
        inside, outside = (place + 1e-5 * side * (1 if place == band.lowest else -1) for side in (1, -1))
        start = machine.rest_state.copy()
        start[0] = inside
        orbit = lp.nonlinear_orbit(machine, 20.0, start)
        assert orbit.amplitude("position") < 1e-9
        start[0] = outside
        assert abs(lp.nonlinear_orbit(machine, 20.0, start).mean("position") - outside) > 1e-7


def test_sensitivity_is_that_of_differences(pressed: lp.Machine) -> None:
    name, step = "load.friction_area_1", 1e-9
    found = lp.nonlinear_sensitivity(pressed, 8.0, [name]).amplitude("position", name)
    sides = [
        lp.nonlinear_orbit(
            replace(pressed, load=replace(pressed.load, friction_area_1=16.4e-6 + side * 1e3 * step)),
            8.0,
            method=lp.DormandPrince(rtol=1e-11),
        ).amplitude("position")
        for side in (1, -1)
    ]
    assert found == pytest.approx((sides[0] - sides[1]) / (2e3 * step), rel=2e-2)
    assert found < 0


def test_without_dry_friction_no_seal_rubs(pressed: lp.Machine) -> None:
    free = pressed.without_dry_friction()
    assert not free.has_dry_friction
    assert hold_of(np.array([0.0, 0.0, 6e5, 6e5]), free.record) == 0.0
    alone = replace(pressed, load=replace(pressed.load, dry_friction=0.0, stiction=0.0))
    assert alone.has_dry_friction
    state = np.array([0.0, 0.0, 4e5, 3e5])
    assert hold_of(state, alone.record) > 0
    assert np.isfinite(external_force(state, alone.record))


def test_areas_that_take_friction_below_zero_are_refused(pressed: lp.Machine) -> None:
    with pytest.raises(ValueError, match="less friction at the exhaust pressure"):
        replace(pressed, exhaust_pressure=0.2e5, load=replace(pressed.load, friction_area_1=1e-4))
    with pytest.raises(ValueError, match="friction_area_1: found -1"):
        replace(pressed.load, friction_area_1=-1.0)
