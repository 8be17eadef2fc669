"""One step of the cotangent-lifted method from a point of T*Q."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.root import find_root
from ..stages import Stage
from ..stages.stage import positive


class StepResult(NamedTuple):
    """End of a step: position, covector, the stage's unknowns, and whether the equations are solved."""

    q: Ambient
    p: Ambient
    unknowns: Any
    converged: Bool[Array, ""]


def lifted_step(stage: Stage, q0: Ambient, p0: Ambient, previous: Any) -> StepResult:
    """Step ``(q0, p0) -> (q1, p1)``: a stationary point of the stage's generating function that starts at ``q0``.

    Solves ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` for the unknowns ``y`` and ``p1`` by Newton's method in a chart around
    the stage's prediction, where both are coordinates; then ``q1 = R2``. Differentiable by the implicit function theorem.
    """
    frozen = jax.lax.stop_gradient
    guess = frozen(stage.predict(q0, p0, previous))
    start, end = stage.manifold.basis(frozen(q0)), stage.manifold.basis(stage.ends(guess)[1])
    n, size = stage.manifold.dimension, stage.dimension

    def generating(d: Array, p1: Ambient) -> Array:
        y = stage.move(guess, d)
        r1, r2 = stage.ends(y)
        return vec.pairing(p1, r2) - vec.pairing(p0, r1) - stage.cost(y)

    def residual(c: Array) -> Array:
        stationarity = jax.grad(generating)(c[:size], vec.combine(end, c[size:]))
        r1, _ = stage.ends(stage.move(guess, c[:size]))
        return jnp.concatenate([vec.components(start, vec.subtract(r1, q0)), stationarity])

    costate = frozen(vec.components(end, p0))
    first = jnp.concatenate([jnp.zeros(size, costate.dtype), costate])
    covector_size = positive(jnp.maximum(vec.size(p0), jnp.max(jnp.abs(residual(first)[n:]))))
    scale = jnp.concatenate([stage.sizes(guess), jnp.broadcast_to(covector_size, (n,))])
    c, converged = find_root(residual, first, scale)
    y = stage.move(guess, c[:size])
    q1 = stage.ends(y)[1]
    p1 = stage.manifold.projection(q1, vec.combine(end, c[size:]))
    finite = jnp.isfinite(vec.size((q1, p1)))
    return StepResult(q1, p1, y, converged & finite)
