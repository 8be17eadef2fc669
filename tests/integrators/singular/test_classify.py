"""The integrability algorithm: its answers, that they depend on no start and no scale, and what it says in words."""

import logging
import sys
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify, singular_integrator, solve
from retrax.integrators.problem_checks.inspection import Inspection
from retrax.integrators.singular.integrability.algorithm_stages import summarise as summarise_levels
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError, Sphere
from retrax.problems import SINGULAR
from retrax.retractions import Addition, Midpoint, default_retraction

from tests.integrators.singular.cases import ONE, classified, known, scaled

FACTORS = (1.0, 1e3, 1e-3)
SCALES = [*((x, f, 1.0) for x, f in product(FACTORS, FACTORS)), (1.0, 1.0, 1e3), (1.0, 1.0, 1e-3)]
EMPTY = [name for name in SINGULAR if known(name).empty_at is not None]
LONG_TO_COMPILE = (
    "brown",
    "chain of 2",
    "chain of 3",
    "chain of 4",
    "curved arc",
    "free actuator",
    "massless particle",
    "sphere",
)
REGULAR_EQUATIONS = [
    pytest.param(name, marks=[pytest.mark.slow] if name in LONG_TO_COMPILE else [])
    for name in SINGULAR
    if known(name).empty_at is None and known(name).regular_equations
]
SEEDS = pytest.mark.parametrize("seeds", [(0,), pytest.param((1, 2), marks=pytest.mark.slow)])


@SEEDS
@pytest.mark.parametrize("name", REGULAR_EQUATIONS)
@pytest.mark.usual("academic-seeds0")
def test_known_answers_from_every_start_and_at_every_scale(name, seeds):
    answer = known(name)
    for factors, seed in product(SCALES, seeds):
        c = classified(name, factors, seed)
        assert not c.stratified, c
        assert c.levels[-1].consistent == c.levels[-1].tried == 20, c
        found = (c.k_f, c.k_f_base), c.dimension, c.rank, c.gauge_controls
        assert found == (answer.levels, answer.dimension, answer.rank, answer.gauge), (factors, str(c))
        assert min(level.gap for level in c.levels) > 1e6
        assert not c.irregular
        assert c.morse.family == (name != "dummy control")
        assert c.regular == (name == "regular")


@SEEDS
@pytest.mark.parametrize("name", EMPTY)
@pytest.mark.slow
def test_contradictory_conditions_are_said_to_be_empty(name, seeds):
    for factors, seed in product(SCALES, seeds):
        c = classified(name, factors, seed)
        assert c.empty
        assert c.levels[-1].index == known(name).empty_at
        assert c.levels[-1].residual > 1e-3
        assert "contradict each other at every point tried" in str(c)
        with pytest.raises(InvalidInputError, match="P_f is empty"):
            _ = c.dimension


@pytest.mark.slow
def test_every_stratum_is_seen_where_a_vanishing_costate_is_admitted():
    # Without its terminal cost nothing excludes p = 0 from the Mayer form of Aly and Chan's problem.
    problem = known("aly-chan, Mayer").problem
    free = OptimalControlProblem(problem.manifold, problem.dynamics, problem.running_cost, 1)
    for factors in SCALES:
        c = classify(scaled(free, factors))
        assert "P_f is not one manifold" in str(c)
        assert {s.signature for s in c.strata} == {(2, 0, 4), (3, 1, 0)}
        assert all(np.max(np.abs(s.p)) < 1e-9 for s in c.strata if s.signature.codimension == 3)
        assert c.dimension == 4


def test_a_vanishing_costate_can_be_excluded():
    c = classify(known("gauge").problem, exclude_zero_costate=True)
    assert c.empty
    assert "p = 0 is excluded" in str(c)


@SEEDS
@pytest.mark.slow
def test_irregular_equations_are_flagged(seeds):
    for factors, seed in product(SCALES, seeds):
        c = classified("irregular", factors, seed)
        assert c.irregular
        assert not c.morse.family
        assert "equations irregular at all of them: ranks not reliable" in " ".join(str(c).split())
    with pytest.raises(InvalidInputError, match="the equations of P_f are irregular"):
        _ = c.manifold


def test_nothing_is_built_on_equations_that_are_irregular():
    """``x1' = x2``, ``x2' = u``, cost ``x1^4/4``: the conditions are ``x1^3 = 0`` and its derivatives, and ``P_f`` is a
    point."""
    space = Euclidean(2)
    problem = OptimalControlProblem(space, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: q[0] ** 4 / 4, 1)
    c, midpoint = classify(problem), Midpoint(Addition(space))
    assert not c.reliable
    assert "NOT RELIABLE" in str(c)
    for build in (
        lambda: c.manifold,
        lambda: singular_integrator(c, midpoint),
        lambda: solve(problem, jnp.zeros(2), jnp.array([1.0, 0.0]), 1.0, method=midpoint, steps=10, classification=c),
    ):
        with pytest.raises(InvalidInputError, match="the equations of P_f are irregular"):
            build()


def test_functions_that_are_finite_nowhere_are_refused():
    """``log(-1 - x^2)`` has finite derivatives."""
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: jnp.log(-1 - q[0] ** 2), 1)
    with pytest.raises(
        InvalidInputError, match=r"not finite at any of 20 points of level 0, as at q = .* running cost nan"
    ):
        classify(problem)


@pytest.mark.slow
def test_conditions_that_are_only_approached_are_not_called_contradictory():
    """``x' = log x + u``, cost ``x^2/2``: ``x = 0`` is at the edge of the domain; ``e^u = 0`` where ``u`` is
    infinite."""
    edge = OptimalControlProblem(Euclidean(1), lambda q, u: jnp.log(q) + u, lambda q, u: q @ q / 2, 1)
    infinity = OptimalControlProblem(Euclidean(1), lambda q, u: 0 * u + 1, lambda q, u: jnp.exp(u[0]) + q[0], 1)
    for problem in (edge, infinity):
        c = classify(problem)
        assert c.empty
        assert "not shown to be empty" in str(c)
        assert repr(c) == "Classification(no point found)"
        with pytest.raises(InvalidInputError, match="no point of P_f was found, so"):
            _ = c.dimension


@pytest.mark.parametrize(
    ("name", "classes", "names", "determined_at"),
    [
        ("academic", (1, 0), ("primary",), (0, None)),
        ("chain of 2", (0, 4), ("primary", "secondary", "tertiary", "quaternary"), (4,)),
        ("aly-chan", (0, 2), ("primary", "secondary"), (2,)),
        ("aly-chan, Mayer", (0, 2), ("primary", "secondary"), (2,)),
        ("gauge", (2, 0), ("primary", "secondary"), (None,)),
        ("massless particle", (0, 2), ("primary", "primary"), (1, 1)),
        ("brown", (2, 2), ("primary", "primary", "secondary", "secondary"), None),
        ("curved arc", (0, 2), ("primary", "secondary"), (2,)),
        ("sphere", (0, 2), ("primary", "secondary"), (2,)),
        ("dummy control", (0, 0), (), (0, None)),
    ],
)
@pytest.mark.usual(2)
def test_classes_levels_and_controls(name, classes, names, determined_at):
    c = classified(name)
    assert (c.first_class, c.second_class) == classes
    assert c.equations.names == names
    assert determined_at in (None, c.stratum.determined_at)
    assert c.gauge_controls == len(c.gauge_components)


def test_a_piece_that_is_not_there_is_named():
    c = classified("academic")
    assert c.choose(0).strata == c.strata
    for index in (-1, 1):
        with pytest.raises(InvalidInputError, match=rf"there is no stratum {index}; expected one of \[0\]"):
            c.choose(index)


def test_a_chain_of_integrators_loses_one_dimension_per_level():
    c = classified("chain of 2")
    assert [next(iter(level.strata)).codimension for level in c.levels] == [1, 2, 3, 4, 4]
    np.testing.assert_allclose(np.concatenate([c.stratum.q, c.stratum.p, c.stratum.u]), 0, atol=1e-12)


@pytest.mark.slow
def test_the_morse_family_is_told_from_a_dummy_control():
    dummy, regular, singular = (classified(name).morse for name in ("dummy control", "regular", "aly-chan"))
    assert not dummy.family
    assert not dummy.regular
    assert regular.family
    assert regular.regular
    assert singular.family
    assert not singular.regular
    assert singular.count == 20
    (q, p), problem = singular.states, known("aly-chan").problem
    slopes = jax.vmap(jax.grad(problem.hamiltonian, argnums=2))(q, p, singular.controls)
    assert slopes.shape == (20, 1)
    np.testing.assert_allclose(slopes, 0, atol=1e-9)
    assert classified("regular").regular


class Stirred(eqx.Module):
    """A drift, and controls of which the second is in a unit."""

    unit: Array

    def __call__(self, q, u):
        return jnp.stack([q[1] + u[0], self.unit * u[1]])


class Cheap(eqx.Module):
    """A cost of two controls, the second cheap, in a unit of it."""

    price: Array
    unit: Array

    def __call__(self, q, u):
        return (q @ q + u[0] ** 2 + self.price * (self.unit * u[1]) ** 2) / 2


@pytest.mark.slow
def test_a_cheap_control_is_no_free_one_in_any_unit():
    """``x' = y + u1``, ``y' = u2``, cost ``(x^2 + y^2 + u1^2 + 1e-8 u2^2)/2``: regular, as it is for ``solve``."""
    for price, unit in ((1e-8, 1.0), (1e-8, 1e4), (1e-8, 1e-2), (0.0, 1.0)):
        unit = jnp.array(unit)
        problem = OptimalControlProblem(Euclidean(2), Stirred(unit), Cheap(jnp.array(price), unit), 2)
        c = classify(problem)
        assert c.regular == Inspection(problem, jnp.ones(2), jnp.zeros(2)).is_regular == (price > 0), str(c)
        assert c.codimension == (0 if price else 2)


class Cancelled(eqx.Module):
    """``x' = (w0 - w1) sin u``, with the cost ``x^2 / 2 - (w0 - w1) cos u``."""

    weights: Array

    def __call__(self, q, u):
        return self.weights[0] * jnp.sin(u) - self.weights[1] * jnp.sin(u)

    def cost(self, q, u):
        return q @ q / 2 - self.weights[0] * jnp.cos(u[0]) + self.weights[1] * jnp.cos(u[0])


def test_a_control_is_determined_until_rounding_is_all_that_is_left_of_it():
    for share in (1e-3, 1e-12, 1e-16, 0.0):
        moved = Cancelled(jnp.array([1 + share, 1.0]))
        c = classify(OptimalControlProblem(Euclidean(1), moved, moved.cost, 1))
        assert c.reliable
        assert c.regular == c.morse.family == (share > 1e-14), (share, str(c))
        if share == 1e-3:  # the costate enters dH/du too: of all its derivatives there are more than of those by u
            assert c.morse.family_singular_values[-1] > c.morse.hessian_singular_values[-1] > 0
        assert (c.codimension, c.rank, c.gauge_controls) == (0, 2, 0 if share > 1e-14 else 1), (share, str(c))


def test_regularity_is_a_statement_about_points_with_vanishing_dh_du_alone():
    # dH/du = u - u^3 vanishes at u = -1, 0, 1; d2H/du2 = 1 - 3 u^2 at u^2 = 1/3, which is no such point.
    problem = OptimalControlProblem(Euclidean(1), lambda q, u: q, lambda q, u: (u[0] ** 2 - 1) ** 2 / 4, 1)
    c = classify(problem)
    assert c.morse.family
    assert c.regular
    assert {round(float(s.u[0])) for s in c.strata} <= {-1, 0, 1}
    np.testing.assert_allclose(c.stratum.u, np.round(c.stratum.u), atol=1e-9)


def test_the_paper_s_example_is_reported_as_published():
    c = classified("academic")
    assert c.determined_controls == c.gauge_controls == 1
    assert c.gauge_components == (1,)
    assert c.stratum.determined_at == (0, None)
    np.testing.assert_allclose(np.abs(np.concatenate(c.stratum.kernel, axis=1)), [[0, 0, 0, 1]], atol=1e-12)
    for line in (
        "dimension 3 in T*Q of dimension 4: 1 primary equation\n",
        "rank 2, kernel of dimension 1",
        "1 first class, 0 second class",
    ):
        assert line in str(c)
    assert "1 determined (u[0] by level 0), 1 free (gauge; parametrised by u[1])" in str(c)


def test_components_of_a_control_that_is_no_vector_are_not_called_its_entries():
    """``q' = u[0, 0]`` without cost, ``u`` of shape ``(1, 2)``."""
    c = classify(OptimalControlProblem(Euclidean(1), lambda q, u: u[0, :1], lambda q, u: 0 * q[0], Euclidean((1, 2))))
    names = "coordinate 0, coordinate 1"
    assert c.gauge_components == (0, 1)
    assert f"parametrised by {names}); coordinates in the retraction chart of U around u = [[" in " ".join(
        str(c).split()
    )
    with pytest.raises(
        InvalidInputError, match=rf"the gauge controls {names}, shape \(2,\); coordinates in the retraction chart"
    ):
        singular_integrator(c, Midpoint(Addition(Euclidean(1))), gauge=0.0)


@pytest.mark.slow
def test_components_of_a_control_on_a_sphere_are_coordinates_of_it():
    """``x1' = x2``, ``x2' = u1``, ``u`` in ``S^2``: ``u1 = -x1`` on the arc, and one coordinate in a chart of ``S^2``
    is free."""
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: (q[1] ** 2 - q[0] ** 2) / 2, Sphere(2)
    )
    c = classify(problem)
    c = c.choose([s.free_controls for s in c.strata].index(1))
    (free,), center = c.gauge_components, c.stratum.feedback.center
    given = c.stratum.feedback.jet[0, free] + 0.02
    u = c.control(c.stratum.q, c.stratum.p, given)
    np.testing.assert_allclose(u[0], -c.stratum.q[0], atol=1e-9)
    chart = default_retraction(problem.controls).inverse(center, u)
    np.testing.assert_allclose(problem.controls.basis(center)[free] @ chart, given, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"problem": None}, "classify takes an OptimalControlProblem"),
        ({"starts": 0}, "starts must be a positive number"),
        ({"near": (jnp.zeros(2), jnp.zeros(2)), "symbolic": True}, "leave near out"),
        (
            {"problem": OptimalControlProblem(Euclidean(1), lambda q, u: q, lambda q, u: q[0], 0)},
            "the problem has no controls",
        ),
    ],
)
def test_wrong_input_is_refused_in_words(arguments, message):
    arguments = {"problem": known("regular").problem, **arguments}
    with pytest.raises(InvalidInputError, match=message):
        classify(arguments.pop("problem"), **arguments)


def test_under_a_transformation_it_says_that_it_runs_outside():
    made, midpoint = known("academic").problem, Midpoint(Addition(Euclidean(2)))
    found = classified("academic")
    with pytest.raises(InvalidInputError, match=r"classify runs outside jit"):
        jax.jit(lambda cost: classify(scaled(made, (1.0, cost, 1.0))).stratum.q)(1.0)
    with pytest.raises(InvalidInputError, match=r"singular_integrator runs outside jit"):
        jax.grad(lambda k: singular_integrator(found, midpoint, gauge=lambda t, q, p: k * q[:1]).lift.theta)(1.0)


def test_starts_near_what_is_no_state_are_refused():
    with pytest.raises(NotOnManifoldError, match=r"near must be a state \(q, p\)"):
        classify(known("regular").problem, near=(jnp.zeros(3), jnp.zeros(2)))


@pytest.mark.parametrize("finished", range(4))
def test_an_interrupted_classification_has_its_levels(finished, monkeypatch, caplog):
    """Ctrl-C at each level, and behind the last one."""
    problem, summarise = scaled(known("academic").problem, ONE), summarise_levels
    count = len(classified("academic").levels)
    calls = iter(range(finished))

    def interrupted(*arguments):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return summarise(*arguments)

    monkeypatch.setattr(sys.modules[classify.__module__], "summarise", interrupted)
    with caplog.at_level(logging.INFO, "retrax"):
        if finished < count:
            with pytest.raises(KeyboardInterrupt) as caught:
                classify(problem, verbose=True)
            assert [level.index for level in caught.value.args[0]] == [*range(finished)]
        else:
            assert len(classify(problem, verbose=True).levels) == count
    assert ("20 of 20 points" in caplog.text) == (finished >= count)


@pytest.mark.parametrize(
    ("function", "written"),
    [
        (jax.nn.softplus, lambda x: jnp.log1p(jnp.exp(x))),
        (lambda x: jnp.logaddexp(x, 0.5), lambda x: jnp.log(jnp.exp(x) + jnp.exp(0.5))),
    ],
    ids=["softplus", "logaddexp"],
)
@pytest.mark.slow
def test_functions_with_derivatives_of_their_own_are_expanded_too(function, written):
    """Taylor arithmetic has no rule for them: nested derivatives have those that they say."""
    plane = Euclidean(2)

    def found(rate):
        dynamics = lambda q, u: jnp.stack([rate(q[1]), u[0]])  # noqa: E731
        return classify(OptimalControlProblem(plane, dynamics, lambda q, u: q @ q / 2, 1), starts=8)

    one, other = found(function), found(written)
    assert (one.dimension, one.k_f_base) == (other.dimension, other.k_f_base) == (2, 1)
    z = jax.tree.map(lambda leaf: leaf[0], other.stratum.states)
    np.testing.assert_allclose(one.control(*z), other.control(*z), rtol=1e-9)
