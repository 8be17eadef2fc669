"""Retractions whose long products stay on the manifold."""

from typing import final

from jaxtyping import Array, Bool

from ...manifolds import Manifold
from ...manifolds.numerics.ambient import Ambient
from ..differential import DifferentiatedRetraction, differential_adjoint, differentiated
from ..retraction import Retraction


@final
class RestoredAfter(DifferentiatedRetraction):
    r"""A retraction followed by ``Manifold.restore``, so that rounding errors do not add up from step to step.

    Parameters
    ----------
    inner : Retraction
        The retraction ``R``.

    Notes
    -----
    :math:`S(x, v) = \mathrm{restore}(R(x, v))`. On the manifold ``restore`` is the identity: inverse, domain and
    derivative along the fibres are unchanged.

    Examples
    --------
    >>> RestoredAfter(Cayley(SO(3))).manifold
    SO(n=3)
    """

    inner: Retraction

    @property
    def manifold(self) -> Manifold:
        return self.inner.manifold

    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        return self.manifold.restore(self.inner(x, v))

    def preimage(self, x: Ambient, y: Ambient) -> Ambient:
        return self.inner.preimage(x, y)

    def fibre_derivative(self, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
        return differentiated(self.inner, x, v, w)

    def differential_adjoint(self, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
        return differential_adjoint(self.inner, x, v, xi)

    def domain(self, x: Ambient, v: Ambient) -> Bool[Array, ""]:
        return self.inner.domain(x, v)
