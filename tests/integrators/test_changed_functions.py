"""A value that a function reads may change between two calls: it is read again, however it is held."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, classify
from retrax.integrators.compilation import call_compiled
from retrax.manifolds import Euclidean

from tests.support.changing import WAYS, held

LINE = Euclidean(1)


@pytest.fixture(params=WAYS)
def way(request):
    return request.param


def priced(product):
    """``q' = u`` at the cost ``q^2 + k u^2``: regular, or, for ``k = 0``, of a single extremal at rest."""
    return OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q + u @ product(u), 1)


def test_a_changed_value_changes_the_value_of_a_compiled_function(way):
    product, change = held(way, 1.0)
    for k in (1.0, 2.0, -3.0, 2.0):
        change(k)
        value, *_ = call_compiled(lambda f, x: f(x) + x, product, jnp.arange(3.0))
        np.testing.assert_array_equal(value, (k + 1) * np.arange(3.0))


def test_a_changed_value_changes_the_classification(way):
    product, change = held(way, 1.0)
    problem = priced(product)
    found = []
    for k in (1.0, 0.0, 1.0):
        change(k)
        found.append(classify(problem, starts=4))
    assert [c.regular for c in found] == [True, False, True]
    assert [c.dimension for c in found] == [2, 0, 2]
    assert [c.is_of(problem) for c in found] == [True, False, True]
