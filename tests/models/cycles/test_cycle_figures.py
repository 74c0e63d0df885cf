"""Figures of cycles and their derivatives against differences of whole cycles, and linear against nonlinear."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ltvpneu as lp
from ltvpneu.errors import NonUniqueOrbitError
from ltvpneu.models.cycles.figures import Figure
from ltvpneu.models.cycles.linear_cycles import LinearCycles
from ltvpneu.models.cycles.nonlinear_cycles import NonlinearCycles
from ltvpneu.models.machine.parameters import present_value

FIGURES = [
    Figure("mean", 0), Figure("minimum", 0), Figure("maximum", 0), Figure("maximum", 2), Figure("at", 0, 1.0),
    Figure("at", 1, 4.0), Figure("air_use"),
]  # fmt: skip


@pytest.fixture(scope="module")
def machine():
    return lp.load_machine("kunt_singh_1990")


def two_valves():
    """A double-acting drive whose sides are switched by valves of their own."""
    machine = lp.load_machine("double_acting_5_2")
    paths = tuple(
        lp.FlowPath(
            source=path.source,
            chamber=path.chamber,
            area=path.area,
            discharge_coefficient=path.discharge_coefficient,
            opening="on" if path.source == "supply" else "off",
            valve=int(path.chamber == "chamber_2"),
        )
        for path in machine.flow_paths
    )
    valves = lp.OnOffValve(duty=0.4, ramp=0.1), lp.OnOffValve(duty=0.45, ramp=0.1, start=3.0)
    return replace(machine, valve=valves[0], more_valves=valves[1:], flow_paths=paths)


def check(cycles, machine, frequency, names, rtol):
    settings = {name: present_value(machine, frequency, name) for name in names}
    found = cycles.figures(settings, FIGURES, names)
    for column, name in enumerate(names):
        step = 1e-4 * max(abs(settings[name]), 1e-3)
        up, down = (
            cycles.figures({**settings, name: settings[name] + side * step}, FIGURES, []).values for side in (1, -1)
        )
        slopes = (up - down) / (2 * step)
        sizes = np.abs(slopes) + 1e-3 * np.abs(found.values) / max(abs(settings[name]), 1.0)
        # A piston on a stop has a figure of zero.
        assert np.max(np.abs(found.jacobian[:, column] - slopes) / np.maximum(sizes, 1e-12)) < rtol, name
    return found


@pytest.mark.parametrize(
    ("frequency", "duty", "names", "mode", "steps"),
    [
        (8.0, 0.5, ["duty"], "fitted", 1),
        (15.0, 0.4, ["duty", "frequency", "supply_pressure", "load.mass"], "fitted", 1),
        (4.0, 0.4, ["duty", "frequency", "load.mass"], "self-consistent", 10),
        # Repeats every second period.
        (5.4, 0.86, ["duty"], "fitted", 2),
    ],
)
def test_derivatives_are_those_of_the_refitted_cycle(machine, frequency, duty, names, mode, steps):
    cycles = LinearCycles(machine.with_duty(duty), frequency, mode, steps)
    check(cycles, machine.with_duty(duty), frequency, names, 3e-4)


def test_derivatives_over_edges_of_several_pulses(machine):
    pulsed = machine.with_pulses([(0.1, 1.0), (1.7, 2.9), (4.1, 5.5)])
    names = ["on_1", "off_1", "on_2", "off_2", "on_3", "off_3"]
    found = check(LinearCycles(pulsed, 3.0), pulsed, 3.0, names, 3e-4)
    # All edges together only turn the cycle, to within what differences of single cells are right to.
    assert abs(found.jacobian[0].sum()) < 1e-5 * np.abs(found.jacobian[0]).max()
    assert abs(found.jacobian[6].sum()) < 1e-5 * np.abs(found.jacobian[6]).max()


def test_derivatives_over_the_phase_between_two_valves():
    machine = two_valves()
    check(LinearCycles(machine, 4.0, "fitted", 2), machine, 4.0, ["more_valves.0.start", "more_valves.0.duty"], 2e-3)


def proportional(last=0.3):
    machine = lp.load_machine("double_acting_5_2").without_dry_friction()
    angles, openings = (0.0, 0.7 * math.pi, 1.2 * math.pi), (-0.8, 1.0, last)
    return replace(machine, valve=lp.ProportionalValve(command=lp.Command(angles=angles, openings=openings)))


def test_derivatives_over_what_moves_the_pieces_without_being_an_edge():
    machine = proportional()
    names = ["valve.command.angles.1", "valve.command.openings.2", "flow_paths.0.discharge_coefficient"]
    check(LinearCycles(machine, 5.0, "fitted", 2), machine, 5.0, names, 3e-4)
    on_off = lp.load_machine("double_acting_5_2").without_dry_friction()
    vacuum = replace(on_off, ambient_pressure=0.0)
    check(LinearCycles(vacuum, 5.0, "fitted", 2), vacuum, 5.0, ["valve.ramp"], 3e-4)
    # Here the greatest pressure hangs on starts of cells, differenced over 1e-5, and pressures are marched to 1e-8.
    check(LinearCycles(on_off, 5.0, "fitted", 2), on_off, 5.0, ["valve.ramp"], 5e-3)


@pytest.mark.parametrize("kind", [LinearCycles, NonlinearCycles])
def test_a_point_of_a_command_at_its_limit_is_differentiated_from_one_side(kind):
    name, just_below = "valve.command.openings.1", 1.0 - 1e-5
    at_limit = kind(proportional(), 5.0).figures({name: 1.0}, FIGURES[:1], [name])
    below = kind(proportional(), 5.0).figures({name: just_below}, FIGURES[:1], [name])
    assert at_limit.jacobian[0, 0] == pytest.approx(below.jacobian[0, 0], rel=1e-2)


def test_many_steps_agree_with_the_nonlinear_machine(machine):
    machine = machine.with_duty(0.4)
    names = ["duty", "supply_pressure"]
    settings = {name: present_value(machine, 10.0, name) for name in names}
    linear = LinearCycles(machine, 10.0, "self-consistent", 80).figures(settings, FIGURES, names)
    nonlinear = NonlinearCycles(machine, 10.0).figures(settings, FIGURES, names)
    np.testing.assert_allclose(linear.values, nonlinear.values, rtol=2e-4)
    assert np.max(np.abs(linear.jacobian / nonlinear.jacobian - 1)) < 5e-3
    assert linear.spectral_radius == pytest.approx(nonlinear.spectral_radius, rel=1e-3)


def test_the_nonlinear_figures_are_those_of_the_orbit(machine):
    from ltvpneu import design

    machine = machine.with_pulses([(0.0, 1.5), (3.0, 5.0)])
    orbit = lp.nonlinear_orbit(machine, 4.0)
    values = NonlinearCycles(machine, 4.0).figures({}, FIGURES, []).values
    times = np.array([1.0, 4.0]) / (2 * math.pi * 4.0)
    at = orbit.at(times)
    wanted = [orbit.mean(0), orbit.minimum(0), orbit.maximum(0), orbit.maximum(2), at[0, 0], at[1, 1]]
    np.testing.assert_allclose(values[:6], wanted, rtol=1e-5, atol=1e-7)
    assert values[6] == pytest.approx(design.air_use(machine, orbit), rel=1e-5)


def test_extremes_within_pieces(machine):
    machine = machine.with_pulses([(0.0, 1.5), (3.0, 5.0)])
    figures = [Figure("maximum", 0, 0.0, piece) for piece in range(4)]
    for cycles in (LinearCycles(machine, 4.0, "fitted", 4), NonlinearCycles(machine, 4.0)):
        found = cycles.figures({}, figures, []).values
        orbit = lp.nonlinear_orbit(machine, 4.0)
        ends = machine.openings.fractions / 4.0
        for piece in range(4):
            times = np.linspace(ends[piece], ends[piece + 1] - 1e-12, 2001)
            assert found[piece] == pytest.approx(float(orbit.at(times)[0].max()), abs=2e-4)


def test_a_piston_held_by_stiction_has_no_figures(machine):
    for cycles in (LinearCycles(machine, 20.0), NonlinearCycles(machine, 20.0)):
        with pytest.raises(NonUniqueOrbitError, match="stiction holds"):
            cycles.figures({"duty": 0.7}, FIGURES, ["duty"])
