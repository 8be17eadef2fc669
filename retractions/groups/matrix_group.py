"""The exponential and the Cayley transform of every matrix Lie group that has them [Hairer, Lubich, Wanner 2006,
IV.8]."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Shaped

from ...manifolds import SE, SO, SU, MatrixLieGroup, U, UnknownRetractionError
from ..retraction import comes_back, nan_unless
from ..rounding import SINGULAR_DISTANCE, length
from .functions import general, rigid_motions, rotations, unitary
from .group_map import SymmetricGroupRetraction, is_on_group, on_group

Matrix = Shaped[Array, "n n"]


# Shares of the tolerance of a group to which exponentials satisfy its equations, where there is a logarithm and in the
# domain.
INVERTED = 1 / 4
DOMAIN_SHARE = 1 / 16  # of the tolerance of the group: equations that hold to it with a margin inside the domain


class _MatrixFunctions(NamedTuple):
    """Functions between the algebra and the group, with the test ``injective`` that the logarithm inverts the
    exponential."""

    exponential: Callable[[Matrix], Matrix] = general.exponential
    logarithm: Callable[[Matrix], Matrix] = general.logarithm
    square_root: Callable[[Matrix], Matrix] = general.square_root
    injective: Callable[[Matrix], Any] = general.injective
    cayley: Callable[[Matrix], Matrix] = general.cayley
    cayley_inverse: Callable[[Matrix], Matrix] = general.cayley_inverse


_ROTATIONS = _MatrixFunctions(
    rotations.exponential,
    rotations.logarithm,
    rotations.rotation_sqrt,
    unitary.injective,
    rotations.cayley,
    rotations.cayley_inverse,
)
_UNITARY = _MatrixFunctions(
    unitary.exponential, unitary.logarithm, unitary.square_root, unitary.injective, unitary.cayley
)
_RIGID = _MatrixFunctions(
    rigid_motions.exponential,
    rigid_motions.logarithm,
    rigid_motions.square_root,
    rigid_motions.injective,
    rigid_motions.cayley,
    rigid_motions.cayley_inverse,
)
_SPECIAL_UNITARY = _MatrixFunctions(
    unitary.exponential,
    unitary.special_logarithm,
    unitary.special_square_root,
    unitary.injective,
    unitary.special_cayley,
    unitary.special_cayley_inverse,
)
_CLOSED_FORMS = {SO: _ROTATIONS, U: _UNITARY, SU: _SPECIAL_UNITARY, SE: _RIGID}


def _functions(group: MatrixLieGroup) -> _MatrixFunctions:
    return _CLOSED_FORMS.get(type(group), _MatrixFunctions())


@final
class GroupExponential(SymmetricGroupRetraction):
    r"""The group exponential :math:`R(x, xA) = x \exp(A)`: translated one-parameter subgroups.

    Parameters
    ----------
    manifold : MatrixLieGroup
        The group.

    Notes
    -----
    On SO, U and SU its curves are geodesics of the bi-invariant metric; on other groups there is in general no such
    metric. Entries are NaN if rounding leads off the group.

    Inverse: the principal logarithm, where no eigenvalue lies on the closed negative axis. Domain on SO, SE, U and SU:
    all angles of ``A`` are below :math:`\pi`, and no two angles, except those of one plane, are within
    :math:`8\pi\sqrt\epsilon` of a full turn apart. On other groups the domain is where the logarithm comes back to
    1e-11, up to about 1e-4 from a half turn.

    Examples
    --------
    >>> Exponential(SO(3))
    GroupExponential(manifold=SO(n=3))
    """

    manifold: MatrixLieGroup

    def group_map(self, a: Matrix) -> Matrix:
        return on_group(self.manifold, _functions(self.manifold).exponential(a))

    def group_map_inverse(self, b: Matrix) -> Matrix:
        a = self.manifold.algebra_part(_functions(self.manifold).logarithm(b))
        if type(self.manifold) in _CLOSED_FORMS:
            return a
        return nan_unless(self._stays_on_group(jax.lax.stop_gradient(a), INVERTED), a)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        a = self.manifold.left_trivialise(x, v)
        inside = _functions(self.manifold).injective(a)
        if type(self.manifold) in _CLOSED_FORMS:
            return inside
        return inside & self._stays_on_group(a, DOMAIN_SHARE) & comes_back(self, x, v)

    def _stays_on_group(self, a: Matrix, share: float) -> Bool[Array, ""]:
        """Whether the exponential is on the group wherever it is computed: its rounding is another one there, of which
        these are a sample."""
        near = jnp.stack([(1 + k * jnp.finfo(a.dtype).eps) * a for k in (-2, -1, 0, 1, 2)])
        return jnp.all(jax.vmap(lambda b: is_on_group(self.manifold, general.exponential(b), share))(near))

    def square_root(self, b: Matrix) -> Matrix:
        return _functions(self.manifold).square_root(b)


@final
class GroupCayley(SymmetricGroupRetraction):
    r"""The Cayley transform :math:`R(x, xA) = x (I - A/2)^{-1} (I + A/2)` on groups that it maps to themselves.

    Parameters
    ----------
    manifold : MatrixLieGroup
        A group whose algebra contains :math:`A^3` with ``A``, or SU(n): SO, U, symplectic groups, SL(2), SU(n), SE(n).

    Raises
    ------
    UnknownRetractionError
        For other groups, such as SL(n) for n > 2.

    Notes
    -----
    Inverse: :math:`2 (b - I)(b + I)^{-1}` with :math:`b = x^{-1} y`. Its image is where ``b`` has no eigenvalue -1: a
    single step can rotate by less than 180 degrees. Its domain is where ``A`` has no eigenvalue 2. This is all of the
    algebra of SO, SE, U, SU(n) and unitriangular groups; elsewhere all multiples of an ``A`` except a few, as long as
    half of the digits of ``A`` come back. Entries are NaN if rounding leads off the group.

    On SU(n), n > 2, the transform ``c`` is multiplied by the phase that makes its determinant one,
    :math:`c \det(c)^{-1/n} = \exp(A + (A^3 - \mathrm{tr}(A^3)/n\, I)/12 + \dots)`: also symmetric and of second order.
    Its image leaves out matrices whose angles, with sum 0, have two a full turn apart; its inverse leaves out the
    eigenvalue -1.

    Examples
    --------
    >>> Cayley(SE(3))
    GroupCayley(manifold=SE(n=3))
    """

    manifold: MatrixLieGroup

    def __check_init__(self) -> None:
        super().__check_init__()
        if not self.applies(self.manifold):
            raise UnknownRetractionError(
                f"the Cayley transform leads from the algebra of {self.manifold} out of the group; try Exponential"
            )

    @staticmethod
    def applies(group: MatrixLieGroup) -> bool:
        """Whether the Cayley transform maps the algebra to the group.

        Parameters
        ----------
        group : MatrixLieGroup
            The group.
        """
        return isinstance(group, SU) or group.lie_algebra.closed_under_cubes

    def group_map(self, a: Matrix) -> Matrix:
        return on_group(self.manifold, _functions(self.manifold).cayley(a))

    def group_map_inverse(self, b: Matrix) -> Matrix:
        a = self.manifold.algebra_part(_functions(self.manifold).cayley_inverse(b))
        return nan_unless(_invertible(jnp.eye(b.shape[0], dtype=b.dtype) + b), a)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        a = self.manifold.left_trivialise(x, v)
        return _invertible(jnp.eye(a.shape[0], dtype=a.dtype) - a / 2) & comes_back(self, x, v)

    def square_root(self, b: Matrix) -> Matrix:
        return _functions(self.manifold).square_root(b)


def _invertible(a: Matrix) -> Bool[Array, ""]:
    """Whether a matrix that would be the identity plus a small one is farther than rounding from a singular one.

    The length of the inverse bounds the inverse of this distance, and a tape has it, unlike singular values.
    """
    return length(jnp.linalg.inv(jax.lax.stop_gradient(a))) * SINGULAR_DISTANCE * jnp.finfo(a.dtype).eps < 1
