"""The abstract retraction, with the inverse and the domain that follow from its values."""

import inspect
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NoReturn, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..manifolds import DomainError, InvalidInputError, Manifold, Metric
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.attribute import attribute
from ..manifolds.numerics.errors import NotOnManifoldError
from ..manifolds.numerics.precision import default_tolerance, same_point
from ..manifolds.numerics.root import find_root, known_root
from ..manifolds.numerics.shapes import require_shapes
from ..module import Module

DERIVED = ("preimage", "domain", "frame", "chart", "both_ways")
INVERSE_ROUNDING = 8  # units of it in the entries of a point, by which the value of an inverse may miss it anywhere


class Retraction(Module):
    r"""A retraction ``R: TM -> M`` of a manifold: a base class.

    Notes
    -----
    :math:`R(x, 0) = x` and :math:`D_v R(x, 0) = \mathrm{Id}`. For any length of ``v``, ``R(x, v)`` is a point of the
    manifold to rounding, or not finite.

    Subclass it with ``manifold`` and ``retract``; a call ``R(x, v)`` checks the shapes and calls ``retract``.
    ``preimage``, ``domain``, ``frame``, ``chart`` and ``both_ways`` have defaults by Newton's method and a round trip;
    a class with closed forms replaces them. A class that defines ``__call__`` raises ``InvalidInputError``.

    References
    ----------
    Absil, Mahony, Sepulchre, Optimization algorithms on matrix manifolds, 2008, 4.1.
    """

    __hash__ = vec.shared_hash  # for jax.jit of a method

    @attribute
    @abstractmethod
    def manifold(self) -> Manifold:
        """The manifold of the retraction."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Raise for a class that would leave out the check of the shapes."""
        super().__init_subclass__(**options)
        if "__call__" in vars(cls):
            raise InvalidInputError(
                f"{cls.__name__} defines __call__, expected retract(self, x, v), which R(x, v) calls after a check of "
                "the shapes; try the other name"
            )

    def __check_init__(self) -> None:
        """Raise unless the manifold, the retractions and the metric it is made of are of the classes in their
        annotations."""
        annotated = [item for kind in reversed(type(self).__mro__) for item in inspect.get_annotations(kind).items()]
        for name, wanted in dict(annotated).items():
            made_of = isinstance(wanted, type) and issubclass(wanted, Manifold | Retraction | Metric)
            if made_of and not isinstance(getattr(self, name), wanted):
                raise InvalidInputError(f"{type(self).__name__} takes a {wanted.__name__}, got {getattr(self, name)!r}")

    @final
    def __call__(self, x: Ambient, v: Ambient) -> Ambient:
        """The point ``R(x, v)`` reached from ``x`` along the tangent vector ``v``.

        Parameters
        ----------
        x : point
            A point.
        v : tangent vector
            A tangent vector there; ``manifold.is_tangent(x, v)`` checks it, this call does not.

        Raises
        ------
        InvalidInputError
            For arrays of other shapes, such as a batch without ``jax.vmap``.
        """
        require_shapes(self.manifold, {"a point": x, "a tangent vector": v})
        return self.retract(x, v)

    @abstractmethod
    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        """The point ``R(x, v)`` for arrays of the shape of a point; smooth also for ``x``, ``v`` off ``TM``.

        Parameters
        ----------
        x, v : point, tangent vector
            Arrays of the shape of a point.
        """

    @property
    def closed_forms(self) -> frozenset[str]:
        """The names among ``preimage``, ``domain``, ``frame``, ``chart`` and ``both_ways`` that the class defines."""
        return frozenset(name for name in DERIVED if getattr(type(self), name) is not getattr(Retraction, name))

    def frame(self, x: Ambient) -> Any:
        """The basis data of a chart at ``x``, computed once because a basis may jump near ``x``.

        Parameters
        ----------
        x : point
            The centre.
        """
        return self.manifold.basis(x)

    def chart(self, x: Ambient, frame: Any, c: Array) -> Ambient:
        r"""The point :math:`R(x, \sum_k c_k E_k(x))` with coordinates ``c`` in the basis at ``x``.

        Parameters
        ----------
        x : point
            The centre.
        frame : pytree
            The result of ``frame(x)``.
        c : array of shape (n,)
            The coordinates.
        """
        return self(x, vec.combine(frame, c))

    def both_ways(self, x: Ambient, v: Ambient) -> tuple[Ambient, Ambient]:
        """The two points ``R(x, -v)`` and ``R(x, v)``.

        Parameters
        ----------
        x, v : point, tangent vector
            Arrays of the shape of a point.
        """
        # One batched evaluation: half as much to compile as two.
        both = jax.vmap(lambda s: self(x, vec.scale(s, v)))(jnp.array([-1.0, 1.0]))
        first, second = (vec.entries(both, i) for i in (0, 1))
        return first, second

    def preimage(self, x: Ambient, y: Ambient) -> Ambient:
        """The inverse retraction: ``v`` at ``x`` with ``R(x, v) = y``, with NaN if there is none.

        Parameters
        ----------
        x, y : point
            Two points.

        Notes
        -----
        ``inverse`` is the same for one point outside of ``jit``; it raises an error instead of returning NaN.
        """
        return newton_preimage(self, x, y)

    def domain(self, x: Ambient, v: Ambient) -> Bool[Array, ""]:
        """Whether ``preimage`` inverts :math:`R_x` at ``v`` to more than half of the digits, relative to ``1 +
        |v|``.

        Parameters
        ----------
        x, v : point, tangent vector
            Arrays of the shape of a point.

        Notes
        -----
        Closed forms end where :math:`R_x` is no longer injective, or where rounding of ``R(x, v)`` leaves fewer digits
        of ``v``.
        """
        return comes_back(self, x, v)

    def inverse(self, x: Ambient, y: Ambient) -> Ambient:
        """The inverse retraction: the tangent vector ``v`` at ``x`` with ``R(x, v) = y``.

        Parameters
        ----------
        x, y : point
            Two points.

        Raises
        ------
        DomainError
            If ``y`` is outside the image, or so far that half of the digits are lost.
        NotOnManifoldError
            If ``y`` is not a point. Under ``jit`` and ``vmap`` the entries are NaN instead.
        """
        require_shapes(self.manifold, {"a base point": x, "a point": y})
        v = self.preimage(x, y)
        if not vec.is_traced(x, y, v):
            z = self(x, v)
            if not is_reached(self.manifold, y, z, x, v):
                self._explain_miss(x, y, z)
        return v

    def _explain_miss(self, x: Ambient, y: Ambient, z: Ambient) -> NoReturn:
        """Raise the error for an inverse that leads to ``z`` instead of ``y``."""
        for role, point in {"the base point": x, "the point": y}.items():
            verdict = self.manifold.contains(point)
            if not verdict:
                raise NotOnManifoldError(f"{role} is no point: {verdict.reason}")
        gap = self.manifold.length(y, vec.subtract(z, y))
        miss = "no tangent vector leads to it" if jnp.isnan(gap) else f"the inverse misses it by {gap:.3g}, expected 0"
        raise DomainError(
            f"the point is outside the image of {type(self).__name__} at the base point, or too far for the precision "
            f"in use: {miss}; take a nearer point, or a retraction with a larger image"
        )


def is_reached(manifold: Manifold, y: Ambient, z: Ambient, x: Ambient, v: Ambient) -> Bool[Array, ""]:
    """Whether the point ``z`` to which ``v`` leads from ``x`` is ``y``, to half of the digits or but for rounding.

    Half of the digits are those of the manifold's own measure, relative to ``1 + |v|``; rounding is that of the arrays
    ``x`` and ``y``, which far out is more.
    """
    miss = vec.subtract(z, y)
    half = manifold.length(y, miss) <= default_tolerance() * (1 + manifold.length(x, v))
    rounding = vec.size(miss) <= INVERSE_ROUNDING * jnp.finfo(vec.size(miss).dtype).eps * vec.size((x, y))
    # Beside the image v may be as long as one likes, and half of its digits say nothing.
    return same_point(z, y, default_tolerance()) & (half | rounding)


def comes_back(retraction: Retraction, x: Ambient, v: Ambient) -> Bool[Array, ""]:
    """Whether the inverse finds ``v`` from ``R(x, v)`` to more than half of the digits."""
    return same_point(retraction.preimage(x, retraction(x, v)), v, default_tolerance())


def newton_preimage(retraction: Retraction, x: Ambient, y: Ambient, start: Ambient | None = None) -> Ambient:
    """Inverse of any retraction by Newton's method in orthonormal coordinates of the tangent space.

    ``start`` is the tangent vector to begin with, the projected chord ``y - x`` if it is not given.
    """
    here, there = jax.lax.stop_gradient((x, y))
    source = retraction.manifold.basis(here)
    begin = vec.components(source, vec.subtract(there, here) if start is None else start)
    c, converged = find_root(miss(retraction, x, y), begin)
    v = retraction.manifold.projection(x, vec.combine(source, c))
    reached = is_reached(retraction.manifold, y, _moved(retraction, x, v), x, v)
    return nan_unless(converged & reached, v)


def implicit_preimage(retraction: Retraction, x: Ambient, y: Ambient, v: Ambient) -> Ambient:
    """``v``, an inverse ``R(x, v) = y`` found by whatever means, with the derivatives of the implicit function
    theorem."""
    source = retraction.manifold.basis(jax.lax.stop_gradient(x))
    c = known_root(miss(retraction, x, y), vec.components(source, v))
    return retraction.manifold.projection(x, vec.combine(source, c))


def miss(retraction: Retraction, x: Ambient, y: Ambient) -> Callable[[Array], Array]:
    """By how much ``R(x, v)`` misses ``y``, in coordinates at ``y``, as a function of the coordinates of ``v`` at
    ``x``."""
    here, there = jax.lax.stop_gradient((x, y))
    source, target = retraction.manifold.basis(here), retraction.manifold.basis(there)

    def residual(c: Array) -> Array:
        v = retraction.manifold.projection(x, vec.combine(source, c))
        return vec.components(target, vec.subtract(_moved(retraction, x, v), y))

    return residual


@eqx.filter_jit
def _moved(retraction: Retraction, x: Ambient, v: Ambient) -> Ambient:
    """``R(x, v)``, traced once for all that Newton's method makes of it."""
    return retraction(x, v)


def nan_unless(valid: Bool[Array, ""], v: Ambient) -> Ambient:
    """``v`` where ``valid``, NaN elsewhere."""
    return jax.tree.map(lambda leaf: jnp.where(valid, leaf, jnp.nan), v)


class MidpointRetraction(Retraction):
    """A retraction with known midpoints: a base class.

    Notes
    -----
    The midpoint of :math:`x_0` and :math:`x_1` is the ``m`` with :math:`R(m, -w) = x_0` and :math:`R(m, w) = x_1` for
    one ``w``.

    Examples
    --------
    >>> isinstance(Cayley(SO(3)), MidpointRetraction)
    True
    """

    @abstractmethod
    def midpoint(self, x0: Ambient, x1: Ambient) -> Ambient:
        """The midpoint of two points.

        Parameters
        ----------
        x0, x1 : point
            The points.
        """
