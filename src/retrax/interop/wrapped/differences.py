"""Functions that run on the host, with derivatives of every order by differences along curves.

A function of another library cannot be traced. Its derivative is taken here from its values on curves that stay on the
manifold, so that it is never asked for a value elsewhere: along ``s -> curve(x, s d)`` for each vector ``d`` of a
basis, by the central difference of order 8. It is compared with that of order 6, and at the points where the two differ
the step is shortened. From steps of 1e-2 the first differs from the second by about 1e-14 of the seventh derivative;
rounding of the function's values is magnified by the inverse of the step for each order of the derivative.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds.numerics.differences import central_difference, central_nodes

# Steps of difference quotients: the first length in the coordinates, the ratio of the next one, and how many.
FIRST_STEP_LENGTH, STEP_RATIO, SHORTENINGS = 1e-2, 0.25, 6
# Relative difference at which a first derivative is not made better; for each order more, LOSS times as much.
GOOD_DIFFERENCE = 1e-11
LOSS = 1e2
LIMIT = 1e-7  # relative difference above which a derivative of any order is taken for unknown
HOST_NODES = central_nodes(4)

Host = Callable[[np.ndarray], np.ndarray]
Moved = Callable[[np.ndarray, float], np.ndarray]


def host_function(values: Host, moved: Moved, shape: tuple[int, ...], order: int = 0) -> Callable[[Array], Array]:
    """A JAX function from one on the host.

    ``values`` takes points in a batch, shape ``(batch, k)``, to values ``(batch, *shape)``; it is a derivative of this
    ``order``. ``moved`` takes the same points and a step to points around them, shape ``(batch, k, 8, k)``: the nodes
    of the difference along each of the ``k`` coordinates. Derivatives of every order, in every mode; their entries are
    NaN at points where no step gives them.
    """

    @jax.custom_jvp
    def call(x: Array) -> Array:
        out = jax.ShapeDtypeStruct(shape, x.dtype)
        return jax.pure_callback(_on_batches(values, shape), out, x, vmap_method="broadcast_all")

    @call.defjvp
    def jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        (x,), (dx,) = primals, tangents
        slope = host_function(slopes(values, moved, shape, order), moved, (*shape, x.size), order + 1)
        return call(x), jnp.tensordot(slope(x), dx, 1)

    return call


def slopes(values: Host, moved: Moved, shape: tuple[int, ...], order: int = 0) -> Host:
    """The derivative along each coordinate, shape ``(batch, *shape, k)``, of a function that is a derivative of
    ``order``."""
    enough = min(GOOD_DIFFERENCE * LOSS**order, LIMIT)

    def slopes(x: np.ndarray) -> np.ndarray:
        best, error = np.full((len(x), *shape, x.shape[1]), np.nan), np.full(len(x), np.inf)
        step = FIRST_STEP_LENGTH
        for _ in range(SHORTENINGS):
            (left,) = np.nonzero(error > enough)
            if not left.size:
                break
            tried, missed = _difference(values, moved, shape, x[left], step)
            better = missed < error[left]
            best[left[better]], error[left[better]] = tried[better], missed[better]
            step *= STEP_RATIO
        best[error > LIMIT] = np.nan
        return best

    return slopes


def _difference(
    values: Host, moved: Moved, shape: tuple[int, ...], x: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """The derivative of order 8, and its distance to the derivative of order 6, relative to at least 1."""
    batch, k = x.shape
    with np.errstate(all="ignore"):  # a long step may end where the library's functions overflow
        around = values(moved(x, step).reshape(-1, k)).reshape(batch, k, len(HOST_NODES), *shape)
        fine, coarse = (np.moveaxis(central_difference(around, step, order, 2), 1, -1) for order in (8, 6))
        axes = tuple(range(1, fine.ndim))
        missed = np.max(np.abs(fine - coarse), axes) / np.maximum(1.0, np.max(np.abs(fine), axes))
    return fine, np.where(np.isfinite(missed), missed, np.inf)


def _on_batches(values: Host, shape: tuple[int, ...]) -> Callable[[Array], np.ndarray]:
    def call(x: Array) -> np.ndarray:
        points = np.asarray(x, np.float64)
        flat = values(points.reshape(-1, points.shape[-1]))
        return np.asarray(flat, np.asarray(x).dtype).reshape((*points.shape[:-1], *shape))

    return call
