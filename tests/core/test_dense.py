"""LU of the core, against NumPy and LAPACK."""

import numpy as np
import pytest
from retrax.compute.binding.library import best_instruction_set

from .core_calls import core


def factorised(matrix):
    """Factors and exchanges of rows, by the core."""
    n = len(matrix)
    factors, swaps, weights = np.ascontiguousarray(matrix, float).copy(), np.full(n, -1, np.intp), np.empty(n)
    core().retrax_lu_factorise(n, factors.ctypes.data, swaps.ctypes.data, weights.ctypes.data)
    return factors, swaps


def solved(factors, swaps, side, own=0):
    n, columns = side.shape
    x = np.zeros((n, -(-columns // 8) * 8))
    x[:, :columns] = side
    core().retrax_lu_solve(n, factors.ctypes.data, swaps.ctypes.data, x.shape[1], x.ctypes.data, own)
    return x[:, :columns]


def solved_transposed(factors, swaps, side):
    x = np.array(side, float)
    core().retrax_lu_solve_transposed(len(factors), factors.ctypes.data, swaps.ctypes.data, x.ctypes.data)
    return x


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 13, 40])
def test_systems_are_solved_to_their_condition_with_rows_of_any_size(n):
    rng = np.random.default_rng(n)
    for _ in range(20):
        a = rng.normal(size=(n, n)) * 10 ** rng.uniform(-8, 8, (n, 1))
        side = rng.normal(size=(n, 3))
        factors, swaps = factorised(a)
        low, up = np.tril(factors, -1) + np.eye(n), np.triu(factors)
        exchanged = a.copy()
        for k, r in enumerate(swaps):
            exchanged[[k, r]] = exchanged[[r, k]]
        np.testing.assert_allclose(
            low @ up, exchanged, rtol=1e-12, atol=1e-12 * np.abs(exchanged).max(axis=1)[:, None].max()
        )
        scaled = np.linalg.cond(a / np.abs(a).max(axis=1, keepdims=True))
        expected = np.linalg.solve(a, side)
        for own in range(best_instruction_set() + 1):
            found = solved(factors, swaps, side, own)
            assert np.abs(found - expected).max() < 1e-14 * scaled * np.abs(expected).max() * n
        turned = np.linalg.solve(a.T, side[:, 0])
        found = solved_transposed(factors, swaps, side[:, 0])
        assert np.abs(a.T @ found - side[:, 0]).max() < 1e-13 * n * (np.abs(a.T) @ np.abs(turned)).max()


def eliminated(a):
    """Gauss's elimination in NumPy: the upper triangle, and the exchanges of rows."""
    a, n, swaps = a.copy(), len(a), []
    diagonal, largest = np.abs(np.diag(a)), np.abs(a).max(axis=1)
    alone = (np.abs(a - np.diag(np.diag(a))).max(axis=1) == 0) & (diagonal > 0)
    weights = np.where(alone, 1e300, 1 / largest)
    for k in range(n):
        r = k + int(np.argmax(np.abs(a[k:, k]) * weights[k:]))
        swaps.append(r)
        a[[k, r]], weights[[k, r]] = a[[r, k]], weights[[r, k]]
        a[k + 1 :] -= np.outer(a[k + 1 :, k] / a[k, k], a[k])
    return np.triu(a), swaps


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_pivots_are_the_largest_in_proportion_to_their_row_but_states_at_rest_come_first(n):
    rng = np.random.default_rng(n)
    for trial in range(40):
        a = rng.normal(size=(n, n)) * 10 ** rng.uniform(-3, 3, (n, 1))
        if trial % 2:  # a state at rest: a row that has nothing but its diagonal
            rest = int(rng.integers(n))
            a[rest] = 0.0
            a[rest, rest] = 1e-9
        upper, swaps = eliminated(a)
        factors, own = factorised(a)
        assert own.tolist() == swaps
        np.testing.assert_allclose(np.triu(factors), upper, rtol=1e-9, atol=1e-12 * np.abs(a).max())


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_singular_matrix_has_no_finite_solution(n):
    a = np.ones((n, n)) if n > 1 else np.zeros((1, 1))
    assert not np.isfinite(solved(*factorised(a), np.arange(1.0, n + 1)[:, None])).all()
