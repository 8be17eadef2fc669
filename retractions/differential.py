"""The derivative of a retraction along its fibres, ``DR = D_v R(x, v)``, and its adjoint."""

from abc import abstractmethod

import jax

from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.shapes import require_shapes
from .retraction import Retraction


class DifferentiatedRetraction(Retraction):
    r"""A retraction with closed forms of its derivative along the fibres and of its adjoint: a base class.

    Notes
    -----
    :math:`DR[w] = \frac{d}{ds} R(x, v + s w)` at ``s = 0``. The functions ``differentiated`` and
    ``differential_adjoint`` take any retraction.

    Examples
    --------
    >>> isinstance(Cayley(SO(3)), DifferentiatedRetraction)
    True
    """

    @abstractmethod
    def fibre_derivative(self, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
        """The derivative :math:`DR[w] = D_v R(x, v)[w]`, tangent at ``R(x, v)``.

        Parameters
        ----------
        x : point
            A point.
        v, w : tangent vectors
            Tangent vectors there.
        """

    @abstractmethod
    def differential_adjoint(self, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
        r"""The adjoint :math:`DR^*[\xi]`, tangent at ``x``.

        Parameters
        ----------
        x : point
            A point.
        v : tangent vector
            A tangent vector there.
        xi : covector
            Any ambient covector at ``R(x, v)``.
        """


def differentiated(retraction: Retraction, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
    r"""The differentiated retraction :math:`DR[w] = \frac{d}{ds} R(x, v + s w)` at ``s = 0``, a tangent vector at
    ``R(x, v)``.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``R``.
    x : point
        A point.
    v, w : tangent vectors
        Tangent vectors there, of the shape of ``x``.

    Returns
    -------
    tangent vector
        The vector transport of ``w`` along ``v`` that belongs to the retraction, of the shape of ``x``.

    References
    ----------
    Absil, Mahony, Sepulchre, Optimization algorithms on matrix manifolds, 2008, 8.1.2.

    Examples
    --------
    >>> x, v, w = jnp.zeros(2), jnp.ones(2), jnp.array([1.0, 2.0])
    >>> differentiated(Addition(Euclidean(2)), x, v, w).tolist()
    [1.0, 2.0]
    """
    require_shapes(retraction.manifold, {"a point": x, "a tangent vector": v, "a direction": w})
    if isinstance(retraction, DifferentiatedRetraction):
        return retraction.fibre_derivative(x, v, w)
    return jax.jvp(lambda u: retraction(x, u), (v,), (w,))[1]


def differential_adjoint(retraction: Retraction, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
    r"""The adjoint :math:`DR^*` of the differentiated retraction:
    :math:`\langle DR[w], \xi \rangle = \langle w, DR^*[\xi] \rangle`.

    Parameters
    ----------
    retraction : Retraction
        The retraction ``R``.
    x : point
        A point.
    v : tangent vector
        A tangent vector there, of the shape of ``x``.
    xi : covector
        A covector at ``R(x, v)``, any ambient array.

    Returns
    -------
    tangent vector
        The covector at ``x``, as a tangent vector.

    Examples
    --------
    >>> x, v, xi = jnp.zeros(2), jnp.ones(2), jnp.array([1.0, 2.0])
    >>> differential_adjoint(Addition(Euclidean(2)), x, v, xi).tolist()
    [1.0, 2.0]
    """
    require_shapes(retraction.manifold, {"a point": x, "a tangent vector": v, "a covector": xi})
    if isinstance(retraction, DifferentiatedRetraction):
        return retraction.differential_adjoint(x, v, xi)
    _, pull = vec.pullback(lambda u: retraction(x, u), v)
    return retraction.manifold.projection(x, pull(xi)[0])
