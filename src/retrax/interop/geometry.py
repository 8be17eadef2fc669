"""The Riemannian geometry of one of our manifolds, in the arrays of another library."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import SO, Euclidean, Manifold, Metric, Product, Sphere
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..retractions import Exponential, Retraction
from .conventions import Conventions, Theirs

_RESTORATIONS = 8
_SYMMETRIC = (Euclidean, Sphere, SO)


def _is_symmetric(manifold: Manifold) -> bool:
    if isinstance(manifold, Product):
        return all(map(_is_symmetric, manifold.factors))
    return isinstance(manifold, _SYMMETRIC)


@final
class Geometry(eqx.Module):
    """A manifold with a retraction and a metric, seen through conventions: ``x``, ``y``, ``v`` below are all theirs.

    The metric of their coordinates is ours for ``metric``; None stands for the sum of products of entries of *their* tangent
    vectors, which is the embedded metric wherever conventions are the same.
    """

    manifold: Manifold
    retraction: Retraction
    metric: Metric | None
    conventions: Conventions

    @property
    def has_exponential(self) -> bool:
        """Whether a closed form of the exponential map is known."""
        return Exponential.knows(self.manifold)

    @property
    def is_symmetric(self) -> bool:
        """Whether the manifold is a symmetric space with a known exponential map."""
        return self.has_exponential and _is_symmetric(self.manifold)

    def random_point(self, key: Array) -> Theirs:
        """A random point."""
        return self.conventions.lift(self.manifold.random_point(key))

    def random_tangent(self, key: Array, x: Theirs) -> Theirs:
        """A random tangent vector of length 1 at ``x``."""
        v = self.conventions.coordinates(x, self.manifold.random_tangent(key, self.conventions.point(x)))
        return vec.scale(1 / jnp.sqrt(self.inner_product(x, v, v)), v)

    def violation(self, x: Theirs) -> Array:
        """How far ``x`` is from the manifold: the largest violation of its equations."""
        values = jax.tree.leaves(self.manifold.violations(self.conventions.point(x)))
        return jnp.max(jnp.stack([jnp.asarray(value, float) for value in values])) if values else jnp.zeros(())

    def restore(self, x: Theirs) -> Theirs:
        """The point of the manifold for one near it, by a few Newton steps."""
        q = jax.lax.fori_loop(0, _RESTORATIONS, lambda _, q: self.manifold.restore(q), self.conventions.point(x))
        return self.conventions.lift(q, near=x)

    def project(self, x: Theirs, a: Theirs) -> Theirs:
        """The tangent vector at ``x`` nearest to a vector ``a`` of the space around their points."""
        w = self.manifold.projection(self.conventions.point(x), self.conventions.push(x, a))
        return self.conventions.coordinates(x, w)

    def tangential(self, x: Theirs, v: Theirs) -> Theirs:
        """The tangent vector at ``x`` nearest to given coordinates ``v``."""
        return self.project(x, self.conventions.embedding(x, v))

    def embed(self, x: Theirs, v: Theirs) -> Theirs:
        """The vector of the space around their points that the coordinates ``v`` of a tangent vector stand for."""
        return self.conventions.embedding(x, v)

    def normal_part(self, x: Theirs, a: Theirs) -> Array:
        """Largest entry of the normal part of a vector of the space around their points."""
        return vec.size(vec.subtract(a, self.embed(x, self.project(x, a))))

    def inner_product(self, x: Theirs, v: Theirs, w: Theirs) -> Array:
        """Riemannian inner product of two tangent vectors at ``x``."""
        if self.metric is None:
            return vec.pairing(v, w)
        ours = self.conventions.tangent(x, v), self.conventions.tangent(x, w)
        return self.metric.inner_product(self.conventions.point(x), *ours)

    def move(self, x: Theirs, v: Theirs) -> Theirs:
        """The retraction."""
        return self._along(self.retraction, x, v)

    def back(self, x: Theirs, y: Theirs) -> Theirs:
        """Inverse of the retraction: the tangent vector at ``x`` that leads to ``y``; NaN outside its image."""
        return self._between(self.retraction, x, y)

    def exp(self, x: Theirs, v: Theirs) -> Theirs:
        """The exponential map."""
        return self._along(Exponential(self.manifold), x, v)

    def log(self, x: Theirs, y: Theirs) -> Theirs:
        """Inverse of the exponential map: the tangent vector at ``x`` that leads to ``y``; NaN outside its image."""
        return self._between(Exponential(self.manifold), x, y)

    def dist(self, x: Theirs, y: Theirs) -> Array:
        """Geodesic distance: the length of the logarithm."""
        v = self.log(x, y)
        return jnp.sqrt(self.inner_product(x, v, v))

    def middle(self, x: Theirs, y: Theirs) -> Theirs:
        """The point midway on the geodesic between two points."""
        return self.exp(x, vec.scale(0.5, self.log(x, y)))

    def transport(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """Parallel transport of ``v`` along the geodesic from ``x`` to ``y``, on a symmetric space.

        It is minus the differential at ``x`` of the reflection in the midpoint, an isometry that reverses the geodesic.
        """
        middle = jax.lax.stop_gradient(self.middle(x, y))

        def reflected(z: Theirs) -> Theirs:
            return self.exp(middle, vec.scale(-1.0, self.log(middle, z)))

        return self.tangential(y, vec.scale(-1.0, jax.jvp(reflected, (x,), (self.embed(x, v),))[1]))

    def gradient(self, x: Theirs, g: Theirs) -> Theirs:
        """Riemannian gradient from the Euclidean one: partial derivatives in the entries of ``x``."""
        slope = jax.grad(lambda v: vec.pairing(g, self._geodesic(x, v)))
        return self._sharp(x, slope(vec.scale(0.0, x)))

    def hessian(self, x: Theirs, g: Theirs, h: Theirs, v: Theirs) -> Theirs:
        """Riemannian Hessian along ``v`` from the Euclidean gradient ``g`` and the Euclidean Hessian ``h`` along ``v``.

        The Hessian is the second derivative of the function along geodesics.
        """
        zero = vec.scale(0.0, x)
        bend = jax.jvp(jax.grad(lambda u: vec.pairing(g, self._geodesic(x, u))), (zero,), (v,))[1]
        _, pull = jax.vjp(lambda u: self._geodesic(x, u), zero)
        return self._sharp(x, vec.add(bend, pull(h)[0]))

    def _along(self, retraction: Retraction, x: Theirs, v: Theirs) -> Theirs:
        y = retraction(self.conventions.point(x), self.conventions.tangent(x, v))
        return self.conventions.lift(y, near=x)

    def _between(self, retraction: Retraction, x: Theirs, y: Theirs) -> Theirs:
        w = retraction.preimage(self.conventions.point(x), self.conventions.point(y))
        return self.conventions.coordinates(x, w)

    def _geodesic(self, x: Theirs, v: Theirs) -> Theirs:
        """The point at time 1 of the geodesic from ``x`` with velocity ``v``, to second order in ``v``."""
        q, w = self.conventions.point(x), self.conventions.tangent(x, self.tangential(x, v))
        bent = vec.add(vec.add(q, w), vec.scale(0.5, self._acceleration(q, w)))
        return self.conventions.lift(bent, near=x)

    def _acceleration(self, q: Ambient, w: Ambient) -> Ambient:
        """Ambient acceleration of the geodesic with velocity ``w``, from Hamilton's equations of its kinetic energy."""
        if self.metric is None:
            return jax.jvp(lambda y: self.manifold.projection(y, w), (q,), (w,))[1]
        energy, p = self.metric.kinetic_energy, self.metric.covector(q, w)
        force = vec.scale(-1.0, jax.grad(energy)(q, p))
        return jax.jvp(jax.grad(energy, argnums=1), (q, p), (w, force))[1]

    def _sharp(self, x: Theirs, slope: Theirs) -> Theirs:
        """The tangent vector whose inner product with any other is that vector's pairing with ``slope``."""
        if self.metric is None:
            return self.tangential(x, slope)
        q = self.conventions.point(x)

        def coordinates(w: Ambient) -> Theirs:
            return self.conventions.coordinates(x, self.manifold.projection(q, w))

        _, pull = jax.vjp(coordinates, vec.zeros(self.manifold.ambient))
        return coordinates(jax.grad(self.metric.kinetic_energy, argnums=1)(q, pull(slope)[0]))
