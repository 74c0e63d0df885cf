"""Steps that end at a threshold, against an independent integrator with its own events, and against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp

L, C, R, T, DUTY = 10e-6, 100e-6, 12.0, 5e-5, 0.583


def boost(supply: float = 5.0, load: float = R, duty: float = DUTY, guess: float = 0.2) -> lp.PeriodicSystem:
    """Switch on; off while the diode conducts; off without current. States: current, voltage."""
    idle, flows = [[0.0, 0.0], [0.0, -1 / (load * C)]], [[0.0, -1 / L], [1 / C, -1 / (load * C)]]
    durations = np.array([duty, guess, 1 - duty - guess]) * T
    forcing = [[supply / L, 0.0], [supply / L, 0.0], [0.0, 0.0]]
    return lp.PeriodicSystem.from_matrices([idle, flows, idle], forcing, durations)


DIODE = {1: ("z1", 0.0)}


def simulated_boost(state: np.ndarray, supply: float = 5.0) -> np.ndarray:
    """The state one period later, by an integrator that looks for the diode's instant itself."""

    def stops(_t: float, z: np.ndarray) -> float:
        return z[0]

    stops.terminal, stops.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    options = {"rtol": 1e-12, "atol": 1e-13}
    on = solve_ivp(lambda _t, z: [supply / L, -z[1] / (R * C)], (0, DUTY * T), state, **options).y[:, -1]
    flowing = solve_ivp(
        lambda _t, z: [(supply - z[1]) / L, (z[0] - z[1] / R) / C], (DUTY * T, T), on, events=stops, **options
    )
    off = np.array([0.0, flowing.y[1, -1]])
    idle = solve_ivp(lambda _t, z: [0.0, -z[1] / (R * C)], (flowing.t[-1], T), off, **options)
    return idle.y[:, -1]


@pytest.mark.parametrize("guess", [0.2, 0.01, 0.4])
def test_a_boost_converter_in_discontinuous_conduction(guess: float) -> None:
    found = lp.with_state_events(boost(guess=guess), DIODE)
    orbit, multipliers = lp.steady_state(found), lp.floquet(found)
    assert orbit.mean("z2") == pytest.approx(18.6596, abs=5e-5)
    np.testing.assert_allclose(simulated_boost(orbit.initial_state), orbit.initial_state, rtol=1e-9, atol=1e-9)
    assert multipliers.log_moduli[1] == -np.inf
    step = 1e-4
    aside = np.array([0.0, step])
    slope = (simulated_boost(orbit.initial_state + aside) - simulated_boost(orbit.initial_state - aside))[1]
    assert multipliers.multipliers[0].real == pytest.approx(slope / (2 * step), rel=1e-6)
    assert found.durations.sum() == pytest.approx(T, rel=1e-14)
    assert found.durations[0] == pytest.approx(DUTY * T, rel=1e-14)


def _volts(**changes: float) -> float:
    return lp.steady_state(lp.with_state_events(boost(**changes), DIODE)).mean("z2")


def test_derivatives_of_the_orbit_are_differences() -> None:
    sensitivity = lp.sensitivity(lp.with_state_events(boost(), DIODE)).of_mean("z2")
    by_supply = (_volts(supply=5.01) - _volts(supply=4.99)) / 0.02
    assert np.sum(sensitivity.by_forcing[:2, 0]) / L == pytest.approx(by_supply, rel=1e-4)
    by_duty = (_volts(duty=DUTY + 1e-4) - _volts(duty=DUTY - 1e-4)) / 2e-4
    # A longer first step shortens the last: the diode's instant moves by itself.
    found = sensitivity.by_duration
    assert (found[0] - found[2]) * T == pytest.approx(by_duty, rel=1e-4)
    by_load = (_volts(load=R + 1e-3) - _volts(load=R - 1e-3)) / 2e-3
    assert np.sum(sensitivity.by_matrix[:, 1, 1]) / (R**2 * C) == pytest.approx(by_load, rel=1e-4)


def impact_oscillator() -> lp.PeriodicSystem:
    """A mass on a spring, pushed for half of each period, that bounces off a wall at z1 = 0.5 with 60 % of its speed."""
    swing = [[0.0, 1.0], [-4.0, -0.3]]
    free = lp.PeriodicSystem.from_matrices([swing] * 3, [[0.0, 6.0], [0.0, 6.0], [0.0, -2.0]], [0.5, 0.4, 1.6])
    return free.with_jumps([np.diag([1.0, -0.6]), np.eye(2), np.eye(2)])


def simulated_impact(state: np.ndarray) -> tuple[np.ndarray, float]:
    def hits(_t: float, z: np.ndarray) -> float:
        return z[0] - 0.5

    hits.terminal, hits.direction = True, 1  # pyright: ignore[reportFunctionMemberAccess]
    options = {"rtol": 1e-12, "atol": 1e-13}

    def pushed(_t: float, z: np.ndarray) -> list[float]:
        return [z[1], -4 * z[0] - 0.3 * z[1] + 6]

    to_wall = solve_ivp(pushed, (0, 0.9), state, events=hits, **options)
    back = to_wall.y[:, -1] * [1, -0.6]
    after = solve_ivp(pushed, (to_wall.t[-1], 0.9), back, **options).y[:, -1]
    end = solve_ivp(lambda _t, z: [z[1], -4 * z[0] - 0.3 * z[1] - 2], (0.9, 2.5), after, **options)
    return end.y[:, -1], float(to_wall.t[-1])


def test_an_impact() -> None:
    found = lp.with_state_events(impact_oscillator(), {0: ([1.0, 0.0], 0.5)}, initial_state=[-1.0, 0.0])
    orbit = lp.steady_state(found)
    after, instant = simulated_impact(orbit.initial_state)
    np.testing.assert_allclose(after, orbit.initial_state, rtol=1e-8, atol=1e-9)
    assert found.durations[0] == pytest.approx(instant, rel=1e-9)
    step, columns = 1e-5, []
    for direction in np.eye(2):
        ahead, behind = (simulated_impact(orbit.initial_state + sign * step * direction)[0] for sign in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    np.testing.assert_allclose(lp.monodromy(found), np.array(columns).T, rtol=1e-6, atol=1e-8)


def test_two_thresholds_in_one_period() -> None:
    """A tank between two levels: fills until 1, drains until 0.25, and rests."""
    steps = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-2.0]], [[0.0]]], [[2.0], [0.0], [0.0]], [0.3, 0.3, 9.4])
    found = lp.with_state_events(steps, {0: ("z1", 1.0), 1: ("z1", 0.25)})
    np.testing.assert_allclose(
        found.durations, [np.log(1.75), np.log(4) / 2, 10 - np.log(1.75) - np.log(2)], rtol=1e-12
    )
    assert list(lp.floquet(found).log_moduli) == [-np.inf]


def test_a_threshold_that_is_not_reached_is_named() -> None:
    # With a small load resistance the current flows throughout.
    with pytest.raises(lp.NotConvergedError, match=r"step 1 does not reach \+1 z1 = 0 in the time"):
        lp.with_state_events(boost(load=0.5), DIODE)


@pytest.mark.parametrize(
    ("events", "says"),
    [
        ({3: ("z1", 0.0)}, "found step 3, expected 0 to 2"),
        ({2: ("z1", 0.0)}, "found one at the end of step 2 and none that takes up its time"),
        ({1: ("z3", 0.0)}, "found 'z3', expected one of z1, z2"),
        ({1: ([1.0], 0.0)}, r"events\[1\]: c: found shape \(1,\)"),
        ({1: ("z1", np.nan)}, r"events\[1\]: level: found nan"),
        ({}, "events: found none"),
        ({1: "z1"}, r"events\[1\]: found 'z1', expected \(c, level\)"),
    ],
)
def test_bad_events(events: dict[int, tuple[str, float]], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        lp.with_state_events(boost(), events)


def test_what_is_no_mapping_or_grows_without_bound() -> None:
    with pytest.raises(TypeError, match="events: found list, expected a mapping"):
        lp.with_state_events(boost(), [("z1", 0.0)])  # pyright: ignore[reportArgumentType]
    runaway = lp.PeriodicSystem.from_matrices([[[900.0]], [[900.0]]], [[1.0], [1.0]], [1.0, 1.0])
    with pytest.raises(lp.NotConvergedError):
        lp.with_state_events(runaway, {0: ("z1", -5.0)}, initial_state=[1.0])


def test_other_functions_take_the_linearized_system() -> None:
    found = lp.with_state_events(boost(), DIODE)
    assert lp.floquet(found).is_stable
    driven = replace(found, B=np.array([[[1 / L], [0.0]], [[1 / L], [0.0]], [[0.0], [0.0]]]), inputs=("supply",), levels=np.zeros(1), D=np.zeros((3, 2, 1)))  # fmt: skip
    # At frequency zero: how the mean voltage follows the supply, as by the derivative.
    gain = lp.harmonic_transfer(driven, 0.0)[0, 1, 0].real
    assert gain == pytest.approx((_volts(supply=5.01) - _volts(supply=4.99)) / 0.02, rel=1e-4)
