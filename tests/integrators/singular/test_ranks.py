"""Ranks of matrices that are known to a precision of their own, swept through what counts beside it."""

import numpy as np
import pytest
from retrax.integrators.singular.integrability.echelon import CERTAIN, COUNTED, RANK_GAP, Echelon, eliminate

CHANGE = 1e-8  # of what remains of the last entry, beside which the rounding of the others is small


def echelon(significance: float, units: tuple[float, float] = (1.0, 1.0)) -> Echelon:
    """``[[1, 2, 3], [1, 2, 3 + s d], [0, 0, 0]]`` with an entry that changes by ``d``, in units of rows and columns."""
    matrix = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0 + significance * CHANGE], [0.0, 0.0, 0.0]])
    stack = np.tile(matrix, (1, 5, 1, 1))
    stack[0, 1:, 1, 2] += CHANGE * np.array([1.0, -0.5, 0.2, -1.0])
    scale = np.array([units[0], 1.0, 1 / units[0]])[:, None] * np.array([1.0, units[1], 1 / units[1]])
    return eliminate(scale * stack, (slice(0, 3),), np.zeros(3, int))


@pytest.mark.parametrize("units", [(1.0, 1.0), (1e6, 1.0), (1e-6, 1e3), (1e4, 1e-8)])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.09, 0.11, 0.5, 0.99, 1.01, 2.0, 9.0, 11.0, 1e3])
def test_what_remains_of_a_row_counts_beside_what_it_changes_by_and_between_nothing_is_decided(share, units):
    found = echelon(share * COUNTED, units)
    assert np.sum(found.rows >= 0) == (2 if share > 1 else 1)
    assert found.decided.tolist() == [share * COUNTED <= RANK_GAP or share * COUNTED >= CERTAIN]
    seen = found.smallest if share > 1 else found.largest
    assert seen[0] == pytest.approx(share * COUNTED, rel=1e-3, abs=1e-3)
    free = found.null_basis(slice(0, 3))[0, 0]
    assert np.linalg.matrix_rank(free) == (1 if share > 1 else 2)
