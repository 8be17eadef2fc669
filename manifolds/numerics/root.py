"""Newton's method for small square systems, with implicit-function derivatives and a verdict on convergence."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from .chord_newton import Vector
from .implicit import implicit_root
from .levenberg import APPROACH, levenberg

NEWTON_REGION = 1e-3  # where Newton's method takes over


def solve_small(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solve a small dense system; a single equation is a division."""
    return right / matrix[0, 0] if matrix.shape[0] == 1 else jnp.linalg.solve(matrix, right)


def find_root(
    residual: Callable[[Vector], Vector],
    start: Vector,
    scale: ArrayLike = 1.0,
    inverse: np.ndarray | None = None,
) -> tuple[Vector, Bool[Array, ""]]:
    """Root of ``residual`` near ``start`` and whether the iteration converged to it.

    Newton's method that keeps its Jacobian while the steps shrink fivefold each (chord iteration) and renews it where
    they do not. ``scale`` holds the typical sizes of the unknowns, shape ``(k,)`` or one number; ``inverse``, if given,
    is an approximate inverse Jacobian to begin with. Derivatives with respect to anything that ``residual`` closes over
    come from the implicit function theorem, in every autodiff mode.
    """
    if not start.size:
        return start, jnp.array(True)
    unit = jax.lax.stop_gradient(jnp.broadcast_to(jnp.asarray(scale, start.dtype), start.shape))
    first = jax.lax.stop_gradient(start) / unit
    scaled = None if inverse is None else jnp.asarray(inverse, first.dtype) / unit[:, None]
    root, converged = implicit_root(lambda c: residual(unit * c), first, scaled)
    return unit * root, converged


def known_root(residual: Callable[[Vector], Vector], root: Vector) -> Vector:
    """``root``, a root of ``residual`` to rounding, with the derivatives of the implicit function theorem."""
    return implicit_root(residual, jax.lax.stop_gradient(root), known=True)[0]


def approach_root(residual: Callable[[Vector], Float[Array, " m"]], start: Vector) -> Vector:
    """Levenberg's steps towards a root of ``m >= k`` equations, to where Newton's method converges."""

    def step(j: Float[Array, "m k"], r: Float[Array, " m"], damping: Array) -> Vector:
        return -jnp.linalg.solve(j.T @ j + damping * jnp.eye(start.size, dtype=start.dtype), j.T @ r)

    return levenberg(residual, start, step, APPROACH, NEWTON_REGION)[0]
