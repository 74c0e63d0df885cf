"""The periodic core: laws, twins, limits and exact numbers; no pneumatics."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import ltvpneu as lp
from tests.periodic.strategies import systems


def plain_monodromy(system: lp.PeriodicSystem) -> np.ndarray:
    total = np.eye(system.n_states)
    for A, T in zip(system.A, system.durations, strict=True):
        total = expm(A * T) @ total
    return total


@given(systems(damped=False))
def test_the_determinant_of_the_monodromy_matrix_is_liouvilles(system):
    expected = sum(float(np.trace(A)) * T for A, T in zip(system.A, system.durations, strict=True))
    assert np.sum(lp.floquet(system).log_moduli) == pytest.approx(expected, abs=1e-6 * (1 + abs(expected)))


@given(systems())
def test_multipliers_do_not_depend_on_the_starting_step(system):
    A, f, T = list(system.A), list(system.f), list(system.durations)
    shifted = lp.PeriodicSystem.from_matrices(A[1:] + A[:1], f[1:] + f[:1], T[1:] + T[:1])
    a, b = lp.floquet(system).multipliers, lp.floquet(shifted).multipliers
    # A defective pair moves by the root of the rounding error.
    np.testing.assert_allclose(np.poly(a), np.poly(b), atol=1e-12)


@given(systems(), st.floats(0.1, 0.9))
def test_splitting_a_step_changes_nothing(system, share):
    A, f, T = list(system.A), list(system.f), list(system.durations)
    split = lp.PeriodicSystem.from_matrices([A[0], *A], [f[0], *f], [share * T[0], (1 - share) * T[0], *T[1:]])
    np.testing.assert_allclose(lp.monodromy(split), lp.monodromy(system), atol=1e-13)
    a, b = lp.steady_state(system), lp.steady_state(split)
    for name in system.states:
        assert a.mean(name) == pytest.approx(b.mean(name), abs=1e-12)
        assert a.maximum(name) == pytest.approx(b.maximum(name), abs=1e-10)


@given(systems(), arrays(float, (3,), elements=st.sampled_from([1e-3, 1.0, 1e5])))
def test_units_of_the_states_do_not_matter(system, scale):
    A = [scale[:, None] * a / scale for a in system.A]
    f = [scale * x for x in system.f]
    other = lp.PeriodicSystem.from_matrices(A, f, system.durations)
    np.testing.assert_allclose(
        lp.steady_state(other).initial_state / scale, lp.steady_state(system).initial_state, atol=1e-11
    )
    for row, name in enumerate(system.states):
        assert lp.steady_state(other).amplitude(name) / scale[row] == pytest.approx(
            lp.steady_state(system).amplitude(name), abs=1e-11
        )


@given(systems())
def test_the_orbit_closes_and_superposition_holds_in_the_forcing(system):
    orbit = lp.steady_state(system)
    doubled = lp.PeriodicSystem.from_matrices(list(system.A), list(2 * system.f), system.durations)
    np.testing.assert_allclose(lp.steady_state(doubled).step_states, 2 * orbit.step_states, atol=1e-12)
    response = lp.response(system, n_periods=1, initial_state=orbit.initial_state)
    np.testing.assert_allclose(response.states[:, -1], orbit.initial_state, atol=1e-12)


@given(systems(damped=False))
def test_monodromy_equals_the_product_of_exponentials(system):
    plain = plain_monodromy(system)
    np.testing.assert_allclose(lp.monodromy(system), plain, atol=1e-12 * max(1, np.abs(plain).max()))


@given(systems())
def test_extremes_and_means_equal_those_of_dense_samples(system):
    orbit = lp.steady_state(system)
    # Just inside each step: states do not jump, but samples at a boundary belong to the next step.
    samples = orbit.at(np.linspace(0, orbit.period, 4001)[:-1])
    # A peak at a switch may be steep on both sides.
    peaks = np.concatenate([samples, orbit.step_states.T], axis=1)
    for row, name in enumerate(system.states):
        size = np.abs(samples[row]).max() + 1e-9
        assert orbit.maximum(name) >= samples[row].max() - 1e-12 * size
        assert orbit.minimum(name) <= samples[row].min() + 1e-12 * size
        assert orbit.maximum(name) <= peaks[row].max() + 1e-3 * size
        assert orbit.mean(name) == pytest.approx(np.mean(samples[row]), abs=3e-3 * size)


def test_an_extreme_between_samples_of_a_fast_decay_is_found():
    """y = e^-t - e^-1000t peaks at ln(1000)/999 s of a step of 10 s."""
    system = lp.PeriodicSystem.from_matrices([[[-1.0, 0.0], [0.0, -1000.0]]], [[1.0, 1000.0]], [10.0], C=[[[1.0, 1.0]]])
    switched = lp.PeriodicSystem.from_matrices(
        [np.diag([-1.0, -1000.0])] * 2, [[1.0, 0.0], [0.0, 1000.0]], [10.0, 10.0], C=[[[1.0, 1.0]]] * 2
    )
    assert lp.steady_state(system).amplitude("y1") == pytest.approx(0, abs=1e-12)
    # During the second step y = a e^-t + 1 - e^-1000t, and its peak is where the derivative vanishes.
    a = (1 - math.exp(-10)) / (1 - math.exp(-20))
    t = math.log(1000 / a) / 999
    assert lp.steady_state(switched).maximum("y1") == pytest.approx(
        1 + a * math.exp(-t) - math.exp(-1000 * t), rel=1e-12
    )


def test_a_swinging_step_is_sampled_finely_enough():
    system = lp.PeriodicSystem.from_matrices([[[-0.1, 50.0], [-50.0, -0.1]]] * 2, [[1.0, 0.0], [-1.0, 0.0]], [3.0, 3.0])
    orbit = lp.steady_state(system)
    samples = orbit.at(np.linspace(0, 6, 200001)[:-1])
    assert orbit.maximum("z1") == pytest.approx(samples[0].max(), rel=1e-5)
    assert orbit.maximum("z1") >= samples[0].max() * (1 - 1e-12)


def test_response_and_orbit_equal_solve_ivp_restarted_at_each_switch():
    rng = np.random.default_rng(5)
    A = [a - 4 * np.eye(3) for a in rng.normal(size=(3, 3, 3))]
    f, T = list(rng.normal(size=(3, 3))), [0.3, 0.05, 0.7]
    system = lp.PeriodicSystem.from_matrices(A, f, T)
    z = np.array([1.0, -2.0, 0.5])
    response = lp.response(system, n_periods=2, initial_state=z)
    for _ in range(2):
        for a, b, t in zip(A, f, T, strict=True):
            z = solve_ivp(lambda _t, y, a=a, b=b: a @ y + b, (0, t), z, method="DOP853", rtol=1e-12, atol=1e-12).y[
                :, -1
            ]
    np.testing.assert_allclose(response.states[:, -1], z, atol=1e-10)
    for _ in range(30):
        for a, b, t in zip(A, f, T, strict=True):
            z = solve_ivp(lambda _t, y, a=a, b=b: a @ y + b, (0, t), z, method="DOP853", rtol=1e-12, atol=1e-12).y[
                :, -1
            ]
    np.testing.assert_allclose(lp.steady_state(system).initial_state, z, atol=1e-10)


# Exact numbers
# ------------------------------------------------------------------------------------------------------------


def test_a_short_pulse_is_not_missed():
    """x' = -x + u, a pulse of height 100 over 1 % of the period: z0 = 100 (1 - e^-.01) e^-.52 / (1 - e^-1)."""
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 3, [[0.0], [100.0], [0.0]], [0.47, 0.01, 0.52])
    expected = 100 * (1 - math.exp(-0.01)) * math.exp(-0.52) / (1 - math.exp(-1))
    orbit = lp.steady_state(system)
    assert orbit.initial_state[0] == pytest.approx(expected, rel=1e-13)
    assert orbit.mean("z1") == pytest.approx(1.0, rel=1e-13)


def test_multipliers_of_a_stiff_machine_like_system_against_50_digits():
    A = [
        [[0, 1, 0], [-1200, -25, 3.5e-4], [0, -7e6, -300.0]],
        [[0, 1, 0], [-1200, -25, 3.5e-4], [0, -3e6, -20.0]],
    ]
    T = [0.02, 0.03]
    system = lp.PeriodicSystem.from_matrices(A, [[0, 0, 0]] * 2, T)
    with mpmath.workdps(50):
        total = mpmath.eye(3)
        for a, t in zip(A, T, strict=True):
            total = mpmath.expm(mpmath.matrix(a) * mpmath.mpf(t)) * total
        exact = sorted((complex(x) for x in mpmath.eig(total)[0]), key=lambda x: (-abs(x), -x.imag))
    np.testing.assert_allclose(lp.floquet(system).multipliers, exact, rtol=1e-8)


def test_each_step_stable_but_the_whole_unstable():
    """Branicky's pair, switched every quarter turn: growth in spite of two stable steps."""
    A = [[[-1.0, 10.0], [-100.0, -1.0]], [[-1.0, 100.0], [-10.0, -1.0]]]
    quarter = math.pi / 2 / math.sqrt(1000)
    system = lp.PeriodicSystem.from_matrices(A, [[0.0, 0.0]] * 2, [quarter, quarter])
    found = lp.floquet(system)
    assert found.verdict == "unstable"
    assert found.spectral_radius == pytest.approx(10 * math.exp(-2 * quarter), rel=1e-12)
    assert lp.floquet(lp.PeriodicSystem.from_matrices([A[0]], [[0, 0]], [1.0])).is_stable


def test_a_pure_oscillator_is_bounded_and_its_exponents_are_imaginary():
    system = lp.PeriodicSystem.from_matrices([[[0.0, 1.0], [-1.0, 0.0]]], [[0.0, 0.0]], [1.0])
    found = lp.floquet(system)
    assert found.is_marginal
    assert not found.is_stable
    assert found.verdict == "bounded"
    np.testing.assert_allclose(found.exponents, [1j, -1j], atol=1e-14)
    assert found.modes.shape == (2, 2)


def test_exponents_stay_finite_where_multipliers_underflow():
    system = lp.PeriodicSystem.from_matrices([[[-900.0]], [[-800.0]]], [[1.0], [0.0]], [1.0, 1.0])
    found = lp.floquet(system)
    assert found.log_moduli[0] == pytest.approx(-1700, rel=1e-12)
    assert found.exponents[0] == pytest.approx(-850, rel=1e-12)
    assert found.is_stable


@pytest.mark.parametrize("growth", [400.0, 710.0, 2000.0])
def test_systems_that_grow_beyond_all_bounds_are_unstable_not_marginal(growth):
    found = lp.floquet(lp.PeriodicSystem.from_matrices([np.diag([growth, -1.0])], [[1.0, 0.0]], [1.0]))
    assert found.verdict == "unstable"
    assert found.log_moduli[0] == pytest.approx(growth, rel=1e-12)
    assert found.margin < 1e-9
    many = lp.PeriodicSystem.from_matrices([np.diag([9.0, -1.0])] * 200, [[1.0, 0.0]] * 200, np.ones(200))
    assert lp.floquet(many).log_moduli[0] == pytest.approx(1800, rel=1e-12)


def test_a_map_beyond_double_precision_is_a_named_error_but_the_orbit_and_the_multipliers_are_had():
    system = lp.PeriodicSystem.from_matrices([np.diag([2000.0, -2000.0])], [[1.0, 1.0]], [1.0])
    with pytest.raises(lp.StepOverflowError, match="step 1 of 1 s grows by more than double precision"):
        lp.lifted(system)
    with pytest.raises(lp.StepOverflowError, match=r"the monodromy matrix has an entry of about 10\^869"):
        lp.monodromy(system)
    # A^-1 f, unstable or not.
    assert lp.steady_state(system).initial_state == pytest.approx([-1 / 2000, 1 / 2000], rel=1e-12)
    assert lp.steady_state(system).mean("z1") == pytest.approx(-1 / 2000, rel=1e-12)
    assert lp.floquet(system).log_moduli == pytest.approx([2000, -2000], rel=1e-12)


def test_growth_beyond_double_precision_that_comes_back_leaves_everything_finite():
    """Up by e^800 and down by e^801 in single steps, in coordinates that mix both states."""
    turn = np.array([[1.0, 0.5], [0.0, 1.0]])
    A = [turn @ np.diag([rate, -1.0]) @ np.linalg.inv(turn) for rate in (800.0, -801.0)]
    system = lp.PeriodicSystem.from_matrices(A, [[1.0, 2.0], [0.0, 1.0]], [1.0, 1.0])
    # Eight hundred times the rounding of A.
    assert lp.floquet(system).log_moduli == pytest.approx([-1.0, -2.0], abs=1e-9)
    np.testing.assert_allclose(lp.monodromy(system)[0, 0], math.exp(-1), rtol=1e-9)
    # The orbit itself passes e^800.
    with pytest.raises(lp.StepOverflowError, match="grows too far within the period, and comes back"):
        lp.steady_state(system)


def test_an_orbit_that_is_large_within_the_period_is_not_mistaken_for_a_drift():
    """Scalar: z(T1) = e^40 (z0 + 1/40) - 1/40, z(T) = e^-41 z(T1)."""
    system = lp.PeriodicSystem.from_matrices([[[40.0]], [[-41.0]]], [[1.0], [0.0]], [1.0, 1.0])
    z0 = math.exp(-1) / 40 / (1 - math.exp(-1))
    orbit = lp.steady_state(system)
    # The solve is backward stable relative to the largest state, e^36 times the first.
    assert orbit.initial_state[0] == pytest.approx(z0, rel=1e-7)
    assert orbit.step_states[1, 0] == pytest.approx(math.exp(40) * (z0 + 1 / 40), rel=1e-7)


def test_multipliers_do_not_depend_on_the_coordinates():
    random = np.random.default_rng(4)
    A, turn = random.normal(size=(5, 4, 4)), random.normal(size=(4, 4))
    plain = lp.PeriodicSystem.from_matrices(A, np.zeros((5, 4)), np.ones(5))
    turned = lp.PeriodicSystem.from_matrices(turn @ A @ np.linalg.inv(turn), np.zeros((5, 4)), np.ones(5))
    np.testing.assert_allclose(lp.floquet(turned).log_moduli, lp.floquet(plain).log_moduli, atol=1e-10)


def test_a_step_stiff_beyond_sense_has_multipliers_and_answers_or_a_named_error():
    system = lp.PeriodicSystem.from_matrices([np.diag([-1.0, -1e12])], [[1.0, 1.0]], [1.0], B=[[[1.0], [1.0]]])
    np.testing.assert_array_equal(lp.floquet(system).log_moduli, [-1.0, -1e12])
    with pytest.raises(lp.StepOverflowError, match=r"too stiff: the norm of A times its duration is 1\.0e\+12"):
        lp.harmonic_transfer(system, -2e12)
    found = lp.harmonic_transfer(system, 1.0)[0].ravel()
    np.testing.assert_allclose(found, [1 / 2, 1 / (1 + 1e12)], rtol=1e-8)


def test_a_slow_period_of_a_fast_oscillation_has_its_extremes_quickly():
    """Ten million swings in a step, of which forty matter: they decay."""
    A = [[[-50.0, 1000.0], [-1000.0, -50.0]]] * 2
    system = lp.PeriodicSystem.from_matrices(A, [[1.0, 0.0], [-1.0, 0.0]], [5e4, 5e4])
    orbit = lp.steady_state(system)
    overshoot = orbit.at(5e4 + np.linspace(0, 0.02, 20001))
    assert orbit.minimum("z1") == pytest.approx(overshoot[0].min(), rel=1e-6)


def test_a_step_of_no_duration_changes_nothing():
    with_it = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 3, [[1.0], [7.0], [0.0]], [0.25, 0.0, 0.75])
    without = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[1.0], [0.0]], [0.25, 0.75])
    a, b = lp.steady_state(with_it), lp.steady_state(without)
    assert a.initial_state == pytest.approx(b.initial_state, rel=1e-14)
    assert a.mean("z1") == pytest.approx(0.25, rel=1e-13)
    assert a.amplitude("z1") == pytest.approx(b.amplitude("z1"), rel=1e-12)


# Outcomes
# -----------------------------------------------------------------------------------------------------------------


def test_no_orbit_states_its_drift():
    system = lp.PeriodicSystem.from_matrices([[[0.0]]] * 2, [[1.0], [-0.5]], [0.5, 0.5])
    with pytest.raises(lp.NoOrbitError, match="drifts by z1") as caught:
        lp.steady_state(system)
    assert caught.value.drift == pytest.approx([0.25])


def test_a_family_of_orbits_states_its_least_norm_and_directions():
    A = [[[0.0, 1.0], [0.0, -2.0]]] * 2
    system = lp.PeriodicSystem.from_matrices(A, [[0.0, 1.0], [0.0, -1.0]], [0.5, 0.5])
    with pytest.raises(lp.NonUniqueOrbitError, match="Free direction: z1") as caught:
        lp.steady_state(system)
    direction = caught.value.free_directions[:, 0]
    assert abs(direction[0]) == pytest.approx(1)
    member = caught.value.least_norm
    assert member @ direction == pytest.approx(0, abs=1e-12)
    response = lp.response(system, n_periods=1, initial_state=member)
    np.testing.assert_allclose(response.states[:, -1], member, atol=1e-12)


def test_an_unstable_system_still_has_its_orbit():
    system = lp.PeriodicSystem.from_matrices([[[1.0]]] * 2, [[1.0], [0.0]], [0.5, 0.5])
    orbit = lp.steady_state(system)
    after = lp.response(system, n_periods=1, initial_state=orbit.initial_state)
    assert after.states[0, -1] == pytest.approx(orbit.initial_state[0], rel=1e-12)


# python-control
# -----------------------------------------------------------------------------------------------------------


def test_steps_are_named_state_spaces_and_lose_nothing():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[2.0]], [1.0], B=[[[3.0]]], C=[[[4.0]]], D=[[[5.0]]])
    sys = system.steps[0].sys
    assert sys.state_labels == ["z1"]
    assert sys.input_labels == ["u1", "one"]
    np.testing.assert_array_equal(sys.B, [[3.0, 2.0]])
    np.testing.assert_array_equal(sys.D, [[5.0, 0.0]])
    # Theirs are writable, ours are not reached by it.
    sys.A[0, 0] = 7.0
    assert system.A[0, 0, 0] == -1.0


def test_a_system_is_a_value():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]], [[2.0]], [1.0])
    with pytest.raises(ValueError, match="read-only"):
        system.A[0, 0, 0] = 1.0
    with pytest.raises(AttributeError):
        system.A = 1  # type: ignore[misc]


def test_a_response_is_a_named_time_response():
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[1.0], [0.0]], [0.25, 0.75])
    response = lp.response(system, n_periods=2, points_per_period=8)
    assert response.state_labels == ["z1"]
    assert response.time[0] == 0
    assert response.time[-1] == 2
    assert {0.25, 1.0, 1.25} <= set(response.time.tolist())
    assert response.output_labels == ["z1"]


# Errors
# -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (([[[math.nan]]], [[0.0]], [1.0]), r"A: found nan at index \(0, 0, 0\)"),
        (([[[1.0, 2.0]]], [[0.0]], [1.0]), r"A: found shape|f: found shape"),
        (([[[1.0]], [[1.0, 2.0]]], [[0.0], [0.0]], [1.0, 1.0]), "A: expected numbers in a regular array"),
        (([[[1.0]]], [[0.0]], [-1.0]), "durations: found -1 s in step 0"),
        (([[[1.0]]], [[0.0]], [0.0]), "found a period of 0 s"),
        (([[[1.0]]], [[0.0, 1.0]], [1.0]), r"f: found shape \(1, 2\), expected \(1, 1\)"),
        (([[[1.0]]], [[0.0]], [1.0, 2.0]), r"A: found shape \(1, 1, 1\), expected \(2, any, any\)"),
        (([[[1.0]]], [[0.0]], [math.inf]), "durations: found inf"),
        (([[[1j]]], [[0.0]], [1.0]), "A: found complex numbers, expected real"),
    ],
)
def test_bad_matrices_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        lp.PeriodicSystem.from_matrices(*arguments)


def test_a_model_given_for_its_system_is_told_so(table_1):
    model = lp.ltv_model(table_1, 4.0)
    for function in (lp.floquet, lp.steady_state, lp.monodromy, lp.response):
        with pytest.raises(TypeError, match=r"found LtvModel, expected a PeriodicSystem; give its \.system"):
            function(model)
    for result in (model, lp.floquet(model.system), lp.steady_state(model.system)):
        assert len(repr(result)) < 200


def test_unknown_signals_are_named():
    orbit = lp.steady_state(lp.PeriodicSystem.from_matrices([[[-1.0]]], [[1.0]], [1.0]))
    with pytest.raises(ValueError, match="found 'x', expected one of z1"):
        orbit.amplitude("x")
    with pytest.raises(ValueError, match="found 3, expected 0 to 0"):
        orbit.mean(3)
    with pytest.raises(ValueError, match="n_periods: found 0"):
        lp.response(lp.PeriodicSystem.from_matrices([[[-1.0]]], [[1.0]], [1.0]), n_periods=0)
