"""The abstract manifold: a set of ambient arrays with its tangent spaces."""

import re
from abc import abstractmethod
from typing import Any, ClassVar, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..hooks import Hook
from ..module import Module
from .numerics import ambient as vec
from .numerics.ambient import Ambient, Frame
from .numerics.attribute import attribute
from .numerics.errors import InvalidInputError
from .numerics.precision import default_tolerance
from .numerics.shapes import check_shapes, require_shapes
from .verdict import Verdict

LOST_DIGITS = 1e-2  # of the manifold: a point that lost digits rather than a wrong one


product_of: Hook[["Manifold", "Manifold"], "Manifold"] = Hook("manifolds/product.py")


class Manifold(Module):
    r"""An ``n``-dimensional manifold embedded in a vector space of arrays: a base class.

    Notes
    -----
    Points, tangent vectors and covectors are ambient arrays of one shape, or tuples of arrays for products. Covectors
    pair with vectors by the sum of products of entries. A covector is stored as its tangent representative. Methods act
    on one point; use ``jax.vmap`` for batches. Methods named in ``one_point`` raise an error for arrays of other
    shapes.

    :math:`P_x: E \to T_xM` is orthogonal, and :math:`\sum_i \langle E_i, a \rangle E_i = P_x a` for the basis
    :math:`E_i` of :math:`T_xM`.
    """

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        "projection": ("a point", "an ambient vector"),
        "basis": ("a point",),
        "restore": ("a point",),
        "violations": ("a point",),
        "length": ("a point", "an ambient vector"),
    }

    def __init_subclass__(cls, **options: Any) -> None:
        """Make the methods of every subclass reject arrays of other shapes, such as batches without ``jax.vmap``."""
        super().__init_subclass__(**options)
        check_shapes(cls, cls.one_point, lambda manifold: manifold)

    __hash__ = vec.shared_hash  # for jax.jit of a method

    @attribute
    @abstractmethod
    def dimension(self) -> int:
        """The dimension ``n`` of the manifold."""

    @attribute
    @abstractmethod
    def ambient(self) -> Any:
        """The shapes and dtypes of the arrays of a point: a pytree of ``jax.ShapeDtypeStruct``."""

    @abstractmethod
    def projection(self, x: Ambient, a: Ambient) -> Ambient:
        """The orthogonal projection :math:`P_x a` of an ambient vector on the tangent space at ``x``.

        Parameters
        ----------
        x, a : point, ambient vector
            A point, and arrays of its shape.
        """

    @abstractmethod
    def basis(self, x: Ambient) -> Frame:
        """The orthonormal basis ``E(x)`` of the tangent space: leaves of shape ``(n, *leaf)``.

        Parameters
        ----------
        x : point
            A point.
        """

    @abstractmethod
    def restore(self, x: Ambient) -> Ambient:
        """One Newton step from an ambient point near the manifold towards it; the identity on the manifold.

        Parameters
        ----------
        x : ambient vector
            A point near the manifold. Errors of size ``e`` become :math:`O(e^2)`, which limits round-off in long
            products.
        """

    @abstractmethod
    def violations(self, x: Ambient) -> dict[str, Array]:
        """The defining equations in words, each with its violation by ``x`` (0 on the manifold).

        Parameters
        ----------
        x : ambient vector
            A point near the manifold.
        """

    @abstractmethod
    def random_point(self, key: Array) -> Ambient:
        """A random point.

        Parameters
        ----------
        key : JAX key
            The key, such as ``jax.random.key(0)``.
        """

    def length(self, x: Ambient, a: Ambient) -> Array:
        """The size of an ambient vector ``a`` at ``x`` in the measure of the manifold, by default ``max |a_i|``.

        Parameters
        ----------
        x, a : point, ambient vector
            A point, and arrays of its shape.

        Notes
        -----
        Errors of inverses are measured in it. Far out on a manifold with another geometry it is the length in the
        metric.
        """
        require_shapes(self, {"a point": x, "an ambient vector": a})
        return vec.size(a)

    def random_tangent(self, key: Array, x: Ambient) -> Ambient:
        """A random tangent vector at ``x``: the projection of a standard normal ambient vector.

        Parameters
        ----------
        key, x : JAX key, point
            The key, and a point.
        """
        return self.projection(x, vec.normal(key, self.ambient))

    def contains(self, x: Ambient, tolerance: float | None = None) -> Verdict:
        """Whether ``x`` is a point of this manifold.

        Parameters
        ----------
        x : ambient vector
            Arrays of the shape of a point.
        tolerance : float, optional
            The largest violation; by default the square root of the machine epsilon.
        """
        wrong = self.describe_mismatch(x, "a point")
        if wrong:
            return Verdict(False, wrong)
        limit = default_tolerance() if tolerance is None else tolerance
        return self.judge(_violations(self, jax.tree.map(jnp.asarray, x)), limit)

    def judge(self, violations: dict[str, Array], limit: float) -> Verdict:
        """The verdict on a point with given violations of the defining equations.

        Parameters
        ----------
        violations, limit : dict of str to number, float
            The violations, and the largest violation of a point.
        """
        for words, value in violations.items():
            if not float(value) <= limit:
                hint = self._hint(words, float(value))
                return Verdict(
                    False, f"not on {self}: {words} is {float(value):.3g}, expected at most {limit:.1g}{hint}"
                )
        return Verdict(True, f"a point of the manifold to {limit:.1g}")

    def _hint(self, words: str, value: float) -> str:
        """Advice for a point that violates the equation of these words by a value, behind a semicolon."""
        return "; restore(x) brings a point near the manifold onto it" if value < LOST_DIGITS else ""

    def is_tangent(self, x: Ambient, v: Ambient, tolerance: float | None = None) -> Verdict:
        """Whether ``v`` is tangent at ``x``: its normal part is small relative to ``1 + max |v|``.

        Parameters
        ----------
        x, v : point, ambient vector
            A point, and arrays of its shape.
        tolerance : float, optional
            The largest relative normal part; by default the square root of the machine epsilon.
        """
        wrong = self.describe_mismatch(v, "a tangent vector")
        if wrong:
            return Verdict(False, wrong)
        limit = default_tolerance() if tolerance is None else tolerance
        normal = float(_normal_part(self, jax.tree.map(jnp.asarray, x), jax.tree.map(jnp.asarray, v)))
        if not normal <= limit:
            return Verdict(
                False, f"not tangent to {self}: its relative normal part is {normal:.3g}, expected at most {limit:.1g}"
            )
        return Verdict(True, f"tangent to the manifold to {limit:.1g}")

    def describe_mismatch(self, a: Ambient, role: str) -> str:
        """The difference between ``a`` and a finite ambient vector of this manifold, in words; empty without one.

        Parameters
        ----------
        a, role : ambient vector, str
            Arrays, and the word for them, such as ``"a point"``.
        """
        if self._holds(a):
            return ""
        wrong = self.describe_shapes(a, role) or self.describe_kinds(a, role)
        if wrong:
            return wrong
        known = [
            leaf for leaf in jax.tree.leaves(a) if not (vec.is_traced(leaf) or isinstance(leaf, jax.ShapeDtypeStruct))
        ]
        if not all(np.all(np.isfinite(np.asarray(leaf))) for leaf in known):
            return f"{self._named(role)} has entries that are NaN or infinite"
        return ""

    def _holds(self, a: Ambient) -> bool:
        """Whether ``a`` is one of NumPy's arrays of finite real numbers for each of a point's: seen at once, in most
        calls."""
        leaves, structure = jax.tree.flatten(a)
        expected, wanted = jax.tree.flatten(self.ambient)
        return structure == wanted and all(
            type(leaf) is np.ndarray
            and leaf.dtype.kind == "f"
            and leaf.shape == kind.shape
            and bool(np.isfinite(leaf).all())
            for leaf, kind in zip(leaves, expected, strict=True)
        )

    def describe_shapes(self, a: Ambient, role: str) -> str:
        """The difference between the shapes of ``a`` and of an ambient vector, in words; empty without one.

        Parameters
        ----------
        a, role
            As in ``describe_mismatch``.
        """
        expected, wanted = jax.tree.flatten(self.ambient)
        leaves, structure = jax.tree.flatten(a)
        if structure != wanted:
            numbers = isinstance(a, list | tuple) and all(np.shape(entry) == () for entry in a)
            hint = "; a list or a tuple is no array, try jax.numpy.array" if numbers or isinstance(a, list) else ""
            hint = (
                "; the parts of a point are a tuple"
                if isinstance(a, list) and isinstance(self.ambient, tuple)
                else hint
            )
            return f"{self._named(role)} has the structure {_outline(self.ambient)}, got {_outline(a)}{hint}"
        for k, (shape, leaf) in enumerate(zip(expected, leaves, strict=True)):
            if np.shape(leaf) != shape.shape:
                known = self.hint_for_shape(k, np.shape(leaf), role)
                hint = "; try its as_matrix()" if hasattr(leaf, "as_matrix") else known
                came = np.shape(leaf) if np.shape(leaf) else _outline(leaf)
                place = f" in its array {k}" if len(leaves) > 1 else ""
                return f"{self._named(role)} has shape {shape.shape}{place}, got {came}{hint}"
        return ""

    def hint_for_shape(self, k: int, shape: tuple[int, ...], role: str) -> str:
        """A hint for an array of another shape, in words; empty without one.

        Parameters
        ----------
        k, shape, role : int, tuple of int, str
            The number of the array, its shape, and the word for it.
        """
        return ""

    def describe_kinds(self, a: Ambient, role: str) -> str:
        """Words on entries that are not numbers, or are complex on a real manifold; empty without such entries.

        Parameters
        ----------
        a, role
            As in ``describe_mismatch``.
        """
        for expected, leaf in zip(jax.tree.leaves(self.ambient), jax.tree.leaves(a), strict=True):
            kind = leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype
            if not jnp.issubdtype(kind, jnp.number):
                return f"{self._named(role)} has numbers as entries, got an array of {kind}"
            if jnp.issubdtype(kind, jnp.complexfloating) and not jnp.issubdtype(expected.dtype, jnp.complexfloating):
                return (
                    f"{self._named(role)} has real entries, got complex ones; try jnp.real of it where the "
                    "rest is rounding, or a manifold of complex arrays: ComplexStiefel(n, p), U(n), SU(n)"
                )
        return ""

    def _named(self, role: str) -> str:
        """``a point of SO(3)``; with a comma after it where there is one inside."""
        return f"{role} of {self}" + ("," if "," in role else "")

    def __str__(self) -> str:
        """As a paper would name it: ``SO(3)``, ``SO(3) x R^3``."""
        return re.sub(r"\b\w+=", "", repr(self))

    def __mul__(self, other: "Manifold") -> "Manifold":
        """Cartesian product; chains of ``*`` give one flat tuple of factors."""
        if not isinstance(other, Manifold):
            raise self._no_product(other)
        return product_of(self, other)

    def __rmul__(self, other: Any) -> NoReturn:
        raise self._no_product(other)

    def __pow__(self, k: Any) -> NoReturn:
        raise self._no_product(k)

    def _no_product(self, other: Any) -> InvalidInputError:
        """The error for a factor that is none, as a number of copies."""
        return InvalidInputError(
            f"a product is one of manifolds, got {self} and {other!r:.80}; try M * N for two of them, or Power(M, 3) "
            "for three copies of one"
        )


class HomogeneousSpace(Manifold):
    r"""A manifold on which a matrix group acts by linear maps of the ambient space: a base class.

    Notes
    -----
    The generators of the action give the momentum map :math:`J_i(q, p) = \langle p, \xi_i(q) \rangle`. Every
    Hamiltonian that the action leaves invariant conserves it.

    Examples
    --------
    >>> isinstance(Sphere(2), HomogeneousSpace)
    True
    """

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        **Manifold.one_point,
        "generators": ("a point",),
        "momentum": ("a point", "a covector"),
    }

    @abstractmethod
    def generators(self, x: Ambient) -> Frame:
        r"""The infinitesimal generators :math:`\xi_i(x)` of the action, leaves of shape ``(group dimension,
        *leaf)``.

        Parameters
        ----------
        x : point
            A point.
        """

    def momentum(self, x: Ambient, p: Ambient) -> Array:
        r"""The momentum map :math:`J_i = \langle p, \xi_i(x) \rangle`, shape ``(group dimension,)``.

        Parameters
        ----------
        x, p : point, covector
            A point, and a covector there.
        """
        return vec.components(self.generators(x), p)


def _outline(a: Any) -> str:
    """The structure of a point in words: its arrays by their shapes, as ``(array[3,3], array[3])``."""

    def words(leaf: Any) -> _Word:
        is_array = isinstance(leaf, np.ndarray | jax.Array | jax.ShapeDtypeStruct)
        return _Word(f"array{list(leaf.shape)}".replace(" ", "") if is_array else type(leaf).__name__)

    return repr(jax.tree.map(words, a))


class _Word(str):
    """A text that is written without quotes in a structure."""

    __repr__ = str.__str__


@eqx.filter_jit
def _violations(manifold: Manifold, x: Ambient) -> dict[str, Array]:
    return manifold.violations(x)


@eqx.filter_jit
def _normal_part(manifold: Manifold, x: Ambient, v: Ambient) -> Array:
    return vec.size(vec.subtract(v, manifold.projection(x, v))) / (1 + vec.size(v))
