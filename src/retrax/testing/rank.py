"""Equations whose gradients vanish on the manifold, such as equations of squares."""

import jax
import jax.numpy as jnp
import numpy as np

from ..manifolds import LevelSet
from .report import number

GRADIENT_DISTANCE = 1e-2  # distance at which gradients are compared with those on the manifold
VANISHES = 1e-4  # of the gradient beside the manifold: a smaller one on it is zero, to the precision of the point
DIRECTIONS = 3  # random directions, along each of which a gradient is examined


def lost_rank(manifold: LevelSet, points: np.ndarray) -> str:
    """Words on the equations of a level set without a gradient at any of the flat points; empty if every equation has
    one."""
    ways = np.random.default_rng(0).standard_normal((DIRECTIONS, points.shape[1]))
    ways *= GRADIENT_DISTANCE / np.linalg.norm(ways, axis=1, keepdims=True)

    def lengths(x: jax.Array) -> jax.Array:
        return jnp.linalg.norm(manifold.jacobian(x.reshape(manifold.shape)), axis=1)

    each = jax.jit(jax.vmap(lengths))
    on, beside = (np.asarray(each(np.concatenate([points + step for step in steps]))) for steps in (0 * ways[:1], ways))
    beside = np.max(beside.reshape(DIRECTIONS, *on.shape), axis=0)
    gone = np.flatnonzero(np.all(on <= VANISHES * beside, axis=0))
    if not gone.size:
        return ""
    k = gone[0]
    return (
        f"rank lost by the constraint's Jacobian is {gone.size} on {manifold}: the gradient of equation {k} is "
        f"{number(np.max(on[:, k]))} at random points, and {number(np.min(beside[:, k]))} at a distance of "
        f"{number(GRADIENT_DISTANCE)} from them; expected a gradient that is not zero; try the "
        "equation itself instead of its "
        "square"
    )
