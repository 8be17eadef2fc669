"""Round trips of retractions whose points are matrices, compiled once each."""

from functools import lru_cache

import numpy as np

from .numerics import compiled, draw_point, draw_tangent, unflat


@lru_cache
def programs(retraction):
    """A retraction and its inverse: apart, as each is compiled once so however often a round trip needs it."""
    return compiled(retraction), compiled(retraction.inverse)


def inverse(retraction, x, y):
    """What the inverse finds, compiled: NaN outside the image."""
    return programs(retraction)[1](x, y)


def round_trip(retraction, x, v):
    """Value of a retraction, what its inverse finds from there, and the value of that."""
    y = programs(retraction)[0](x, v)
    back = inverse(retraction, x, y)
    return y, back, programs(retraction)[0](x, back)


def draw(manifold, seed, length):
    """A random point and a random tangent vector of this length, as matrices."""
    x, _, basis = draw_point(manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), basis, length)
    return tuple(np.asarray(unflat(manifold)(a)) for a in (x, v))
