"""Lifting, averaging and interconnection: LTI answers of python-control, and the response they must reproduce."""

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings

import ltvpneu as lp
from tests.periodic.strategies import split_lti, systems


def lti(n: int, m: int, p: int, seed: int) -> ct.StateSpace:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n)) - 3 * np.eye(n)
    return ct.ss(
        A, random.normal(size=(n, m)), random.normal(size=(p, n)), 0.3 * random.normal(size=(p, m)), name=f"s{seed}"
    )


def periodic(system: ct.StateSpace, durations: list[float]) -> lp.PeriodicSystem:
    N = len(durations)
    return lp.PeriodicSystem.from_matrices(
        [system.A] * N, np.zeros((N, system.nstates)), durations, [system.B] * N, [system.C] * N, [system.D] * N
    )


def pulsed(gain: float = 100.0) -> lp.PeriodicSystem:
    """An RC circuit that a forcing drives for 1 % of the time, and an input all the time."""
    return lp.PeriodicSystem.from_matrices(
        [[[-1.0]]] * 3, [[0.0], [gain], [0.0]], [0.47, 0.01, 0.52], B=[[[1.0]]] * 3, C=[[[1.0]]] * 3
    )


@settings(max_examples=25)
@given(systems(ports=(2, 1), damped=False))
def test_the_lifted_system_maps_states_as_the_response_does(system):
    z0 = np.array([1.0, -2.0, 0.5])
    driven = system.with_levels([0.3, -0.7])
    reached = lp.response(driven, n_periods=1, initial_state=z0).states[:, -1]
    size = 1 + np.abs(reached).max()
    found = lp.lifted(system)
    assert found.dt == pytest.approx(system.period)
    assert found.input_labels == ["u1", "u2", "one"]
    np.testing.assert_allclose(found.A @ z0 + found.B @ [0.3, -0.7, 1.0], reached, atol=1e-12 * size)
    stacked = lp.lifted(system, stacked=True)
    held = [0.3] * system.n_steps + [-0.7] * system.n_steps + [1.0]
    np.testing.assert_allclose(stacked.A @ z0 + stacked.B @ held, reached, atol=1e-12 * size)
    seen = stacked.C @ z0 + stacked.D @ held
    states = [z0]
    for k in range(system.n_steps - 1):
        part = lp.PeriodicSystem.from_matrices(driven.A[[k]], driven.f[[k]], driven.durations[[k]])
        states.append(lp.response(part, n_periods=1, initial_state=states[-1]).states[:, -1])
    expected = [system.C[k] @ z for k, z in enumerate(states)]
    np.testing.assert_allclose(seen, np.ravel(expected), atol=1e-11 * (1 + np.abs(expected).max()))


def test_the_lifted_system_of_a_machine_has_the_multipliers_for_poles():
    system = lp.ltv_model(lp.load_machine("kunt_singh_1990"), frequency=8.0).system
    poles = np.sort_complex(lp.lifted(system).poles())
    np.testing.assert_allclose(poles, np.sort_complex(lp.floquet(system).multipliers), atol=1e-10)


def test_a_split_lti_system_lifts_to_its_zero_order_hold_and_averages_to_itself():
    system = split_lti([0.7, 0.0, 0.01, 1.3], D=0.5)
    whole = ct.ss(system.A[0], system.B[0], system.C[0], system.D[0])
    sampled, found = ct.sample_system(whole, system.period), lp.lifted(system)
    for letter in "ABCD":
        expected = getattr(sampled, letter)
        np.testing.assert_allclose(getattr(found, letter)[:, : expected.shape[1]], expected, atol=1e-13)
        np.testing.assert_allclose(
            getattr(lp.averaged(system), letter)[:, : expected.shape[1]], getattr(whole, letter), rtol=1e-14
        )


def test_a_short_pulse_is_in_the_lifted_and_in_the_averaged_system():
    assert lp.averaged(pulsed()).B[0, 1] == pytest.approx(1.0)
    assert lp.lifted(pulsed()).B[0, 1] == pytest.approx(100 * (np.exp(-0.52) - np.exp(-0.53)), rel=1e-12)


@pytest.mark.parametrize(
    ("ours", "theirs"), [(lp.series, ct.series), (lp.feedback, ct.feedback)], ids=["series", "feedback"]
)
def test_interconnections_of_split_lti_systems_have_the_lti_answers(ours, theirs):
    a, b = lti(2, 2, 3, 1), lti(3, 3, 2, 2)
    whole = theirs(a, b)
    p, q = periodic(a, [0.2, 0.3]), periodic(b, [0.3, 0.45])
    for first, second, period in ((p, q, 1.5), (p, b, 0.5), (a, q, 0.75)):
        found = ours(first, second)
        assert found.period == pytest.approx(period)
        for s in (0.0, 0.3 + 1j):
            np.testing.assert_allclose(lp.harmonic_transfer(found, s)[0], whole(s), atol=1e-13)


def test_parallel_systems_and_constant_gains_have_the_lti_answers():
    a, c = lti(2, 2, 3, 1), lti(3, 2, 3, 4)
    p = periodic(a, [0.2, 0.3])
    both = lp.parallel(p, c)
    np.testing.assert_allclose(lp.harmonic_transfer(both, 1j)[0], ct.parallel(a, c)(1j), atol=1e-13)
    both = lp.parallel(c, p)
    np.testing.assert_allclose(lp.harmonic_transfer(both, 1j)[0], ct.parallel(a, c)(1j), atol=1e-13)
    gain = np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 1.0]])
    looped = lp.feedback(p, gain)
    np.testing.assert_allclose(lp.harmonic_transfer(looped, 1j)[0], ct.feedback(a, gain)(1j), atol=1e-12)
    assert looped.states == p.states


def test_forcing_and_output_offsets_go_through_the_interconnection():
    """Mean values by hand: the pulse has mean 1, and the loop around it divides what comes in by two."""
    assert lp.steady_state(lp.series(pulsed(), ct.ss(-2.0, 1.0, 1.0, 0.0))).mean("y[0]") == pytest.approx(
        0.5, rel=1e-12
    )
    looped = lp.feedback(pulsed(), [[1.0]]).with_levels([3.0])
    assert lp.steady_state(looped).mean("y1") == pytest.approx((1.0 + 3.0) / 2, rel=1e-12)
    # Two pulses of other periods: means add.
    slow = lp.PeriodicSystem.from_matrices(
        [[[-3.0]]] * 2, [[0.0], [30.0]], [1.4, 0.1], B=[[[1.0]]] * 2, C=[[[1.0]]] * 2
    )
    both = lp.parallel(pulsed(), slow)
    assert both.period == pytest.approx(3.0)
    assert lp.steady_state(both).mean("y1") == pytest.approx(1.0 + 2 / 3, rel=1e-12)


def test_state_feedback_places_what_it_says():
    system = pulsed()
    closed = lp.state_feedback(system, [[[1.0]], [[-4.0]], [[1.0]]])
    assert closed.A.ravel() == pytest.approx([-2.0, 3.0, -2.0])
    regulator = lp.lqr(system, [[1.0]], [[1.0]])
    held = lp.state_feedback(system, regulator.step_gains)
    assert lp.floquet(held).spectral_radius < lp.floquet(system).spectral_radius


def test_names_are_kept_or_told_apart():
    assert lp.series(pulsed(), lti(2, 1, 1, 3)).states == ("z1", "x[0]", "x[1]")
    assert lp.series(pulsed(), pulsed()).states == ("periodic_1_z1", "periodic_2_z1")


@pytest.mark.parametrize(
    ("join", "error", "message"),
    [
        (
            lambda: lp.series(periodic(lti(2, 2, 3, 1), [1.0]), pulsed()),
            ValueError,
            r"series: found 3 outputs \(y1, y2, y3\)",
        ),
        (lambda: lp.parallel(periodic(lti(2, 2, 3, 1), [1.0]), pulsed()), ValueError, "parallel: found 2 inputs"),
        (lambda: lp.parallel(pulsed(), pulsed().with_levels([1.0])), ValueError, "parallel: found input levels"),
        (lambda: lp.feedback(pulsed(), np.ones((2, 1))), ValueError, "feedback: found 1 outputs"),
        (lambda: lp.feedback(pulsed(), [[1.0]], sign=2), ValueError, "sign: found 2, expected -1 or 1"),
        (
            lambda: lp.series(lti(1, 1, 1, 1), lti(1, 1, 1, 1)),
            TypeError,
            "found StateSpace and StateSpace, expected one Per",
        ),
        (lambda: lp.series(pulsed(), ct.ss(-1, 1, 1, 0, 0.1)), ValueError, "found discrete time"),
        (lambda: lp.series(pulsed(), "controller"), TypeError, "operand: found str"),
        (
            lambda: lp.series(pulsed(), periodic(lti(1, 1, 1, 1), [np.pi])),
            ValueError,
            "found periods of 1 s and 3.14159265359 s, expected a ratio of two whole numbers",
        ),
        (
            lambda: lp.feedback(periodic(ct.ss(-1, 1, 1, 1), [1.0]), [[1.0]], sign=1),
            ValueError,
            "the algebraic loop of D in step 1 has no solution",
        ),
        (lambda: lp.state_feedback(pulsed(), np.ones((2, 1))), ValueError, "K: found shape"),
    ],
)
def test_what_cannot_be_joined_is_named(join, error, message):
    with pytest.raises(error, match=message):
        join()


def test_operators_are_connections():
    rng = np.random.default_rng(5)

    def system(seed: int) -> lp.PeriodicSystem:
        rng = np.random.default_rng(seed)
        return lp.PeriodicSystem.from_matrices(
            rng.standard_normal((2, 2, 2)) - 2 * np.eye(2),
            rng.standard_normal((2, 2)),
            [0.4, 0.6],
            B=rng.standard_normal((2, 2, 2)),
            C=rng.standard_normal((2, 2, 2)),
        )

    a, b, gain, s = system(1), system(2), rng.standard_normal((2, 2)), 0.3 + 1j
    H, K = lp.harmonic_transfer(a, s)[0], lp.harmonic_transfer(b, s)[0]
    pairs = [
        (a + b, H + K), (a - b, H - K), (-a, -H), (2 * a, 2 * H), (a * 0.5, H / 2), (np.float64(3) * a, 3 * H),
        (a + gain, H + gain), (gain - a, gain - H), (gain + a, gain + H),
        (gain @ np.eye(2) * a, gain @ H), (a * gain, H @ gain),
        (b * a, lp.harmonic_transfer(lp.series(a, b), s)[0]),
        (ct.ss(-1.0 * np.eye(2), np.eye(2), np.eye(2), 0 * np.eye(2)) * a, H / (s + 1)),
    ]  # fmt: skip
    for found, right in pairs:
        np.testing.assert_allclose(lp.harmonic_transfer(found, s)[0], right, rtol=1e-11, atol=1e-13)
    # Offsets go along.
    assert (-2 * a).r.any()
    for signal in ("y1", "y2"):
        assert lp.steady_state(-2 * a).mean(signal) == pytest.approx(-2 * lp.steady_state(a).mean(signal), rel=1e-12)
    with pytest.raises(ValueError, match="parallel: found input levels"):
        _ = a + b.with_levels([1.0, 0.0])
    with pytest.raises(TypeError):
        _ = a + "b"
