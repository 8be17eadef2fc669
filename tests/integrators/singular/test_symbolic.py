"""The algorithm in exact algebra: the same answers as the numeric one, in closed form."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.integrators import OptimalControlProblem, SymbolicClassification, classify
from retrax.integrators.singular.symbolic.symbolic_trace import fraction, trace
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.problems import SINGULAR

from tests.integrators.singular.cases import classified, known, martinet

EUCLIDEAN = [
    pytest.param(name, marks=[pytest.mark.slow] if name in ("chain of 3", "chain of 4") else [])
    for name in SINGULAR
    if isinstance(known(name).problem.manifold, Euclidean) and known(name).empty_at is None
]


def signatures(exact: SymbolicClassification) -> list[tuple[int, int, int]]:
    return [tuple(piece.signature) for piece in exact.strata]


@lru_cache
def symbolic(name: str) -> SymbolicClassification:
    return classify(known(name).problem, symbolic=True)


def assert_same(exact, piece, numeric, stratum, accuracy=1e-8):
    """The same facts of a piece; the numeric point satisfies the exact equations, and has the exact controls and
    kernel."""
    for fact in ("k_f", "k_f_base", "signature"):
        assert getattr(piece, fact) == getattr(stratum, fact), fact
    coordinates = np.concatenate([stratum.q, stratum.p, stratum.u])
    values = dict(zip((*exact.phase.q, *exact.phase.p, *exact.phase.u), coordinates, strict=True))
    for equation, _ in piece.equations:
        assert abs(equation.subs(values)) < accuracy
    for u in piece.controls:
        np.testing.assert_allclose(float(piece.reduce(u).subs(values)), values[u], atol=accuracy)
    size = 2 * numeric.problem.manifold.dimension
    span = np.array([[float(c.subs(values)) for c in vector.flat()] for vector in piece.kernel]).reshape(-1, size)
    both = np.concatenate([span, np.concatenate([stratum.kernel[0], stratum.kernel[1]], axis=1)])
    assert np.linalg.matrix_rank(both, tol=1e-6) == len(span) == len(stratum.kernel[0])


def assert_same_levels(exact, numeric):
    """Every stratum seen at a level is one of the exact ones."""
    for level in numeric.levels:
        assert set(level.strata) <= {piece.up_to(level.index).signature for piece in exact.strata}, level.index


@pytest.mark.parametrize("name", EUCLIDEAN)
@pytest.mark.usual(2)
def test_exact_and_numeric_answers_agree(name):
    exact, numeric = symbolic(name), classified(name)
    assert exact.family == numeric.morse.family
    assert len(exact.strata) == len(numeric.strata) == 1
    assert exact.stratum.irregular == numeric.irregular == (not numeric.reliable) == (not known(name).regular_equations)
    if not numeric.reliable:  # then its ranks are no statement about P_f
        assert "NOT RELIABLE" in str(numeric)
        return
    for fact in ("dimension", "first_class", "second_class", "gauge_controls", "regular"):
        assert getattr(exact, fact) == getattr(numeric, fact), fact
    assert_same(exact, exact.stratum, numeric, numeric.stratum, 1e-8)
    assert_same_levels(exact, numeric)


@pytest.mark.parametrize("bend", [0.0, 0.5])
@pytest.mark.slow
def test_exact_and_numeric_pieces_agree(bend):
    exact, numeric = classify(martinet(bend), symbolic=True), classify(martinet(bend))
    assert signatures(exact) == [(2, 0, 4), (3, 1, 2)]
    assert "inside       P_f of [0], where its ranks drop" in str(exact)
    for stratum in numeric.strata:
        piece = next(piece for piece in exact.strata if piece.signature == stratum.signature)
        assert_same(exact, piece, numeric, stratum)
    assert_same_levels(exact, numeric)
    assert exact.choose(1).gauge_controls == numeric.choose(1).gauge_controls == 1
    assert exact.zero_costate_excluded


def test_both_reports_print_the_same_facts():
    lines = [str(record).splitlines() for record in (symbolic("brown"), classified("brown"))]
    facts = [
        {line for line in text if line.split()[0] in ("problem", "P_f", "k_f", "omega_f", "constraints")}
        for text in lines
    ]
    assert len(facts[0]) == 5
    assert facts[0] == facts[1]
    levels = [[line.split("[")[0].strip() for line in text if line.startswith("P^")] for text in lines]
    assert levels[0] == levels[1]
    for text in map("\n".join, lines):
        assert "is a Morse family" in text
        assert "kind         singular: d2H/du2 has" in text


@pytest.mark.parametrize("n", [2, 3, 4])
def test_chains_of_integrators_end_at_the_origin(n):
    exact = symbolic(f"chain of {n}")
    assert (exact.k_f, exact.k_f_base, exact.dimension) == (2 * n, 2 * n - 1, 0)


@pytest.mark.parametrize(
    ("name", "contradiction"), [("linear cost", "1 = 0 at level 1"), ("unpaid control", "at level 0")]
)
def test_contradictions_are_printed(name, contradiction):
    exact = symbolic(name)
    assert exact.empty
    assert exact.contradictions[0][1] == known(name).empty_at
    assert contradiction in str(exact)


def test_the_paper_s_example_in_closed_form():
    report = str(symbolic("academic"))
    for line in ("q2 = 0 (level 0)", "d/dp2", "u1 = p1 - q1 (level 0)", "u2 is free (gauge)"):
        assert line in report
    assert "irregular: the differentials of the conditions vanish" in str(symbolic("irregular"))


def test_a_power_in_one_condition_is_regular_where_another_has_a_simple_zero():
    """``q' = u``, cost ``x^2 y^2/2``: ``x y^2 = 0`` and ``x^2 y = 0`` are regular on both lines off the origin."""
    exact = classify(
        OptimalControlProblem(Euclidean(2), lambda q, u: u, lambda q, u: (q[0] * q[1]) ** 2 / 2, 2), symbolic=True
    )
    assert signatures(exact) == [(3, 1, 0), (3, 1, 0)]
    assert not any(piece.irregular for piece in exact.strata)
    assert "irregular" not in str(exact)


def test_strata_where_a_factor_vanishes():
    problem = known("aly-chan, Mayer").problem
    exact = classify(problem, symbolic=True, exclude_zero_costate=False)
    assert {(piece.codimension, len(piece.coordinates) - len(piece.kernel)) for piece in exact.strata} == {
        (2, 4),
        (3, 0),
    }
    assert all(exact.strata[1].reduce(p) == 0 for p in exact.phase.p)


CIRCLES = OptimalControlProblem(
    Euclidean(3), lambda q, u: jnp.stack([u[0], u[1], q[0] * u[0] + q[1] * u[1]]), lambda q, u: q[2] * u[2], 3
)
HEISENBERG = OptimalControlProblem(
    Euclidean(3), lambda q, u: jnp.stack([u[0], u[1], q[0] * u[1] - q[1] * u[0]]), lambda q, u: q[2] ** 2 / 2, 2
)
RADIAL = OptimalControlProblem(Euclidean(2), lambda q, u: u, lambda q, u: (q @ u) ** 2 / 2, 2)


@pytest.mark.parametrize(
    ("problem", "pieces", "ranks", "relation"),
    [
        # Motion on circles, which crosses q1 = 0; at the centre u3 moves p3 and nothing else.
        pytest.param(CIRCLES, [(3, 1, 2), (5, 1, 0)], (3, 0), "q1*u1 + q2*u2", id="circles"),
        # Motion along q with p = 0, in every direction.
        pytest.param(HEISENBERG, [(2, 0, 4), (4, 1, 0)], (2, 0), "q1*u2 - q2*u1", id="Heisenberg"),
        # p is along q, and q.u is its length over that of q: no equation is left at the origin alone.
        pytest.param(RADIAL, [(1, 1, 2), (4, 0, 0)], (2, 1), "p1*q2 - p2*q1", id="radial"),
    ],
)
@pytest.mark.usual(1)
def test_no_piece_is_invented_where_one_coefficient_vanishes(problem, pieces, ranks, relation):
    exact = classify(problem, symbolic=True)
    assert signatures(exact) == pieces
    assert exact.ranks == ranks
    symbols = {s.name: s for s in (*exact.phase.q, *exact.phase.p, *exact.phase.u)}
    for piece in exact.strata:
        assert piece.reduce(sympy.sympify(relation, locals=symbols)) == 0


def test_a_rank_drops_behind_a_pivot_that_vanishes_there():
    # The determinant is -x, and rows and columns but the first have rank 2 where x = 0.
    def cost(q, u):
        x, y = q
        return u @ jnp.stack([jnp.stack([x, y, y]), jnp.stack([y, 1, 0]), jnp.stack([y, 0, -1])]) @ u / 2

    exact = classify(OptimalControlProblem(Euclidean(2), lambda q, u: 0 * q, cost, 3), symbolic=True)
    assert signatures(exact) == [(0, 0, 4), (1, 1, 2)]


def test_a_coefficient_that_vanishes_beside_a_control_that_is_not_linear():
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: u, lambda q, u: u[0] - q[0] * u[0] * u[1] - u[0] ** 3 / 3, 2
    )
    exact = classify(problem, symbolic=True)
    # q1 = u1 = 0 where all coefficients vanish; u1 = +-sqrt(1 - p1) where q1 = 0 is not followed, and said.
    assert signatures(exact) == [(0, 0, 4), (3, 1, 0)]
    assert exact.unsolved == ((exact.phase.q[0], 0),)
    assert exact.regular


@pytest.mark.slow
def test_branches_too_long_to_follow_are_said():
    # The singular arc is of first order where {phi, {phi, H}}, a polynomial of 24 terms, does not vanish.
    exact = symbolic("curved arc")
    assert len(exact.strata) == 1
    assert exact.stratum.levels == {exact.phase.u[0]: 2}
    assert any(
        level == 2 and expression.free_symbols <= set(exact.stratum.coordinates) for expression, level in exact.unsolved
    )
    assert "no short closed form" in " ".join(str(exact).split())


def test_a_traced_function_has_the_values_of_the_function():
    matrix = np.arange(6.0).reshape(2, 3)

    def function(x):
        y = jnp.concatenate([x[1:], x[:1] ** 3])
        return (
            jnp.sum(jnp.sin(matrix @ y) * jnp.exp(x[:2]) / (1 + jnp.sqrt(x[0]) ** 2))
            + jnp.stack([y[2], x[0]]) @ x[1:]
            + jnp.arange(3.0) @ x
        )

    symbols = np.array(sympy.symbols("x1:4"), dtype=object)
    point = np.array([0.3, 0.7, 0.2])
    value = trace(function, symbols).item().subs(dict(zip(symbols, point, strict=True)))
    np.testing.assert_allclose(float(value), function(jnp.asarray(point)), rtol=1e-14)


@pytest.mark.parametrize(
    ("number", "meant"),
    [
        (0.1, "1/10"),
        (1e-20, "1e-20"),
        (1 / 3, "1/3"),
        (-2 / 7, "-2/7"),
        (1e22, "1e22"),
        (np.float32(0.1), "1/10"),
        (0.0, "0"),
    ],
)
def test_constants_become_the_numbers_that_were_meant(number, meant):
    number = np.asarray(number)[()]
    assert fraction(number) == sympy.Rational(meant)


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(width=32, allow_nan=False, allow_infinity=False))
@example(float(np.finfo(np.float64).max), float(np.finfo(np.float32).max))
@example(float(np.finfo(np.float64).tiny), float(np.finfo(np.float32).tiny))
def test_constants_round_to_their_floats(number, single):
    exact, rough = fraction(np.float64(number)), fraction(np.float32(single))
    assert exact.p / exact.q == number
    assert np.float32(rough.p / rough.q) == np.float32(single)


def test_small_constants_and_close_ones_are_kept():
    # Without the first term p = 0 would follow from dH/du = p; with it, u = p / 1e-20.
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: 1e-20 * u[0] ** 2 / 2, 1)
    exact = classify(problem, symbolic=True)
    assert exact.regular
    assert exact.stratum.controls[exact.phase.u[0]] == 10**20 * exact.phase.p[0]
    # 0.1 (x - y) u with another 0.1, the float next to it, is not x u / 10 - y u / 10.
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: q, lambda q, u: (0.1 * q[0] - np.nextafter(0.1, 1) * q[1]) * u[0], 1
    )
    (equation, _), *_ = classify(problem, symbolic=True).stratum.equations
    x, y = (sympy.diff(equation, s) for s in sympy.symbols("q1 q2", real=True))
    assert x != -y
    assert abs(float(x / y) + 1) < 1e-15


def test_constants_that_are_not_finite_are_refused():
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: jnp.inf * u[0] ** 2, 1)
    with pytest.raises(InvalidInputError, match="contain the constant inf"):
        classify(problem, symbolic=True)


def test_what_has_no_exact_form_is_refused_in_words():
    with pytest.raises(InvalidInputError, match="needs a problem on Euclidean spaces"):
        symbolic("sphere")
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: jnp.abs(u), lambda q, u: u @ u, 1)
    with pytest.raises(
        InvalidInputError, match=r"use the operation abs; exact algebra treats .* without symbolic=True"
    ):
        classify(problem, symbolic=True)
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: jnp.exp(u[0]) + u[0] ** 2, 1)
    with pytest.raises(InvalidInputError, match="no branch ends in closed form"):
        classify(problem, symbolic=True)
