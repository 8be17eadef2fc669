"""Tableaus of Radau methods."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.legendre import legder, legroots
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Radau
from retrax.retractions.collocation import Tableau

LINE = Addition(Euclidean(1))


@given(st.integers(1, 20))
def test_quadrature_and_stages_are_exact_for_polynomials(stages: int) -> None:
    method = Radau(stages, LINE)
    A, b, c = method.matrix, method.weights, method.nodes
    for k in range(2 * stages - 1):
        assert b @ c**k == pytest.approx(1 / (k + 1), abs=1e-14)
    assert abs(b @ c ** (2 * stages - 1) - 1 / (2 * stages)) > 1e-14 or stages > 6
    for k in range(stages):
        assert A @ c**k == pytest.approx(c ** (k + 1) / (k + 1), abs=1e-14)


@given(st.integers(1, 20))
def test_the_last_stage_is_the_end_of_the_step(stages: int) -> None:
    method = Radau(stages, LINE)
    assert method.nodes[-1] == 1.0
    assert method.matrix[-1] == pytest.approx(method.weights, abs=1e-15)
    assert np.all(np.diff(method.nodes) > 0)
    assert np.all(method.weights > 0)


def test_radau_5() -> None:
    """Hairer, Wanner 1996, Table IV.5.6."""
    root = np.sqrt(6.0)
    method = Radau(3, LINE)
    assert method.nodes == pytest.approx([(4 - root) / 10, (4 + root) / 10, 1], abs=1e-15)
    assert method.weights == pytest.approx([(16 - root) / 36, (16 + root) / 36, 1 / 9], abs=1e-15)
    assert method.matrix[0] == pytest.approx(
        [(88 - 7 * root) / 360, (296 - 169 * root) / 1800, (-2 + 3 * root) / 225], abs=1e-15
    )


LOBATTO = [[1, 1], [1 / 3, 4 / 3, 1 / 3], [1 / 6, 5 / 6, 5 / 6, 1 / 6], [1 / 10, 49 / 90, 32 / 45, 49 / 90, 1 / 10]]


@pytest.mark.parametrize("weights", LOBATTO)
def test_a_tableau_of_lobatto_nodes(weights: list[float]) -> None:
    """The ends and the extrema of ``P_{s-1}``; weights on [-1, 1] in Abramowitz, Stegun 1964, Table 25.6."""
    inner = legroots(legder([0.0] * (len(weights) - 1) + [1.0])) if len(weights) > 2 else []
    tableau = Tableau.of(np.array([-1.0, *inner, 1.0]))
    assert tableau.weights == pytest.approx(np.array(weights) / 2, abs=1e-15)
    assert tableau.matrix[-1] == pytest.approx(tableau.weights, abs=1e-15)


@given(st.lists(st.integers(0, 20), min_size=1, max_size=6, unique=True))
def test_a_tableau_of_any_nodes_is_exact_for_the_polynomials_of_its_stages(places: list[int]) -> None:
    tableau = Tableau.of(np.array(sorted(places)) / 10 - 1)
    A, b, c = tableau.matrix, tableau.weights, tableau.nodes
    for k in range(len(c)):
        assert b @ c**k == pytest.approx(1 / (k + 1), abs=1e-15 * np.sum(np.abs(b)) * len(c) ** 4)
        assert A @ c**k == pytest.approx(c ** (k + 1) / (k + 1), abs=1e-15 * np.sum(np.abs(A)) * len(c) ** 4)
    assert tableau.centred == pytest.approx(A - b / 2)


@pytest.mark.parametrize("stages", [0, -1, 1.5, "2", True])
def test_other_numbers_of_stages_are_refused(stages: object) -> None:
    with pytest.raises(InvalidInputError, match=r"number of stages must be a whole number of at least 1, got"):
        Radau(stages, LINE)  # pyright: ignore[reportArgumentType]
