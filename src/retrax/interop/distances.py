"""Geodesic distances, also between points with more than one shortest geodesic: there a logarithm has no value."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import (
    SE,
    SO,
    SU,
    AffineInvariantMetric,
    EmbeddedMetric,
    Grassmann,
    LorentzMetric,
    Metric,
    Oblique,
    PowerMetric,
    ProductMetric,
    ScaledMetric,
    Sphere,
    U,
)
from ..manifolds.numerics.ambient import Ambient
from ..retractions import PowerRetraction, ProductRetraction, Retraction
from ..retractions.retraction import is_reached, nan_unless
from .metrics import split


def distance(metric: Metric, exponential: Retraction, x: Ambient, y: Ambient) -> Array:
    """Geodesic distance of two points; ``exponential`` is the exponential map of the metric.

    In closed form on spheres, rotations, rigid motions, U(n), SU(2), Grassmann and oblique manifolds, hyperbolic space
    and positive definite matrices, and products and powers of them. Elsewhere it is the length of the logarithm, NaN
    where there is none.
    """
    if isinstance(metric, ScaledMetric):
        return jnp.sqrt(metric.scale) * distance(metric.base, exponential, x, y)
    match split(metric), exponential:
        case ProductMetric(factors=metrics), ProductRetraction(factors=maps):
            return jnp.linalg.norm(jnp.stack([distance(*parts) for parts in zip(metrics, maps, x, y, strict=True)]))
        case PowerMetric(factor=base), PowerRetraction(factor=factor):
            return jnp.linalg.norm(jax.vmap(lambda a, b: distance(base, factor, a, b))(x, y))
        case AffineInvariantMetric(manifold=manifold) | LorentzMetric(manifold=manifold), _:
            return manifold.distance(x, y)
        case EmbeddedMetric(manifold=manifold), _:
            known = _embedded_distance(manifold, x, y)
            if known is not None:
                return known
    v = trusted_inverse(exponential, x, y)
    return jnp.sqrt(metric.inner_product(x, v, v))


def trusted_inverse(retraction: Retraction, x: Ambient, y: Ambient) -> Ambient:
    """The tangent vector at ``x`` that leads to ``y``; NaN where it does not, or lies outside the domain."""
    v = retraction.preimage(x, y)
    reached = is_reached(retraction.manifold, y, retraction(x, v), x, v)
    return nan_unless(reached & retraction.domain(x, v), v)


def _embedded_distance(manifold: object, x: Array, y: Array) -> Array | None:
    """The distance in the metric of the ambient space, where it is an angle or made of angles."""
    match manifold:
        case Sphere():
            return _angle(jnp.linalg.norm(x - y), jnp.linalg.norm(x + y))
        case Oblique():
            return jnp.linalg.norm(_angle(jnp.linalg.norm(x - y, axis=0), jnp.linalg.norm(x + y, axis=0)))
        case SO() | U() | SU(n=2):
            return _unitary_distance(x, y)
        case SE():
            (here, start), (there, end) = manifold.parts(x), manifold.parts(y)
            return jnp.hypot(_unitary_distance(here, there), jnp.linalg.norm(end - start))
        case Grassmann(n=n):  # the reflections of two subspaces differ by rotations of twice the angles between them
            eye = jnp.eye(n, dtype=x.dtype)
            return _unitary_distance(2 * x - eye, 2 * y - eye) / 2
    return None


def _unitary_distance(x: Array, y: Array) -> Array:
    """Root of the sum of the squared angles of ``x^H y``."""
    differences, sums = (jnp.linalg.svd(a, compute_uv=False) for a in (x - y, x + y))
    return jnp.linalg.norm(_angle(differences[::-1], sums))


def _angle(difference: Array, total: Array) -> Array:
    """The angle between unit vectors from the lengths of their difference and their sum: accurate for every angle."""
    return 2 * jnp.arctan2(difference, total)
