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
    r"""Collocation at ``s`` Gauss-Legendre nodes in the chart of a retraction around a point in the middle of the
    step.

    Parameters
    ----------
    stages : int
        The number ``s`` of nodes, at least 1. The order is ``2 s``.
    retraction : Retraction
        The retraction ``R``; the method acts on its manifold.

    Raises
    ------
    InvalidInputError
        For other arguments.

    Notes
    -----
    With the tableau ``b, c, A`` of the classical method, a frame ``E`` of :math:`T_xQ` and chart velocities
    :math:`\nu_i` in R^n, a step of length ``h`` has the ends :math:`q_0, q_1 = R_x(\mp E\eta/2)` with
    :math:`\eta = h \sum_j b_j \nu_j`, and

    .. math::
        q_i = R_x(E \xi_i), \quad v_i = DR_x(E \xi_i)[E \nu_i], \quad
        \xi_i = h \sum_j (a_{ij} - b_j/2) \nu_j, \quad v_i = X(q_i).

    In the chart this is the classical method: the order is :math:`2s` with any retraction. The chart is centred in the
    middle of the step, so that the step is symmetric. For Hamilton's equations and for optimal control the step is a
    symplectic map of ``T*Q``. One stage is the midpoint rule, ``Midpoint(R)``. The methods take coordinates, shape
    ``(n,)``, in the basis at ``x``, and the result of ``frame(x)``.

    References
    ----------
    Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.1.3.

    Examples
    --------
    >>> Gauss(3, Exponential(SO(3))).order
    6
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
        """The manifold of the method."""
        return self.retraction.manifold

    @property
    def order(self) -> int:
        """The order of convergence at the ends of the steps."""
        return 2 * self.stages

    @property
    def theta(self) -> float:
        """The place of the centre in the step: 1/2."""
        return 0.5

    @property
    def weights(self) -> Float[np.ndarray, " s"]:
        """The weights ``b`` of the quadrature on [0, 1]."""
        return _tableau(self.stages).weights

    @property
    def nodes(self) -> Float[np.ndarray, " s"]:
        """The nodes ``c`` in [0, 1], ascending: the times of the points, in fractions of the step."""
        return _tableau(self.stages).nodes

    @property
    def centred(self) -> Float[np.ndarray, "s s"]:
        """The matrix :math:`a_{ij} - b_j/2`: integrals from the middle of the step instead of its start."""
        return _tableau(self.stages).centred

    @property
    def matrix(self) -> Float[np.ndarray, "s s"]:
        """The matrix ``A``: :math:`a_{ij}` is the integral from 0 to :math:`c_i` of the Lagrange polynomial of
        :math:`c_j`.
        """
        return _tableau(self.stages).matrix

    def frame(self, x: Ambient) -> Any:
        """The basis data of a step at ``x``, computed once because a basis may jump near ``x``.

        Parameters
        ----------
        x : point
            The centre.
        """
        return self.retraction.frame(x)

    def ends(self, x: Ambient, frame: Any, eta: Array) -> tuple[Ambient, Ambient]:
        r"""The two ends :math:`R_x(-E\eta/2)` and :math:`R_x(E\eta/2)` of a step.

        Parameters
        ----------
        x : point
            The centre.
        frame : pytree
            The result of ``frame(x)``.
        eta : array of shape (n,)
            The displacement.
        """
        return self.point(x, frame, -eta / 2), self.point(x, frame, eta / 2)

    def point(self, x: Ambient, frame: Any, xi: Array) -> Ambient:
        r"""The point :math:`R_x(E\xi)`.

        Parameters
        ----------
        x, frame
            As in ``ends``.
        xi : array of shape (n,)
            Its coordinates.
        """
        return self.retraction.chart(x, frame, xi)

    def velocity(self, x: Ambient, frame: Any, xi: Array, nu: Array) -> tuple[Ambient, Ambient]:
        r"""The point :math:`R_x(E\xi)` and the tangent vector :math:`DR_x(E\xi)[E\nu]` there.

        Parameters
        ----------
        x, frame
            As in ``ends``.
        xi, nu : array of shape (n,)
            Coordinates of the point and of the velocity.
        """
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
