"""Compiled kernels of retractions, in flat coordinates: values with derivatives of orders one and two, and inverses."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from retrax.manifolds import Manifold
from retrax.retractions import Retraction
from retrax.retractions.retraction import newton_preimage

from .cases import RETRACTIONS, reach
from .numerics import NODES, compiled, draw_point, draw_tangent, flat, unflat

# Spacing of the differences: the error of order 6 and the rounding divided by it are both below 1e-11.
STEP = 4e-3
LENGTHS = 2.0 ** -np.arange(4, 15)


def flat_retraction(retraction: Retraction) -> Callable:
    """``R(x, v)`` on vectors."""
    unravel = unflat(retraction.manifold)
    return lambda x, v: flat(retraction(unravel(x), unravel(v)))


@lru_cache
def _derivatives(name: str) -> Callable:
    move = flat_retraction(RETRACTIONS[name])

    def facts(z: tuple, d: tuple, e: tuple, c: jax.Array, frame: jax.Array) -> dict:
        def along(y: tuple) -> Callable:
            return lambda *z: jax.jvp(move, z, y)[1]

        def height(z: tuple) -> jax.Array:
            return c @ move(*z)

        def shifted(s: jax.Array) -> tuple:
            return jax.tree.map(lambda a, b: a + s * b, z, d)

        gradient = jax.grad(height)
        return {
            "push": jax.vmap(lambda b: jax.jvp(move, z, (jnp.zeros_like(b), b))[1])(frame),
            "forward": along(d)(*z),
            "reverse": gradient(z),
            "forward forward": jax.jvp(along(d), z, e)[1],
            "forward reverse": jax.jvp(gradient, (z,), (d,))[1],
            "reverse reverse": jax.grad(lambda z: sum(g @ b for g, b in zip(gradient(z), d, strict=True)))(z),
            "values": jax.vmap(lambda s: move(*shifted(s)))(STEP * NODES),
            "gradients": jax.vmap(lambda s: gradient(shifted(s)))(STEP * NODES),
        }

    return compiled(facts)


@lru_cache
def _values(name: str) -> Callable:
    move = flat_retraction(RETRACTIONS[name])

    def facts(x: jax.Array, v: jax.Array) -> tuple:
        return move(x, v), jax.vmap(lambda t: move(x, t * v))(LENGTHS), move(x, jnp.zeros_like(v))

    return compiled(facts)


def draw(name: str, seed: int, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point, a tangent vector of this length and the basis there."""
    x, _, basis = draw_point(RETRACTIONS[name].manifold, seed)
    return x, draw_tangent(np.random.default_rng(seed), basis, length), basis


def values(name: str, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``R(x, v)``, ``R(x, t v)`` for ``t`` in ``LENGTHS``, and ``R(x, 0)``."""
    return _values(name)(x, v)


def derivatives(name: str, seed: int, length: float, both: tuple | None = None) -> dict:
    """First and second derivatives at a tangent vector of this length, along random ambient directions (or ``both``)."""
    x, v, frame = draw(name, seed, length)
    rng = np.random.default_rng(seed + 1)
    c, *directions = rng.standard_normal((5, x.size)) / np.sqrt(x.size)
    d, e = (directions[:2], directions[2:]) if both is None else both
    facts = _derivatives(name)((x, v), tuple(d), tuple(e), c, frame)
    return {**facts, "x": x, "v": v, "d": d, "e": e, "c": c, "frame": frame}


@lru_cache
def _inverses(name: str) -> Callable:
    retraction: Retraction = RETRACTIONS[name]
    manifold: Manifold = retraction.manifold
    move, unravel = flat_retraction(retraction), unflat(manifold)

    def facts(x: jax.Array, y: jax.Array, a: jax.Array, b: jax.Array) -> dict:
        def closed(x: jax.Array, y: jax.Array) -> jax.Array:
            return flat(retraction.inverse(unravel(x), unravel(y)))

        def newton(x: jax.Array, y: jax.Array) -> jax.Array:
            return flat(newton_preimage(retraction, unravel(x), unravel(y)))

        def on_curves(inverse: Callable) -> Callable:
            """The inverse between the points ``R(x, s_0 a)`` and ``R(y, s_1 b)``."""
            return lambda s: inverse(move(x, s[0] * a), move(y, s[1] * b))

        at_zero = jnp.zeros(2)
        lines = jnp.eye(2)[:, None, :] * (STEP * NODES)[None, :, None]
        v = closed(x, y)
        return {
            "closed": v,
            "there": move(x, v),
            "inside": retraction.domain(unravel(x), unravel(v)),
            "newton": newton(x, y),
            "forward": jax.jacfwd(on_curves(newton))(at_zero),
            "reverse": jax.jacrev(on_curves(newton))(at_zero),
            "closed forward": jax.jacfwd(on_curves(closed))(at_zero),
            "values": jax.vmap(jax.vmap(on_curves(newton)))(lines),
        }

    return compiled(facts)


def inverses(name: str, seed: int, length: float) -> dict:
    """Inverses between a random point and one at this distance, and their derivatives along curves of both."""
    x, v, basis = draw(name, seed, length)
    y = values(name, x, v)[0]
    a = draw_tangent(np.random.default_rng(seed + 1), basis, 1.0)
    # Any tangent vector at y will do for its curve: the one from the nearest draw, projected by the derivative of R.
    b = _derivatives(name)((x, v), (a, a), (a, a), a, basis)["push"][0]
    return {**_inverses(name)(x, y, a, b), "x": x, "y": y, "v": v}


__all__ = ["LENGTHS", "STEP", "derivatives", "draw", "flat_retraction", "inverses", "reach", "values"]
