"""What takes a machine says so when given something else."""

import pytest

import ltvpneu as lp
from ltvpneu import design


@pytest.mark.parametrize(
    "call",
    [
        lambda thing: lp.nonlinear_orbit(thing, 4.0),
        lambda thing: lp.simulate(thing, 4.0),
        lambda thing: lp.ltv_model(thing, 4.0),
        lambda thing: lp.lti_model(thing, 4.0),
        lambda thing: lp.attractors(thing, 4.0),
        lambda thing: lp.data_sheet(thing),
        lambda thing: lp.orbit_map(thing, [4.0], [0.5]),
        lambda thing: design.optimize_duty(thing, 4.0, minimize="air_use"),
        lambda thing: design.duty_map(thing, [0.4], [4.0]),
        lambda thing: design.duty_model(thing, 4.0),
        lambda thing: design.operating_box(thing, position=(0.02, 0.08)),
    ],
)
def test_a_name_or_a_system_in_place_of_a_machine_is_named(call):
    with pytest.raises(
        TypeError, match=r"machine: found str, expected a Machine; lp.load_machine\('kunt_singh_1990'\)"
    ):
        call("kunt_singh_1990")
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[1.0]], [1.0])
    with pytest.raises(TypeError, match="machine: found PeriodicSystem, expected a Machine$"):
        call(system)
