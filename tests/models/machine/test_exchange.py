"""Another valve, another bore: what changes with them and what stays."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp

PARTS = lp.catalogue()
LOAD = lp.Load(mass=3.0)


@pytest.fixture(scope="module")
def drive():
    return lp.catalogue_drive(PARTS.cylinders[6], PARTS.valve("SMC SY3000"), stroke=0.1, load=LOAD, supply_pressure=7e5)


@pytest.mark.parametrize("name", ["SMC SY5000", "CKD M4GA1 5/3 closed", "CKD M3GA1 2 x 3/2"])
def test_a_valve_in_place_of_another_makes_the_drive_that_is_built_with_it(drive, name):
    valve = PARTS.valve(name)
    built = lp.catalogue_drive(PARTS.cylinders[6], valve, stroke=0.1, load=LOAD, supply_pressure=7e5)
    assert replace(lp.with_valve(drive, valve), name="") == replace(built, name="")


def test_a_bore_in_place_of_another_makes_the_drive_that_is_built_with_it(drive):
    larger = PARTS.cylinders[8]
    built = lp.catalogue_drive(larger, PARTS.valve("SMC SY3000"), stroke=0.1, load=LOAD, supply_pressure=7e5)
    found = lp.with_bore(drive, larger).cylinder
    for name in ("piston_area_1", "piston_area_2", "dead_volume_1", "dead_volume_2", "lower_stop", "upper_stop"):
        assert getattr(found, name) == pytest.approx(getattr(built.cylinder, name), rel=1e-12), name
    np.testing.assert_allclose(found.rod_areas, built.cylinder.rod_areas)


def test_a_bore_by_its_number_keeps_the_proportions(drive):
    found = lp.with_bore(drive, 0.064).cylinder
    assert found.piston_area_1 == pytest.approx(math.pi / 4 * 0.064**2)
    ratio = found.piston_area_1 / drive.cylinder.piston_area_1
    assert ratio == pytest.approx(4.0)
    assert found.piston_area_2 / drive.cylinder.piston_area_2 == pytest.approx(ratio)
    assert found.dead_volume_2 / drive.cylinder.dead_volume_2 == pytest.approx(ratio)


def test_switching_leaks_and_silencers_stay(drive):
    law, silencer = lp.ISO6358(sonic_conductance=1e-10), lp.ISO6358(sonic_conductance=2e-8)
    leak = lp.FlowPath(source="chamber_2", chamber="chamber_1", law=law)
    paths = lp.directional_paths("5/2", lp.ISO6358(sonic_conductance=1e-8), silencer=silencer)
    before = replace(drive, flow_paths=(*paths, leak)).with_pulses([(0.1, 1.0), (2.0, 4.0)])
    after = lp.with_valve(before, PARTS.valve("CKD M4GA1"))
    assert leak in after.flow_paths
    assert after.valve.pulses == before.valve.pulses
    for path in after.flow_paths[:-1]:
        assert (path.in_series is None) == (path.source == "supply")


def test_valves_that_do_not_fit(drive):
    with pytest.raises(ValueError, match=r'a "3/2" valve for one chamber, but .* feeds chamber_1 and chamber_2'):
        lp.with_valve(drive, PARTS.valve("SMC SX090 3/2"))
    with pytest.raises(ValueError, match="whose valve is no on-off valve"):
        lp.with_valve(lp.load_machine("kunt_singh_1990"), PARTS.valve("SMC SY3000"))
    with pytest.raises(ValueError, match="expected at most 1 m"):
        lp.with_bore(drive, 32.0)
    single = replace(
        drive,
        cylinder=lp.catalog_cylinder(bore=0.032, stroke=0.1, acting="push", clearance=0.1),
        flow_paths=lp.directional_paths("3/2", 5e-6),
    )
    assert lp.with_valve(single, PARTS.valve("SMC SX090 3/2")).flow_paths[0].law is not None
    with pytest.raises(ValueError, match=r'a "5/2" valve for both chambers, but .* feeds chamber_1 of chamber_1'):
        lp.with_valve(single, PARTS.valve("SMC SY3000"))
