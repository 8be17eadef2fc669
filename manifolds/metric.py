"""Riemannian metrics: inner products of the tangent spaces, and the energies of their geodesics."""

from abc import abstractmethod
from typing import Any, ClassVar, final

from jaxtyping import Array

from ..module import Module
from .manifold import Manifold
from .numerics import ambient as vec
from .numerics.ambient import Ambient
from .numerics.attribute import attribute
from .numerics.shapes import check_shapes


class Metric(Module):
    r"""A Riemannian metric ``g`` on a manifold: a base class.

    Notes
    -----
    :math:`g_x(v, w)` is symmetric and positive definite on :math:`T_xM`. The covector of ``v`` is the ``p`` with
    :math:`\langle p, w \rangle = g_x(v, w)`. The pairing of covectors with vectors is the sum of products of entries,
    with any metric.

    Examples
    --------
    >>> isinstance(EmbeddedMetric(Sphere(2)), Metric)
    True
    """

    __hash__ = vec.shared_hash  # for jax.jit of a method

    @attribute
    @abstractmethod
    def manifold(self) -> Manifold:
        """The manifold on which this is a metric."""

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        "inner_product": ("a point", "a tangent vector", "a second tangent vector"),
        "kinetic_energy": ("a point", "a covector"),
    }

    def __init_subclass__(cls, **options: Any) -> None:
        """Make the methods of every subclass reject arrays of other shapes, such as batches without ``jax.vmap``."""
        super().__init_subclass__(**options)
        check_shapes(cls, cls.one_point, lambda metric: metric.manifold)

    @abstractmethod
    def inner_product(self, x: Ambient, v: Ambient, w: Ambient) -> Array:
        """The inner product :math:`g_x(v, w)` of two tangent vectors, a scalar.

        Parameters
        ----------
        x : point
            A point.
        v, w : tangent vectors
            Two tangent vectors there.
        """

    @abstractmethod
    def kinetic_energy(self, x: Ambient, p: Ambient) -> Array:
        """The kinetic energy :math:`g_x^{-1}(p, p) / 2`: the Hamiltonian of the geodesics.

        Parameters
        ----------
        x : point
            A point.
        p : covector
            A covector there, any ambient array.
        """

    def covector(self, x: Ambient, v: Ambient) -> Ambient:
        r"""The covector :math:`g_x(v, \cdot)`: the momentum of a geodesic with velocity ``v``.

        Parameters
        ----------
        x : point
            A point.
        v : tangent vector
            A tangent vector there.
        """
        return self.manifold.projection(x, vec.gradient(lambda w: self.inner_product(x, v, w), v))

    def vector(self, x: Ambient, p: Ambient) -> Ambient:
        """The tangent vector whose ``covector`` is ``p``.

        Parameters
        ----------
        x : point
            A point.
        p : covector
            A covector there.
        """
        return self.manifold.projection(x, vec.gradient(lambda a: self.kinetic_energy(x, a), p))


@final
class EmbeddedMetric(Metric):
    r"""The metric of the ambient space on a manifold: :math:`g_x(v, w) = \langle v, w \rangle`.

    Parameters
    ----------
    manifold : Manifold
        The manifold.

    Examples
    --------
    >>> q, v = jnp.zeros(2), jnp.array([3.0, 4.0])
    >>> float(EmbeddedMetric(Euclidean(2)).inner_product(q, v, v))
    25.0
    """

    manifold: Manifold

    def inner_product(self, x: Ambient, v: Ambient, w: Ambient) -> Array:
        return vec.pairing(v, w)

    def kinetic_energy(self, x: Ambient, p: Ambient) -> Array:
        p = self.manifold.projection(x, p)
        return vec.pairing(p, p) / 2
