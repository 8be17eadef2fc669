"""A retraction of the interior of the simplex."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Simplex
from ..retraction import Retraction, nan_unless


@final
class SimplexExponential(Retraction):
    r"""The exponential families through ``x`` on the simplex: always positive.

    Parameters
    ----------
    manifold : Simplex
        The manifold.

    Notes
    -----
    ``R(x, v)`` is proportional to :math:`x \exp(v/x)`, entry by entry. These curves are geodesics of the e-connection,
    not of a metric: ``SecondOrder`` makes them agree with a metric to second order. Inverse:
    :math:`v = x (\log(y/x) - \sum x \log(y/x))`. Its image is the manifold. Its domain is every tangent vector whose
    value has no entry that underflows or has lost digits (2e-308 in double precision); NaN outside it.

    References
    ----------
    Amari, Differential-Geometrical Methods in Statistics, 1985.

    Examples
    --------
    >>> Exponential(Simplex(3))
    SimplexExponential(manifold=Simplex(n=3))
    """

    manifold: Simplex

    def retract(self, x: Array, v: Array) -> Array:
        logs = jnp.log(x) + v / x
        # Relative to the largest, of which derivatives would be multiplied by 1 - y, a difference, where y is nearly 1.
        y = jax.nn.softmax(logs - logs[jnp.argmax(logs)])
        return nan_unless(jnp.all(y >= jnp.finfo(y.dtype).tiny), y)

    def preimage(self, x: Array, y: Array) -> Array:
        logs = jnp.log(y / x)
        return x * (logs - x @ logs)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(self(x, v)))
