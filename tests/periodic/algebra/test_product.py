"""Eigenvalues of long products: against mpmath in hundreds of digits, against SLICOT, and where doubles end."""

import math
import warnings
from fractions import Fraction

import ctrlsys
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ortho_group

import ltvpneu as lp


def exact_logs(factors: np.ndarray, digits: int = 400) -> np.ndarray:
    with mpmath.workdps(digits):
        product = mpmath.eye(factors.shape[1])
        for factor in factors:
            product = mpmath.matrix(factor.tolist()) * product
        values = mpmath.eig(product, left=False, right=False)
        return np.array(sorted((float(mpmath.log(abs(value))) for value in values), reverse=True))


def graded(random: np.random.Generator, N: int, n: int, decades: float) -> np.ndarray:
    """Products whose multipliers span that many decades in each factor, in turning coordinates."""
    turns = [ortho_group.rvs(n, random_state=random) if n > 1 else np.ones((1, 1)) for _ in range(N + 1)]
    core = np.diag(10.0 ** (-decades * np.arange(n) / max(n - 1, 1)))
    mixed = [core @ (np.eye(n) + 0.3 * random.normal(size=(n, n))) for _ in range(N)]
    return np.array([turns[k + 1] @ mixed[k] @ turns[k].T for k in range(N)])


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("N", [1, 2, 3, 10, 60])
def test_random_products_equal_four_hundred_digits(n, N):
    random = np.random.default_rng(100 * n + N)
    factors = random.normal(size=(N, n, n))
    np.testing.assert_allclose(lp.product_multipliers(factors).log_moduli, exact_logs(factors), atol=1e-10)


@pytest.mark.parametrize("decades", [1.0, 4.0])
@pytest.mark.parametrize("N", [5, 80])
def test_graded_products_equal_four_hundred_digits(N, decades):
    factors = graded(np.random.default_rng(N), N, 3, decades)
    # Each factor's smallest direction is known to eps times its condition number, 10^decades.
    np.testing.assert_allclose(
        lp.product_multipliers(factors).log_moduli, exact_logs(factors, 800), atol=10 * N * 2e-16 * 10**decades
    )


@pytest.mark.parametrize("n", [2, 4, 7])
def test_equal_moduli_do_not_separate_and_are_found_all_the_same(n):
    random = np.random.default_rng(n)
    factors = np.array([ortho_group.rvs(n, random_state=random) for _ in range(50)])
    found = lp.product_multipliers(factors)
    np.testing.assert_allclose(found.log_moduli, 0.0, atol=1e-13)
    product = np.linalg.multi_dot(list(factors[::-1]))
    np.testing.assert_allclose(np.poly(found.multipliers), np.poly(product), atol=1e-12)


def test_growth_within_the_period_that_cancels_leaves_no_trace():
    """One direction grows by e^15 and comes back, the other the reverse: no basis suits both halves.

    Much more growth would make the multipliers themselves uncertain: rounding of one factor, grown twice.
    """
    N, rate = 600, 0.05
    turn = np.array([[1.0, 0.4], [0.1, 1.0]])
    up = turn @ np.diag([math.exp(rate), math.exp(-rate)]) @ np.linalg.inv(turn)
    down = turn @ np.diag([math.exp(-rate) * 1.001, math.exp(rate) * 0.998]) @ np.linalg.inv(turn)
    factors = np.array([up] * (N // 2) + [down] * (N // 2))
    exact = exact_logs(factors)
    np.testing.assert_allclose(lp.product_multipliers(factors).log_moduli, exact, atol=1e-11)
    formed = np.log(np.abs(np.linalg.eigvals(np.linalg.multi_dot(list(factors[::-1])))))
    assert np.abs(np.sort(formed)[::-1] - exact).max() > 1e-5


@given(st.integers(1, 5), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_products_equal_the_compiled_periodic_schur_form(n, N, seed):
    factors = np.random.default_rng(seed).normal(size=(N, n, n))
    found = np.sort(lp.product_multipliers(factors).log_moduli)
    np.testing.assert_allclose(found, np.sort(slicot_logs(factors)), atol=1e-9)


def slicot_logs(factors: np.ndarray) -> np.ndarray:
    """Return log moduli by SLICOT's MB03VW and MB03BD."""
    N, n = factors.shape[:2]
    # SLICOT's product is A_1 A_2 ... A_p.
    stack, signs = np.asfortranarray(np.moveaxis(factors[::-1], 0, 2)), np.ones(N, dtype=np.int32)
    reduced, _, h, info = ctrlsys.mb03vw("N", None, "A", n, N, 1, 1, n, signs, stack)
    assert info == 0
    _, _, real, imag, beta, scale, _, info = ctrlsys.mb03bd("E", "C", "N", N, n, h, 1, n, signs, reduced)
    assert info == 0
    return np.log(np.hypot(real, imag)) - np.log(np.abs(beta)) + scale * math.log(2)


def test_singular_factors_give_zeros_and_leave_the_others_right():
    random = np.random.default_rng(3)
    factors = random.normal(size=(30, 4, 4))
    factors[10] = random.normal(size=(4, 2)) @ random.normal(size=(2, 4))
    factors[20] = random.normal(size=(4, 3)) @ random.normal(size=(3, 4))
    found = lp.product_multipliers(factors)
    assert (found.log_moduli[2:] == -np.inf).all()
    assert (found.multipliers[2:] == 0).all()
    start = np.roll(factors, -11, axis=0)
    left, values, right = np.linalg.svd(factors[10])
    small = right[:2] @ np.linalg.multi_dot(list(start[:-1][::-1])) @ left[:, :2] * values[:2]
    expected = np.sort(np.log(np.abs(np.linalg.eigvals(small))))[::-1]
    np.testing.assert_allclose(found.log_moduli[:2], expected, atol=1e-10)


def test_nilpotent_and_zero_factors_give_nothing_but_zeros():
    for factors in ([[[0.0, 1.0], [0.0, 0.0]]] * 3, [np.eye(2), np.zeros((2, 2))], [[[0.0]]]):
        assert (lp.product_multipliers(factors).log_moduli == -np.inf).all()


def test_factors_of_tiny_or_huge_entries_are_scaled():
    random = np.random.default_rng(5)
    factors = random.normal(size=(6, 3, 3))
    plain = lp.product_multipliers(factors)
    for scale in (1e-200, 1e250):
        scaled = lp.product_multipliers(factors * scale)
        np.testing.assert_allclose(scaled.log_moduli, plain.log_moduli + 6 * math.log(scale), rtol=1e-14)
        np.testing.assert_allclose(scaled.angles, plain.angles, atol=1e-13)
    assert lp.product_multipliers(factors * 1e250).spectral_radius == math.inf


def test_real_and_conjugate_multipliers_are_so_to_the_last_bit():
    random = np.random.default_rng(11)
    for n in (2, 5, 8):
        found = lp.product_multipliers(random.normal(size=(20, n, n)))
        for value, angle in zip(found.multipliers, found.angles, strict=True):
            assert value.imag == 0 or value.conjugate() in found.multipliers
            assert value.imag != 0 or angle in (0.0, np.pi)
        upper_first = found.multipliers[found.multipliers.imag != 0].imag[::2]
        assert (upper_first > 0).all()


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ([[[1.0, np.nan], [0.0, 1.0]]], r"factors: found nan at index \(0, 0, 1\)"),
        ([[[1.0, np.inf], [0.0, 1.0]]], "factors: found inf at index"),
        ([np.eye(2), np.eye(3)], r"factors: found shape \(2, 2\) of factors\[0\] and \(3, 3\)"),
        (np.ones((3, 2, 4)), r"factors: found shape \(3, 2, 4\), expected one or more square"),
        ([], "factors: found shape"),
        ([np.eye(2) * 1j], "factors: found complex numbers"),
    ],
)
def test_bad_factors_are_named(factors, message):
    with pytest.raises(ValueError, match=message):
        lp.product_multipliers(factors)


def _rank(rows):
    """Rank of a matrix of fractions, by elimination."""
    rows, rank = [list(row) for row in rows], 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column] != 0), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, len(rows)):
            share = rows[i][column] / rows[rank][column]
            rows[i] = [x - share * y for x, y in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return rank


def _product(a, b):
    return [[sum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)] for row in a]


@pytest.mark.parametrize("seed", range(60))
def test_every_exact_zero_of_a_singular_product_is_found(seed):
    """Zeros counted in fractions: n less the rank of the n-th power of the product."""
    rng = np.random.default_rng(seed)
    n, N = int(rng.integers(2, 6)), int(rng.integers(1, 5))
    factors = rng.integers(-4, 5, (N, n, n)).astype(float)
    k = rng.integers(N)
    factors[k, -1] = factors[k, 0] * rng.integers(-2, 3)
    product = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    for factor in factors:
        product = _product([[Fraction(int(x)) for x in row] for row in factor], product)
    power = product
    for _ in range(n - 1):
        power = _product(power, product)
    n_zero = n - _rank(power)
    found = lp.product_multipliers(factors)
    assert np.isneginf(found.log_moduli).sum() == n_zero
    plain = np.sort(np.abs(np.linalg.eigvals(np.array(product, dtype=float))))[::-1][: n - n_zero]
    np.testing.assert_allclose(np.exp(found.log_moduli[: n - n_zero]), plain, rtol=1e-7)


@pytest.mark.parametrize("size", [1e160, 1e300])
@pytest.mark.parametrize("side", ["rows", "columns"])
def test_factors_of_entries_at_the_ends_of_double_precision_have_right_logarithms(size, side):
    """A graded product has its largest and smallest multipliers by minors: F_11 of all, and the determinants."""
    rng = np.random.default_rng(3)
    grades = np.diag([size, 1.0, 1 / size])
    mixed = [np.eye(3) + 0.1 * rng.random((3, 3)) for _ in range(3)]
    factors = [grades @ one if side == "rows" else one @ grades for one in mixed]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lp.product_multipliers(factors)
    # Minors of leading rows and columns, each relative to the last; what they leave out is a 1e-160th of it.
    minors = np.array([[np.linalg.det(one[:k, :k]) for k in range(1, 4)] for one in mixed])
    shares = (
        np.log(minors[:, 0]).sum(),
        np.log(minors[:, 1] / minors[:, 0]).sum(),
        np.log(minors[:, 2] / minors[:, 1]).sum(),
    )
    right = np.array(shares) + 3 * math.log(size) * np.array([1, 0, -1])
    np.testing.assert_allclose(found.log_moduli, right, atol=1e-11)


@pytest.mark.parametrize("seed", range(8))
def test_rectangular_factors_have_the_multipliers_of_their_product(seed):
    rng = np.random.default_rng(seed)
    N = int(rng.integers(2, 6))
    sizes = rng.integers(1, 6, N)
    factors = [rng.standard_normal((sizes[(k + 1) % N], sizes[k])) for k in range(N)]
    product = np.eye(sizes[0])
    for factor in factors:
        product = factor @ product
    found = lp.product_multipliers(factors)
    plain = np.linalg.eigvals(product)
    assert found.multipliers.shape == (sizes[0],)
    assert np.isneginf(found.log_moduli).sum() == sizes[0] - sizes.min()
    largest = np.sort(np.abs(plain))[::-1][: sizes.min()]
    np.testing.assert_allclose(np.exp(found.log_moduli[: sizes.min()]), largest, rtol=1e-8)


def test_an_exact_zero_of_rectangular_factors_is_found():
    found = lp.product_multipliers([[[1.0, 1.0], [2.0, 2.0], [0.5, 3.0]], [[1.0, -1.0, 2.0], [3.0, 3.0, 6.0]]])
    product = np.array([[1.0, -1.0, 2.0], [3.0, 3.0, 6.0]]) @ [[1.0, 1.0], [2.0, 2.0], [0.5, 3.0]]
    np.testing.assert_allclose(np.sort(found.multipliers.real), np.sort(np.linalg.eigvals(product)), rtol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gone = lp.product_multipliers([[[0.1], [0.1]], [[1.0, -1.0]]])
        assert np.isneginf(gone.log_moduli).all()
        chain = [[[0.0, 2.0], [1.0, -1.0]], [[1.0, 2.0], [-2.0, -2.0]], [[0.0, 0.0], [-2.0, 0.0]]]
        assert np.isneginf(lp.product_multipliers(chain).log_moduli[-1])


def test_rectangular_factors_that_do_not_follow_each_other_are_refused():
    with pytest.raises(ValueError, match=r"found shape \(2, 3\) of factors\[0\] and \(3, 3\) of factors\[1\]"):
        lp.product_multipliers([np.ones((2, 3)), np.ones((3, 3))])
    with pytest.raises(ValueError, match=r"found shape \(4, 3\) of factors\[1\] and \(3, 2\) of the first one"):
        lp.product_multipliers([np.ones((3, 2)), np.ones((4, 3))])
