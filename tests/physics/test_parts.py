"""Gas, cylinder, friction, load: their limits and their checks."""

import math

import pytest

from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.friction import holding_force, slip_direction
from ltvpneu.physics.gas import Gas, polytropic_temperature
from ltvpneu.physics.load import Load


def test_a_polytropic_process_keeps_p_v_to_the_n():
    """(3) and (4): with the mass fixed, p V^n is constant."""
    n, p_a, T_a, R, mass = 1.25, 1e5, 293.15, 287.05, 1e-5

    def volume(p: float) -> float:
        return mass * R * polytropic_temperature(p, n, T_a, p_a) / p

    assert 3e5 * volume(3e5) ** n == pytest.approx(p_a * volume(p_a) ** n, rel=1e-13)
    assert polytropic_temperature(5e5, 1.0, T_a, p_a) == T_a


def test_stiction_holds_in_both_directions_erratum_e5():
    """The printed condition F_e <= F_s would hold a piston against any negative force."""
    hold = holding_force(13.3, 26.6)
    assert [slip_direction(force, hold, hold) for force in (-30.0, -26.6, 0.0, 26.6, 30.0)] == [
        -1,
        0,
        0,
        0,
        1,
    ]
    printed_sticks = -30.0 <= 26.6
    assert printed_sticks
    assert slip_direction(-30.0, hold, hold) != 0


def test_dry_friction_above_stiction_holds_too():
    assert holding_force(20.0, 10.0) == 20.0
    assert slip_direction(15.0, math.inf, 10.0) == 1
    assert slip_direction(-1e9, math.inf, 10.0) == 0


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Gas(heat_capacity_ratio=1.0), "heat_capacity_ratio: found 1"),
        (lambda: Gas(temperature=-1.0), "temperature: found -1 K"),
        (lambda: Gas(specific_gas_constant=math.inf), "specific_gas_constant: found inf"),
        (lambda: Load(mass=0.0), "mass: found 0 kg, expected a finite number above zero$"),
        (lambda: Load(mass=1.0, spring_stiffness=-1.0), "spring_stiffness: found -1 N/m"),
        (lambda: Load(mass=1.0, stiction=math.nan), "stiction: found nan N"),
        (lambda: Cylinder(piston_area_1=1e-3, piston_area_2=1e-3, dead_volume_1=-1e-6), "dead_volume_1: found -1e-06"),
        (lambda: Cylinder(piston_area_1=0.0, piston_area_2=1e-3, dead_volume_1=1e-6), "piston_area_1: found 0"),
        (lambda: Cylinder(piston_area_1=1e-3, piston_area_2=1e-3, dead_volume_1=None), "found neither"),
        (
            lambda: Cylinder(piston_area_1=1e-3, piston_area_2=1e-3, dead_volume_1=1e-6, polytropic_exponent_1=-0.5),
            "polytropic_exponent_1: found -0.5",
        ),
        (
            lambda: Cylinder(piston_area_1=1e-3, piston_area_2=1e-3, dead_volume_1=1e-6, lower_stop=1.0, upper_stop=0.0),
            "expected the lower below the upper",
        ),
        (
            lambda: Cylinder(piston_area_1=1e-3, piston_area_2=1e-3, dead_volume_1=1e-6, lower_stop=-0.01),
            "dead_volume_1 at the lower stop",
        ),
    ],
)  # fmt: skip
def test_impossible_quantities_are_refused_by_name(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_a_string_is_not_a_number():
    with pytest.raises(TypeError, match="mass: found '1 kg' of type str"):
        Load(mass="1 kg")  # type: ignore[arg-type]
