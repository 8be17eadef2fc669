"""Round trips of retractions whose points are matrices, compiled once each."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from .numerics import compiled, draw_point, draw_tangent


@lru_cache
def kernel(retraction):
    """Value of a retraction, what its inverse finds from there, the value of that, and the inverse of another point."""

    def facts(x, v, other):
        y = retraction(x, v)
        back, inverse = jax.vmap(lambda y: retraction.inverse(x, y))(jnp.stack([y, other]))
        return y, back, retraction(x, back), inverse

    return compiled(facts)


def round_trip(retraction, x, v):
    """Value of a retraction, what its inverse finds from there, and the value of that."""
    return kernel(retraction)(x, v, x)[:3]


def draw(manifold, seed, length):
    """A random point and a random tangent vector of this length, as matrices."""
    x, _, basis = draw_point(manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), basis, length)
    return x.reshape(manifold.ambient.shape), v.reshape(manifold.ambient.shape)
