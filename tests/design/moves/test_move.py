"""Moves against brute force, the machine's own simulation, and what was asked."""

import math

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import root

import ltvpneu as lp
from ltvpneu import design
from ltvpneu.design.moves.search import MoveSearch
from ltvpneu.models.machine.dynamics import external_force
from ltvpneu.models.nonlinear.passage import passage, positions_of


@pytest.fixture(scope="module")
def table_1():
    return lp.load_machine("kunt_singh_1990")


@pytest.fixture(scope="module")
def quickest(table_1):
    return design.optimize_move(table_1, 0.02, 0.07)


def springless(kind="5/2", **valve):
    law = lp.ISO6358(sonic_conductance=0.7e-8, critical_pressure_ratio=0.3)
    own = lp.OnOffValve(duty=0.5, **valve)
    return lp.Machine(
        name="slide", supply_pressure=7.01e5, exhaust_pressure=1.01e5,
        cylinder=lp.catalog_cylinder(bore=0.032, rod=0.012, stroke=0.1, clearance=0.1),
        load=lp.Load(mass=3.0, dry_friction=20.0, stiction=35.0), valve=own,
        more_valves=(own,) if kind.startswith("5/3") else (), flow_paths=lp.directional_paths(kind, law),
    )  # fmt: skip


def test_table_1_in_the_least_time_equals_brute_force(table_1, quickest):
    """The first part on a grid, the two others by the two equations of rest: the least time that holds."""
    held = positions_of(table_1)
    on, off = held[True,], held[False,]
    start, scales = quickest.way.start, table_1.state_scales

    def of_first(first, guess):
        """The time of the move with that first part, where it ends at rest and is held; else infinite."""

        def rest(lasting):
            # What a solver tries may be shorter than nothing.
            durations = np.array([first, *np.maximum(np.abs(lasting), 1e-6)])
            return (passage([on, off, on], durations, start).unheld_end[0][:2] - [0.07, 0.0]) / scales[:2]

        found = root(rest, guess, tol=1e-9)
        lasting = np.abs(found.x)
        push = external_force(passage([on, off, on], np.array([first, *lasting]), start).end, table_1.record)
        held = found.success and abs(push) <= table_1.load.stiction * (1 + 1e-9)
        return (first + float(lasting.sum()) if held else math.inf), found.x

    guess, best, least = np.array([0.013, 0.008]), 0.0622, math.inf
    for width in (2e-3, 1e-4, 5e-6):
        for first in np.linspace(best - width, best + width, 41):
            time, guess = of_first(first, guess)
            if time < least:
                least, closest = time, first
        best = closest
    assert quickest.status == "optimal"
    assert quickest.n_switches == 2
    assert quickest.time == pytest.approx(least, rel=1e-4)
    assert quickest.time <= least * (1 + 1e-9)


def test_the_machine_itself_makes_the_move(table_1, quickest):
    """`simulate`, told the same pulses over one period, ends at the same place."""
    assert [position for (position,) in quickest.order] == [True, False, True]
    first, second = (2 * np.pi * quickest.switching_times / quickest.time).tolist()
    pulsed = table_1.with_pulses([(0.0, first), (second, 2 * np.pi * (1 - 1e-12))])
    response = lp.simulate(pulsed, 1 / quickest.time, 1, quickest.way.start)
    end = np.asarray(response.states)[:, -1]
    assert end == pytest.approx(quickest.end_state, rel=1e-5, abs=1e-5)
    assert quickest.end_state[0] == pytest.approx(0.07, abs=1e-7)
    assert abs(quickest.end_state[1]) < 1e-6
    assert np.asarray(quickest.response.states)[:, -1] == pytest.approx(quickest.end_state, rel=1e-9)


def test_a_search_takes_a_handful_of_simulations(table_1, quickest):
    """From switching times that are up to 20 % off; SLSQP with differences takes fifty to a hundred, or fails."""
    search = MoveSearch(table_1, 0.02, 0.07, None, (None, None, None, None), "time", None)
    search.limit(None, None, None)
    random = np.random.default_rng(0)
    for _ in range(6):
        search.n_simulations = 0
        found = search.best_of(quickest.order, [quickest.durations * random.uniform(0.8, 1.2, 3)])
        assert found.status == "optimal"
        assert found.time == pytest.approx(quickest.time, rel=1e-6)
        assert search.n_simulations <= 10


@pytest.mark.parametrize("way", [(0.07, 0.02), (0.03, 0.05)])
def test_moves_of_other_lengths_and_directions_end_as_asked(table_1, way):
    found = design.optimize_move(table_1, *way)
    assert found.status == "optimal"
    assert found.end_state[0] == pytest.approx(way[1], abs=1e-7)
    assert abs(external_force(found.end_state, table_1.record)) <= table_1.load.stiction * (1 + 1e-6)
    assert not found.broken


def test_bounds_on_the_way_are_kept(table_1, quickest):
    found = design.optimize_move(table_1, 0.02, 0.07, switches=3, hold=False, speed=0.9, maximum={"velocity": 0.95})
    assert found.status != "infeasible"
    assert found.figures["speed"] <= 0.9 * (1 + 1e-6)
    free = design.optimize_move(table_1, 0.02, 0.07, switches=1, hold=False)
    assert free.time < min(found.time, quickest.time)
    assert found.duals["speed"] >= 0


def test_an_objective_and_constraints_of_ones_own(table_1):
    found = design.optimize_move(
        table_1, 0.02, {"position": (0.06, 0.07), "velocity": 0.0}, switches=1,
        minimize=lambda move: move.time + 100 * move.air_mass(),
        constraints=lambda move: {"first": move.durations[0] >= 0.04, "calm": cp.abs(move.end("pressure_1")) <= 3e5},
    )  # fmt: skip
    assert found.status == "optimal"
    assert found.objective == pytest.approx(found.time + 100 * found.figures["air_mass"], rel=1e-9)
    assert found.durations[0] >= 0.04 - 1e-9
    assert found.end_state[0] == pytest.approx(0.06, abs=1e-7)
    assert "first" in found.duals


def test_constraints_may_be_of_parts_that_shorter_moves_do_not_have(table_1):
    found = design.optimize_move(
        table_1, 0.02, 0.07, switches=2, constraints=lambda move: {"last": move.durations[2] >= 0.01}
    )
    assert found.status == "optimal"
    assert found.durations[2] >= 0.01 - 1e-9
    with pytest.raises(lp.NotConvexError, match="convex"):
        design.optimize_move(table_1, 0.02, 0.07, minimize=lambda move: -cp.square(move.time))


def test_a_stroke_into_the_stop_takes_as_long_as_the_stroke():
    machine = springless()
    stroke = lp.stroke(machine, "out")
    found = design.optimize_move(machine, 0.0, 0.1, switches=0)
    # The stroke starts from chambers as the valve left them, and so does the move.
    assert found.time == pytest.approx(stroke.time, rel=1e-5)
    assert found.figures["impact_energy"] == pytest.approx(stroke.impact_energy, rel=1e-4)
    assert found.n_switches == 0


def test_braking_before_the_stop_spares_it(table_1):
    machine = springless()
    hard = design.optimize_move(machine, 0.0, 0.1, switches=0)
    found = design.optimize_move(machine, 0.0, 0.1, switches=2, impact_energy=0.1 * hard.figures["impact_energy"])
    assert found.status != "infeasible"
    assert found.figures["impact_energy"] <= 0.1 * hard.figures["impact_energy"] * (1 + 1e-6)
    assert found.time > hard.time


def test_two_coils_move_a_springless_drive_and_hold_it_with_the_valve_shut():
    machine = springless("5/3 closed", opening_delay=0.012, closing_delay=0.018)
    found = design.optimize_move(machine, 0.02, 0.07, switches=2)
    assert found.status in ("optimal", "stopped")
    assert found.end_state[0] == pytest.approx(0.07, abs=1e-7)
    assert len(found.commands) == 2
    # Commands come before what they do by the delay of what they do.
    times = np.concatenate([[0.0], found.switching_times])
    for told in found.commands:
        for command, on in told:
            assert np.min(np.abs(times - (command + (0.012 if on else 0.018)))) < 1e-12
    shut = found.end_state.copy()
    held = positions_of(springless("5/3 closed"))[False, False]
    assert passage([held], np.array([0.05]), shut).end[0] == pytest.approx(0.07, abs=1e-7)


def test_shortest_commands_are_kept(table_1):
    found = design.optimize_move(table_1, 0.02, 0.07, shortest_on=0.03, shortest_off=0.02, switches=2)
    assert found.status != "infeasible"
    assert found.durations[1] >= 0.02 - 1e-9


def test_a_move_that_is_out_of_reach_says_what_is_nearest(table_1):
    found = design.optimize_move(table_1, 0.02, 0.07, switches=0)
    assert found.status == "infeasible"
    assert found.broken
    assert "misses" in repr(found)
    assert abs(found.end_state[0] - 0.07) < 0.005


def test_bad_input_is_named(table_1):
    with pytest.raises(ValueError, match="no pressure between exhaust and supply holds"):
        design.optimize_move(table_1, 0.02, 0.2)
    with pytest.raises(ValueError, match="start: found 200 mm"):
        design.optimize_move(table_1, 0.2, 0.05)
    with pytest.raises(ValueError, match="between the end stops"):
        design.optimize_move(springless(), 0.0, 0.2)
    with pytest.raises(ValueError, match="'x', expected one of position"):
        design.optimize_move(table_1, 0.02, {"x": 0.1})
    with pytest.raises(ValueError, match='expected "time"'):
        design.optimize_move(table_1, 0.02, 0.07, minimize="noise")
    with pytest.raises(ValueError, match="switches"):
        design.optimize_move(table_1, 0.02, 0.07, switches=-1)
    with pytest.raises(ValueError, match="contradict"):
        design.optimize_move(table_1, 0.02, 0.07, maximum={"pressure_1": 2e5}, minimum={"pressure_1": 3e5})
    with pytest.raises(ValueError, match="signal: found 'preasure_1'.*did you mean"):
        design.optimize_move(table_1, 0.02, 0.07, constraints=lambda move: [move.end("preasure_1") <= 1e5])


def test_pictures(quickest):
    assert len(lp.plot(quickest).axes) == 4
