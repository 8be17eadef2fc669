"""Ranks of matrices that are known to a precision of their own, swept through what counts beside it."""

from importlib import import_module

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify
from retrax.integrators.singular.integrability.echelon import CERTAIN, COUNTED, RANK_GAP, Echelon, eliminate
from retrax.integrators.singular.integrability.sample_points import Points
from retrax.manifolds import Euclidean

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


def test_points_keep_all_derivatives_that_exceed_rounding(monkeypatch):
    """Also where derivatives change from a point to the points beside it."""
    module = import_module("retrax.integrators.singular.integrability.classify")
    mark, seen = module._mark_unclear, []

    def mark_and_keep(points: Points) -> Points:
        seen.append(points)
        return mark(points)

    monkeypatch.setattr(module, "_mark_unclear", mark_and_keep)

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([jnp.exp(q[1]) + q[0] ** 3, u[0]])

    classify(OptimalControlProblem(Euclidean(2), dynamics, lambda q, u: jnp.exp(q[0]) + q[1] ** 4, 1))
    for points in seen:
        with np.errstate(invalid="ignore"):
            rounded = points.rounded
        for name in ("by_state", "by_jet"):
            own, kept = (getattr(part.at, name) for part in (points, rounded))
            assert np.any(getattr(points.beside, name)[0] != own)
            np.testing.assert_array_equal(kept[kept != 0], own[kept != 0])
            np.testing.assert_allclose(kept, own, rtol=0, atol=1e-10 * np.abs(own).max())
    assert seen
