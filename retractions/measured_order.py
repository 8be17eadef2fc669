"""The order of a retraction, measured."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import EmbeddedMetric, Manifold, Metric
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.differences import slope
from ..manifolds.numerics.precision import default_tolerance
from ..manifolds.numerics.tolerances import tolerance
from .constructions.second_order import acceleration, metric_on
from .differential import differentiated
from .retraction import Retraction

MEASURED_LENGTHS = 2.0 ** -np.arange(5, 12)
UNSEEN = 1e3  # times eps: errors that may be rounding


class MeasuredOrder(NamedTuple):
    r"""The measured order of a retraction, the worst of all points.

    Attributes
    ----------
    order : int
        2 if the curves ``R(x, tv)`` agree with geodesics to second order, 1 if they have the velocity ``v`` at ``x``,
        otherwise 0.
    base : float
        Largest ``|R(x, 0) - x|``.
    velocity : float
        Largest ``|D_v R(x, 0)[v] - v|`` for unit vectors ``v``.
    acceleration : float
        Largest acceleration of the curves for unit vectors.
    slope : float
        Slope of the error against the Taylor polynomial of the geodesic over ``t``; infinite without an error.

    Notes
    -----
    :math:`|R(x, tv) - \gamma(t)| = O(t^{order + 1})` for a geodesic :math:`\gamma`.

    Examples
    --------
    >>> measured = MeasuredOrder(order=2, base=0.0, velocity=0.0, acceleration=0.0, slope=3.0)
    >>> measured.order
    2
    """

    order: int
    base: float
    velocity: float
    acceleration: float
    slope: float


def measured_order(
    retraction: Retraction,
    metric: Metric | None = None,
    at: tuple[Ambient, Ambient] | None = None,
    points: int = 5,
    seed: int = 0,
) -> MeasuredOrder:
    """Measure the order of a retraction for a metric.

    Parameters
    ----------
    retraction : Retraction
        The retraction.
    metric : Metric, optional
        The metric; by default the embedded metric.
    at : tuple of point and tangent vector, optional
        One place ``(x, v)``; by default random points.
    points : int
        The number of random points.
    seed : int
        Their seed.

    Returns
    -------
    MeasuredOrder
        The smaller of two orders: by derivatives at ``v = 0``, and by the values ``R(x, tv)`` for ``t`` from ``2^-5``
        to ``2^-11``.

    Examples
    --------
    >>> measured_order(Cayley(SO(3))).order, measured_order(QR(SO(3))).order
    (2, 1)
    """
    metric = metric_on(retraction.manifold, metric)
    if at is None:
        draws = _draws(retraction.manifold, jax.random.split(jax.random.key(seed), points))
    else:
        draws = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], at)
    facts = jax.device_get(_measure(retraction, metric, *draws))
    base, velocity, curvature = (float(np.max(part)) for part in facts[:3])
    rate = min(_slope(errors) for errors in facts[3])
    limit = default_tolerance()
    by_derivative = 0 if not max(base, velocity) <= limit else 1 if not curvature <= limit else 2
    by_values = 2 if rate > 2.5 else 1 if rate > 1.5 else 0
    return MeasuredOrder(min(by_derivative, by_values), base, velocity, curvature, rate)


@eqx.filter_jit
def _draws(manifold: Manifold, keys: Array) -> tuple[Ambient, Ambient]:
    def draw(key: Array) -> tuple[Ambient, Ambient]:
        first, second = jax.random.split(key)
        x = manifold.random_point(first)
        return x, manifold.random_tangent(second, x)

    return jax.vmap(draw)(keys)


@eqx.filter_jit
def _measure(retraction: Retraction, metric: Metric, x: Ambient, v: Ambient) -> tuple[Array, Array, Array, Array]:
    embedded = EmbeddedMetric(retraction.manifold)

    def one(x: Ambient, v: Ambient) -> tuple[Array, Array, Array, Array]:
        v = vec.scale(1 / jnp.sqrt(vec.pairing(v, v)), v)
        rest = vec.scale(0.0, v)
        bend = acceleration(retraction, metric, x, v)
        # The geodesic's second derivative along the tangent space: the difference of two accelerations is a tensor.
        flat = bend if isinstance(metric, EmbeddedMetric) else acceleration(retraction, embedded, x, v)
        ahead = vec.subtract(flat, bend)

        def error(t: Array) -> Array:
            chord = retraction.manifold.projection(x, vec.subtract(retraction(x, vec.scale(t, v)), x))
            return vec.size(vec.subtract(chord, vec.add(vec.scale(t, v), vec.scale(t * t / 2, ahead)))) / (
                1 + vec.size(x)
            )

        velocity = vec.subtract(differentiated(retraction, x, rest, v), v)
        base = vec.subtract(retraction(x, rest), x)
        return vec.size(base), vec.size(velocity), vec.size(bend), jax.vmap(error)(jnp.asarray(MEASURED_LENGTHS))

    return jax.vmap(one)(x, v)


def _slope(errors: np.ndarray) -> float:
    """Slope of ``log error`` over ``log t`` where the errors are above rounding; infinite where none of them is."""
    return (
        slope(MEASURED_LENGTHS, errors, UNSEEN * tolerance(errors, 1.0), 2) if np.all(np.isfinite(errors)) else np.nan
    )
