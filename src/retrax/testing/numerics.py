"""Numerics that facts are measured with: compiled kernels, flat real coordinates, differences."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..manifolds import Manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.compiler import Option, known_options
from ..manifolds.numerics.differences import FEWEST_ERRORS, central_difference, central_nodes
from ..manifolds.numerics.precision import working_precision

Vector = Float[Array, " N"]

# The kernels run a few times each: compiling them takes longer than running them, so the compiler is asked for less.
_WISHES: dict[str, Option] = {
    "xla_backend_optimization_level": "0",
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` compiled quickly, with numpy arrays as its values: in double precision, for what is made of them."""
    fast = jax.jit(function, compiler_options=known_options(_WISHES))
    return lambda *arguments: jax.tree.map(_widen, fast(*arguments))


def _widen(a: Any) -> np.ndarray:
    found = np.asarray(a)
    return found.astype(np.result_type(found, np.float64)) if np.issubdtype(found.dtype, np.inexact) else found


def flat(a: Ambient) -> Vector:
    """The entries of an ambient vector, or of several, as one real vector: each array's real, then imaginary parts."""
    return vec.flatten_frame(jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], a))[0]


def unflat(manifold: Manifold) -> Callable[[Vector], Ambient]:
    """The map from real vectors to ambient vectors of a manifold, inverse to ``flat``."""
    leaves, structure = jax.tree.flatten(manifold.ambient)

    def back(w: Vector) -> Ambient:
        parts, start = [], 0
        for leaf in leaves:
            stop = start + leaf.size
            part = w[start:stop]
            if jnp.issubdtype(leaf.dtype, jnp.complexfloating):
                part, stop = part + 1j * w[stop : stop + leaf.size], stop + leaf.size
            parts.append(jnp.asarray(part, leaf.dtype).reshape(leaf.shape))
            start = stop
        return jax.tree.unflatten(structure, parts)

    return back


def violation_kernel(manifold: Manifold) -> Callable[[np.ndarray], np.ndarray]:
    """The largest violation of a manifold's equations at a flat point, 0 where there are none, and the largest absolute
    value."""
    back = unflat(manifold)

    def violation(y: Vector) -> jax.Array:
        values = jnp.stack([jnp.zeros(()), *map(jnp.asarray, manifold.violations(back(y)).values())])
        return jnp.stack([jnp.max(values), jnp.max(jnp.abs(values))])

    return compiled(violation)


def ambient_size(manifold: Manifold) -> int:
    """Real dimension of the ambient space."""
    return jax.eval_shape(flat, vec.zeros(manifold.ambient)).size


def largest(a: Any) -> float:
    """Largest absolute entry of an ambient vector; NaN if any entry is."""
    return float(max(np.max(np.abs(leaf), initial=0.0) for leaf in jax.tree.leaves(a)))


CENTRAL_NODES = central_nodes(3)  # of differences of orders 6 and 4
STEP_SCALES = 4.0 ** -np.arange(4)  # of a step: the longest at which both orders agree is read


def along(function: Callable[[jax.Array], jax.Array], step: Any) -> jax.Array:
    """Values of a function of a number at ``step CENTRAL_NODES``, and at shorter steps, ``(steps, nodes, ...)``."""
    times = step * jnp.asarray(STEP_SCALES[:, None] * CENTRAL_NODES, working_precision())
    values = jax.vmap(function)(times.reshape(-1))
    return values.reshape(times.shape + values.shape[1:])


def differences(values: np.ndarray, h: float) -> np.ndarray:
    """Derivative at 0, to order ``h^6``, of a function with these ``values`` at ``h CENTRAL_NODES``."""
    return central_difference(values, h, 6)


def coarse_differences(values: np.ndarray, h: float) -> np.ndarray:
    """Derivative at 0 to order ``h^4``; its distance from ``differences`` bounds the error of the latter."""
    return central_difference(values, h, 4)


def is_hidden(errors: np.ndarray, floor: float) -> bool:
    """Whether some errors are above the rounding ``floor``, but too few for a slope."""
    return bool(0 < np.sum(errors > floor) < FEWEST_ERRORS)
