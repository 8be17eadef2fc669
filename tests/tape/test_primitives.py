"""Every primitive of the tape gives the values and derivatives that XLA gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.jaxpr_tools import called_program
from retrax.tape import Tape
from retrax.tape.elementwise import ELEMENTWISE_PRIMITIVES
from retrax.tape.guarded_rules import BY_MARKS
from retrax.tape.linear import LINEAR
from retrax.tape.structural_rules import STRUCTURAL_RULES

from .functions import SMOOTH, SPECIAL

POINTS = 0.05 + 0.9 * np.random.default_rng(0).random((3, 5))


def weights(values):
    """One value whose derivatives show those of all of a function's."""
    return jnp.sum(jnp.sin(jnp.arange(1.0, 4.0) * values))


def weighted(function):
    """The same, of the argument of the function."""
    return lambda x: weights(function(x))


CASES = {
    **{name: (function, POINTS) for name, function in SMOOTH.items()},
    **{n: (f, x[:, None]) for n, (f, x) in SPECIAL.items()},
}


@pytest.fixture(scope="module")
def by_xla():
    """Values, gradients and Hessians of all functions, each traced once, and ten compiled together: all in one take
    longer."""

    def all_of(function, points):
        def value(x):
            values = function(x)
            return weights(values), values

        def slope(x):
            found, values = jax.grad(value, has_aux=True)(x)
            return found, (found, values)

        def at(x):
            curvature, (found, values) = jax.jacfwd(slope, has_aux=True)(x)
            return values, found, curvature

        return jax.vmap(at, -1, -1)(points)

    found, names = {}, list(CASES)
    for first in range(0, len(names), 10):
        points = {name: CASES[name][1] for name in names[first : first + 10]}
        found |= jax.jit(lambda data: {name: all_of(CASES[name][0], x) for name, x in data.items()})(points)
    return found


@pytest.mark.parametrize("name", CASES)
@pytest.mark.usual(8)
def test_values_and_two_derivatives_are_those_of_xla(name, by_xla):
    function, points = CASES[name]
    values, slopes, curvatures = by_xla[name]
    np.testing.assert_allclose(Tape.trace(function, points[:, 0])(points), values, rtol=1e-13, atol=1e-14)
    tape = Tape.trace(weighted(function), points[:, 0])
    np.testing.assert_allclose(tape.gradient()(points), slopes, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(tape.hessian()(points), curvatures, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("name", ["sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt"])
def test_both_parts_of_complex_numbers_have_all_their_digits(name):
    """Also where XLA loses some, next to zero."""
    z = np.array(
        [1e-12 - 1e-9j, 1e-9 + 1e-12j, 1e-20j, -3 + 1e-9j, -3 - 1e-9j, -1 + 1e-20j, 300 - 1j, 1e-200 + 1e-200j]
    )
    np.testing.assert_allclose(
        [part(Tape.trace(getattr(jnp, name), 1j)(z)) for part in (np.real, np.imag)],
        [part(getattr(np, name)(z)) for part in (np.real, np.imag)],
        rtol=1e-14,
    )


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_come_where_they_are_asked_for(lost):
    """Through the point where a choice changes, from either side: in values, and in a derivative by a factor."""
    x = np.array([-1.0, -1e-300, 0.0, 1e-300, 1.0])
    for choice in (
        lambda x, y: jnp.where(x > 0, x, lost) * y,
        lambda x, y: jnp.where(x < 0, lost, 0.0) * y,
        lambda x, y: jnp.where(x > 0, lost, -lost) * y,
        lambda x, y: jnp.where(x < 0, jnp.where(x < -0.5, 1.0, lost), x) * y,
    ):
        tape, y = Tape.trace(choice, 0.0, 0.0), np.full(5, 3.0)
        np.testing.assert_array_equal(tape(x, y), jax.vmap(choice)(x, y))
        np.testing.assert_array_equal(tape.gradient(1)(x, y)[0], jax.vmap(jax.grad(choice, 1))(x, y))
        np.testing.assert_array_equal(tape.hessian(1)(x, y), np.zeros((1, 1, 5)))


def test_each_of_two_choices_in_a_sum_has_its_own_condition():
    x, y = (a.ravel() for a in np.meshgrid([-2.0, 3.0], [-5.0, 7.0]))
    tape = Tape.trace(lambda x, y: jnp.where(x > 0, 0.0, x) + jnp.where(y > 0, y, 0.0), 0.0, 0.0)
    np.testing.assert_array_equal(tape(x, y), np.minimum(x, 0) + np.maximum(y, 0))


@pytest.mark.parametrize("name", ["NaN in the entries of what is known", "zero or infinite"])
def test_casadi_derives_choices_of_what_is_not_finite(name):
    """Its own machine multiplies by truth values, where ours chooses."""
    function, x = SPECIAL[name]
    slope = Tape.trace(weighted(function), x).gradient().to_casadi()(x).full()
    np.testing.assert_allclose(slope[:, 0], jax.grad(weighted(function))(x), rtol=1e-12)


def primitives(jaxpr, found):
    for eqn in jaxpr.eqns:
        found.add(eqn.primitive.name)
        for value in jax.tree.leaves(
            [*eqn.params.values(), called_program(eqn)], is_leaf=lambda v: hasattr(v, "eqns") or hasattr(v, "jaxpr")
        ):
            if hasattr(value, "eqns") or hasattr(value, "jaxpr"):
                primitives(getattr(value, "jaxpr", value), found)
    return found


NEWER = {"log2", "one_minus_square", "polynomial"}  # since JAX 0.11


def test_every_rule_is_used_by_one_of_these_functions():
    used = set().union(*(primitives(jax.make_jaxpr(f)(POINTS[:, 0]).jaxpr, set()) for f, _ in CASES.values()))
    assert {*STRUCTURAL_RULES, *LINEAR, *ELEMENTWISE_PRIMITIVES, *BY_MARKS} - used == (
        NEWER if jax.__version_info__ < (0, 11) else set()
    )
