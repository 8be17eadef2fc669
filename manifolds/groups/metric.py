"""Left-invariant metrics: an inner product of the Lie algebra carried to every point of the group."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike

from ..metric import Metric
from ..numerics.ambient import is_traced
from ..numerics.errors import InvalidInputError
from ..numerics.precision import default_tolerance
from .matrix_lie_group import MatrixLieGroup


@final
class LeftInvariantMetric(Metric):
    r"""A left-invariant metric on a group, given by an inner product of the Lie algebra.

    Parameters
    ----------
    manifold : MatrixLieGroup
        The group.
    inertia : array_like of shape (d, d) or (d,)
        The symmetric positive definite matrix ``I``, or its diagonal. For a rigid body on SO(3) it is the inertia
        tensor in the body frame, kg m^2.

    Raises
    ------
    InvalidInputError
        For another group or matrix.

    Notes
    -----
    :math:`g_x(xA, xB) = a \cdot I b`, with the coordinates ``a`` and ``b`` of ``A`` and ``B`` in the basis of the
    algebra.

    Examples
    --------
    >>> metric = LeftInvariantMetric(SO(3), [1.0, 2.0, 3.0])
    >>> v = hat([1.0, 0.0, 0.0])
    >>> float(metric.inner_product(jnp.eye(3), v, v))
    1.0
    """

    manifold: MatrixLieGroup
    inertia: Array

    def __init__(self, manifold: MatrixLieGroup, inertia: ArrayLike) -> None:
        if not isinstance(manifold, MatrixLieGroup):
            raise InvalidInputError(f"LeftInvariantMetric takes a MatrixLieGroup, got {manifold!r}; try SO(3)")
        self.manifold, self.inertia = manifold, jnp.asarray(inertia, float)
        d = manifold.dimension
        if self.inertia.shape not in ((d,), (d, d)):
            raise InvalidInputError(f"the inertia on {manifold} has shape {(d,)} or {(d, d)}, got {self.inertia.shape}")
        if not is_traced(self.inertia):
            matrix = np.asarray(self.inertia)
            matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
            symmetric = np.max(np.abs(matrix - matrix.T)) <= default_tolerance() * np.max(np.abs(matrix))
            if not (symmetric and np.all(np.linalg.eigvalsh(matrix) > 0)):
                raise InvalidInputError(f"the inertia must be symmetric and positive definite, got {matrix.tolist()}")

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        a, b = (self.manifold.vee(self.manifold.left_trivialise(x, u)) for u in (v, w))
        return a @ (self.inertia * b if self.inertia.ndim == 1 else self.inertia @ b)

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        """``mu . I^-1 mu / 2`` with the body covector ``mu`` of ``p``: its flow conserves spatial covectors."""
        mu = self.manifold.body(x, p)
        if self.inertia.ndim == 1:
            return mu @ (mu / self.inertia) / 2
        return mu @ jax.scipy.linalg.solve(self.inertia, mu, assume_a="pos") / 2
