"""Collocation on a manifold: several points of each step in a retraction chart around the middle of the step."""

from abc import abstractmethod
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.legendre import legvander

from ..manifolds import InvalidInputError, Manifold
from ..manifolds.numerics.ambient import Ambient, is_count
from ..module import Module
from .discretization import DiscretizationMap
from .retraction import Retraction


class Tableau(NamedTuple):
    """The tableau of a collocation method, in arrays that cannot be written to."""

    weights: np.ndarray
    nodes: np.ndarray
    centred: np.ndarray
    matrix: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray) -> Self:
        """The tableau of distinct nodes in [-1, 1].

        The Lagrange polynomials are sums of Legendre's ``P_k``, ``k < s``, whose integrals are ``P'_{k+1} - P'_{k-1} =
        (2k + 1) P_k``. With these the matrix that is inverted is well conditioned for the nodes of Gauss, Radau and
        Lobatto.
        """
        stages = len(x)
        values = legvander(x, stages)
        lagrange = np.linalg.inv(values[:, :-1])  # (s, s): coefficients of each polynomial in a column
        # Over [0, x] for k = 0, over [-1, x] for the others.
        integrals = np.column_stack([x, (values[:, 2:] - values[:, :-2]) / (2 * np.arange(1, stages) + 1)])
        centred, b = integrals @ lagrange / 2, lagrange[0]
        tableau = cls(b.copy(), (x + 1) / 2, centred, centred + b / 2)
        for array in tableau:
            array.flags.writeable = False
        return tableau


class CollocationMethod(Module):
    r"""Collocation at ``s`` nodes in the chart of a retraction around a point in the middle of the step: a base class.

    Parameters
    ----------
    stages : int
        The number ``s`` of nodes, at least 1.
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

    In the chart this is the classical method, so that its order does not depend on the retraction. For Hamilton's
    equations and for optimal control the step is a symplectic map of ``T*Q``. A subclass has the tableau and the order.
    The methods take coordinates, shape ``(n,)``, in the basis at ``x``, and the result of ``frame(x)``.

    References
    ----------
    Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.1.2.
    """

    stages: int = eqx.field(static=True)
    retraction: Retraction

    def __init__(self, stages: int, retraction: Retraction) -> None:
        if not is_count(stages):
            raise InvalidInputError(
                f"the number of stages must be a whole number of at least 1, got {stages!r}; try "
                f"{type(self).__name__}(3, R)"
            )
        if not isinstance(retraction, Retraction):
            raise InvalidInputError(
                f"{type(self).__name__} collocation is made from a retraction, got {retraction!r}; try "
                f"{type(self).__name__}({stages}, default_retraction(manifold))"
            )
        self.stages, self.retraction = int(stages), retraction

    @property
    def manifold(self) -> Manifold:
        """The manifold of the method."""
        return self.retraction.manifold

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of convergence at the ends of the steps."""

    @property
    @abstractmethod
    def tableau(self) -> Tableau:
        """The tableau of the classical method."""

    @property
    @abstractmethod
    def discretization_map(self) -> DiscretizationMap:
        """The discretization map that the method of one stage is, up to its chart."""

    def with_stages(self, stages: int) -> Self:
        """The method of this kind with another number of stages.

        Parameters
        ----------
        stages : int
            The number.
        """
        return type(self)(stages, self.retraction)

    def on(self, retraction: Retraction) -> Self:
        """The method of this kind, with as many stages, by another retraction.

        Parameters
        ----------
        retraction : Retraction
            The retraction.
        """
        return type(self)(self.stages, retraction)

    @property
    def theta(self) -> float:
        """The place of the centre in the step: 1/2."""
        return 0.5

    @property
    def weights(self) -> Float[np.ndarray, " s"]:
        """The weights ``b`` of the quadrature on [0, 1]."""
        return self.tableau.weights

    @property
    def nodes(self) -> Float[np.ndarray, " s"]:
        """The nodes ``c`` in [0, 1], ascending: the times of the points, in fractions of the step."""
        return self.tableau.nodes

    @property
    def centred(self) -> Float[np.ndarray, "s s"]:
        """The matrix :math:`a_{ij} - b_j/2`: integrals from the middle of the step instead of its start."""
        return self.tableau.centred

    @property
    def matrix(self) -> Float[np.ndarray, "s s"]:
        """The matrix ``A``: :math:`a_{ij}` is the integral from 0 to :math:`c_i` of the Lagrange polynomial of
        :math:`c_j`.
        """
        return self.tableau.matrix

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
