"""A value that a function reads may change between two calls: it is read again, however it is held."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import Jaxpr
from retrax.compute import jit_cache
from retrax.compute.jit_cache import compile_and_call
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, classify, integrate, integrate_many, solve
from retrax.integrators.problem.optimal_control_problem import is_same_problem
from retrax.integrators.problem_checks.smoothness.step_primitives import find_step_primitives
from retrax.manifolds import Euclidean, InvalidInputError, LevelSet
from retrax.retractions import CotangentLift, Exponential, Midpoint, Projection
from retrax.tape import Tape
from retrax.tracing import trace_program

from tests.support.changing import WAYS, held

LINE = Euclidean(1)
FEW = "attribute of a class", "slots", "jitted helper", "jitted helper of a derivative"  # others are traced as these
SOME = [way if way in FEW else pytest.param(way, marks=pytest.mark.slow) for way in WAYS]


def priced(product):
    """``q' = u`` at the cost ``q^2 + k u^2``: regular, or, for ``k = 0``, of a single extremal at rest."""
    return OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q + u @ product(u), 1)


@pytest.mark.parametrize("way", WAYS)
def test_a_changed_value_changes_the_value_of_a_compiled_function(way):
    product, change = held(way, 1.0)
    for k in (1.0, 2.0, -3.0, 2.0):
        change(k)
        value, *_ = compile_and_call(lambda f, x: f(x) + x, product, jnp.arange(3.0))
        np.testing.assert_array_equal(value, (k + 1) * np.arange(3.0))


@pytest.mark.parametrize("way", WAYS)
def test_a_changed_value_changes_the_tape(way):
    product, change = held(way, 1.0)
    for k in (1.0, 2.0, -3.0):
        change(k)
        tape = Tape.trace(product, np.zeros(3))
        np.testing.assert_array_equal(tape(np.eye(3)), k * np.eye(3))
        np.testing.assert_array_equal(tape.jacobian()(np.eye(3))[..., 0], k * np.eye(3))


@jax.jit
def stepped(x):
    return jnp.round(x) if STEPS["there"] else x


STEPS = {"there": False}


def test_a_step_that_a_jitted_helper_has_later_is_seen():
    found = []
    for STEPS["there"] in (False, True, False):
        found.append(find_step_primitives(stepped, 1.0))
    assert found == [[], ["jnp.round"], []]


@pytest.mark.parametrize("way", WAYS)
def test_a_problem_is_another_one_where_its_functions_compute_another_value(way):
    (product, change), (other, change_other) = held(way, 1.0), held(way, 1.0)
    problem, same = priced(product), priced(other)
    before = problem._digest()
    assert is_same_problem(problem, same)
    change(2.0)
    change_other(2.0)
    assert problem._digest() != before
    assert is_same_problem(problem, same)
    assert not is_same_problem(problem, priced(lambda u: 3 * u))


@pytest.mark.parametrize("evaluator", ["tape", pytest.param("xla", marks=pytest.mark.slow)])
@pytest.mark.parametrize("way", SOME)
@pytest.mark.usual(1)
def test_a_changed_value_changes_the_trajectory(way, evaluator):
    """``q'' = -k q``: a step of the midpoint rule is known, one by one and of many."""
    product, change = held(way, 1.0)
    method = SymplecticIntegrator(CotangentLift(Midpoint(Exponential(LINE))))
    for k in (1.0, 4.0, 1.0):
        change(k)
        start = np.ones(1), np.zeros(1)
        path = integrate(lambda q, p: (p @ p + q @ product(q)) / 2, method, start, 0.5, 1, evaluator=evaluator)
        many = integrate_many(
            lambda q, p: (p @ p + q @ product(q)) / 2,
            method,
            (np.ones((2, 1)), np.zeros((2, 1))),
            0.5,
            1,
            evaluator=evaluator,
        )
        for end in (path.q[-1, 0], *many.q[:, -1, 0]):
            assert end == pytest.approx((1 - k / 16) / (1 + k / 16), rel=1e-14)


@pytest.mark.parametrize("way", SOME)
@pytest.mark.usual(1)
def test_a_changed_value_changes_the_classification(way):
    product, change = held(way, 1.0)
    problem = priced(product)
    found = []
    for k in (1.0, 0.0):
        change(k)
        found.append(classify(problem, starts=2))
    assert [c.regular for c in found] == [True, False]
    assert [c.dimension for c in found] == [2, 0]
    assert [c.is_of(problem) for c in found] == [False, True]


def test_a_classification_of_other_values_is_refused():
    product, change = held("slots", 0.0)
    problem = priced(product)
    found = classify(problem, starts=2)
    change(1.0)
    with pytest.raises(
        InvalidInputError, match="classification must be that of the problem with its functions as they are"
    ):
        solve(problem, np.zeros(1), np.ones(1), 1.0, method=Midpoint(Exponential(LINE)), steps=4, classification=found)


def test_a_root_with_a_rule_of_its_own_is_compiled_once():
    def root(x):
        def solve(f, y):
            return jax.lax.fori_loop(0, 9, lambda i, y: y - f(y) / (1 + 3 * y**2), y)

        return jax.lax.custom_root(lambda y: y + y**3 - x, x, solve, lambda g, y: y / g(1.0))

    def seconds():
        return compile_and_call(lambda x: root(x) + jax.grad(root)(x), jnp.array(1.0))[1]

    first = seconds()
    known = len(jit_cache._compiled)
    again = [seconds() for _ in range(3)]
    assert len(jit_cache._compiled) == known
    assert max(again) < first


def test_what_a_user_compiled_is_left_alone():
    """Reading functions anew has no effect on the user's own calls of them."""
    traces = []

    @jax.jit
    def product(x):
        traces.append(x)
        return 2 * x

    product(jnp.ones(3))
    compile_and_call(product, jnp.ones(3))
    assert len(traces) == 2
    product(jnp.ones(3))
    assert len(traces) == 2


@pytest.mark.slow  # thousands of traces
def test_what_was_read_is_released():
    growing = jax.jit(lambda x: jnp.sin(x) * x)  # lives on: JAX finds what it traced of it again, by its identity

    def alive():
        gc.collect()
        return sum(issubclass(type(each), Jaxpr) for each in gc.get_objects())  # a proxy of what is gone has no class

    def read(times):
        for _ in range(times):
            trace_program(lambda x: growing(x), np.zeros(2))
        return alive()

    before = alive()
    read(2100)  # JAX's other caches are bounded by 2048 entries
    assert read(2100) < before + 2 * 2100


RADIUS = [1.0]


class Circle(LevelSet):
    shape = (2,)

    def constraint(self, x):
        RADIUS[1:] = [*RADIUS[1:], 0.0]
        return x @ x - RADIUS[0] ** 2


@pytest.mark.slow
def test_a_manifold_that_changes_is_another_one_and_is_read_a_few_times_in_a_call():
    """An arc of a quarter turn costs ``(pi r / 2)^2 / 2``; the same object, whose constraint reads the radius."""
    circle = Circle()
    problem = OptimalControlProblem(circle, lambda q, u: circle.projection(q, u), lambda q, u: u @ u / 2, 2)
    for radius in (1.0, 2.0, 0.5):
        RADIUS[:] = [radius]
        start = np.array([radius, 0.0])
        found = solve(problem, start, start[::-1], 1.0, method=Midpoint(Projection(circle)), steps=40)
        assert found.cost == pytest.approx((np.pi * radius / 2) ** 2 / 2, rel=1e-3)
        assert len(RADIUS) < 150  # it would be 600 times if each of its derivatives were traced wherever it is used
