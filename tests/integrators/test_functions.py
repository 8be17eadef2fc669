"""Functions of a user under JAX's transformations, and programs that are compiled once."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute import jit_cache
from retrax.compute.jit_cache import compile_and_call, digest, optimize_and_call
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.integrators.problem.user_functions import in_precision, require_concrete
from retrax.manifolds import Euclidean, InvalidInputError, NotDifferentiableError
from retrax.manifolds.numerics.ambient import is_transformed
from retrax.retractions import Addition, CotangentLift, Exponential, Gauss, Midpoint
from retrax.tracing import one_tracing, reads_once

LINE = Euclidean(1)
MIDPOINT = Midpoint(Exponential(LINE))
THREE = jnp.arange(3.0)


def test_a_manifold_described_in_double_precision_brings_no_warning_in_single(recwarn):
    with jax.enable_x64(False):
        assert in_precision("dynamics", np.ones(2), np.dtype(np.float64)).dtype == np.float32
    assert not recwarn.list


def test_a_changed_parameter_changes_the_trajectory_and_is_differentiated():
    integrator, start = SymplecticIntegrator(CotangentLift(MIDPOINT)), (jnp.ones(1), jnp.zeros(1))

    def end(k):
        return integrate(lambda q, p: p @ p / 2 + k * q @ q / 2, integrator, start, 0.1, 5).q[-1, 0]

    ends = [float(end(k)) for k in (1.0, 1.001, 1.0)]
    assert ends[0] == ends[2]
    slope = (ends[1] - ends[0]) / 1e-3
    for derivative in (jax.grad(end), jax.jit(jax.grad(end))):
        assert slope == pytest.approx(float(derivative(1.0)), rel=1e-2)


@pytest.mark.parametrize(
    "transform",
    [
        jax.jit,
        jax.grad,
        lambda f: lambda k: jax.vmap(f)(jnp.array([k])),
        lambda f: lambda k: jax.jvp(f, (k,), (1.0,)),
        lambda f: lambda k: jax.linearize(f, k),
    ],
    ids=["jit", "grad", "vmap", "jvp", "linearize"],
)
def test_a_transformation_of_the_caller_is_seen(transform):
    seen = []

    def inside(k):
        seen.append(is_transformed())
        with pytest.raises(InvalidInputError, match="runs outside jit"):
            require_concrete("solve", 1.0)
        return k * k

    transform(inside)(1.0)
    assert seen[0]
    assert not is_transformed(1.0)


def test_a_compiled_function_is_differentiated_in_what_it_closes_over():
    def total(k):
        return compile_and_call(lambda x: jnp.sum(k * x * x), THREE)[0]

    assert jax.grad(total)(2.0) == jax.jit(jax.grad(total))(2.0) == 5.0
    np.testing.assert_array_equal(jax.vmap(total)(jnp.arange(2.0)), [0.0, 5.0])


@pytest.fixture
def compilations(monkeypatch):
    """How many programs were compiled."""
    monkeypatch.setattr(jit_cache, "_compiled", {})
    return lambda: len(jit_cache._compiled)


def scaled(k):
    return lambda x: k * x


def test_an_equal_program_is_not_compiled_again(compilations):
    for k in (1.0, 2.0):
        value, *_ = compile_and_call(scaled(jnp.array(3 * [k])), THREE)
        np.testing.assert_array_equal(value, k * THREE)
    value, *_ = compile_and_call(lambda f, x: f(x), scaled(np.full(3, 3.0)), THREE)
    np.testing.assert_array_equal(value, 3 * THREE)
    assert compilations() == 1


# Each pair differs in one thing: an operation, its order, a number in the text, a parameter, a kind, what is in a loop
# or branch.
DIFFERENT = {
    "operation": (lambda x: x + 1, lambda x: x - 1),
    "number": (lambda x: x * 2, lambda x: x * 3),
    "sign of zero": (lambda x: x * 0.0, lambda x: x * -0.0),
    "order": (lambda x: x - x[::-1], lambda x: x[::-1] - x),
    "output": (lambda x: (x, x + 1), lambda x: (x + 1, x)),
    "parameter": (lambda x: jnp.sum(x.reshape(1, 3), axis=0), lambda x: jnp.sum(x.reshape(1, 3), axis=1)),
    "power": (lambda x: x**3, lambda x: x**4),
    "kind": (lambda x: x.astype(jnp.float32), lambda x: x.astype(jnp.int32)),
    "loop": (
        lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y + x, x),
        lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y - x, x),
    ),
    "length of a loop": (
        lambda x: jax.lax.fori_loop(0, 3, lambda _, y: y + x, x),
        lambda x: jax.lax.fori_loop(0, 4, lambda _, y: y + x, x),
    ),
    "branch": (
        lambda x: jax.lax.cond(x[0] > 0, jnp.sin, jnp.cos, x),
        lambda x: jax.lax.cond(x[0] > 0, jnp.cos, jnp.sin, x),
    ),
    "constant of an inner function": (jax.jit(scaled(jnp.ones(3))), jax.jit(scaled(jnp.full(3, 2.0)))),
    "index": (lambda x: x.at[jnp.array([0])].get(mode="clip"), lambda x: x.at[jnp.array([0])].get(mode="fill")),
}


@pytest.mark.parametrize("name", DIFFERENT)
def test_different_programs_are_told_apart(name):
    one, other = DIFFERENT[name]
    assert digest(one, THREE) == digest(one, THREE)
    assert digest(one, THREE) != digest(other, THREE)


def test_what_is_not_known_is_compiled_anew(compilations):
    for k in (1.0, 2.0):
        value, *_ = compile_and_call(lambda x, k=k: jax.pure_callback(lambda x: k * np.asarray(x), THREE, x), THREE)
        np.testing.assert_array_equal(value, k * THREE)
    assert compilations() == 2
    assert digest(lambda x: jax.pure_callback(np.asarray, THREE, x), THREE) is None


@pytest.mark.parametrize("used", ["threefry2x32", "rbg", "unsafe_rbg"])
def test_programs_with_random_numbers_are_compiled_once(compilations, used):
    """Their equations have functions of JAX among their parameters; those of other generators are others."""

    def moved(x, impl=used):
        return x + jax.random.normal(jax.random.key(3, impl=impl), x.shape)

    values = [compile_and_call(lambda x: moved(x), THREE)[0] for _ in range(3)]
    np.testing.assert_array_equal(values[0], values[2])
    assert compilations() == 1
    other = "threefry2x32" if used == "rbg" else "rbg"
    assert digest(moved, THREE) != digest(partial(moved, impl=other), THREE)


def test_functions_with_a_name_of_another_are_told_apart(compilations):
    """A function of a user who gives it the place and the name of one of JAX."""

    def renamed(x):
        return 2 * np.asarray(x)

    renamed.__module__, renamed.__qualname__ = jax.numpy.sin.__module__, "sin"
    for _ in range(2):
        value, *_ = compile_and_call(lambda x: jax.pure_callback(renamed, THREE, x), THREE)
        np.testing.assert_array_equal(value, 2 * THREE)
    assert compilations() == 2


def test_a_function_that_runs_long_is_another_program_with_the_same_values(compilations):
    def function(x):
        return jnp.sum(jnp.sin(x) * jnp.exp(-x))

    for call in (compile_and_call, optimize_and_call, compile_and_call, optimize_and_call):
        assert call(function, THREE)[0] == pytest.approx(float(function(THREE)), rel=1e-15)
    assert compilations() == 2


def test_programs_of_arrays_of_another_kind_are_compiled(compilations):
    for x in (THREE, jnp.arange(4.0), jnp.arange(3)):
        np.testing.assert_array_equal(compile_and_call(lambda x: 2 * x, x)[0], 2 * x)
    assert compilations() == 3


def test_as_many_programs_are_kept_as_is_said(compilations, monkeypatch):
    monkeypatch.setattr(jit_cache, "MOST_COMPILED", 2)
    for k in (1.0, 2.0, 3.0, 1.0):
        assert compile_and_call(lambda x, k=k: k * x, 2.0 * jnp.ones(()))[0] == 2 * k
    assert compilations() == 2


def test_values_that_are_no_arrays_are_returned():
    value, *_ = compile_and_call(lambda x: {"x": x, "name": "x", "none": None, "count": 3}, THREE)
    assert (value["name"], value["none"], value["count"]) == ("x", None, 3)
    np.testing.assert_array_equal(value["x"], THREE)


def test_numbers_that_are_equal_are_told_apart_where_they_compute_otherwise():
    with one_tracing():
        for k in (0.0, -0.0, 0, False):
            value, *_ = compile_and_call(lambda k, x: jnp.copysign(x, k), k, THREE)
            np.testing.assert_array_equal(np.signbit(value), np.signbit(np.full(3, float(k))))


def test_within_one_reading_a_function_is_traced_once_and_after_it_again():
    traces = []

    def counted(x):
        traces.append(x)
        return x + 1

    @reads_once
    def often():
        return [compile_and_call(counted, x)[0] for x in (THREE, 2 * THREE, jnp.arange(4.0))]

    for done in (2, 4):
        np.testing.assert_array_equal(often()[1], 2 * THREE + 1)
        assert len(traces) == done


def test_a_loop_runs_where_jit_is_disabled():
    with jax.disable_jit():
        value, *_ = compile_and_call(lambda x: jax.lax.while_loop(lambda y: jnp.sum(y) < 30, lambda y: 2 * y, x), THREE)
    np.testing.assert_array_equal(value, 16 * THREE)


@jax.custom_vjp
def backward_only(x):
    return x**2


backward_only.defvjp(lambda x: (x**2, x), lambda x, t: (2 * x * t,))


def looped(x):
    return jax.lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[1] * 1.1), (0, x))[1]


def called(x, method=None):
    return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method=method)


WITHOUT_DERIVATIVES = {
    "custom_vjp": (backward_only, "try jax.custom_jvp"),
    "while_loop": (looped, "try jax.lax.fori_loop with a number of rounds that no value decides"),
    "callback": (called, "try the same in jax.numpy"),
    "callback in turn": (lambda x: called(x, "sequential"), "try the same in jax.numpy"),
}


@pytest.mark.parametrize("name", WITHOUT_DERIVATIVES)
def test_functions_without_derivatives_are_answered_with_what_has_some(name):
    function, hint = WITHOUT_DERIVATIVES[name]
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2 + function(q[0]), 1)
    with pytest.raises(NotDifferentiableError, match=f"JAX cannot differentiate, or map, a function.*{hint}"):
        solve(problem, np.zeros(1), np.ones(1), 1.0, method=Gauss(2, Addition(LINE)), steps=5)
    with pytest.raises(NotDifferentiableError, match=f"JAX cannot differentiate, or map, a function.*{hint}"):
        integrate(
            lambda q, p: p @ p / 2 + function(q[0]),
            SymplecticIntegrator(CotangentLift(MIDPOINT)),
            (np.zeros(1), np.ones(1)),
            0.1,
            5,
        )


def test_an_equation_that_is_no_function_of_jax_keeps_its_own_error():
    def failing(q, u):
        raise ValueError("a table ends at 3")

    with pytest.raises(ValueError, match="a table ends at 3"):
        OptimalControlProblem(LINE, lambda q, u: u, failing, 1).check(np.zeros(1), np.zeros(1))
