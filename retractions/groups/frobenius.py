"""Geodesics of the left-invariant metric that is the Frobenius inner product at the identity."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Shaped

from ...manifolds import MatrixLieGroup, UnknownRetractionError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.root import approach_root
from ..retraction import miss, newton_preimage
from .functions import general, unitary
from .group_map import GroupRetraction, on_group

Matrix = Shaped[Array, "n n"]


@final
class FrobeniusExponential(GroupRetraction):
    r"""The exponential map of the left-invariant metric
    :math:`\langle xA, xB \rangle = \mathrm{Re}\,\mathrm{tr}(A^H B)`.

    Parameters
    ----------
    manifold : MatrixLieGroup
        A group whose algebra contains :math:`A^H` with ``A``.

    Raises
    ------
    UnknownRetractionError
        For other groups, such as SE(n).

    Notes
    -----
    :math:`R(x, xA) = x \exp(A^H) \exp(A - A^H)`. The body velocity ``u`` solves the Euler-Poincaré equation
    :math:`\dot u = [u^H, u]` by :math:`u = \exp(-tK) A \exp(tK)` with :math:`K = A - A^H`. On SO, U and SU it equals
    ``GroupExponential``, which has a logarithm in closed form. Entries are NaN if rounding leads off the group.

    The inverse is by the Levenberg-Marquardt method and Newton's method from the logarithms of the polar factors; on
    SL(2) and SL(3) it converges for ``|A| < 4``.

    References
    ----------
    Andruchow, Larotonda, Recht, Varela, The left invariant metric in the general linear group, 2014.

    Examples
    --------
    >>> FrobeniusExponential(SL(2)).manifold
    SL(n=2)
    """

    manifold: MatrixLieGroup

    def __check_init__(self) -> None:
        super().__check_init__()
        if not self.applies(self.manifold):
            raise UnknownRetractionError(
                f"the algebra of {self.manifold} does not hold the adjoint of each of its matrices, so these geodesics "
                "are not known in closed form; try GeodesicRetraction(LeftInvariantMetric(group, inertia))"
            )

    @staticmethod
    def applies(group: MatrixLieGroup) -> bool:
        """Whether the algebra contains the adjoints of its matrices.

        Parameters
        ----------
        group : MatrixLieGroup
            The group.
        """
        return group.lie_algebra.closed_under_adjoints

    def group_map(self, a: Matrix) -> Matrix:
        adjoint = a.conj().T
        stretch, turn = jax.vmap(general.exponential)(jnp.stack([adjoint, a - adjoint]))
        return on_group(self.manifold, stretch @ turn)

    def group_map_inverse(self, b: Matrix) -> Matrix:
        eye = jnp.eye(b.shape[0], dtype=b.dtype)
        basis, there = self.manifold.basis(eye), jax.lax.stop_gradient(b)
        first = vec.components(basis, self.manifold.algebra_part(_polar_logarithms(there)))
        near = approach_root(miss(self, eye, there), first)
        return newton_preimage(self, eye, b, vec.combine(basis, near))


def _polar_logarithms(b: Matrix) -> Matrix:
    """``log p + log u`` for ``b = p u`` with ``p`` positive definite and ``u`` unitary: the inverse to first order in
    either."""
    squares, frame = jnp.linalg.eigh(b @ b.conj().T)
    adjoint = frame.conj().T
    turn = (frame / jnp.sqrt(squares)) @ adjoint @ b
    return (frame * jnp.log(squares) / 2) @ adjoint + unitary.logarithm(turn)
