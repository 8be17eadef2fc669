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

_RESTORATIONS = 8  # restorations in a row: the last ones change a point near the manifold by rounding alone


@final
class Geometry(eqx.Module):
    """A manifold with a retraction and a metric in the conventions of another library.

    Parameters
    ----------
    manifold : Manifold
        The manifold.
    retraction : Retraction
        The retraction.
    metric : Metric
        The metric.
    conventions : Conventions
        The conventions: ``x``, ``y``, ``v`` below are points and tangent vectors of the other library.
    """

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
        """A random point; if several arrays represent the point, a random one of them.

        Parameters
        ----------
        key : JAX key
            The key.
        """
        first, second = jax.random.split(key)
        q = self.manifold.random_point(first)
        x = self.conventions.lift(q)
        return self.conventions.lift(q, near=vec.normal(second, x))

    def random_tangent(self, key: Array, x: Theirs) -> Theirs:
        """A random tangent vector of length 1 at ``x``.

        Parameters
        ----------
        key : JAX key
            The key.
        x : point
            A point.
        """
        v = self.conventions.coordinates(x, self.manifold.random_tangent(key, self.conventions.point(x)))
        return vec.scale(1 / jnp.sqrt(self.inner_product(x, v, v)), v)

    def violation(self, x: Theirs) -> Array:
        """The largest violation of the equations of the manifold.

        Parameters
        ----------
        x : point
            A point near the manifold.
        """
        values = jax.tree.leaves(self.manifold.violations(self.conventions.point(x)))
        return jnp.max(jnp.stack([jnp.asarray(value, float) for value in values])) if values else jnp.zeros(())

    def restore(self, x: Theirs) -> Theirs:
        """The point of the manifold for a point near it, by a few Newton steps.

        Parameters
        ----------
        x : point
            A point near the manifold.
        """
        q = jax.lax.fori_loop(0, _RESTORATIONS, lambda _, q: self.manifold.restore(q), self.conventions.point(x))
        return self.conventions.lift(q, near=x)

    def project(self, x: Theirs, a: Theirs) -> Theirs:
        """The tangent vector at ``x`` closest to a vector of the space around the points.

        Parameters
        ----------
        x, a : point, vector
            A point, and a vector of the space around the points.
        """
        w = self.manifold.projection(self.conventions.point(x), self.conventions.push(x, a))
        return self.conventions.coordinates(x, w)

    def tangential(self, x: Theirs, v: Theirs) -> Theirs:
        """The tangent vector at ``x`` closest to given coordinates.

        Parameters
        ----------
        x, v : point, coordinates
            A point, and coordinates of a vector.
        """
        return self.project(x, self.conventions.embedding(x, v))

    def carry(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """The closest tangent vector at ``y`` to a tangent vector at ``x``.

        Parameters
        ----------
        x, y, v : points, tangent vector
            Two points, and a tangent vector at ``x``.
        """
        return self._nan_unless_on_manifold(self.project(y, self.conventions.elsewhere(x, y, v)), x, y)

    def embed(self, x: Theirs, v: Theirs) -> Theirs:
        """The vector of the space around the points with the coordinates of a tangent vector.

        Parameters
        ----------
        x, v : point, tangent vector
            A point, and a tangent vector there.
        """
        return self.conventions.embedding(x, v)

    def normal_part(self, x: Theirs, a: Theirs) -> Array:
        """The largest entry of the normal part of a vector.

        Parameters
        ----------
        x, a : point, vector
            A point, and a vector of the space around the points.
        """
        return vec.size(vec.subtract(a, self.embed(x, self.project(x, a))))

    def inner_product(self, x: Theirs, v: Theirs, w: Theirs) -> Array:
        """The Riemannian inner product of two tangent vectors.

        Parameters
        ----------
        x, v, w : point, tangent vectors
            A point, and two tangent vectors there.
        """
        ours = self.conventions.tangent(x, v), self.conventions.tangent(x, w)
        return self.metric.inner_product(self.conventions.point(x), *ours)

    def move(self, x: Theirs, v: Theirs) -> Theirs:
        """The retraction.

        Parameters
        ----------
        x, v : point, tangent vector
            A point, and a tangent vector there.
        """
        return self._along(self.retraction, x, v)

    def back(self, x: Theirs, y: Theirs) -> Theirs:
        """The inverse of the retraction, the tangent vector at ``x`` that leads to ``y``; NaN outside its image.

        Parameters
        ----------
        x, y : points
            Two points.
        """
        return self._between(self.retraction, x, y)

    def exp(self, x: Theirs, v: Theirs) -> Theirs:
        """The exponential map.

        Parameters
        ----------
        x, v : point, tangent vector
            A point, and a tangent vector there.
        """
        return self._along(self.exponential, x, v)

    def log(self, x: Theirs, y: Theirs) -> Theirs:
        """The inverse of the exponential map, the tangent vector at ``x`` that leads to ``y``; NaN outside its image.

        Parameters
        ----------
        x, y : points
            Two points.
        """
        return self._between(self.exponential, x, y)

    def dist(self, x: Theirs, y: Theirs) -> Array:
        """The geodesic distance, also on the cut locus if it is known in closed form.

        Parameters
        ----------
        x, y : points
            Two points.
        """
        value = distance(self.metric, self.exponential, self.conventions.point(x), self.conventions.point(y))
        return self._nan_unless_on_manifold(value, x, y)

    def middle(self, x: Theirs, y: Theirs) -> Theirs:
        """The point midway on the geodesic between two points.

        Parameters
        ----------
        x, y : points
            Two points.
        """
        return self.exp(x, vec.scale(0.5, self.log(x, y)))

    def transport(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """The parallel transport of ``v`` along the geodesic from ``x`` to ``y``, on a symmetric space.

        Parameters
        ----------
        x, y, v : points, tangent vector
            Two points, and a tangent vector at ``x``.

        Notes
        -----
        It is minus the differential at ``x`` of the reflection in the midpoint, an isometry that reverses the geodesic.
        """
        way = self.log(x, y)
        middle = jax.lax.stop_gradient(self.exp(x, vec.scale(0.5, way)))

        def reflect(z: Theirs) -> Theirs:
            return self.exp(middle, vec.scale(-1.0, self.log(middle, z)))

        moved = self.tangential(y, vec.scale(-1.0, jax.jvp(reflect, (x,), (self.embed(x, v),))[1]))
        return nan_unless(vec.size(way) >= 0, moved)

    def gradient(self, x: Theirs, g: Theirs) -> Theirs:
        """The Riemannian gradient for a Euclidean gradient.

        Parameters
        ----------
        x, g : point, vector
            A point, and the partial derivatives in the entries of ``x``.
        """
        return self._sharp(x, self._slope(x, g, self.zero(x)))

    def hessian(self, x: Theirs, g: Theirs, h: Theirs, v: Theirs) -> Theirs:
        """The Riemannian Hessian along ``v``: the second derivative of the function along geodesics.

        Parameters
        ----------
        x, g, h, v : point, vectors, tangent vector
            A point, the Euclidean gradient, the Euclidean Hessian along ``v``, and a tangent vector.
        """
        zero = self.zero(x)
        bend = jax.jvp(lambda u: self._slope(x, g, u), (zero,), (v,))[1]
        return self._sharp(x, vec.add(bend, self._slope(x, h, zero)))

    def _slope(self, x: Theirs, g: Theirs, v: Theirs) -> Theirs:
        """Gradient at ``v`` of ``v -> <g, geodesic(x, v)>``, in their coordinates."""
        return vec.gradient(lambda u: vec.pairing(g, self._geodesic(x, u)), v)

    def zero(self, x: Theirs) -> Theirs:
        """The zero tangent vector at ``x``.

        Parameters
        ----------
        x : point
            A point.
        """
        return self.conventions.coordinates(x, vec.zeros(self.manifold.ambient))

    def _along(self, retraction: Retraction, x: Theirs, v: Theirs) -> Theirs:
        y = retraction(self.conventions.point(x), self.conventions.tangent(x, v))
        return self.conventions.lift(y, near=x)

    def _between(self, retraction: Retraction, x: Theirs, y: Theirs) -> Theirs:
        w = trusted_inverse(retraction, self.conventions.point(x), self.conventions.point(y))
        return self._nan_unless_on_manifold(self.conventions.coordinates(x, w), x, y)

    def _nan_unless_on_manifold(self, value: Theirs, *points: Theirs) -> Theirs:
        """A value, replaced by NaN if the points are not on the manifold."""
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
        """Raise an error if a method without a value for some pairs of points has none for given pairs.

        Parameters
        ----------
        method : str
            The name of the method.
        values : array or list of arrays
            Its values.
        points : iterable of points
            The points.

        Raises
        ------
        NotOnManifoldError, DomainError
            If one of the points is off the manifold; otherwise.
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
