"""Exponentials of small matrices, compiled."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from ltvpneu.periodic.algebra.small import advanced, exponential, root_time, sampled, solve


@pytest.mark.parametrize("size", [2, 4, 6])
@pytest.mark.parametrize("time", [1e-6, 0.1, 3.0, 50.0])
def test_the_exponential_and_its_mean_equal_scipys_block_exponential(size, time):
    random = np.random.default_rng(size)
    matrix = random.normal(size=(size, size)) - 2 * np.sqrt(size) * np.eye(size)
    result, mean = np.empty((size, size)), np.empty((size, size))
    exponential(matrix, time, result, mean)
    block = np.zeros((2 * size, 2 * size))
    block[:size, :size], block[:size, size:] = matrix * time, np.eye(size)
    whole = expm(block)
    # Doublings double rounding errors; at most some ten of them here.
    np.testing.assert_allclose(result, whole[:size, :size], atol=1e-12)
    np.testing.assert_allclose(mean, whole[:size, size:], atol=1e-12)


@given(st.floats(-0.5, 0.5))
def test_the_series_of_vectors_goes_both_ways(time):
    matrix = np.array([[0.0, 1.0], [-4.0, -0.3]])
    vector = np.array([1.0, 2.0])
    np.testing.assert_allclose(advanced(matrix, vector, time), expm(matrix * time) @ vector, atol=1e-14)


def test_solve_pivots_and_says_when_it_cannot():
    matrix, right = np.array([[0.0, 2.0], [3.0, 1.0]]), np.array([4.0, 5.0])
    assert solve(matrix, right)
    np.testing.assert_allclose(right, [1.0, 2.0])
    assert not solve(np.ones((2, 2)), np.ones(2))


def test_sampled_states_of_several_steps():
    matrices = np.array([[[0.0, 1.0], [-4.0, -0.3]], [[-1.0, 0.0], [0.5, -2.0]]])
    times, starts = np.array([[0.0, 0.1, 0.7], [0.2, 3.0, 9.0]]), np.array([[1.0, 2.0], [-1.0, 0.5]])
    expected = [[expm(matrices[m] * t) @ starts[m] for t in times[m]] for m in range(2)]
    np.testing.assert_allclose(sampled(matrices, times, starts), expected, atol=1e-14)


@pytest.mark.parametrize("frequency", [1.0, 30.0])
def test_root_of_a_damped_oscillation(frequency):
    decay = 0.2
    matrix = np.array([[-decay, frequency], [-frequency, -decay]])
    # The first component is exp(-d t) cos(w t).
    time = root_time(matrix, np.array([1.0, 0.0]), np.array([1.0, 0.0]), 2.5 / frequency)
    assert time == pytest.approx(np.pi / 2 / frequency, rel=1e-14)


def test_no_root_where_the_ends_have_one_sign():
    assert np.isnan(root_time(-np.eye(1), np.ones(1), np.ones(1), 1.0))
