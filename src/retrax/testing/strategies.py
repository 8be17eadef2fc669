"""Hypothesis strategies: points, tangent vectors and covectors of a manifold (needs ``pip install hypothesis``).

They draw an integer seed and lengths, which hypothesis shrinks; values are points and vectors as the manifold has them.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from ..manifolds import Manifold
from ..manifolds.numerics.ambient import Ambient
from ..retractions import Retraction
from .draws import DomainEdge, Sampler, direction

Pair = tuple[Ambient, Ambient]

SEED_INTEGERS = st.integers(0, 2**31 - 1)


def points(manifold: Manifold) -> SearchStrategy[Ambient]:
    """Random points of a manifold."""
    sampler = Sampler(manifold)
    return SEED_INTEGERS.map(lambda seed: _ambient(sampler, sampler.point(seed)[0]))


def tangent_vectors(manifold: Manifold, longest: float = 1.0) -> SearchStrategy[Pair]:
    """Pairs ``(x, v)`` in random directions; the length of ``v`` is uniform up to ``longest``, or 0."""
    return _pairs(manifold, st.one_of(st.just(0.0), st.floats(0.0, longest)))


def tiny_tangent_vectors(manifold: Manifold) -> SearchStrategy[Pair]:
    """Pairs ``(x, v)`` with ``v`` from 1e-15 to 1e-6 long, evenly in the logarithm."""
    return _pairs(manifold, st.floats(-15.0, -6.0).map(lambda power: 10.0**power))


def tangent_vectors_near_the_edge(retraction: Retraction, longest: float = 10.0) -> SearchStrategy[Pair]:
    """Pairs ``(x, v)`` with ``v`` in the domain of a retraction, a relative ``sqrt(eps)`` to 1e-1 from its edge.

    For a domain that is derived from a round trip it is 1e-2 to 1e-1. The edge is the first one in the direction of
    ``v``, as the domain need not be star-shaped: it may begin again behind it. Where it reaches farther than
    ``longest``, that is taken for the edge.
    """
    sampler, edge = Sampler(retraction.manifold), DomainEdge(retraction)

    def draw(seed: int, power: float) -> Pair:
        x, _, basis = sampler.point(seed)
        u = direction(np.random.default_rng(seed), basis)
        length = edge(x, u, (1 - 10.0**power) * edge(x, u, longest))  # again, for a gap that was not seen on the way
        return _ambient(sampler, x), _ambient(sampler, length * u)

    return st.builds(draw, SEED_INTEGERS, st.floats(float(np.log10(edge.margin)), -1.0))


def covectors(manifold: Manifold, longest: float = 1.0) -> SearchStrategy[Pair]:
    """Points ``(x, p)`` of the cotangent bundle: a covector is stored as its tangent representative."""
    return tangent_vectors(manifold, longest)


def _pairs(manifold: Manifold, lengths: SearchStrategy[float]) -> SearchStrategy[Pair]:
    sampler = Sampler(manifold)

    def draw(seed: int, length: float) -> Pair:
        x, _, basis = sampler.point(seed)
        return _ambient(sampler, x), _ambient(sampler, length * direction(np.random.default_rng(seed), basis))

    return st.builds(draw, SEED_INTEGERS, lengths)


def _ambient(sampler: Sampler, w: np.ndarray) -> Any:
    return jax.tree.map(jnp.asarray, sampler.unflat(jnp.asarray(w)))
