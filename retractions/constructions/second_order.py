"""The acceleration with which a retraction starts, and its removal."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds import EmbeddedMetric, InvalidInputError, Manifold, Metric
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.root import find_root
from ..retraction import Retraction, is_reached, nan_unless


def metric_on(manifold: Manifold, metric: Metric | None) -> Metric:
    """The ``metric``, by default the metric of the ambient space.

    Raises ``InvalidInputError`` for a metric of another manifold.
    """
    if metric is None:
        return EmbeddedMetric(manifold)
    if not isinstance(metric, Metric) or not same_manifold(metric.manifold, manifold):
        raise InvalidInputError(f"expected a metric of {manifold}, got {metric!r}; try EmbeddedMetric(manifold)")
    return metric


def acceleration(retraction: Retraction, metric: Metric, x: Ambient, v: Ambient) -> Ambient:
    r"""The covariant acceleration ``a(v, v)`` of the curve :math:`c(t) = R(x, t v)` at ``t = 0``, a tangent vector
    at ``x``.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``R``.
    metric : Metric
        The metric ``g``.
    x : point
        A point.
    v : tangent vector
        A tangent vector there, of the shape of ``x``.

    Returns
    -------
    tangent vector
        The acceleration, of the shape of ``x``; zero for a retraction of second order for the metric.

    Notes
    -----
    :math:`g(a, e) = \langle \frac{d}{dt} \frac{\partial L}{\partial v} - \frac{\partial L}{\partial x}, e \rangle` with
    :math:`L = g_x(v, v)/2` along the curve. For the embedded metric it is the tangential part of the second derivative.
    """

    def lagrangian(at: Ambient, velocity: Ambient) -> Array:
        return metric.inner_product(at, velocity, velocity) / 2

    def curve(t: Array) -> tuple[Ambient, Ambient]:
        return jax.jvp(lambda s: retraction(x, vec.scale(s, v)), (t,), (jnp.ones_like(t),))

    def momentum(t: Array) -> Ambient:
        at, velocity = curve(t)
        return vec.gradient(lambda w: lagrangian(at, w), velocity)

    zero = jnp.zeros((), vec.size(x).dtype)
    rate = jax.jvp(momentum, (zero,), (jnp.ones_like(zero),))[1]
    force = vec.gradient(lambda at: lagrangian(at, v), x)
    return metric.vector(x, retraction.manifold.projection(x, vec.subtract(rate, force)))


@final
class SecondOrder(Retraction):
    """The second-order correction :math:`R(x, v - a(v, v)/2)` of a retraction, with its ``acceleration`` ``a`` for
    a metric.

    Parameters
    ----------
    inner : Retraction
        The retraction ``R``.
    metric : Metric, optional
        The metric; by default the embedded metric.

    Notes
    -----
    Its curves agree with the geodesics to second order. The correction is quadratic in ``v``: it improves short
    vectors. Newton's method computes the inverse from the inverse of ``R``, near zero.

    Examples
    --------
    >>> SecondOrder(QR(SO(3))).manifold
    SO(n=3)
    """

    inner: Retraction
    metric: Metric

    def __init__(self, inner: Retraction, metric: Metric | None = None) -> None:
        self.inner, self.metric = inner, metric_on(inner.manifold, metric)

    @property
    def manifold(self) -> Manifold:
        return self.inner.manifold

    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        return self.inner(x, self.bent(x, v))

    def bent(self, x: Ambient, v: Ambient) -> Ambient:
        """The corrected vector ``v - a(v, v)/2``.

        Parameters
        ----------
        x : point
            A point.
        v : tangent vector
            A tangent vector there.
        """
        return vec.subtract(v, vec.scale(0.5, acceleration(self.inner, self.metric, x, v)))

    def preimage(self, x: Ambient, y: Ambient) -> Ambient:
        w = self.inner.preimage(x, y)
        frame = self.manifold.basis(jax.lax.stop_gradient(x))

        def vector(c: Array) -> Ambient:
            return self.manifold.projection(x, vec.combine(frame, c))

        start = vec.components(frame, w)
        c, converged = find_root(lambda c: vec.components(frame, vec.subtract(self.bent(x, vector(c)), w)), start)
        v = vector(c)
        return nan_unless(converged & is_reached(self.manifold, y, self(x, v), x, v), v)
