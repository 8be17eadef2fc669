"""Ranks of matrices, swept through the power of the rounding that decides them."""

import numpy as np
import pytest
from retrax.manifolds.numerics.rank import is_regular, null_space, numerical_rank, pivotal_values
from retrax.manifolds.numerics.tolerances import EPS, RANK, REGULAR

SHARES = [0.1, 0.5, 0.99, 1.01, 2.0, 10.0]
SIZES = [1e-12, 1.0, 1e12]


def turned(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix with these singular values, and its right singular vectors, by rows."""
    rng, n = np.random.default_rng(3), len(values)
    left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    return left * values @ right, right


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("share", SHARES)
def test_singular_values_count_from_the_power_of_the_rounding_on(share, size):
    smallest = share * EPS**RANK
    for values in ([1.0, smallest], [1.0, 0.3, 2 * EPS**RANK, smallest]):
        matrix, right = turned(size * np.array(values))
        for of in (matrix, np.diag(size * np.array(values)), matrix[:, ::-1].T):
            found = numerical_rank(of)
            assert found.rank == len(values) - (share < 1)
            assert np.isinf(found.gap) if share > 1 else found.gap == pytest.approx(values[-2] / smallest, rel=1e-4)
        free = null_space(matrix)
        assert free.shape == (len(values), int(share < 1))
        np.testing.assert_allclose(np.abs(right[-1] @ free), 1.0, atol=1e-6)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("share", SHARES)
def test_singular_values_are_measured_by_a_unit_that_is_larger(share, size):
    matrix = share * EPS**RANK * size * np.eye(2)
    found = numerical_rank(matrix, unit=size)
    assert found.rank == (2 if share > 1 else 0)
    assert np.isinf(found.gap) if share > 1 else found.gap == pytest.approx(1 / (share * EPS**RANK))
    assert null_space(matrix, unit=size).shape == (2, 2 - found.rank)
    # Of itself a matrix of any size has its rank, and a smaller unit measures nothing.
    assert numerical_rank(matrix).rank == numerical_rank(matrix, unit=matrix[0, 0] / 2).rank == 2


def test_a_matrix_of_zeros_has_no_rank_with_an_infinite_gap():
    for unit in (0.0, 1.0):
        found = numerical_rank(np.zeros((2, 3)), unit)
        assert (found.rank, found.gap) == (0, np.inf)
        assert null_space(np.zeros((2, 3)), unit).shape == (3, 3)
        assert numerical_rank(np.zeros((0, 3)), unit).rank == 0


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("share", SHARES)
def test_a_matrix_is_regular_from_the_power_of_the_rounding_on_in_any_units(share, size):
    """``[[1, 1 - 2 d], [1 - 2 d, 1]]`` has the singular values ``2 - 2 d`` and ``2 d``."""
    d, units = share * EPS**REGULAR, np.array([size, 1.0])
    values = pivotal_values(np.array([[1.0, 1 - 2 * d], [1 - 2 * d, 1.0]]) * np.outer(units, units))
    np.testing.assert_allclose(values, [2 - 2 * d, 2 * d], rtol=1e-5)
    assert is_regular(values) == (share > 1)
    assert is_regular(np.zeros(0))
    assert not is_regular(np.zeros(1))
