"""Functions that run on the host, with derivatives of every order by differences along curves.

A function of another library cannot be traced. Its derivative is taken here from its values on curves that stay on the
manifold, so that it is never asked for a value elsewhere: along ``s -> curve(x, s d)`` for each vector ``d`` of a basis, by the
central difference of order 6. With steps of 1e-2 its error is about 1e-12 of the seventh derivative, and rounding of the
function's values is magnified by 1e2 for each order of the derivative.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

STEP = 1e-2
NODES = STEP * np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0 / STEP

Host = Callable[[np.ndarray], np.ndarray]


def host_function(values: Host, moved: Host, shape: tuple[int, ...]) -> Callable[[Array], Array]:
    """A JAX function from one on the host.

    ``values`` takes points in a batch, shape ``(batch, k)``, to values ``(batch, *shape)``. ``moved`` takes the same points
    to points around them, shape ``(batch, k, 6, k)``: the six nodes of the difference along each of the ``k`` coordinates.
    Derivatives of every order, in every mode.
    """

    @jax.custom_jvp
    def call(x: Array) -> Array:
        out = jax.ShapeDtypeStruct(shape, x.dtype)
        return jax.pure_callback(_on_batches(values, shape), out, x, vmap_method="broadcast_all")

    @call.defjvp
    def jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
        (x,), (dx,) = primals, tangents
        slope = host_function(slopes(values, moved, shape), moved, (*shape, x.size))
        return call(x), jnp.tensordot(slope(x), dx, 1)

    return call


def slopes(values: Host, moved: Host, shape: tuple[int, ...]) -> Host:
    """The derivative along each coordinate, shape ``(batch, *shape, k)``."""

    def slopes(x: np.ndarray) -> np.ndarray:
        batch, k = x.shape
        around = values(moved(x).reshape(-1, k)).reshape(batch, k, len(NODES), *shape)
        return np.moveaxis(np.tensordot(around, WEIGHTS, ((2,), (0,))), 1, -1)

    return slopes


def _on_batches(values: Host, shape: tuple[int, ...]) -> Callable[[Array], np.ndarray]:
    def call(x: Array) -> np.ndarray:
        points = np.asarray(x, np.float64)
        flat = values(points.reshape(-1, points.shape[-1]))
        return np.asarray(flat, np.asarray(x).dtype).reshape((*points.shape[:-1], *shape))

    return call
