"""Gauss collocation on a manifold: methods of order 2, 4, 6, ... in a retraction chart around the middle of each
step."""

from functools import cache
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.legendre import leggauss, legvander

from ..manifolds import InvalidInputError, Manifold
from ..manifolds.numerics.ambient import Ambient, is_count
from ..module import Module
from .retraction import Retraction


@final
class Gauss(Module):
    """Collocation at ``s`` Gauss-Legendre nodes in the chart of a retraction ``R`` around a point ``x`` amid the step.

    With the tableau ``b, c, A`` of the classical method [Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006,
    II.1.3], a frame ``E`` of ``T_xQ`` and chart velocities ``nu_i`` in R^n, a step of length ``h`` has

        ends    q_0, q_1 = R_x(-E eta/2), R_x(E eta/2),    eta = h sum_j b_j nu_j
        points  q_i = R_x(E xi_i),    velocities D R_x(E xi_i)[E nu_i],    xi_i = h sum_j (a_ij - b_j/2) nu_j

    and collocation asks for the velocities ``X(q_i)``. In the chart this is the classical method, so its order is ``2
    s``, whatever the retraction; because the chart sits in the middle, the step is symmetric: a step back from ``q_1``
    has the same centre, and returns. For Hamilton's equations and for optimal control the equations of a step are
    stationarity of a generating function ``<p_1, q_1> - <p_0, q_0> - h sum_i b_i (...)``, so that a step is a
    symplectic map of ``T*Q``. One stage is the midpoint rule, ``Midpoint(R)``; it alone is a map of one tangent vector,
    a ``DiscretizationMap``.

    The methods take coordinates, shape ``(n,)``, in the basis of the manifold at ``x``, and what ``frame(x)`` returns.
    ``stages``: the number ``s`` of nodes, at least 1. Raises ``InvalidInputError`` for anything else.
    """

    stages: int = eqx.field(static=True)
    retraction: Retraction

    def __init__(self, stages: int, retraction: Retraction) -> None:
        if not is_count(stages):
            raise InvalidInputError(
                f"the number of stages must be a whole number of at least 1, got {stages!r}; try Gauss(3, R)"
            )
        if not isinstance(retraction, Retraction):
            raise InvalidInputError(
                f"Gauss collocation is made from a retraction, got {retraction!r}; try default_retraction(manifold)"
            )
        self.stages, self.retraction = int(stages), retraction

    @property
    def manifold(self) -> Manifold:
        """The manifold on which this is a method."""
        return self.retraction.manifold

    @property
    def order(self) -> int:
        """Order of convergence at the ends of the steps."""
        return 2 * self.stages

    @property
    def theta(self) -> float:
        """Where in the step the centre sits: in its middle."""
        return 0.5

    @property
    def weights(self) -> Float[np.ndarray, " s"]:
        """Weights ``b`` of the quadrature on [0, 1]."""
        return _tableau(self.stages).weights

    @property
    def nodes(self) -> Float[np.ndarray, " s"]:
        """Nodes ``c`` in [0, 1], ascending: the times of the points, in fractions of the step."""
        return _tableau(self.stages).nodes

    @property
    def centred(self) -> Float[np.ndarray, "s s"]:
        """Matrix ``a_ij - b_j/2``: integrals from the middle of the step instead of its start. It is zero for one
        stage."""
        return _tableau(self.stages).centred

    @property
    def matrix(self) -> Float[np.ndarray, "s s"]:
        """Matrix ``A``: ``a_ij`` is the integral from 0 to ``c_i`` of the Lagrange polynomial of the node ``c_j``."""
        return _tableau(self.stages).matrix

    def frame(self, x: Ambient) -> Any:
        """What the other methods need of the basis at ``x``: computed once for a step, because a basis may jump near
        ``x``."""
        return self.retraction.frame(x)

    def ends(self, x: Ambient, frame: Any, eta: Array) -> tuple[Ambient, Ambient]:
        """Both ends ``R_x(-E eta/2)``, ``R_x(E eta/2)`` of a step with the displacement ``eta``, shape ``(n,)``."""
        return self.point(x, frame, -eta / 2), self.point(x, frame, eta / 2)

    def point(self, x: Ambient, frame: Any, xi: Array) -> Ambient:
        """The point ``R_x(E xi)``."""
        return self.retraction.chart(x, frame, xi)

    def velocity(self, x: Ambient, frame: Any, xi: Array, nu: Array) -> tuple[Ambient, Ambient]:
        """The point ``R_x(E xi)`` and the tangent vector ``D R_x(E xi)[E nu]`` there."""
        return jax.jvp(lambda c: self.point(x, frame, c), (xi,), (nu,))


class _Tableau(NamedTuple):
    weights: np.ndarray
    nodes: np.ndarray
    centred: np.ndarray
    matrix: np.ndarray


@cache
def _tableau(stages: int) -> _Tableau:
    """The Gauss method of ``s`` stages, in arrays that cannot be written to.

    The Lagrange polynomials are ``l_j = b_j sum_{k<s} (2k + 1) P_k(x_j) P_k``, because the quadrature is exact for
    their products with Legendre's ``P_k``, and ``(2k + 1) P_k = P'_{k+1} - P'_{k-1}``. Nothing is inverted: rounding
    does not grow with ``s``.
    """
    x = leggauss(stages)[0]
    values = np.concatenate([legvander(x, stages - 1), np.zeros((stages, 1))], axis=1)  # P_s vanishes at its roots
    b = 1 / (values**2 @ (2 * np.arange(stages + 1) + 1))  # Christoffel's numbers: more digits than those of leggauss
    # Over [0, x] for k = 0, over [-1, x] for the others.
    integrals = np.column_stack([x, values[:, 2:] - values[:, :-2]])
    centred = integrals @ values[:, :-1].T * b / 2
    tableau = _Tableau(b, (x + 1) / 2, centred, centred + b / 2)
    for array in tableau:
        array.flags.writeable = False
    return tableau
