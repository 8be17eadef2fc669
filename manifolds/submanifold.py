"""Submanifolds of a manifold from equations on it."""

from collections.abc import Callable
from typing import Any, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .level_set import GAUSS_NEWTON_STEPS, point_from_random_starts
from .manifold import Manifold
from .numerics import ambient as vec
from .numerics.ambient import Ambient, Frame
from .numerics.errors import InvalidInputError, shapes_of
from .numerics.frames import null_frame
from .numerics.root import solve_small
from .numerics.tolerances import HALF, tolerance


@final
class Submanifold(Manifold):
    r"""The submanifold :math:`\{x \in M : c(x) = 0\}` of a manifold ``M``, in the ambient space of ``M``.

    Parameters
    ----------
    parent : Manifold
        The manifold ``M``.
    equations : callable
        ``c(x)``, a smooth function of points of ``M`` with values of shape ``(m,)``. Its differentials along ``M`` must
        have rank ``m`` on the set.
    piece : callable, optional
        As many equations that hold on one piece alone, if the set has several pieces.

    Examples
    --------
    >>> print(Submanifold(Euclidean(2), lambda x: x[1:]).dimension)
    1
    """

    parent: Manifold
    equations: Callable[[Any], Any]
    piece: Callable[[Any], Any] | None = None

    def __check_init__(self) -> None:
        values = shapes_of(self.equations, "the function of a submanifold's equations", self.parent.ambient)
        if getattr(values, "ndim", None) != 1:
            raise InvalidInputError(
                f"the equations of a submanifold return a vector, one entry an equation, got {values}; "
                "try x[2:] instead of x[2], or jnp.stack([...])"
            )

    @property
    def dimension(self) -> int:
        return self.parent.dimension - jax.eval_shape(self.equations, self.parent.ambient).size

    def __str__(self) -> str:
        count = self.parent.dimension - self.dimension
        return f"Submanifold({self.parent}, {count} equation{'s' * (count > 1)})"

    @property
    def ambient(self) -> Any:
        return self.parent.ambient

    def normals(self, x: Ambient) -> Frame:
        """The gradients of the ``m`` equations along ``M``: leaves of shape ``(m, *leaf)``.

        Parameters
        ----------
        x : point
            A point.
        """
        gradients = jax.jacrev(self.equations)(x)
        return jax.vmap(lambda gradient: self.parent.projection(x, gradient))(gradients)

    def values(self, x: Ambient) -> tuple[Float[Array, " m"], Frame]:
        """The values of the equations, shape ``(m,)``, and their gradients along ``M``.

        Parameters
        ----------
        x : point
            A point.
        """
        return self.equations(x), self.normals(x)

    def projection(self, x: Ambient, a: Ambient) -> Ambient:
        normals, along = self.normals(x), self.parent.projection(x, a)
        return vec.subtract(along, _combination(normals, vec.components(normals, along)))

    def basis(self, x: Ambient) -> Frame:
        frame = self.parent.basis(x)
        rows = jax.vmap(lambda normal: vec.components(frame, normal))(self.normals(x))
        return vec.combine_each(frame, null_frame(rows))

    def restore(self, x: Ambient) -> Ambient:
        near = self.parent.restore(x)
        values, normals = self.values(near)
        return vec.subtract(near, _combination(normals, values))

    def nearby(self, x: Ambient) -> Ambient:
        """A point of the submanifold near ``x``, by Newton steps along the normals.

        Parameters
        ----------
        x : ambient vector
            A point near the submanifold; ``InvalidInputError`` for another structure.

        Notes
        -----
        If Newton's method does not converge, the last iterate is returned: check it with ``contains``.
        """
        wrong = self.describe_mismatch(x, "a point beside it")
        if wrong:
            raise InvalidInputError(wrong)
        if self.piece is not None:
            y = Submanifold(self.parent, self.piece).nearby(x)
            moved = self.restore(y)
            # Rounding is taken away, and what the equations depend on enters; where another piece crosses, neither can.
            near = vec.size(vec.subtract(moved, y)) <= tolerance(vec.size(y), HALF) * (1 + vec.size(y))
            return jax.tree.map(lambda a, b: jnp.where(near, b, a), y, moved)

        def step(state: tuple[Ambient, Array], _: None) -> tuple[tuple[Ambient, Array], None]:
            return jax.lax.cond(state[1], moved, lambda y: (y, jnp.array(False)), state[0]), None

        def moved(y: Ambient) -> tuple[Ambient, Array]:
            z = self.restore(y)
            return z, vec.size(vec.subtract(z, y)) > tolerance(vec.size(z), 0.95) * (1 + vec.size(z))

        # Of fixed length, to be differentiated in reverse as well.
        return jax.lax.scan(step, (x, jnp.array(True)), length=GAUSS_NEWTON_STEPS)[0][0]

    def violations(self, x: Ambient) -> dict[str, Array]:
        values, normals = self.values(x) if self.piece is None else Submanifold(self.parent, self.piece).values(x)
        lengths = jnp.sqrt(jax.vmap(lambda normal: vec.pairing(normal, normal))(normals))
        off = values / jnp.where(lengths > 0, lengths, 1.0)
        return {
            **self.parent.violations(x),
            "max |equation / its gradient|": vec.size(off) / jnp.maximum(vec.size(x), 1.0),
        }

    def length(self, x: Ambient, a: Ambient) -> Array:
        return self.parent.length(x, a)

    def random_point(self, key: Array) -> Ambient:
        """A random point of ``M`` moved to the submanifold; an error if 20 draws find none."""
        return point_from_random_starts(self, key, lambda k: self.nearby(self.parent.random_point(k)))


def _combination(normals: Frame, coefficients: Float[Array, " m"]) -> Ambient:
    """The vector in the span of the normals with these pairings with them."""
    gram = jax.vmap(lambda normal: vec.components(normals, normal))(normals)
    return vec.combine(normals, solve_small(gram, coefficients))
