"""The abstract manifold: a set of ambient arrays with its tangent spaces."""

import re
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .numerics import ambient as vec
from .numerics.ambient import Ambient, Frame
from .numerics.attribute import attribute
from .numerics.errors import InvalidInputError
from .numerics.precision import default_tolerance
from .numerics.shapes import check_shapes, require_shapes

NEAR = 1e-2  # of the manifold: a point that lost digits rather than a wrong one


@dataclass(frozen=True)
class Verdict:
    """Answer to a membership question: true or false, with the reason in words.

    It holds where the largest violation is ``<= tolerance``.

    >>> verdict = Sphere(2).contains(jnp.array([1.0, 0.0, 0.0]))
    >>> bool(verdict), verdict.reason
    (True, 'a point of the manifold to 1e-08')
    """

    holds: bool
    reason: str

    def __bool__(self) -> bool:
        return self.holds


class Manifold(eqx.Module):
    """An ``n``-dimensional manifold embedded in a vector space of arrays.

    Points, tangent vectors and covectors are ambient arrays (pytrees for products) of one shape. Covectors pair with
    vectors by the sum of products of entries; a covector is stored as its tangent representative.
    Methods act on one point; batches are ``jax.vmap``: those named in ``one_point`` refuse arrays of other shapes.

    In symbols: ``P_x: E -> T_xM``, orthogonal, and ``sum_i <E_i, a> E_i = P_x a`` for the basis ``E_i`` of ``T_xM``.
    """

    one_point: ClassVar[dict[str, tuple[str, ...]]] = {
        "projection": ("a point", "an ambient vector"),
        "basis": ("a point",),
        "restore": ("a point",),
        "violations": ("a point",),
        "length": ("a point", "an ambient vector"),
    }

    def __init_subclass__(cls, **options: Any) -> None:
        """Let the methods of every subclass refuse arrays of other shapes, as those of a batch without ``jax.vmap``."""
        super().__init_subclass__(**options)
        check_shapes(cls, cls.one_point, lambda manifold: manifold)

    __hash__ = vec.shared_hash  # for jax.jit of a method

    @attribute
    @abstractmethod
    def dimension(self) -> int:
        """Dimension ``n`` of the manifold."""

    @attribute
    @abstractmethod
    def ambient(self) -> Any:
        """Shapes and dtypes of the arrays that make up a point: a pytree of ``jax.ShapeDtypeStruct``."""

    @abstractmethod
    def projection(self, x: Ambient, a: Ambient) -> Ambient:
        """Orthogonal projection ``P_x a`` of an ambient vector on the tangent space at ``x``."""

    @abstractmethod
    def basis(self, x: Ambient) -> Frame:
        """Orthonormal basis ``E(x)`` of the tangent space: leaves of shape ``(n, *leaf)``."""

    @abstractmethod
    def restore(self, x: Ambient) -> Ambient:
        """One Newton step from an ambient point near the manifold towards it; the identity on the manifold.

        Errors of size ``e`` become ``O(e^2)``: used to keep round-off from accumulating over long products.
        """

    @abstractmethod
    def violations(self, x: Ambient) -> dict[str, Array]:
        """The defining equations in words, each with how much ``x`` violates it (0 on the manifold)."""

    @abstractmethod
    def random_point(self, key: Array) -> Ambient:
        """A random point from a JAX key."""

    def length(self, x: Ambient, a: Ambient) -> Array:
        """Size of an ambient vector ``a`` at ``x`` in the manifold's own measure, by which inverses are judged.

        By default ``max |a_i|``. Far out on a manifold with another geometry, an ambient length says nothing of how
        near two points are: there the length is that of its metric.
        """
        require_shapes(self, {"a point": x, "an ambient vector": a})
        return vec.size(a)

    def random_tangent(self, key: Array, x: Ambient) -> Ambient:
        """A random tangent vector at ``x``: the projection of a standard normal ambient vector."""
        return self.projection(x, vec.normal(key, self.ambient))

    def contains(self, x: Ambient, tolerance: float | None = None) -> Verdict:
        """Whether ``x`` is a point of this manifold to ``tolerance`` (default: square root of machine epsilon)."""
        wrong = self.describe_mismatch(x, "a point")
        if wrong:
            return Verdict(False, wrong)
        limit = default_tolerance() if tolerance is None else tolerance
        return self.judge(_violations(self, jax.tree.map(jnp.asarray, x)), limit)

    def judge(self, violations: dict[str, Array], limit: float) -> Verdict:
        """The verdict on a point with these violations of the defining equations."""
        for words, value in violations.items():
            if not float(value) <= limit:
                hint = self._hint(words, float(value))
                return Verdict(
                    False, f"not on {self}: {words} is {float(value):.3g}, expected at most {limit:.1g}{hint}"
                )
        return Verdict(True, f"a point of the manifold to {limit:.1g}")

    def _hint(self, words: str, value: float) -> str:
        """What to try where a point violates the equation of these words by a value, behind a semicolon."""
        return "; restore(x) brings a point near the manifold onto it" if value < NEAR else ""

    def is_tangent(self, x: Ambient, v: Ambient, tolerance: float | None = None) -> Verdict:
        """Whether ``v`` is tangent at ``x``: its normal part, relative to ``1 + max |v|``, is below ``tolerance``."""
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
        """Words on how ``a`` differs from a finite ambient vector of this manifold in its structure; empty if it does
        not."""
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
        """Words on how the arrays of ``a`` differ in their shapes from those of an ambient vector; empty if they do
        not."""
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
                return f"{self._named(role)} has shape {shape.shape}, got {came}{hint}"
        return ""

    def hint_for_shape(self, k: int, shape: tuple[int, ...], role: str) -> str:
        """Words on an array of another shape in place of the k-th array of what ``role`` says, a point, a tangent
        vector or a covector; none where it is not known what it may be."""
        return ""

    def describe_kinds(self, a: Ambient, role: str) -> str:
        """Words on entries of ``a`` that are not numbers, or complex where those of a point are real; empty if there
        are none."""
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
        from .product import Product

        if not isinstance(other, Manifold):
            raise self._no_product(other)
        mine = self.factors if isinstance(self, Product) else (self,)
        theirs = other.factors if isinstance(other, Product) else (other,)
        return Product(*mine, *theirs)

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
    """A manifold on which a matrix group acts by linear maps of the ambient space.

    The action's generators give the momentum map ``J_i(q, p) = <p, xi_i(q)>``, conserved by every Hamiltonian that the
    action leaves invariant.

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
        """Infinitesimal generators ``xi_i(x)`` of the action, leaves of shape ``(group dimension, *leaf)``."""

    def momentum(self, x: Ambient, p: Ambient) -> Array:
        """Momentum map ``J_i = <p, xi_i(x)>`` of a covector ``p`` at ``x``."""
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


def same_manifold(a: Manifold, b: Manifold) -> bool:
    """Whether two manifolds are of one class with the same data; tangent and cotangent bundles are the same set."""
    from .bundles import VectorBundle

    if isinstance(a, VectorBundle) and isinstance(b, VectorBundle):
        return same_manifold(a.base, b.base)
    return bool(eqx.tree_equal(a, b))
