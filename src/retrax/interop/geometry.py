"""The Riemannian geometry of one of our manifolds, in the arrays of another library."""

from collections.abc import Iterable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import DomainError, Manifold, Metric, NotOnManifoldError
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.precision import default_tolerance
from ..retractions import Retraction
from ..retractions.retraction import nan_unless
from .conventions import Conventions, Theirs
from .distances import distance, trusted_inverse
from .metrics import exponential_map, has_unique_geodesics, is_symmetric

_RESTORATIONS = 8


@final
class Geometry(eqx.Module):
    """A manifold with a retraction and a metric, seen through conventions: ``x``, ``y``, ``v`` below are all theirs."""

    manifold: Manifold
    retraction: Retraction
    metric: Metric
    conventions: Conventions
    exponential: Retraction  # that of the metric

    def __init__(self, manifold: Manifold, retraction: Retraction, metric: Metric, conventions: Conventions) -> None:
        self.manifold, self.retraction, self.metric, self.conventions = manifold, retraction, metric, conventions
        self.exponential = exponential_map(metric)  # here, where the numbers in the metric are not traced

    @property
    def is_symmetric(self) -> bool:
        """Whether the manifold with its metric is known to be a symmetric space."""
        return is_symmetric(self.metric)

    def random_point(self, key: Array) -> Theirs:
        """A random point, and of the arrays that stand for it, where there are several, a random one."""
        first, second = jax.random.split(key)
        q = self.manifold.random_point(first)
        x = self.conventions.lift(q)
        return self.conventions.lift(q, near=vec.normal(second, x))

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

    def carry(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """A tangent vector at ``x`` as the nearest one at ``y``."""
        return self._known(self.project(y, self.conventions.elsewhere(x, y, v)), x, y)

    def embed(self, x: Theirs, v: Theirs) -> Theirs:
        """The vector of the space around their points that the coordinates ``v`` of a tangent vector stand for."""
        return self.conventions.embedding(x, v)

    def normal_part(self, x: Theirs, a: Theirs) -> Array:
        """Largest entry of the normal part of a vector of the space around their points."""
        return vec.size(vec.subtract(a, self.embed(x, self.project(x, a))))

    def inner_product(self, x: Theirs, v: Theirs, w: Theirs) -> Array:
        """Riemannian inner product of two tangent vectors at ``x``."""
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
        return self._along(self.exponential, x, v)

    def log(self, x: Theirs, y: Theirs) -> Theirs:
        """Inverse of the exponential map: the tangent vector at ``x`` that leads to ``y``; NaN outside its image."""
        return self._between(self.exponential, x, y)

    def dist(self, x: Theirs, y: Theirs) -> Array:
        """Geodesic distance, also on the cut locus where it is known in closed form."""
        value = distance(self.metric, self.exponential, self.conventions.point(x), self.conventions.point(y))
        return self._known(value, x, y)

    def middle(self, x: Theirs, y: Theirs) -> Theirs:
        """The point midway on the geodesic between two points."""
        return self.exp(x, vec.scale(0.5, self.log(x, y)))

    def transport(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """Parallel transport of ``v`` along the geodesic from ``x`` to ``y``, on a symmetric space.

        It is minus the differential at ``x`` of the reflection in the midpoint, an isometry that reverses the geodesic.
        """
        way = self.log(x, y)
        middle = jax.lax.stop_gradient(self.exp(x, vec.scale(0.5, way)))

        def reflected(z: Theirs) -> Theirs:
            return self.exp(middle, vec.scale(-1.0, self.log(middle, z)))

        moved = self.tangential(y, vec.scale(-1.0, jax.jvp(reflected, (x,), (self.embed(x, v),))[1]))
        return nan_unless(vec.size(way) >= 0, moved)

    def gradient(self, x: Theirs, g: Theirs) -> Theirs:
        """Riemannian gradient from the Euclidean one: partial derivatives in the entries of ``x``."""
        return self._sharp(x, self._slope(x, g, self.zero(x)))

    def hessian(self, x: Theirs, g: Theirs, h: Theirs, v: Theirs) -> Theirs:
        """Riemannian Hessian along ``v`` from the Euclidean gradient ``g`` and the Euclidean Hessian ``h`` along ``v``.

        The Hessian is the second derivative of the function along geodesics.
        """
        zero = self.zero(x)
        bend = jax.jvp(lambda u: self._slope(x, g, u), (zero,), (v,))[1]
        return self._sharp(x, vec.add(bend, self._slope(x, h, zero)))

    def _slope(self, x: Theirs, g: Theirs, v: Theirs) -> Theirs:
        """Gradient at ``v`` of ``v -> <g, geodesic(x, v)>``, in their coordinates."""
        return vec.gradient(lambda u: vec.pairing(g, self._geodesic(x, u)), v)

    def zero(self, x: Theirs) -> Theirs:
        """The zero tangent vector at ``x``."""
        return self.conventions.coordinates(x, vec.zeros(self.manifold.ambient))

    def _along(self, retraction: Retraction, x: Theirs, v: Theirs) -> Theirs:
        y = retraction(self.conventions.point(x), self.conventions.tangent(x, v))
        return self.conventions.lift(y, near=x)

    def _between(self, retraction: Retraction, x: Theirs, y: Theirs) -> Theirs:
        w = trusted_inverse(retraction, self.conventions.point(x), self.conventions.point(y))
        return self._known(self.conventions.coordinates(x, w), x, y)

    def _known(self, value: Theirs, *points: Theirs) -> Theirs:
        """A value where it is one of points of the manifold, NaN elsewhere."""
        worst = jnp.max(jnp.stack([self.violation(x) for x in points]))
        return nan_unless(worst <= default_tolerance(), value)

    def _geodesic(self, x: Theirs, v: Theirs) -> Theirs:
        """The point at time 1 of the geodesic from ``x`` with velocity ``v``, to second order in ``v``."""
        q, w = self.conventions.point(x), self.conventions.tangent(x, self.tangential(x, v))
        bent = vec.add(vec.add(q, w), vec.scale(0.5, self._acceleration(q, w)))
        return self.conventions.lift(self.manifold.restore(bent), near=x)

    def _acceleration(self, q: Ambient, w: Ambient) -> Ambient:
        """Ambient acceleration of the geodesic with velocity ``w``, from Hamilton's equations of its kinetic energy."""
        energy, p = self.metric.kinetic_energy, self.metric.covector(q, w)
        force = vec.scale(-1.0, vec.gradient(lambda y: energy(y, p), q))
        return jax.jvp(lambda y, a: vec.gradient(lambda b: energy(y, b), a), (q, p), (w, force))[1]

    def _sharp(self, x: Theirs, slope: Theirs) -> Theirs:
        """The tangent vector whose inner product with any other is that vector's pairing with ``slope``."""
        q = self.conventions.point(x)

        def coordinates(w: Ambient) -> Theirs:
            return self.conventions.coordinates(x, self.manifold.projection(q, w))

        zero = vec.zeros(self.manifold.ambient)
        covector = vec.gradient(lambda w: vec.pairing(slope, coordinates(w)), zero)
        return coordinates(self.metric.vector(q, covector))

    def require_values(self, method: str, values: Theirs, points: Iterable[Theirs]) -> None:
        """Raise if a method that has no value for some pairs of points has none for these.

        ``NotOnManifoldError`` if one of ``points`` is none, else ``DomainError``.
        """
        if method not in _UNDEFINED or not any(np.any(np.isnan(leaf)) for leaf in jax.tree.leaves(values)):
            return
        for x in points:
            verdict = self.manifold.contains(self.conventions.point(x))
            if not verdict:
                raise NotOnManifoldError(f"not a point: {verdict.reason}")
        if has_unique_geodesics(self.metric):
            raise DomainError(
                f"two points of {self.manifold} are too far apart, or too far out, for the precision in use: more than "
                f"half of the digits of {method} would be rounding; take nearer points"
            )
        raise DomainError(
            "between these points there is no one shortest geodesic, or none was found: expected points off each "
            "other's cut locus (not antipodes, not half a turn apart) and within reach of Newton's method; take nearer "
            "points"
        )


_UNDEFINED = {"log", "back", "dist", "middle", "transport", "carry"}  # without a value for some pairs of points
