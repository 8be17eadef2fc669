"""Retractions of matrix Lie groups from maps of the algebra to the group.

[Iserles, Munthe-Kaas, Norsett, Zanna, "Lie-group methods", 2000; as the coordinates of variational integrators:
Bou-Rabee, Marsden, "Hamilton-Pontryagin integrators on Lie groups", 2009.]
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Shaped

from ...manifolds import SE, SO, SU, InvalidInputError, MatrixLieGroup, U
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.attribute import attribute
from ...manifolds.numerics.precision import default_tolerance
from ..retraction import MidpointRetraction, Retraction, is_reached, nan_unless, newton_preimage

Matrix = Shaped[Array, "n n"]
GroupMap = Callable[[Matrix], Matrix]

OFF_ZERO = 0.1  # coordinates of the element of the algebra at which a group map is tried


class GroupRetraction(Retraction):
    r"""A retraction :math:`R(x, xA) = x\, g(A)` by a map ``g`` from the algebra to the group: a base class.

    Notes
    -----
    :math:`g(0) = I` and :math:`Dg(0) = \mathrm{Id}`. It commutes with left translations: integrators built on it
    conserve the momenta of left-invariant Hamiltonians. ``A`` is projected on the algebra first, because rounding
    outside it would make long products drift off the group.

    Examples
    --------
    >>> isinstance(Exponential(SE(3)), GroupRetraction)
    True
    """

    @attribute
    @abstractmethod
    def manifold(self) -> MatrixLieGroup:
        """The group."""

    @abstractmethod
    def group_map(self, a: Matrix) -> Matrix:
        """The group element ``g(A)``.

        Parameters
        ----------
        a : array of shape (n, n)
            A matrix of the algebra.
        """

    @abstractmethod
    def group_map_inverse(self, b: Matrix) -> Matrix:
        """The ``A`` with ``g(A) = b``; entries are NaN if there is none.

        Parameters
        ----------
        b : array of shape (n, n)
            An element of the group.
        """

    def retract(self, x: Array, v: Array) -> Array:
        return x @ self.group_map(self.manifold.left_trivialise(x, v))

    def frame(self, x: Array) -> Array | None:
        # Where the translated basis is orthonormal there is no need to go to the tangent space and back.
        return None if self.manifold.lie_algebra.acts_unitarily else super().frame(x)

    def chart(self, x: Array, frame: Array | None, c: Array) -> Array:
        if frame is None:
            return x @ self.group_map(vec.combine(jnp.asarray(self.manifold.lie_algebra.orthonormal, x.dtype), c))
        return super().chart(x, frame, c)

    def preimage(self, x: Array, y: Array) -> Array:
        return x @ self.group_map_inverse(self.manifold.inverse(x) @ y)


def on_group(group: MatrixLieGroup, g: Matrix) -> Matrix:
    """The matrix ``g`` if ``g`` satisfies the group's equations to half of the digits, otherwise NaN.

    NaN occurs on SL(n) far out, where det is lost. Elements of the groups of rotations and of rigid motions, whose
    functions keep to the group by their form, are left as they are.
    """
    return g if isinstance(group, SO | SE | U | SU) else nan_unless(is_on_group(group, g), g)


def is_on_group(group: MatrixLieGroup, g: Matrix, share: float = 1.0) -> Bool[Array, ""]:
    """Whether ``g`` satisfies the group's equations to this share of half of the digits."""
    return vec.size(group.violations(jax.lax.stop_gradient(g))) <= share * default_tolerance()


class SymmetricGroupRetraction(GroupRetraction, MidpointRetraction):
    """A group retraction with :math:`g(-A) = g(A)^{-1}`: a base class with midpoints.

    Notes
    -----
    Two points are symmetric about the square root of the group element between them.

    Examples
    --------
    >>> isinstance(Cayley(SO(3)), SymmetricGroupRetraction)
    True
    """

    @abstractmethod
    def square_root(self, b: Matrix) -> Matrix:
        """The group element near the identity whose square is ``b``.

        Parameters
        ----------
        b : array of shape (n, n)
            An element of the group.
        """

    def both_ways(self, x: Array, v: Array) -> tuple[Array, Array]:
        # Elsewhere the inverse of g(A) has more rounding than g(-A).
        if not self.manifold.lie_algebra.acts_unitarily:
            return super().both_ways(x, v)
        g = self.group_map(self.manifold.left_trivialise(x, v))
        return x @ self.manifold.inverse(g), x @ g

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return x0 @ self.square_root(self.manifold.inverse(x0) @ x1)


@final
class Translated(Retraction):
    r"""The retraction by any map ``g`` from the algebra to the group, translated from the left or right.

    Parameters
    ----------
    manifold : MatrixLieGroup
        The group.
    group_map : callable
        ``g``, from a matrix of the algebra to a matrix of the group, with ``g(0) = I`` and ``Dg(0) = Id``.
    inverse_map : callable, optional
        The inverse of ``g``; by default Newton's method.
    side : {"left", "right"}
        :math:`R(x, xA) = x\, g(A)`, or :math:`R(x, Ax) = g(A)\, x`.

    Raises
    ------
    InvalidInputError
        If ``g`` breaks these rules.

    Examples
    --------
    >>> cayley = lambda a: jnp.linalg.solve(jnp.eye(3) - a / 2, jnp.eye(3) + a / 2)
    >>> Translated(SO(3), cayley).manifold
    SO(n=3)
    """

    manifold: MatrixLieGroup
    group_map: GroupMap
    inverse_map: GroupMap | None
    side: str = eqx.field(static=True)

    def __init__(
        self, manifold: MatrixLieGroup, group_map: GroupMap, inverse_map: GroupMap | None = None, side: str = "left"
    ) -> None:
        if not isinstance(manifold, MatrixLieGroup):
            raise InvalidInputError(f"Translated takes a MatrixLieGroup, got {manifold!r}; try SE(3)")
        if not callable(group_map) or not (inverse_map is None or callable(inverse_map)):
            raise InvalidInputError(f"Translated takes functions of matrices, got {group_map!r} and {inverse_map!r}")
        if side not in ("left", "right"):
            raise InvalidInputError(f"side must be 'left' or 'right', got {side!r}")
        _check_axioms(manifold, group_map)
        self.manifold, self.group_map, self.inverse_map, self.side = manifold, group_map, inverse_map, side

    def retract(self, x: Array, v: Array) -> Array:
        if self.side == "left":
            return x @ self.group_map(self.manifold.left_trivialise(x, v))
        return self.group_map(self.manifold.algebra_part(v @ self.manifold.inverse(x))) @ x

    def preimage(self, x: Array, y: Array) -> Array:
        if self.inverse_map is None:
            return newton_preimage(self, x, y)
        inverse = self.manifold.inverse(x)
        v = x @ self.inverse_map(inverse @ y) if self.side == "left" else self.inverse_map(y @ inverse) @ x
        return nan_unless(is_reached(self.manifold, y, self(x, v), x, v), v)


def _check_axioms(group: MatrixLieGroup, group_map: GroupMap) -> None:
    """Raise unless ``g(0) = I`` and ``Dg(0) = Id`` on the algebra, and ``g`` of an element near 0 is in the group."""
    expected, zero = group.ambient, vec.zeros(group.ambient)
    value = jax.eval_shape(group_map, zero)
    if getattr(value, "shape", None) != expected.shape or value.dtype != expected.dtype:
        raise InvalidInputError(f"the group map must return an array of {expected.shape} {expected.dtype}, got {value}")
    basis = jnp.asarray(group.algebra, expected.dtype)

    @jax.jit  # one program: XLA would compile each operation by itself
    def gaps(basis: Array) -> tuple[Array, ...]:
        start, slopes = jax.vmap(lambda a: jax.jvp(group_map, (zero,), (a,)))(basis)
        near = group.violations(group_map(jnp.tensordot(jnp.full(len(basis), OFF_ZERO), basis, 1)))
        return vec.size(start - group.identity), vec.size(slopes - basis), jnp.max(jnp.stack(list(near.values())))

    found = gaps(basis)
    if vec.is_traced(found):
        return
    for words, gap in zip(("g(0) = I", "Dg(0) = Id", "its values in the group"), found, strict=True):
        if not gap <= default_tolerance():
            raise InvalidInputError(f"the group map must have {words}, it misses it by {float(gap):.3g}")
