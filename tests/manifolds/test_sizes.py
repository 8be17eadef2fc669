"""What is said of sizes and shapes that make no manifold."""

import numpy as np
import pytest
from retrax.manifolds import SE, SL, SO, SPD, SU, Euclidean, Hyperbolic, InvalidInputError, Simplex, Sphere, U

LEAST = {SO: 2, SE: 2, SU: 2, SL: 2, U: 1, Sphere: 1, Hyperbolic: 1, Simplex: 1, SPD: 1}


@pytest.mark.parametrize("kind", LEAST)
@pytest.mark.parametrize("size", [None, 2.0, "3", True, 0, -1, (2,)])
def test_a_wrong_size_is_refused(kind, size):
    name, least = kind.__name__, LEAST[kind]
    with pytest.raises(
        InvalidInputError, match=rf"{name}\(n\) takes a whole number n of at least {least}, got .*; try {name}\("
    ):
        kind(size)


@pytest.mark.parametrize("kind", LEAST)
def test_a_size_may_be_an_integer_of_numpy_and_no_less_than_the_least(kind):
    assert kind(np.int64(3)).dimension == kind(3).dimension
    assert kind(LEAST[kind]).dimension > 0
    if LEAST[kind] == 2:
        with pytest.raises(InvalidInputError, match="at least 2, got 1"):
            kind(1)


@pytest.mark.parametrize("shape", [2.5, (2, 3.0), "ab", -1, (2, -1), None, True])
def test_a_wrong_shape_is_refused(shape):
    with pytest.raises(InvalidInputError, match=r"a shape is one length or a tuple, .* got .*; try \(3,\)"):
        Euclidean(shape)


def test_shapes_are_lengths_or_several():
    assert Euclidean(np.int64(3)) == Euclidean(3) == Euclidean((3,)) == Euclidean([3])
    assert Euclidean((2, 3)).dimension == 6
    assert Euclidean(()).dimension == 1
    assert Euclidean(0).dimension == 0  # a point: the controls that are left when all are singular
