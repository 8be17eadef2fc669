"""Numbers that a tape may not simplify or round: whole ones, and those that are none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.tape import Tape

WHOLE = {
    "whole division": lambda i, d: i // d,
    "division towards zero": jax.lax.div,
    "floor": lambda i, d: jnp.floor(i / d),
    "ceiling": lambda i, d: -jnp.ceil(-i / d),
    "row of a table": lambda i, d: jnp.arange(12.0)[i // d],
}
ROOTS = {
    "square": lambda x: jnp.sqrt(x) ** 2,
    "product": lambda x: jnp.sqrt(x) * jnp.sqrt(x),
    "fourth power": lambda x: jnp.sqrt(x) ** 4,
    "power of a half": lambda x: (x**0.5) ** 2,
    "powers": lambda x: ((jnp.stack([x, x]) ** jnp.array([2.0, 0.5])) ** 2)[1],
    "sum of squares": lambda x: jnp.sum(jnp.stack([jnp.sqrt(x), 1.0]) ** 2),
    "norm": lambda x: jnp.linalg.norm(jnp.stack([jnp.sqrt(x), 1.0])),
    "inner product": lambda x: jnp.stack([jnp.sqrt(x), 1.0]) @ jnp.stack([jnp.sqrt(x), 2.0]),
    "inverse": lambda x: 1 / jax.lax.rsqrt(x) ** 2,
    "of a difference": lambda x: jnp.sqrt(1 + x - x**2 - 1) ** 2 + 1,
}


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("name", WHOLE)
def test_multiples_are_divided_as_exactly_as_one_number_alone(name, count):
    """With three or more by one divisor its inverse is shared, and ``49 (1 / 49) < 1``."""
    tape = Tape.trace(WHOLE[name], np.zeros(count, int), np.array(1))
    divisors = np.arange(1, 200)
    multiples = divisors * np.arange(1, count + 1)[:, None]
    found = tape(multiples.astype(float), divisors.astype(float))
    np.testing.assert_array_equal(found, np.broadcast_to(np.arange(1.0, count + 1)[:, None], found.shape))


@pytest.mark.parametrize("name", ROOTS)
def test_the_square_of_a_root_is_none_below_zero(name):
    points = np.array([-2.0, -1e-3, 0.25, 0.75])
    tape = Tape.trace(ROOTS[name], points[0])
    expected = jax.vmap(ROOTS[name])(points)
    assert np.isnan(expected[:2]).all()
    np.testing.assert_allclose(tape(points), expected, rtol=1e-13)


@pytest.mark.parametrize("order", ["C", "F"])
def test_entries_are_taken_in_the_order_that_is_asked_for(order):
    """Columns first, of numbers that are known and of those that are not, also to index by."""

    def function(x):
        table = jnp.reshape(jnp.arange(6.0), (2, 3), order=order) * x.sum()
        places = jnp.ravel(jnp.arange(6).reshape(2, 3), order=order)
        return jnp.stack([table.ravel(), jnp.ravel(x.reshape(2, 3), order=order), jnp.arange(6.0)[places]])

    x = np.linspace(0.5, 1.5, 6) ** 2
    np.testing.assert_allclose(Tape.trace(function, x)(x[:, None])[..., 0], function(x), rtol=1e-15)


@pytest.mark.parametrize("x", [-1.0, 0.0, 0.5, np.inf, np.nan])
def test_roots_of_what_is_nowhere_negative_are_as_before(x):
    def function(x):
        return jnp.sqrt(x**2 + jnp.exp(x)) ** 2 + jnp.sqrt(jnp.abs(x)) ** 2 + jnp.sqrt(2.0) * x

    found = Tape.trace(function, 1.0)(np.array([x]))
    np.testing.assert_allclose(found, [function(jnp.asarray(x))], rtol=1e-14)
