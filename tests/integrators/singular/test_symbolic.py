"""The algorithm in exact algebra: the same answers as the numeric one, in closed form."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from retrax.integrators import OptimalControlProblem, classify
from retrax.integrators.singular.symbolic import SymbolicClassification
from retrax.integrators.singular.symbolic.trace import trace
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.problems import SINGULAR

from tests.integrators.singular.cases import classified, known

EUCLIDEAN = [
    pytest.param(name, marks=[pytest.mark.slow] if name in ("chain of 3", "chain of 4") else [])
    for name in SINGULAR
    if isinstance(known(name).problem.manifold, Euclidean) and known(name).empty_at is None
]


@lru_cache
def symbolic(name: str) -> SymbolicClassification:
    return classify(known(name).problem, symbolic=True)


@pytest.mark.parametrize("name", EUCLIDEAN)
def test_exact_and_numeric_answers_agree(name):
    exact, numeric = symbolic(name), classified(name)
    for fact in ("k_f", "k_f_base", "dimension", "rank", "first_class", "second_class", "gauge_controls"):
        assert getattr(exact, fact) == getattr(numeric, fact), fact
    assert len(exact.strata) == len(numeric.strata) == 1
    # The numeric points satisfy the exact equations, and have the exact controls; an irregular one is found to half its digits.
    accuracy = 1e-8 if known(name).regular_equations else 1e-4
    s, piece = numeric.stratum, exact.stratum
    values = dict(zip((*exact.phase.q, *exact.phase.p, *exact.phase.u), np.concatenate([s.q, s.p, s.u]), strict=True))
    for equation, _ in piece.equations:
        assert abs(equation.subs(values)) < accuracy
    for u in piece.controls:
        np.testing.assert_allclose(float(piece.reduce(u).subs(values)), values[u], atol=accuracy)
    span = np.array([[float(c.subs(values)) for c in vector.flat()] for vector in piece.kernel]).reshape(-1, s.q.size * 2)
    both = np.concatenate([span, np.concatenate([s.kernel[0], s.kernel[1]], axis=1)])
    assert np.linalg.matrix_rank(both, tol=1e-6) == len(span) == len(s.kernel[0])


@pytest.mark.parametrize("n", [2, 3, 4])
def test_chains_of_integrators_end_at_the_origin(n):
    exact = symbolic(f"chain of {n}")
    assert (exact.k_f, exact.k_f_base, exact.dimension) == (2 * n, 2 * n - 1, 0)


@pytest.mark.parametrize(("name", "contradiction"), [("linear cost", "1 = 0 at level 1"), ("unpaid control", "at level 0")])
def test_contradictions_are_printed(name, contradiction):
    exact = symbolic(name)
    assert exact.empty
    assert exact.contradictions[0][1] == known(name).empty_at
    assert contradiction in str(exact)


def test_the_paper_s_example_in_closed_form():
    report = str(symbolic("academic"))
    for line in ("q2 = 0 (level 0)", "d/dp2", "u1 = p1 - q1 (level 0)", "u2 is free (gauge)"):
        assert line in report
    assert "irregular: a power of it" in str(symbolic("irregular"))


def test_strata_where_a_factor_vanishes():
    problem = known("aly-chan, Mayer").problem
    exact = classify(problem, symbolic=True, exclude_zero_costate=False)
    assert {(piece.codimension, len(piece.coordinates) - len(piece.kernel)) for piece in exact.strata} == {(2, 4), (3, 0)}
    assert all(exact.strata[1].reduce(p) == 0 for p in exact.phase.p)


def test_branches_too_long_to_follow_are_said():
    # The singular arc is of first order where {phi, {phi, H}}, a polynomial of 24 terms, does not vanish.
    exact = symbolic("curved arc")
    assert len(exact.strata) == 1
    assert exact.stratum.levels == {exact.phase.u[0]: 2}
    assert any(level == 2 and expression.free_symbols <= set(exact.stratum.coordinates) for expression, level in exact.unsolved)
    assert "no short closed form" in str(exact)


def test_a_traced_function_has_the_values_of_the_function():
    matrix = np.arange(6.0).reshape(2, 3)

    def function(x):
        y = jnp.concatenate([x[1:], x[:1] ** 3])
        return jnp.sum(jnp.sin(matrix @ y) * jnp.exp(x[:2]) / (1 + jnp.sqrt(x[0]) ** 2)) + jnp.stack([y[2], x[0]]) @ x[1:]

    symbols = np.array(sympy.symbols("x1:4"), dtype=object)
    point = np.array([0.3, 0.7, 0.2])
    value = trace(function, symbols).item().subs(dict(zip(symbols, point, strict=True)))
    np.testing.assert_allclose(float(value), function(jnp.asarray(point)), rtol=1e-14)


def test_what_has_no_exact_form_is_refused_in_words():
    with pytest.raises(InvalidInputError, match="needs a problem on Euclidean spaces"):
        symbolic("sphere")
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: jnp.abs(u), lambda q, u: u @ u, 1)
    with pytest.raises(InvalidInputError, match=r"the operation abs .* has no exact counterpart"):
        classify(problem, symbolic=True)
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: jnp.exp(u[0]) + u[0] ** 2, 1)
    with pytest.raises(InvalidInputError, match="no branch ends in closed form"):
        classify(problem, symbolic=True)
