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

    Solves ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` for the unknowns ``y`` and ``p1`` in a chart around the stage's prediction,
    where both are coordinates in one frame; then ``q1 = R2``. Differentiable by the implicit function theorem.
    """
    frozen = jax.lax.stop_gradient
    guess = frozen(stage.predict(q0, p0, previous))
    frame = stage.manifold.basis(stage.tangent(guess)[0])
    size = stage.dimension

    def generating(d: Array, p1: Ambient) -> tuple[Array, Ambient]:
        y = stage.move(guess, d)
        r1, r2 = stage.ends(y)
        return vec.pairing(p1, r2) - vec.pairing(p0, r1) - stage.cost(y), r1

    def residual(c: Array) -> Array:
        stationarity, r1 = jax.grad(generating, has_aux=True)(c[:size], vec.combine(frame, c[size:]))
        return jnp.concatenate([vec.components(frame, vec.subtract(r1, q0)), stationarity])

    costate = frozen(vec.components(frame, p0))
    first = jnp.concatenate([jnp.zeros(size, costate.dtype), costate])
    scale = jnp.concatenate([stage.sizes(guess), jnp.broadcast_to(positive(vec.size(p0)), costate.shape)])
    c, converged = find_root(residual, first, scale, stage.small_step_inverse())
    y = stage.move(guess, c[:size])
    q1 = stage.ends(y)[1]
    p1 = stage.manifold.projection(q1, vec.combine(frame, c[size:]))
    finite = jnp.isfinite(vec.size((q1, p1)))
    return StepResult(q1, p1, y, converged & finite)
