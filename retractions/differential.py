"""The derivative of a retraction along its fibres, ``DR = D_v R(x, v)``, and its adjoint."""

from abc import abstractmethod

import jax

from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.shapes import require_shapes
from .retraction import Retraction


class DifferentiatedRetraction(Retraction):
    """A retraction with closed forms of its derivative along the fibres and of the adjoint of that.

    Use ``differentiated`` and ``differential_adjoint``, which take any retraction.

    The derivative is ``DR[w] = d/ds R(x, v + s w)`` at ``s = 0``.

    >>> isinstance(Cayley(SO(3)), DifferentiatedRetraction)
    True
    """

    @abstractmethod
    def fibre_derivative(self, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
        """``DR[w] = D_v R(x, v)[w]``, tangent at ``R(x, v)``, for ``w`` tangent at ``x``."""

    @abstractmethod
    def differential_adjoint(self, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
        """``DR*[xi]``, tangent at ``x``, for ``xi`` any ambient covector at ``R(x, v)``."""


def differentiated(retraction: Retraction, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
    """Differentiated retraction ``DR[w] = d/ds R(x, v + s w)`` at ``s = 0``, a tangent vector at ``R(x, v)``.

    ``x``, ``v``, ``w``: a point and two tangent vectors there. It is the vector transport of ``w`` along ``v`` that
    belongs to the retraction [Absil, Mahony, Sepulchre 2008, 8.1.2].

    All of them, and the value, have the shape of a point.

    >>> x, v, w = jnp.zeros(2), jnp.ones(2), jnp.array([1.0, 2.0])
    >>> differentiated(Addition(Euclidean(2)), x, v, w).tolist()
    [1.0, 2.0]
    """
    require_shapes(retraction.manifold, {"a point": x, "a tangent vector": v, "a direction": w})
    if isinstance(retraction, DifferentiatedRetraction):
        return retraction.fibre_derivative(x, v, w)
    return jax.jvp(lambda u: retraction(x, u), (v,), (w,))[1]


def differential_adjoint(retraction: Retraction, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
    """Adjoint ``DR*`` of the differentiated retraction: ``<DR[w], xi> = <w, DR*[xi]>`` for every ``w`` tangent at
    ``x``.

    ``xi`` is a covector at ``R(x, v)``, any ambient array; the value is the covector at ``x``, as a tangent vector.

    ``v`` and the value are tangent vectors at ``x``, all of the shape of a point.

    >>> x, v, xi = jnp.zeros(2), jnp.ones(2), jnp.array([1.0, 2.0])
    >>> differential_adjoint(Addition(Euclidean(2)), x, v, xi).tolist()
    [1.0, 2.0]
    """
    require_shapes(retraction.manifold, {"a point": x, "a tangent vector": v, "a covector": xi})
    if isinstance(retraction, DifferentiatedRetraction):
        return retraction.differential_adjoint(x, v, xi)
    _, pull = vec.pullback(lambda u: retraction(x, u), v)
    return retraction.manifold.projection(x, pull(xi)[0])
