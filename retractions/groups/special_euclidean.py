"""A retraction of rigid motions that moves rotation and translation apart."""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import SE, SO, InvalidInputError
from ..retraction import MidpointRetraction
from .matrix_group import GroupExponential


@final
class SEDecoupled(MidpointRetraction):
    r"""The retraction of rigid motions that retracts the rotation and adds the translation.

    Parameters
    ----------
    manifold : SE
        The group.
    rotations : MidpointRetraction, optional
        The retraction ``rho`` of rotations; by default the exponential.

    Raises
    ------
    InvalidInputError
        For another manifold, rotations of another size, and a map that is not symmetric.

    Notes
    -----
    :math:`((R, t), (R\Omega, Rv)) \mapsto (\rho(R, R\Omega), t + Rv)`. With the exponential its curves are the
    geodesics of the ambient metric :math:`|\Omega|^2 + |v|^2`: straight lines with a constant rate of rotation. With
    ``SOPolar`` it is the nearest motion to ``x + v``.

    References
    ----------
    Park, Distance metrics on the rigid-body motions with applications to mechanism design, 1995.

    Examples
    --------
    >>> SEDecoupled(SE(3)).manifold
    SE(n=3)
    """

    manifold: SE
    rotations: MidpointRetraction

    def __init__(self, manifold: SE, rotations: MidpointRetraction | None = None) -> None:
        if not isinstance(manifold, SE):
            raise InvalidInputError(f"SEDecoupled takes a group SE(n), got {manifold!r}")
        chosen = GroupExponential(SO(manifold.n)) if rotations is None else rotations
        if not isinstance(chosen, MidpointRetraction) or chosen.manifold != SO(manifold.n):
            raise InvalidInputError(f"SEDecoupled takes a symmetric retraction of SO({manifold.n}), got {rotations!r}")
        self.manifold, self.rotations = manifold, chosen

    def retract(self, x: Array, v: Array) -> Array:
        (rotation, translation), (turn, shift) = self.manifold.parts(x), self.manifold.parts(v)
        return self.manifold.pose(self.rotations(rotation, turn), translation + shift)

    def preimage(self, x: Array, y: Array) -> Array:
        (here, start), (there, end) = self.manifold.parts(x), self.manifold.parts(y)
        return self.manifold.tangent(self.rotations.preimage(here, there), end - start)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        (rotation, _), (turn, shift) = self.manifold.parts(x), self.manifold.parts(v)
        return self.rotations.domain(rotation, turn) & jnp.all(jnp.isfinite(shift))

    def midpoint(self, x0: Array, x1: Array) -> Array:
        (here, start), (there, end) = self.manifold.parts(x0), self.manifold.parts(x1)
        return self.manifold.pose(self.rotations.midpoint(here, there), (start + end) / 2)
