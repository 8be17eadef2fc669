"""Compiled kernels of discretization maps and their cotangent lifts, in flat coordinates."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from retrax.manifolds import CotangentBundle
from retrax.retractions import Adjoint, CotangentLift, DiscretizationMap, Midpoint

from .cases import RETRACTIONS, discretization_maps, inverted_maps, reach
from .numerics import compiled, draw_bundle_tangent, draw_near, draw_point, draw_tangent, flat, unflat

# Lifts that take long to compile and are of the same kind as others are left out.
UNLIFTED = (
    "bundle-T*S2",
    "exponential-H2",
    "exponential-SPD2",
    "log-SPD2",
    "projection-S2x3",
    "qr-St42",
    "cayley-St42",
    "exponential-St32",
    "exponential-Gr31",
    "cayley-Gr42",
    "polar-Gr42",
    "projection-oblique32",
    "truncation-rank2-4x3",
    "orthographic-rank1-3x3",
)
LIFTED = [name for name in RETRACTIONS if name not in UNLIFTED]


def flat_map(discretization: DiscretizationMap) -> Callable:
    """``(R1, R2)`` on vectors ``(x, v)``."""
    unravel = unflat(discretization.manifold)

    def ends(w: jax.Array) -> jax.Array:
        x, v = jnp.split(w, 2)
        return flat(discretization(unravel(x), unravel(v)))

    return ends


def flat_lift(discretization: DiscretizationMap) -> Callable:
    """The cotangent lift on vectors ``(x, p, xdot, pdot)``, with the values ``(q0, p0, q1, p1)``."""
    unravel = unflat(CotangentBundle(discretization.manifold))

    def ends(w: jax.Array) -> jax.Array:
        z, zdot = jnp.split(w, 2)
        return flat(CotangentLift(discretization)(unravel(z), unravel(zdot)))

    return ends


def pushed(function: Callable, w: jax.Array, frame: jax.Array) -> dict:
    """A function's value at ``w`` and its derivative along each vector of a frame."""
    return {"value": function(w), "push": jax.vmap(lambda d: jax.jvp(function, (w,), (d,))[1])(frame)}


@lru_cache
def _base(name: str) -> Callable:
    maps, retraction = discretization_maps(name), RETRACTIONS[name]
    symmetric = {"midpoint": Midpoint(retraction), "adjoint of the midpoint": Adjoint(Midpoint(retraction))}
    twice = {f"adjoint of the adjoint of {key}": Adjoint(Adjoint(d)) for key, d in maps.items()}

    def facts(w: jax.Array, frame: jax.Array) -> dict:
        values = {key: flat_map(d)(w) for key, d in {**symmetric, **twice}.items()}
        return {**{key: pushed(flat_map(d), w, frame) for key, d in maps.items()}, **values}

    return compiled(facts)


def map_facts(name: str, seed: int, length: float) -> dict:
    """Values of the maps made from a retraction, and their derivatives along ``(0, e_i)`` for the basis ``e_i``."""
    x, _, basis = draw_point(RETRACTIONS[name].manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), basis, length)
    frame = np.concatenate([np.zeros_like(basis), basis], axis=1)
    return {"x": x, "v": v, "basis": basis, **_base(name)(np.concatenate([x, v]), frame)}


@lru_cache
def _lifts(name: str) -> Callable:
    maps = discretization_maps(name)
    return compiled(lambda w, frame: {key: pushed(flat_lift(d), w, frame) for key, d in maps.items()})


def lift_facts(name: str, seed: int, length: float) -> dict:
    """Values of the cotangent lifts at a random point of ``TT*Q``, and derivatives along a frame of its tangent space.

    ``length`` is that of the tangent vector of ``T*Q``.
    """
    w, frame = draw_bundle_tangent(RETRACTIONS[name].manifold, seed, length)
    return {"w": w, "frame": frame, **_lifts(name)(w, frame)}


@lru_cache
def _map_inverses(name: str) -> Callable:
    maps, unravel = inverted_maps(name), unflat(RETRACTIONS[name].manifold)

    def facts(w: jax.Array, ends: jax.Array) -> dict:
        def one(d: DiscretizationMap) -> dict:
            there = jnp.stack([flat_map(d)(w), ends])
            back = jax.vmap(lambda y: flat(d.inverse(*map(unravel, jnp.split(y, 2)))))(there)
            return {"back": back[0], "there": flat_map(d)(back[1])}

        return {key: one(d) for key, d in maps.items()}

    return compiled(facts)


def map_inverses(name: str, seed: int, length: float) -> dict:
    """Inverses of the maps made from a retraction: of their value at a random ``(x, v)``, and of two points nearby."""
    manifold, rng = RETRACTIONS[name].manifold, np.random.default_rng(seed)
    x, _, basis = draw_point(manifold, seed)
    w = np.concatenate([x, draw_tangent(rng, basis, length)])
    ends = np.concatenate([x, draw_near(manifold, x, rng, 0.3 * min(1.0, reach(name)))])
    return {"w": w, "ends": ends, **_map_inverses(name)(w, ends)}


@lru_cache
def _lift_inverses(name: str) -> Callable:
    maps, manifold = inverted_maps(name), RETRACTIONS[name].manifold
    unravel, of_base = unflat(CotangentBundle(manifold)), unflat(manifold)

    def tangent(x: jax.Array, a: jax.Array) -> jax.Array:
        return flat(manifold.projection(of_base(x), of_base(a)))

    def facts(w: jax.Array, points: tuple, covectors: tuple) -> dict:
        z0, z1 = (jnp.concatenate([x, tangent(x, a)]) for x, a in zip(points, covectors, strict=True))
        ends = jnp.concatenate([z0, z1])

        def one(d: DiscretizationMap) -> dict:
            there = jnp.stack([flat_lift(d)(w), ends])
            back = jax.vmap(lambda y: flat(CotangentLift(d).inverse(*map(unravel, jnp.split(y, 2)))))(there)
            return {"back": back[0], "there": flat_lift(d)(back[1])}

        return {"ends": ends, **{key: one(d) for key, d in maps.items()}}

    return compiled(facts)


def lift_inverses(name: str, seed: int, length: float) -> dict:
    """Inverses of the cotangent lifts: of their value at a random point of ``TT*Q``, and of two covectors nearby."""
    manifold, rng = RETRACTIONS[name].manifold, np.random.default_rng(seed)
    w, _ = draw_bundle_tangent(manifold, seed, length)
    x = w[: w.size // 4]
    y = draw_near(manifold, x, rng, 0.3 * min(1.0, reach(name)))
    return {"w": w, **_lift_inverses(name)(w, (x, y), tuple(rng.standard_normal((2, x.size))))}
