"""Elementary functions in exact algebra: what is treated is right, by derivatives of JAX, the rest is refused in
words."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from retrax.integrators import OptimalControlProblem, SymbolicClassification, classify
from retrax.integrators.singular.symbolic.algorithm import _contradict
from retrax.integrators.singular.symbolic.field import normal_form
from retrax.integrators.singular.symbolic.symbolic_trace import fraction
from retrax.manifolds import Euclidean, InvalidInputError

from tests.integrators.singular.test_symbolic import signatures


def assert_invariant(exact: SymbolicClassification) -> None:
    """At points of the pieces ``dH/du = 0``, the equations hold and so do their rates along ``X_H``: derivatives by
    JAX."""
    problem, phase = exact.problem, exact.phase
    states, n = (*phase.q, *phase.p), len(phase.q)

    def gradient(x):
        return jax.grad(lambda x: problem.hamiltonian(x[:n], x[n : 2 * n], x[2 * n :]))(x)

    for piece in exact.strata:
        equations = sympy.lambdify([states], [e for e, _ in piece.equations], modules="jax")
        for seed in range(3):
            free = np.random.default_rng(seed).uniform(0.4, 0.9, len(states) + len(phase.u))
            values = dict(zip((*states, *phase.u), free, strict=True))
            x = jnp.array([float(piece.solution.get(s, s).subs(values)) for s in values])
            slope = gradient(x)
            field = jnp.concatenate([slope[n : 2 * n], -slope[:n]])
            found = jax.jvp(lambda z, of=equations: jnp.stack([jnp.zeros(()), *of(z)]), (x[: 2 * n],), (field,))
            size = 1 + jnp.max(jnp.abs(x)) ** 2 + jnp.max(jnp.abs(slope)) ** 2
            assert jnp.max(jnp.abs(jnp.concatenate([slope[2 * n :], *found]))) < 1e-12 * size, piece.equations


def goddard(q, u):
    h, v, m = q
    return jnp.stack([v, (3.5 * u[0] - 310 * v**2 * jnp.exp(-500 * (h - 1))) / m - 1 / h**2, -7 * u[0]])


def rocket() -> SymbolicClassification:
    return classify(OptimalControlProblem(Euclidean(3), goddard, lambda q, u: 0.0, 1, lambda q: -q[0]), symbolic=True)


def test_goddard_s_rocket_in_closed_form():
    """[Goddard, A method of reaching extreme altitudes, 1919]"""
    exact = rocket()
    assert signatures(exact) == [(2, 0, 4)]
    assert exact.stratum.levels == {exact.phase.u[0]: 2}
    assert exact.zero_costate_excluded
    assert exact.excluded == 1  # p = 0
    assert "exp(500 - 500*q1)" in str(exact)


@pytest.mark.slow
def test_the_thrust_of_goddard_s_arc_keeps_the_switching_function_zero():
    exact = rocket()
    piece, at = exact.stratum, dict(zip((*exact.phase.q, exact.phase.p[2]), (1.01, 0.06, 0.8, 0.1), strict=True))
    q, p, u = (
        jnp.array([float(piece.reduce(s).subs(at)) for s in part])
        for part in (exact.phase.q, exact.phase.p, exact.phase.u)
    )

    def switching(z):
        return jax.grad(lambda u: exact.problem.hamiltonian(*z, u))(u)[0]

    def rate(f):
        def along(z):
            dq, dp = jax.grad(lambda z: exact.problem.hamiltonian(*z, u))(z)
            return jax.jvp(f, (z,), ((dp, -dq),))[1]

        return along

    for function in (switching, rate(switching), rate(rate(switching))):
        assert abs(function((q, p))) < 1e-11


def planar(f):
    """``x' = f(x, y)``, ``y' = u``, cost ``(x^2 + y^2) / 2``: ``P_f`` is symplectic of dimension 2 where ``df/dy !=
    0``."""
    return OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([f(*q), u[0]]), lambda q, u: q @ q / 2, 1)


ELEMENTARY = {
    "exp": lambda x, y: y + jnp.exp(-20 * x),
    "commensurate exponents": lambda x, y: jnp.exp(y / 2) + jnp.exp(-y / 3),
    "Arrhenius": lambda x, y: 1 - x - x * jnp.exp(-1 / y),
    "exp of a product": lambda x, y: jnp.exp(x * y),
    "sin": lambda x, y: jnp.sin(x) + y * jnp.cos(3 * x),
    "sin of the unknown": lambda x, y: jnp.sin(y),
    "logistic": lambda x, y: jax.nn.sigmoid(y),
    "tanh": lambda x, y: jnp.tanh(y) + jnp.sinh(x) * jnp.cosh(x),
    "exp2": lambda x, y: jnp.exp2(y) + 2.0**x,
    "log": lambda x, y: jnp.log(y) + jnp.log1p(x),
    "power": lambda x, y: y**1.37,
    "roots": lambda x, y: jnp.sqrt(x) + jnp.cbrt(y),
    "norm": lambda x, y: y / jnp.sqrt(x * x + y * y + 1),
    "an identity": lambda x, y: y + jnp.sin(y) * jnp.cos(y) - jnp.sin(2 * y) / 2 + jnp.cosh(x) ** 2 - jnp.sinh(x) ** 2,
    "moved entries": lambda x, y: jnp.prod(jnp.where(np.array([True, False]), 1.0, jnp.stack([x, y]).at[0].set(x * y))),
}

QUICK = ("exp", "sin of the unknown", "log", "power", "an identity")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in ELEMENTARY]
)
@pytest.mark.usual(1)
def test_elementary_functions_are_treated(name):
    exact = classify(planar(ELEMENTARY[name]), symbolic=True)
    assert signatures(exact) == [(2, 0, 2)]
    assert exact.stratum.levels == {exact.phase.u[0]: 2}
    assert_invariant(exact)


@pytest.mark.parametrize("rate", [-300.0, -20.0, -1.0, -1e-3, 1e-9, 0.37, 4.0, 1e4])
@pytest.mark.usual(2)
def test_the_rate_of_an_exponential_changes_nothing(rate):
    exact = classify(planar(lambda x, y: y + jnp.exp(rate * x)), symbolic=True)
    assert signatures(exact) == [(2, 0, 2)]
    assert not exact.unsolved


@pytest.mark.parametrize(
    ("text", "zero"),
    [
        ("exp(x + y) - exp(x)*exp(y)", True),
        ("exp(x/6)**3 - exp(x/2)", True),
        ("exp(1/x - 1/(x + 1)) - exp(1/(x*(x + 1)))", True),
        ("exp(x + 500) - exp(x)*exp(500)", True),
        ("exp(x + 500) - exp(x)", False),
        ("sin(3*x) - 3*sin(x) + 4*sin(x)**3", True),
        ("cos(x - y) - cos(x)*cos(y) - sin(x)*sin(y)", True),
        ("sin(x)**2 + cos(y)**2 - 1", False),
        ("sqrt(x + y)*sqrt(x + y) - x - y", True),
        ("1/(sqrt(x) - 1) - (sqrt(x) + 1)/(x - 1)", True),
        ("log(x)**2 - log(x)", False),
    ],
)
def test_what_vanishes_is_zero(text, zero):
    x, y = sympy.symbols("x y", real=True)
    assert (normal_form(sympy.sympify(text, locals={"x": x, "y": y})) == 0) == zero


def dubins(q, u):
    return jnp.stack([jnp.cos(q[2]), jnp.sin(q[2]), u[0]])


def chemostat(q, u):
    growth = q[1] / (1 + q[1]) * q[0]
    return jnp.stack([growth - u[0] * q[0], -growth + u[0] * (2 - q[1]), q[0] * jnp.exp(-q[2])])


def predators(q, u):
    return jnp.stack([q[0] * (1 - q[1]) - 0.4 * q[0] * u[0], q[1] * (q[0] - 1) - 0.2 * q[1] * u[0]])


@pytest.mark.parametrize(
    ("n", "dynamics", "cost", "pieces"),
    [
        # Straight lines, and p = 0.
        pytest.param(3, dubins, lambda q, u: jnp.ones(()), [(2, 0, 4), (3, 1, 0)], id="Dubins", marks=pytest.mark.slow),
        # Washed out without biomass, with the substrate of the feed or a worthless one.
        pytest.param(
            3,
            chemostat,
            lambda q, u: -q[0] * u[0],
            [(2, 0, 4), (2, 1, 2), (2, 1, 2)],
            id="chemostat",
            marks=pytest.mark.slow,
        ),
        pytest.param(2, predators, lambda q, u: (q - 1) @ (q - 1) / 2, [(2, 0, 2), (2, 1, 0)], id="predators"),
    ],
)
def test_pieces_where_a_coefficient_of_the_closed_form_vanishes(n, dynamics, cost, pieces):
    exact = classify(OptimalControlProblem(Euclidean(n), dynamics, cost, 1), symbolic=True)
    assert signatures(exact) == pieces
    assert_invariant(exact)


def test_functions_of_one_angle_that_vanish_nowhere_together_are_a_contradiction():
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([jnp.sin(q[1]), u[0]]), lambda q, u: q @ q / 2, 1
    )
    exact = classify(problem, symbolic=True)
    sine, cosine = sympy.sin(exact.phase.q[1]), sympy.cos(exact.phase.q[1])
    assert _contradict([sine, cosine], exact.stratum)
    assert not _contradict([sine, cosine - 1], exact.stratum)
    assert not _contradict([sine - cosine], exact.stratum)


def test_an_exponential_that_cannot_be_one_is_a_contradiction():
    def reactor(q, u):
        reaction = q[0] * jnp.exp(-1 / q[1])
        return jnp.stack([1 - q[0] - reaction, 1 - q[1] + reaction - 2 * (q[1] - q[2]), u[0] - q[2]])

    # The concentration 1/2 that costs nothing is not kept at any finite temperature.
    assert classify(
        OptimalControlProblem(Euclidean(3), reactor, lambda q, u: (q[0] - 0.5) ** 2, 1), symbolic=True
    ).empty
    held = OptimalControlProblem(Euclidean(3), reactor, lambda q, u: (q[0] - 0.75) ** 2, 1)
    exact = classify(held, symbolic=True)
    assert exact.dimension == 0
    assert exact.stratum.reduce(exact.phase.q[1]) == 1 / sympy.log(3)


ODD = {
    "of too different frequencies": lambda x, y: jnp.exp(y) + jnp.exp(100 * y),
    "a function of what is not rational": lambda x, y: jnp.exp(jnp.sin(y)),
    "which depend on each other": lambda x, y: jnp.log(x * y) + jnp.log(x) + jnp.log(y),
    "roots of .* which depend": lambda x, y: jnp.sqrt(x * y) + jnp.sqrt(x) + jnp.sqrt(y),
    r"exp\(q2\*log\(q1\)\)": lambda x, y: x**y,
    "use the operation max": lambda x, y: jax.nn.relu(y),
    "use the operation gt": lambda x, y: jnp.where(y > 0, y, 0.0),
    "use the operation convert_element_type": lambda x, y: 1.0 * y.astype(int),
    "use the operation while|use the operation scan": lambda x, y: jax.lax.fori_loop(0, 3, lambda i, a: a + y, x),
    "jnp.where instead of if": lambda x, y: y if x > 0 else x,
    "jnp.sin instead of np.sin": lambda x, y: np.sin(y),
    "contain the constant nan": lambda x, y: y + jnp.nan,
    "problem's functions fail at a point": lambda x, y: jnp.stack([y, jnp.ones(2)]),
}


@pytest.mark.parametrize("words", ODD)
@pytest.mark.usual(4)
def test_odd_functions_are_refused_in_words(words):
    with pytest.raises(InvalidInputError, match=words):
        classify(planar(ODD[words]), symbolic=True)


def test_complex_constants_are_refused():
    with pytest.raises(InvalidInputError, match="contain the complex constant 1j"):
        fraction(np.complex128(1j))
