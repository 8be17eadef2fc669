"""The abstract matrix Lie group: a manifold and a group from a basis of its Lie algebra."""

from abc import abstractmethod
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float

from ..manifold import HomogeneousSpace
from ..numerics import ambient as vec
from ..numerics.attribute import attribute
from ..numerics.errors import InvalidInputError, shapes_of
from ..numerics.matrices import exponential
from ..numerics.precision import complex_entries, real
from ..numerics.tolerances import HALF, tolerance
from . import invariants
from .lie_algebra import LieAlgebra, lie_algebra

Coordinates = Float[Array, " d"]


class MatrixLieGroup(HomogeneousSpace):
    r"""A base class of connected Lie groups of real or complex matrices, with points of shape ``(n, n)``.

    Notes
    -----
    Subclass it with ``algebra``, a basis :math:`A_i` of the Lie algebra; all other methods have defaults. Tangent
    vectors at ``x`` are :math:`xA` with ``A`` in the algebra (left trivialisation). Vectors ``c`` of ``d`` real
    coordinates stand for :math:`A = \sum_i c_i A_i`. Pairings are real parts,
    :math:`\langle a, b \rangle = \mathrm{Re}\, \mathrm{tr}(a^H b)`. The group acts on itself from the left.

    ``algebra_part``, ``inverse``, ``equations``, ``restore``, ``violations`` and ``random_point`` are derived; a class
    with closed forms replaces them.
    """

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        **HomogeneousSpace.one_point,
        "algebra_part": ("a matrix",),
        "vee": ("a matrix",),
        "left_trivialise": ("a point", "a tangent vector"),
        "body": ("a point", "a covector"),
        "covector": ("a point",),
        "Ad": ("a point",),
        "compose": ("a point", "a second point"),
        "inverse": ("a point",),
    }

    @attribute
    @abstractmethod
    def algebra(self) -> np.ndarray:
        """The basis :math:`A_i` of the Lie algebra, shape ``(d, n, n)``: independent and closed under commutators."""

    def __check_init__(self) -> None:
        lie_algebra(self.algebra)
        if type(self).violations is MatrixLieGroup.violations:
            # An error here instead of one at every use: of groups that their invariants do not tell.
            shapes_of(self.equations, f"the function equations of {type(self).__name__}", self.ambient)

    @property
    def lie_algebra(self) -> LieAlgebra:
        """The Lie algebra with its dual and orthonormal bases."""
        return lie_algebra(self.algebra)

    @property
    def dimension(self) -> int:
        return len(self.algebra)

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        shape = self.algebra.shape[1:]
        return complex_entries(shape) if np.iscomplexobj(self.algebra) else real(shape)

    @property
    def identity(self) -> Array:
        """The neutral element."""
        return jnp.eye(self.ambient.shape[0], dtype=self.ambient.dtype)

    def compose(self, x: Array, y: Array) -> Array:
        """The product ``x y``.

        Parameters
        ----------
        x, y : array of shape (n, n)
            Two elements.
        """
        return x @ y

    def inverse(self, x: Array) -> Array:
        """The inverse :math:`x^{-1}`.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        """
        return jnp.linalg.inv(x)

    def algebra_part(self, a: Array) -> Array:
        """The orthogonal projection of a matrix on the Lie algebra.

        Parameters
        ----------
        a : array of shape (n, n)
            A matrix.
        """
        e = _constant(self.lie_algebra.orthonormal, a)
        return vec.combine(e, vec.components(e, a))

    def hat(self, c: Coordinates) -> Array:
        r"""The element :math:`\sum_i c_i A_i` of the algebra, shape ``(n, n)``.

        Parameters
        ----------
        c : array of shape (d,)
            The coordinates; ``InvalidInputError`` for another number of them.
        """
        if np.shape(c)[-1:] != (self.dimension,):
            got = f"an array of shape {np.shape(c)}"
            raise InvalidInputError(f"hat of {self} takes {self.dimension} coordinates, got {got}")
        return vec.combine(_constant(self.algebra, c), c)

    def vee(self, a: Array) -> Coordinates:
        """The coordinates, shape ``(d,)``, of the part of a matrix in the algebra: ``vee(hat(c)) = c``.

        Parameters
        ----------
        a : array of shape (n, n)
            A matrix.
        """
        return vec.components(_constant(self.lie_algebra.dual, a), a)

    def left_trivialise(self, x: Array, v: Array) -> Array:
        """The ``A`` with ``v = x A``, exactly in the algebra for any ambient ``v``.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        v : array of shape (n, n)
            A tangent vector there.
        """
        return self.algebra_part(self.inverse(x) @ v)

    def projection(self, x: Array, a: Array) -> Array:
        # The adjoint of A -> x A takes a to the algebra's part of x^H a; it is the inverse where lengths are kept.
        part = self.algebra_part(x.conj().T @ a)
        if self.lie_algebra.acts_unitarily:
            return x @ part
        e = _constant(self.lie_algebra.orthonormal, x)
        c = cho_solve((self._translated_factor(x), True), vec.components(e, part))
        return x @ vec.combine(e, c)

    def basis(self, x: Array) -> Array:
        e = _constant(self.lie_algebra.orthonormal, x)
        if self.lie_algebra.acts_unitarily:
            return x @ e
        translated = (x @ e).reshape(self.dimension, -1)
        return solve_triangular(self._translated_factor(x).astype(x.dtype), translated, lower=True).reshape(e.shape)

    def _translated_factor(self, x: Array) -> Float[Array, "d d"]:
        """Cholesky factor of the Gram matrix ``<x E_i, x E_j>`` of the translated orthonormal basis ``E_i``."""
        rows = vec.flatten_frame(x @ _constant(self.lie_algebra.orthonormal, x))
        return jnp.linalg.cholesky(rows @ rows.T)

    def equations(self, x: Array) -> Float[Array, " m"]:
        """The equations of the group, a real vector that is zero on it: ``x`` fixes the tensors that the algebra
        annihilates.

        Parameters
        ----------
        x : array of shape (n, n)
            A matrix.
        """
        return invariants.equations(self.lie_algebra.invariants, x)

    def restore(self, x: Array) -> Array:
        units = jnp.eye(x.size, dtype=x.dtype).reshape(-1, *x.shape)
        units = jnp.concatenate([units, 1j * units]) if jnp.iscomplexobj(x) else units
        slopes = jax.vmap(lambda e: jax.jvp(self.equations, (x,), (e,))[1])(units)
        # The equations are dependent, as x'x = I is by symmetry: the step of least norm that solves them.
        return x - vec.combine(units, jnp.linalg.pinv(slopes.T, rtol=tolerance(x, HALF)) @ self.equations(x))

    def violations(self, x: Array) -> dict[str, Array]:
        return {"max |equations of the group|": vec.size(self.equations(x))}

    def length(self, x: Array, a: Array) -> Array:
        """The length ``max |x^-1 a|``, invariant under left translations."""
        return vec.size(self.inverse(x) @ a)

    def random_point(self, key: Array) -> Array:
        """The exponential of a random element of the algebra whose squared norm is 1 on average."""
        c = jax.random.normal(key, (self.dimension,)) / np.sqrt(self.dimension)
        return exponential(vec.combine(_constant(self.lie_algebra.orthonormal, c), c))

    def generators(self, x: Array) -> Array:
        return _constant(self.algebra, x) @ x

    def body(self, x: Array, p: Array) -> Coordinates:
        r"""The body covector :math:`\mu_i = \langle p, x A_i \rangle`, shape ``(d,)``:
        :math:`\langle p, x\,\hat c \rangle = \mu \cdot c`.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        p : array of shape (n, n)
            A covector there.
        """
        return vec.components(x @ _constant(self.algebra, x), p)

    def spatial(self, x: Array, p: Array) -> Coordinates:
        r"""The spatial covector :math:`\langle p, A_i x \rangle`, shape ``(d,)``: the momentum of left
        multiplication, :math:`\mathrm{Ad}(x)^{-T} \mu`.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        p : array of shape (n, n)
            A covector there.
        """
        return self.momentum(x, p)

    def covector(self, x: Array, mu: Coordinates) -> Array:
        """The ambient covector at ``x`` with a given body covector.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        mu : array of shape (d,)
            The body covector.
        """
        if self.lie_algebra.acts_unitarily:
            return x @ vec.combine(_constant(self.lie_algebra.dual, x), mu)
        # In the translated orthonormal basis E: p = sum_k c_k E_k with sum_k c_k <E_k, x A_i> = mu_i.
        e, frame = self.basis(x), x @ _constant(self.algebra, x)
        return vec.combine(e, jnp.linalg.solve(jax.vmap(lambda a: vec.components(e, a))(frame), mu))

    def Ad(self, x: Array) -> Float[Array, "d d"]:
        r"""The adjoint action :math:`A \mapsto x A x^{-1}` on coordinates, shape ``(d, d)``:
        :math:`c_{spatial} = \mathrm{Ad}(x) c_{body}`.

        Parameters
        ----------
        x : array of shape (n, n)
            An element.
        """
        moved = x @ _constant(self.algebra, x) @ self.inverse(x)
        return jax.vmap(self.vee, out_axes=1)(moved)

    def ad(self, c: Coordinates) -> Float[Array, "d d"]:
        """The derivative of ``Ad`` at the identity: ``ad(c) b`` are the coordinates of ``[hat(c), hat(b)]``.

        Parameters
        ----------
        c : array of shape (d,)
            The coordinates.
        """
        a, basis = self.hat(c), _constant(self.algebra, c)
        return jax.vmap(self.vee, out_axes=1)(a @ basis - basis @ a)


def _constant(a: np.ndarray, like: Any) -> Array:
    """Constant matrices in the precision of an array, complex if they are."""
    return jnp.asarray(a, jnp.result_type(like.dtype, jnp.complex64) if np.iscomplexobj(a) else like.dtype)
