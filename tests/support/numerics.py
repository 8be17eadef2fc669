"""Numerics that the facts are stated with, those of the conformance kit among them, and draws that remember their
kernels."""

from functools import lru_cache

import jax
import numpy as np
from hypothesis import strategies as st
from retrax.manifolds import CotangentBundle, Manifold, TangentBundle
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.differences import slope
from retrax.testing.draws import direction
from retrax.testing.numerics import CENTRAL_NODES, compiled, differences, flat, unflat
from retrax.testing.numerics import largest as norm

__all__ = [
    "CENTRAL_NODES",
    "FRACTIONS",
    "SEEDS",
    "bundle_frame",
    "compiled",
    "differences",
    "draw_bundle_tangent",
    "draw_point",
    "draw_tangent",
    "flat",
    "norm",
    "slope",
    "unflat",
]

SEEDS = st.integers(0, 2**31 - 1)
FRACTIONS = st.one_of(st.just(0.0), st.floats(0.0, 1.0))


@lru_cache
def _points(manifold: Manifold):
    """A random point, flat, by its seed, and the orthonormal basis of the tangent space there, by rows."""

    def draw(seed: jax.Array) -> tuple[jax.Array, jax.Array]:
        x = manifold.random_point(jax.random.key(seed))
        return flat(x), vec.flatten_frame(manifold.basis(x))

    return compiled(draw)


def draw_point(manifold: Manifold, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random point and a random tangent vector there, flat, and the orthonormal basis of the tangent space, by
    rows."""
    x, basis = _points(manifold)(seed)
    # Not the numbers of ``default_rng(seed)``, from which tests draw other vectors.
    return x, np.random.default_rng([seed, 1]).standard_normal(len(basis)) @ basis, basis


def draw_tangent(rng: np.random.Generator, basis: np.ndarray, length: float) -> np.ndarray:
    """A tangent vector of this Euclidean length in a random direction."""
    return length * direction(rng, basis)


def draw_bundle_tangent(manifold: Manifold, seed: int, length: float) -> np.ndarray:
    """A random point of ``TT*Q``, flat ``(x, p, xdot, pdot)``; ``length`` is the Euclidean length of ``(xdot,
    pdot)``."""
    z, basis = _points(CotangentBundle(manifold))(seed)
    return np.concatenate([z, draw_tangent(np.random.default_rng(seed), basis, length)])


@lru_cache
def _bundle_frames(manifold: Manifold):
    back = unflat(TangentBundle(CotangentBundle(manifold)))
    return compiled(lambda w: vec.flatten_frame(TangentBundle(CotangentBundle(manifold)).spanning_frame(back(w))))


def bundle_frame(manifold: Manifold, w: np.ndarray) -> np.ndarray:
    """A frame of the tangent space of ``TT*Q`` at ``w``, by rows, its second half ``(0, e_i)`` with an orthonormal
    basis ``e_i`` of the tangent space of ``T*Q``."""
    return _bundle_frames(manifold)(w)
