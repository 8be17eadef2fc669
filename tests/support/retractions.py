"""Compiled kernels of retractions, in flat coordinates: values, inverses, derivatives of orders one and two."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from retrax.retractions import Retraction
from retrax.retractions.retraction import newton_preimage

from .cases import RETRACTIONS, reach
from .numerics import NODES, compiled, draw_near, draw_point, draw_tangent, flat, unflat

# Spacing of the differences: the error of order 6 and the rounding divided by it are both below 1e-10.
STEP = 2e-3
LENGTHS = 2.0 ** -np.arange(4, 15)

Vector = jax.Array


def flat_retraction(retraction: Retraction) -> Callable:
    """``R(x, v)`` on vectors."""
    unravel = unflat(retraction.manifold)
    return lambda x, v: flat(retraction(unravel(x), unravel(v)))


def _inverses(retraction: Retraction, x: Vector, v: Vector, value: Vector, y: Vector) -> dict:
    """Inverses: from the value back to ``v``, from the point ``y`` to its tangent vector and back."""
    unravel = unflat(retraction.manifold)
    back, to_y = jax.vmap(lambda y: flat(retraction.inverse(unravel(x), unravel(y))))(jnp.stack([value, y]))
    inside = retraction.domain(unravel(x), unravel(v))
    return {"inside": inside, "back": back, "to y": to_y, "there": flat_retraction(retraction)(x, to_y)}


def _values(move: Callable, z: tuple, d: tuple) -> dict:
    """Values at ``z = (x, v)``, on short multiples of ``v``, and along the ambient direction ``d``."""
    multiples = jnp.concatenate([jnp.array([0.0, 1.0]), LENGTHS])
    x = jnp.concatenate([z[0] + 0 * multiples[:, None], z[0] + STEP * NODES[:, None] * d[0]])
    v = jnp.concatenate([multiples[:, None] * z[1], z[1] + STEP * NODES[:, None] * d[1]])
    at_zero, value, *rest = jax.vmap(move)(x, v)
    short, values = jnp.split(jnp.stack(rest), [LENGTHS.size])
    return {"at zero": at_zero, "value": value, "short": short, "values": values}


def _derivatives(move: Callable, z: tuple, d: tuple, e: tuple, c: Vector, frame: Vector) -> dict:
    """Derivatives at ``z = (x, v)`` along the ambient directions ``d``, ``e``, and those of the height ``<c, R>``."""

    def along(d: tuple) -> Callable:
        return lambda *z: jax.jvp(move, z, d)[1]

    def shifted(s: Vector) -> tuple:
        return jax.tree.map(lambda a, b: a + s * b, z, d)

    gradient = jax.grad(lambda z: c @ move(*z))
    reverse, *gradients = zip(*jax.vmap(lambda s: gradient(shifted(s)))(STEP * jnp.append(0.0, NODES)), strict=True)
    directions = jnp.concatenate([d[0][None], 0 * frame]), jnp.concatenate([d[1][None], frame])
    forward, *push = jax.vmap(lambda d: along(d)(*z))(directions)
    return {
        "forward": forward,
        "push": jnp.stack(push),
        "reverse": reverse,
        "gradients": [jnp.stack(part) for part in zip(*gradients, strict=True)],
        "forward forward": jax.jvp(along(d), z, e)[1],
        "forward reverse": jax.jvp(gradient, (z,), (d,))[1],
        "reverse reverse": jax.grad(lambda z: sum(g @ b for g, b in zip(gradient(z), d, strict=True)))(z),
    }


@lru_cache
def _kernel(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move = flat_retraction(retraction)

    def facts(z: tuple, y: Vector, d: tuple, e: tuple, c: Vector, frame: Vector) -> dict:
        values = _values(move, z, d)
        inverses = _inverses(retraction, *z, values["value"], y)
        return {**values, **inverses, **_derivatives(move, z, d, e, c, frame)}

    return compiled(facts)


def retraction_facts(name: str, seed: int, length: float, along: str = "ambient directions") -> dict:
    """Everything about a retraction at a random point and a random tangent vector of this length.

    The second derivatives are taken along random ambient directions of ``TM``, or twice along the fibre's ``(0, w)`` with
    a unit tangent vector ``w``.
    """
    manifold, rng = RETRACTIONS[name].manifold, np.random.default_rng(seed)
    x, _, frame = draw_point(manifold, seed)
    v, w = draw_tangent(rng, frame, length), draw_tangent(rng, frame, 1.0)
    c, *directions = rng.standard_normal((5, x.size)) / np.sqrt(x.size)
    directions = [min(1.0, reach(name)) * direction for direction in directions]
    fibre = np.zeros_like(x), w
    d, e = (fibre, fibre) if along == "the fibre" else (tuple(directions[:2]), tuple(directions[2:]))
    y = draw_near(manifold, x, rng, 0.3 * min(1.0, reach(name)))
    given = {"x": x, "v": v, "w": w, "y": y, "d": d, "e": e, "c": c, "frame": frame}
    return {**given, **_kernel(name)((x, v), y, d, e, c, frame)}


@lru_cache
def _newton(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move, unravel = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x: Vector, v: Vector) -> tuple:
        y = move(x, v)
        return flat(newton_preimage(retraction, unravel(x), unravel(y)))

    return compiled(facts)


def newton_inverse(name: str, seed: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A random tangent vector of this length, and what Newton's method finds from its value."""
    x, _, frame = draw_point(RETRACTIONS[name].manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), frame, length)
    return v, _newton(name)(x, v)


@lru_cache
def _newton_derivatives(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move, unravel = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x: Vector, v: Vector, a: Vector, c: Vector) -> dict:
        y = move(x, v)
        # The velocity of a curve through y: any tangent vector there.
        b = jax.jvp(lambda v: move(x, v), (v,), (a,))[1]

        def between(s: Vector) -> Vector:
            """The inverse between the points ``R(x, s_0 a)`` and ``R(y, s_1 b)``."""
            return flat(newton_preimage(retraction, unravel(move(x, s[0] * a)), unravel(move(y, s[1] * b))))

        lines = jnp.eye(2)[:, None, :] * (STEP * NODES)[None, :, None]
        return {
            "forward": jax.jacfwd(between)(jnp.zeros(2)),
            "reverse": jax.grad(lambda s: c @ between(s))(jnp.zeros(2)),
            "values": jax.vmap(jax.vmap(between))(lines),
        }

    return compiled(facts)


def newton_derivatives(name: str, seed: int, length: float) -> dict:
    """Derivatives of Newton's inverse along curves of both points, and its values on them."""
    x, _, frame = draw_point(RETRACTIONS[name].manifold, seed)
    rng = np.random.default_rng(seed)
    v, a, c = draw_tangent(rng, frame, length), draw_tangent(rng, frame, 1.0), rng.standard_normal(x.size)
    return {"c": c, **_newton_derivatives(name)(x, v, a, c)}
