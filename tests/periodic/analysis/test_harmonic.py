"""Harmonic transfer functions: closed form against the truncated harmonic operator and against simulation."""

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ltvpneu as lp
from tests.periodic.strategies import split_lti, systems


def truncated(system: lp.PeriodicSystem, s: complex, k: int, order: int) -> np.ndarray:
    """H_k by the block Toeplitz form [Wereley1990] of Fourier coefficients up to the order."""
    n, m, p = system.n_states, len(system.inputs), len(system.outputs)
    w, T = 2 * np.pi / system.period, system.period
    size = 2 * order + 1

    def coefficient(values, j):
        starts, ends = system.switching_times[:-1], system.switching_times[1:]
        if j == 0:
            weights = (ends - starts) / T
        else:
            weights = (np.exp(-1j * j * w * starts) - np.exp(-1j * j * w * ends)) / (1j * j * w * T)
        return np.tensordot(weights, values, axes=1)

    def toeplitz(values):
        parts = {j: coefficient(values, j) for j in range(-2 * order, 2 * order + 1)}
        return np.block([[parts[a - b] for b in range(size)] for a in range(size)])

    A, B, C = toeplitz(system.A), toeplitz(system.B), toeplitz(system.C)
    N = np.kron(np.diag(1j * w * np.arange(-order, order + 1)), np.eye(n))
    G = C @ np.linalg.solve(s * np.eye(size * n) + N - A, B) + toeplitz(system.D)
    return G[(order + k) * p : (order + k + 1) * p, order * m : (order + 1) * m]


def example() -> lp.PeriodicSystem:
    return lp.PeriodicSystem.from_matrices(
        [[[0.0, 1.0], [-1.0, -0.4]], [[0.0, 1.0], [-2.0, -0.4]], [[0.0, 1.0], [-2.0, -0.8]]],
        np.zeros((3, 2)),
        [0.8, 0.02, 1.2],
        B=[[[0.0, 1.0], [1.0, 0.0]], [[0.0, 1.0], [9.0, 0.0]], [[0.0, 1.0], [2.0, 0.0]]],
        C=[[[1.0, 0.0]]] * 3,
        D=[[[0.0, 0.1]]] * 3,
    )


@pytest.mark.parametrize("s", [0.3j, 0.1 + 1.1j, 5j])
def test_the_truncated_harmonic_operator_converges_to_the_closed_form(s):
    system = example()
    harmonics = [-2, -1, 0, 1, 3]
    exact = lp.harmonic_transfer(system, s, harmonics)
    errors = []
    for order in (20, 80):
        found = np.array([truncated(system, s, k, order) for k in harmonics])
        errors.append(np.abs(found - exact).max())
    # The Fourier coefficients of jumps fall like 1/k: so do those of A and B, and the error faster.
    assert errors[1] < 1e-5
    assert errors[1] < errors[0] / 8


def test_a_simulated_response_has_the_harmonics():
    """u = cos(w_in t) into the block as python-control simulates it, once it has settled."""
    system = example()
    omega = np.pi / system.period  # the response repeats after two periods
    block = lp.to_iosys(system)
    span = 2 * system.period
    times = np.linspace(0, 10 * span, 10 * 100 + 1)
    inputs = np.array([np.cos(omega * times), np.zeros_like(times)])
    found = ct.input_output_response(
        block, times, inputs, [0, 0], solve_ivp_method=lp.SwitchAware, solve_ivp_kwargs={"rtol": 1e-6, "atol": 1e-8}
    )
    last = slice(9 * 100, 10 * 100)
    H = lp.harmonic_transfer(system, 1j * omega, range(-30, 31))[:, 0, 0]
    turns = np.exp(1j * np.outer(omega + np.arange(-30, 31) * 2 * np.pi / system.period, times[last]))
    # Linear interpolation of the cosine between 100 points a cycle: 5e-4; free motion has decayed by e^-10.
    np.testing.assert_allclose(found.outputs[0, last], (H @ turns).real, atol=2e-3 * np.abs(H).max())


@settings(max_examples=25)
@given(systems(ports=(2, 2)), st.complex_numbers(max_magnitude=3).filter(lambda s: s.real > -1))
def test_splitting_steps_and_shifting_s_by_j_w_change_nothing(system, s):
    exact = lp.harmonic_transfer(system, s, [-1, 0, 2])
    size = np.abs(exact).max()
    finer = system.split(np.full(system.n_steps, 3))
    np.testing.assert_allclose(lp.harmonic_transfer(finer, s, [-1, 0, 2]), exact, atol=1e-12 * size)
    # The response to e^{st} and to e^{(s + jw)t} solve the same equation one harmonic apart, for a plain LTI system only;
    # for conjugate s the harmonics are conjugate and mirrored.
    mirrored = lp.harmonic_transfer(system, s.conjugate(), [1, 0, -2])
    np.testing.assert_allclose(mirrored.conj(), exact, atol=1e-12 * size)


def test_a_split_lti_system_has_its_transfer_function_and_no_harmonics():
    system = split_lti([0.7, 0.0, 0.01, 1.3], D=0.3)
    lti = ct.ss(system.A[0], system.B[0], system.C[0], system.D[0])
    for s in (0.0, 1.7j, 0.5 - 2j):
        found = lp.harmonic_transfer(system, s, [0, 1, -3])
        np.testing.assert_allclose(found[0], lti(s), rtol=1e-12)
        np.testing.assert_allclose(found[1:], 0.0, atol=1e-14)


def test_a_short_pulse_is_in_every_harmonic():
    """x' = -x + g(t) u, g one for 1 % of the period: H_0(0) = 0.01, by hand."""
    system = lp.PeriodicSystem.from_matrices(
        [[[-1.0]]] * 3, [[0.0]] * 3, [0.47, 0.01, 0.52], B=[[[0.0]], [[1.0]], [[0.0]]]
    )
    assert lp.harmonic_transfer(system, 0.0)[0, 0, 0] == pytest.approx(0.01, rel=1e-12)
    found = lp.harmonic_transfer(system, 0.0, [50])[0, 0, 0]
    w = 2 * np.pi * 50
    g = (np.exp(-1j * w * 0.47) - np.exp(-1j * w * 0.48)) / (1j * w)
    assert found == pytest.approx(g / (1 + 1j * w), rel=1e-10)


def test_the_frequency_response_is_python_controls_with_named_harmonics():
    found = lp.frequency_response(example(), [0.1, 1.0, 10.0], [-1, 0, 1])
    assert isinstance(found, ct.FrequencyResponseData)
    assert found.output_labels == ["y1[k=-1]", "y1", "y1[k=+1]"]
    assert found.input_labels == ["u1", "u2"]
    np.testing.assert_allclose(found.frdata[:, :, 1], lp.harmonic_transfer(example(), 1j, [-1, 0, 1])[:, 0], rtol=1e-14)


@pytest.mark.parametrize(
    ("s", "harmonics", "message"),
    [
        (-1.0, 0, r"s: found -1\+0j, a characteristic exponent but for multiples"),
        (-1.0 + 2j * np.pi, 0, "a characteristic exponent but for multiples of j 2 pi / T"),
        (np.nan, 0, "s: found .*nan.*, expected a finite number"),
        (1.0, [0.5], "harmonics: found .*, expected whole numbers"),
    ],
)
def test_bad_frequencies_and_harmonics_are_named(s, harmonics, message):
    system = lp.PeriodicSystem.from_matrices([[[-1.0]]] * 2, [[0.0]] * 2, [0.25, 0.75], B=[[[1.0]]] * 2)
    with pytest.raises(ValueError, match=message):
        lp.harmonic_transfer(system, s, harmonics)


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e9, 1e12])
def test_stiff_steps_cost_no_more_and_are_right(rate):
    A = [[[-rate, 1.0], [0.3, -0.1]], [[-1.0, 0.2], [1.0, -0.7 * rate]]]
    system = lp.PeriodicSystem.from_matrices(A, np.zeros((2, 2)), [0.5, 0.5], B=[[[1.0], [1.0]]] * 2)
    orbit = lp.steady_state(system.with_levels([1.0]))
    found = lp.harmonic_transfer(system, 0.0)[0, :, 0]
    np.testing.assert_allclose(found, [orbit.mean("z1"), orbit.mean("z2")], rtol=1e-12)


def test_a_shift_that_makes_steps_grow_warns_of_nothing():
    system = lp.PeriodicSystem.from_matrices([[[1.0]], [[-2.0]]], np.zeros((2, 1)), [5.0, 5.0], B=[[[1.0]]] * 2)
    assert np.isfinite(lp.harmonic_transfer(system, -80.0)).all()
