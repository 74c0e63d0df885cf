"""Machines by their data sheets against the twin, which has the flow law written out once more."""

from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from tests.conftest import by_data_sheet
from tests.models.twin import Twin


@pytest.fixture(scope="module")
def drive(double_acting: lp.Machine) -> lp.Machine:
    return by_data_sheet(double_acting)


@pytest.mark.parametrize("frequency", [4.0, 15.0])
def test_orbit_is_that_of_the_twin(drive: lp.Machine, frequency: float) -> None:
    orbit = lp.nonlinear_orbit(drive, frequency)
    found = Twin(drive).orbit(frequency, orbit.n_periods, start=orbit.initial_state)
    assert found["closure"] < 1e-6
    for number, name in enumerate(drive.states):
        scale = drive.state_scales[number]
        assert orbit.mean(name) == pytest.approx(found["mean"][number], abs=1e-4 * scale)
        assert orbit.maximum(name) == pytest.approx(found["max"][number], abs=1e-4 * scale)


def test_nozzles_critical_ratio_makes_the_nozzles_orbit(double_acting: lp.Machine) -> None:
    b = lp.Gas().critical_pressure_ratio
    paths = []
    for path in double_acting.flow_paths:
        unit = lp.ISO6358(sonic_conductance=1e-8, critical_pressure_ratio=b)
        law = replace(unit, sonic_conductance=1e-8 * path.effective_area / unit.area)
        paths.append(replace(path, area=None, discharge_coefficient=1.0, law=law))
    drive = replace(double_acting, flow_paths=tuple(paths))
    by_law, nozzle = lp.nonlinear_orbit(drive, 10.0), lp.nonlinear_orbit(double_acting, 10.0)
    assert by_law.amplitude("position") == pytest.approx(nozzle.amplitude("position"), rel=3e-3)


def test_linear_model_has_the_slopes_of_the_law(drive: lp.Machine) -> None:
    """The fitted cycle of many steps tends to the machine's own orbit."""
    orbit = lp.nonlinear_orbit(drive, 10.0)
    errors = []
    for n_steps in (16, 64):
        model = lp.ltv_model(drive, 10.0, n_steps=n_steps, operating_points="fitted")
        errors.append(abs(model.orbit.amplitude("position") - orbit.amplitude("position")))
    assert errors[1] < 1e-4 * orbit.amplitude("position")
    assert errors[1] < errors[0]


def test_check_valve_lets_through_one_way(double_acting: lp.Machine) -> None:
    law = lp.ISO6358(sonic_conductance=1e-8)
    shut = replace(law, sonic_conductance=0.0)
    paths = tuple(
        lp.FlowPath(source=p.source, chamber=p.chamber, law=law, law_back=shut, opening=p.opening)
        if p.source == "supply"
        else replace(p, opening="always")
        for p in double_acting.flow_paths
    )
    machine = replace(double_acting, flow_paths=paths, valve=lp.OnOffValve(duty=0.5))
    assert np.isfinite(lp.nonlinear_orbit(machine, 10.0).mean("position"))
    # Its supply fails: nothing flows back into it, the chambers empty through the exhaust alone.
    empty = replace(machine, supply_pressure=machine.exhaust_pressure)
    start = machine.rest_state.copy()
    start[2:] = 4e5
    pressures = lp.simulate(empty, 10.0, 20, start).outputs[2:]
    assert pressures[:, -1] == pytest.approx([machine.exhaust_pressure] * 2, rel=1e-6)


def test_law_and_area_exclude_each_other() -> None:
    law = lp.ISO6358(sonic_conductance=1e-8)
    with pytest.raises(ValueError, match="area, law: found both"):
        lp.FlowPath(source="supply", chamber="chamber_1", area=1e-6, law=law)
    with pytest.raises(ValueError, match="area, law: found neither"):
        lp.FlowPath(source="supply", chamber="chamber_1")
    with pytest.raises(ValueError, match="law_back: found it beside an area"):
        lp.FlowPath(source="supply", chamber="chamber_1", area=1e-6, law_back=law)


def test_liquid_takes_no_law_of_gases(double_acting: lp.Machine) -> None:
    with pytest.raises(ValueError, match="found a law of gases"):
        by_data_sheet(double_acting).with_gas(lp.Liquid())
