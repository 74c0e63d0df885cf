"""Smooth coefficients as steps: against an independent integrator, and where they are not smooth."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ltvpneu as lp


def _integrated(A, period, n, f=None):
    """Map over the period and the end from zero, by DOP853 at its tightest."""

    def rate(t, y):
        states = y.reshape(n, n + 1)
        found = np.asarray(A(t)) @ states
        if f is not None:
            found[:, -1] += f(t)
        return found.ravel()

    start = np.hstack([np.eye(n), np.zeros((n, 1))]).ravel()
    end = solve_ivp(rate, (0, period), start, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1].reshape(n, n + 1)
    return end[:, :n], end[:, -1]


def _blade(t, ratio=0.4, lock=8.0):
    """Flapping of a rotor blade in forward flight; its advance ratio and Lock number."""
    stiffness = 1.1**2 + lock / 8 * (4 / 3 * ratio * math.cos(t) + ratio**2 * math.sin(2 * t))
    return np.array([[0.0, 1.0], [-stiffness, -lock / 8 * (1 + 4 / 3 * ratio * math.sin(t))]])


def _mathieu(t):
    return np.array([[0.0, 1.0], [-1.0 - 0.4 * math.cos(t), 0.0]])


@pytest.mark.parametrize("A", [_blade, _mathieu])
@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9, 1e-11])
def test_the_tolerance_is_kept(A, rtol):
    system = lp.PeriodicSystem.from_function(A, 2 * math.pi, lambda t: [math.sin(t), 1.0], rtol=rtol)
    map_, end = _integrated(A, 2 * math.pi, 2, lambda t: np.array([math.sin(t), 1.0]))
    assert np.abs(lp.monodromy(system) - map_).max() < rtol * np.abs(map_).max()
    reached = lp.response(system, n_periods=1, initial_state=[0.0, 0.0]).states[:, -1]
    assert np.abs(reached - end).max() < 10 * rtol * np.abs(end).max()


def test_the_number_of_steps_grows_like_that_of_a_fourth_order_method():
    counts = [lp.PeriodicSystem.from_function(_blade, 2 * math.pi, rtol=r).n_steps for r in (1e-6, 1e-10)]
    assert 5 < counts[1] / counts[0] < 20


def test_inputs_are_taken_along():
    system = lp.PeriodicSystem.from_function(
        _blade, 2 * math.pi, lambda t: [0.0, math.cos(t)], B=lambda t: [[0.0], [math.cos(t)]]
    )
    assert system.inputs == ("u1",)
    # An input of one does what the same forcing does.
    doubled = lp.steady_state(system.with_levels([1.0])).initial_state
    np.testing.assert_allclose(doubled, 2 * lp.steady_state(system).initial_state, rtol=1e-10)


def test_a_jump_is_a_named_error_and_bad_coefficients_say_where():
    with pytest.raises(lp.NotConvergedError, match=r"the worst is at t = (1|0\.99999)"):
        lp.PeriodicSystem.from_function(lambda t: [[-1.0 if t < 1 else -2.0]], 2 * math.pi)
    with pytest.raises(ValueError, match=r"A: at t = 0 s: found nan at index \(0, 0\)"):
        lp.PeriodicSystem.from_function(lambda _: [[math.nan]], 1.0)
    with pytest.raises(ValueError, match=r"A: found shape \(1, 2\) at t = 0 s, expected a square matrix"):
        lp.PeriodicSystem.from_function(lambda _: [[1.0, 2.0]], 1.0)
    with pytest.raises(ValueError, match="period: found 0 s"):
        lp.PeriodicSystem.from_function(_blade, 0.0)


def test_natural_frequency_and_damping_are_those_of_the_poles_of_a_constant_system():
    system = lp.PeriodicSystem.from_matrices([[[0.0, 1.0], [-4.0, -0.8]]] * 2, [[0.0, 0.0]] * 2, [0.3, 0.4])
    found = lp.floquet(system)
    np.testing.assert_allclose(found.natural_frequencies, [2.0, 2.0])
    np.testing.assert_allclose(found.damping_ratios, [0.2, 0.2])


def test_systems_side_by_side_answer_each_to_its_own_inputs():
    one = lp.PeriodicSystem.from_matrices([[[-1.0]], [[-2.0]]], [[1.0], [0.0]], [0.3, 0.7], B=[[[1.0]]] * 2)
    two = lp.PeriodicSystem.from_matrices([[[-3.0]]], [[0.0]], [0.5], B=[[[2.0]]])
    both = lp.append(one, two)
    assert both.inputs == ("periodic_1_u1", "periodic_2_u1")
    assert both.n_states == 2
    orbit = lp.steady_state(both.with_levels([0.5, 3.0]))
    alone = lp.steady_state(one.with_levels([0.5])), lp.steady_state(two.with_levels([3.0]))
    np.testing.assert_allclose(orbit.initial_state, [x.initial_state[0] for x in alone], rtol=1e-12)
    found = lp.floquet(both).log_moduli
    # Two periods of the second are one of both.
    np.testing.assert_allclose(found, sorted([-1.7, -3.0], reverse=True), rtol=1e-12)


def test_selected_channels_keep_the_orbit_and_answer_as_before():
    rng = np.random.default_rng(2)
    A, B = rng.standard_normal((2, 3, 3)) - 3 * np.eye(3), rng.standard_normal((2, 3, 2))
    C, D = rng.standard_normal((2, 2, 3)), rng.standard_normal((2, 2, 2))
    whole = lp.PeriodicSystem.from_matrices(A, rng.standard_normal((2, 3)), [0.4, 0.6], B=B, C=C, D=D)
    whole = whole.with_levels([1.0, -2.0])
    part = whole.select(outputs=["y2"], inputs=[1])
    assert (part.inputs, part.outputs, part.levels.tolist()) == (("u2",), ("y2",), [-2.0])
    assert lp.steady_state(part).mean("y2") == pytest.approx(lp.steady_state(whole).mean("y2"), rel=1e-12)
    expected = lp.harmonic_transfer(whole, 2j, [0, 1])[:, 1:, 1:]
    np.testing.assert_allclose(lp.harmonic_transfer(part, 2j, [0, 1]), expected, rtol=1e-12)
    with pytest.raises(ValueError, match="outputs: found 'y3', expected some of y1, y2"):
        whole.select(outputs=["y3"])
    with pytest.raises(ValueError, match="inputs: found 2, expected some of u1, u2"):
        whole.select(inputs=[2])
    with pytest.raises(ValueError, match=r"inputs: found \[0, 'u1'\], expected each once"):
        whole.select(inputs=[0, "u1"])
    with pytest.raises(ValueError, match=r"outputs: found 'y1', expected a list of names, such as \['y1'\]"):
        whole.select(outputs="y1")


def test_outputs_of_smooth_systems():
    system = lp.PeriodicSystem.from_function(
        lambda t: [[-1.0 + 0.5 * np.cos(t)]],
        2 * np.pi,
        f=lambda t: [np.sin(t)],
        B=lambda t: [[1.0]],
        C=lambda t: [[1.0], [np.cos(t)]],
        D=lambda t: [[0.0], [np.sin(t)]],
    )
    assert system.outputs == ("y1", "y2")
    middles = system.switching_times[:-1] + system.durations / 2
    np.testing.assert_allclose(system.C[:, 1, 0], np.cos(middles), atol=system.durations.max() ** 2)
    np.testing.assert_allclose(system.D[:, 1, 0], np.sin(middles), atol=system.durations.max() ** 2)
    orbit = lp.steady_state(system)
    times = np.linspace(0, 2 * np.pi, 20001)[:-1]
    assert orbit.mean("y2") == pytest.approx(np.mean(np.cos(times) * orbit.at(times)[0]), rel=1e-3)
    with pytest.raises(ValueError, match=r"C: at t = .* found shape \(1, 2\)"):
        lp.PeriodicSystem.from_function(lambda t: [[-1.0]], 1.0, C=lambda t: [[1.0, 2.0]])
    with pytest.raises(ValueError, match="C: found 1 and 2 rows"):
        lp.PeriodicSystem.from_function(lambda t: [[-1.0]], 1.0, C=lambda t: [[1.0]] * (1 + (t > 0.5)))
