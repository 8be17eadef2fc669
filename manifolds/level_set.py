"""A manifold from one constraint function."""

from abc import abstractmethod
from collections.abc import Callable
from inspect import get_annotations, signature
from math import prod
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..index_bounds import require_indices
from ..tracing import in_one_tracing, trace_program
from .manifold import Manifold
from .numerics import ambient as vec
from .numerics.ambient import Ambient, is_traced
from .numerics.errors import InvalidInputError, shapes_of
from .numerics.frames import null_frame
from .numerics.precision import default_tolerance, real
from .numerics.root import solve_small
from .numerics.sizes import as_shape
from .verdict import Verdict

RANDOM_STARTS = 20  # random points from which a point of the level set is searched
GAUSS_NEWTON_STEPS = 30  # steps from each of them
MOST_NAMED = 6  # most equations that are named
LOST_RANK = "rank lost by the constraint's Jacobian"


def _dependent(rows: Float[Array, "m N"]) -> Bool[Array, " m"]:
    """Whether each of some unit rows is a combination of the rows before it."""
    return jnp.abs(jnp.diagonal(jnp.linalg.qr(rows.T, mode="r"))) <= default_tolerance()


def positive_norms(rows: Float[Array, "m N"]) -> Float[Array, " m"]:
    """Lengths of the rows, as units without derivatives; one where a row is zero."""
    lengths = jnp.linalg.norm(jax.lax.stop_gradient(rows), axis=1)
    return jnp.where(lengths > 0, lengths, 1.0)


class LevelSet(Manifold):
    r"""A regular level set :math:`\{x : c(x) = 0\}` of a smooth function of arrays: a base class.

    Parameters
    ----------
    shape : int or tuple of int
        The shape of points, given by name; a class attribute ``shape = (3,)`` fixes it for all manifolds of the class.

    Notes
    -----
    Subclass it with ``constraint``. Automatic differentiation gives the tangent spaces, projections, random points and
    checks. The equations must be independent: there is no manifold where the Jacobian of ``c`` loses rank.

    Examples
    --------
    >>> class Circle(LevelSet):
    ...     shape = (2,)
    ...
    ...     def constraint(self, x):
    ...         return x @ x - 1.0
    >>> Circle().dimension
    1
    """

    if TYPE_CHECKING:  # given as a number or a tuple, or by the class, and read as a tuple: checkers know no such field
        shape: Any = eqx.field(static=True, default=(), kw_only=True)
    else:
        shape: tuple[int, ...] = eqx.field(static=True, converter=as_shape)

    def __init_subclass__(cls, **options: Any) -> None:
        """A shape that the class has for all of its manifolds need not be given to them."""
        super().__init_subclass__(**options)
        own = get_annotations(cls)
        if "shape" in vars(cls) and "shape" not in own:
            cls.shape = eqx.field(static=True, converter=as_shape, default=vars(cls)["shape"], kw_only=True)
            cls.__annotations__ = {**own, "shape": tuple[int, ...]}

    def __check_init__(self) -> None:
        what, size = f"the constraint of {type(self).__name__}", prod(self.shape)
        try:
            signature(self.constraint).bind(self.ambient)
        except TypeError as error:
            raise InvalidInputError(
                f"{what} must be a method of one array, def constraint(self, x), got one with the arguments "
                f"{signature(type(self).constraint)}"
            ) from error
        values = shapes_of(self.constraint, what, self.ambient)
        require_indices(trace_program(self.constraint, self.ambient), what)
        if not hasattr(values, "size"):
            raise InvalidInputError(f"{what} returns an array, got {values}; try jnp.stack([...])")
        if not jnp.issubdtype(values.dtype, jnp.floating):
            raise InvalidInputError(
                f"{what} returns real numbers that are zero on the manifold, got {values.dtype}; try x @ x - 1 in "
                "place of x @ x == 1"
            )
        if not 0 < values.size <= size:
            raise InvalidInputError(
                f"{what} has {values.size} equations for points of {size} numbers; expected at least one and at most "
                "as many as numbers"
            )

    @abstractmethod
    def constraint(self, x: Array) -> Array:
        """The constraint ``c(x)``, a number or an array of any shape: zero on the manifold, smooth around it.

        Parameters
        ----------
        x : array
            A point near the manifold.
        """

    def equations(self, x: Array) -> Float[Array, " m"]:
        """The constraint as a vector of ``m`` equations.

        Parameters
        ----------
        x : array
            A point near the manifold.
        """
        return jnp.ravel(self.constraint(x))

    def jacobian(self, x: Array) -> Float[Array, "m N"]:
        """The Jacobian of the equations in the entries of ``x``, shape ``(m, N)``.

        Parameters
        ----------
        x : array
            A point near the manifold.
        """
        return in_one_tracing(LevelSet._jacobian, self)(x)

    def _jacobian(self, x: Array) -> Float[Array, "m N"]:
        return jax.jacrev(self.equations)(x).reshape(-1, prod(self.shape))

    @property
    def dimension(self) -> int:
        m = jax.eval_shape(self.equations, self.ambient).size
        return prod(self.shape) - m

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real(self.shape)

    def in_lengths(self, x: Array) -> tuple[Float[Array, " m"], Float[Array, "m N"]]:
        """The equations and their Jacobian, each divided by the length of its gradient: distances to first order.

        Parameters
        ----------
        x : array
            A point near the manifold.
        """
        j = self.jacobian(x)
        lengths = positive_norms(j)
        return self.equations(x) / lengths, j / lengths[:, None]

    def projection(self, x: Array, a: Array) -> Array:
        _, j = self.in_lengths(x)
        return a - (j.T @ solve_small(j @ j.T, j @ a.reshape(-1))).reshape(self.shape)

    def basis(self, x: Array) -> Array:
        return null_frame(self.in_lengths(x)[1]).reshape(-1, *self.shape)

    def restore(self, x: Array) -> Array:
        values, j = self.in_lengths(x)
        return x - (j.T @ solve_small(j @ j.T, values)).reshape(self.shape)

    def violations(self, x: Array) -> dict[str, Array]:
        values, j = self.in_lengths(x)
        off = vec.size(values) / jnp.maximum(vec.size(x), 1.0)
        return {"max |constraint / its gradient|": off, LOST_RANK: jnp.sum(_dependent(j))}

    def contains(self, x: Ambient, tolerance: float | None = None) -> Verdict:
        verdict = super().contains(x, tolerance)
        return Verdict(False, verdict.reason + self._dependence(x)) if LOST_RANK in verdict.reason else verdict

    def _dependence(self, x: Ambient) -> str:
        """Words on the equations that depend on earlier equations at ``x``, empty for independent equations."""
        dependent = np.asarray(_dependent(self.in_lengths(jnp.asarray(x))[1]))
        found = np.flatnonzero(dependent)
        named = ", ".join(map(str, found[:MOST_NAMED])) + (", ..." if len(found) > MOST_NAMED else "")
        rows = f"; of its values, counted from 0 row by row, {named} follow from those before, or have no gradient"
        return rows if found.size and dependent.size > 1 else ""

    def _hint(self, words: str, value: float) -> str:
        lost = "its equations must be independent: leave out one that follows from others, and take c instead of c**2"
        return f"; {lost}" if words == LOST_RANK else super()._hint(words, value)

    def random_point(self, key: Array) -> Array:
        """A random ambient point moved to the level set by least squares; an error if 20 draws find none."""

        def draw(key: Array) -> Array:
            start = jax.random.normal(key, self.shape)
            return jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, lambda _, x: self.restore(x), start)

        return point_from_random_starts(self, key, draw, self._dependence)


def point_from_random_starts(
    manifold: Manifold, key: Array, draw: Callable[[Array], Ambient], why: Callable[[Ambient], str] = lambda _: ""
) -> Ambient:
    """The first of 20 draws that satisfies the manifold's equations; an error if none does.

    Outside of ``jit`` it ends with the words of ``why`` on a random ambient point.
    """

    def off(x: Ambient) -> Array:
        return ~(vec.size(manifold.violations(x)) <= default_tolerance())

    def again(state: tuple[Array, Ambient, Array, Array]) -> tuple[Array, Ambient, Array, Array]:
        key, sub = jax.random.split(state[0])
        x = draw(sub)
        return key, x, state[2] + 1, off(x)

    def unfinished(state: tuple[Array, Ambient, Array, Array]) -> Array:
        return (state[2] < RANDOM_STARTS) & state[3]

    nowhere = jax.tree.map(lambda leaf: jnp.full(leaf.shape, jnp.nan, leaf.dtype), manifold.ambient)
    begin = key, nowhere, jnp.zeros((), int), jnp.array(True)
    _, found, _, missed = jax.lax.while_loop(unfinished, again, begin)
    message = f"no point of {manifold} was found from {RANDOM_STARTS} random starts; check its equations"
    if not is_traced(found):
        if missed:
            raise InvalidInputError(message + why(vec.normal(key, manifold.ambient)))
        return found
    return eqx.error_if(found, missed, message)
