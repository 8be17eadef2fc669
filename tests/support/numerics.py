"""Numerics that the facts are stated with, those of the conformance kit among them, and draws that remember their
kernels."""

from functools import lru_cache

import numpy as np
from hypothesis import strategies as st
from retrax.manifolds import Manifold
from retrax.manifolds.numerics.differences import slope
from retrax.testing.draws import Sampler, direction
from retrax.testing.numerics import NODES, compiled, differences, flat, unflat
from retrax.testing.numerics import largest as norm

__all__ = [
    "FRACTIONS",
    "NODES",
    "SEEDS",
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

_sampler = lru_cache(Sampler)


def draw_point(manifold: Manifold, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random point and a random tangent vector there, flat, and the orthonormal basis of the tangent space, by
    rows."""
    return _sampler(manifold).point(seed)


def draw_tangent(rng: np.random.Generator, basis: np.ndarray, length: float) -> np.ndarray:
    """A tangent vector of this Euclidean length in a random direction."""
    return length * direction(rng, basis)


def draw_bundle_tangent(manifold: Manifold, seed: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A random point of ``TT*Q``, flat ``(x, p, xdot, pdot)``, and a frame of its tangent space, by rows.

    The second half of the frame is ``(0, e_i)`` with an orthonormal basis ``e_i`` of the tangent space of ``T*Q``.
    ``length`` is the Euclidean length of ``(xdot, pdot)``.
    """
    cotangent = _sampler(manifold).cotangent
    z, _, basis = cotangent.point(seed)
    zdot = draw_tangent(np.random.default_rng(seed), basis, length)
    return np.concatenate([z, zdot]), cotangent.bundle_frame(z, zdot)
