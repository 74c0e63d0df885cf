r"""Exponentials of small matrices, compiled, for marching a state through many steps one by one.

With M a step's augmented matrix in scaled coordinates, X = M t,

.. math:: e^X = \sum_k \frac{X^k}{k!}, \qquad \bar\varphi(X) = \int_0^1 e^{X s}\, ds = \sum_k \frac{X^k}{(k + 1)!}

by Taylor series after halving, then doubled: phi(2 X) = (phi + e^X phi) / 2. `scipy.linalg.expm` takes stacks, but each
step of a march starts where the last one ended, and one call costs more than a whole step here.
"""

import math

import numpy as np

from ltvpneu._arrays import FloatArray
from ltvpneu._compiled import compiled, inlined

TERMS = 10
"""Terms of the Taylor series; with a norm of at most `LARGEST_NORM` the next is below 1e-14."""
LARGEST_NORM = 0.25
SMALLEST_TERM = 1e-17


@inlined
def multiply(first: FloatArray, second: FloatArray, product: FloatArray) -> None:
    """Write the product of two square matrices."""
    n = first.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += first[i, k] * second[k, j]
            product[i, j] = total


@inlined
def apply(matrix: FloatArray, vector: FloatArray, product: FloatArray) -> None:
    """Write matrix times vector."""
    for i in range(product.size):
        total = 0.0
        for j in range(vector.size):
            total += matrix[i, j] * vector[j]
        product[i] = total


@compiled
def exponential(matrix: FloatArray, time: float, result: FloatArray, mean: FloatArray) -> None:
    """Write exp(M t) and the mean of exp(M s) over s from 0 to t, each (k, k)."""
    k = matrix.shape[0]
    scaled, work = np.empty((k, k)), np.empty((k, k))
    norm = 0.0
    for i in range(k):
        row = 0.0
        for j in range(k):
            row += abs(matrix[i, j])
        norm = max(norm, row)
    norm *= time
    doublings = 0
    # A matrix that is not finite is not halved for ever; what it gives is not finite either.
    while norm > LARGEST_NORM and doublings < 200:
        norm *= 0.5
        doublings += 1
    short = time / 2.0**doublings
    for i in range(k):
        for j in range(k):
            scaled[i, j] = matrix[i, j] * short
            mean[i, j] = 0.0
        mean[i, i] = 1.0
    for term in range(TERMS, 1, -1):
        multiply(scaled, mean, work)
        for i in range(k):
            for j in range(k):
                mean[i, j] = work[i, j] / term
            mean[i, i] += 1.0
    multiply(scaled, mean, result)
    for i in range(k):
        result[i, i] += 1.0
    for _ in range(doublings):
        multiply(result, mean, work)
        for i in range(k):
            for j in range(k):
                mean[i, j] = 0.5 * (mean[i, j] + work[i, j])
        multiply(result, result, work)
        for i in range(k):
            for j in range(k):
                result[i, j] = work[i, j]


ROUGH_TERMS, ROUGH_NORM = 6, 0.5
"""Likewise, of a series whose next term is below 1e-6."""


@compiled
def rough_exponential(matrix: FloatArray, result: FloatArray) -> None:
    """Write exp(M) to six digits, (k, k), in a third of the time."""
    k = matrix.shape[0]
    scaled, work, norm, doublings = np.empty((k, k)), np.empty((k, k)), 0.0, 0
    for i in range(k):
        row = 0.0
        for j in range(k):
            row += abs(matrix[i, j])
        norm = max(norm, row)
    while norm > ROUGH_NORM and doublings < 200:
        norm *= 0.5
        doublings += 1
    for i in range(k):
        for j in range(k):
            scaled[i, j] = matrix[i, j] / 2.0**doublings
            result[i, j] = scaled[i, j] / ROUGH_TERMS
        result[i, i] += 1.0
    for term in range(ROUGH_TERMS - 1, 0, -1):
        multiply(scaled, result, work)
        for i in range(k):
            for j in range(k):
                result[i, j] = work[i, j] / term
            result[i, i] += 1.0
    for _ in range(doublings):
        multiply(result, result, work)
        for i in range(k):
            for j in range(k):
                result[i, j] = work[i, j]


@compiled
def sampled(matrices: FloatArray, times: FloatArray, starts: FloatArray) -> FloatArray:
    """Return exp(M_m t_mj) v_m, from shapes (n_steps, k, k), (n_steps, n_times) and (n_steps, k).

    Shape (n_steps, n_times, k).
    """
    n_steps, k = starts.shape
    states = np.empty((n_steps, times.shape[1], k))
    map_, mean = np.empty((k, k)), np.empty((k, k))
    for m in range(n_steps):
        for j in range(times.shape[1]):
            exponential(matrices[m], times[m, j], map_, mean)
            apply(map_, starts[m], states[m, j])
    return states


@compiled
def root_time(matrix: FloatArray, start: FloatArray, row: FloatArray, span: float) -> float:
    """Return the time in [0, span] at which row exp(M t) v vanishes; nan if its ends have no opposite signs.

    Newton's method, kept within the bracket by bisection.
    """
    k = start.size
    map_, mean = np.empty((k, k)), np.empty((k, k))
    state, rate = start.copy(), np.empty(k)
    exponential(matrix, span, map_, mean)
    apply(map_, start, state)
    low, high, at_low, at_high = 0.0, span, np.dot(row, start), np.dot(row, state)
    if not at_low * at_high < 0.0:
        return math.nan
    time = 0.5 * span
    for _ in range(200):
        exponential(matrix, time, map_, mean)
        apply(map_, start, state)
        value = np.dot(row, state)
        if value == 0.0:
            return time
        if (value < 0.0) == (at_low < 0.0):
            low = time
        else:
            high = time
        apply(matrix, state, rate)
        slope = np.dot(row, rate)
        following = time - value / slope if slope != 0.0 else math.nan
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - time) <= 1e-15 * span:
            return following
        time = following
    return time


@compiled
def advanced(matrix: FloatArray, vector: FloatArray, time: float) -> FloatArray:
    """Return exp(M t) v for a short time of either sign, by the series of vectors."""
    k = vector.size
    total, term, following = vector.copy(), vector.copy(), np.empty(k)
    for order in range(1, 100):
        largest = 0.0
        apply(matrix, term, following)
        for i in range(k):
            term[i] = following[i] * time / order
            total[i] += term[i]
            largest = max(largest, abs(term[i]))
        if largest < SMALLEST_TERM or not math.isfinite(largest):
            break
    return total


@compiled
def solve(matrix: FloatArray, right: FloatArray) -> bool:
    """Solve a small linear system in place, by elimination with pivots; False where it is singular."""
    n = right.size
    for i in range(n):
        pivot = i
        for row in range(i + 1, n):
            if abs(matrix[row, i]) > abs(matrix[pivot, i]):
                pivot = row
        if matrix[pivot, i] == 0.0:
            return False
        if pivot != i:
            for column in range(n):
                matrix[i, column], matrix[pivot, column] = matrix[pivot, column], matrix[i, column]
            right[i], right[pivot] = right[pivot], right[i]
        for row in range(i + 1, n):
            factor = matrix[row, i] / matrix[i, i]
            for column in range(i, n):
                matrix[row, column] -= factor * matrix[i, column]
            right[row] -= factor * right[i]
    for i in range(n - 1, -1, -1):
        total = right[i]
        for column in range(i + 1, n):
            total -= matrix[i, column] * right[column]
        right[i] = total / matrix[i, i]
    return True
