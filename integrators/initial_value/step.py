"""One step of the cotangent-lifted method from a point of T*Q."""

from copy import copy
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Manifold
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


def restored(manifold: Manifold, new: StepResult) -> StepResult:
    """The end of a step moved to the manifold, from which rounding takes it."""
    q = manifold.restore(new.q)
    return new._replace(q=q, p=manifold.projection(q, new.p))


class StepEquations:
    """The equations ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` of a step from near ``(q0, p0)``, in a chart around a prediction.

    Their unknowns are the coordinates ``c`` of the stage's unknowns ``y`` and of ``p1``, both in one frame.
    """

    def __init__(self, stage: Stage, q0: Ambient, p0: Ambient, previous: Any) -> None:
        frozen = jax.lax.stop_gradient
        self.stage = stage
        self._guess = frozen(stage.predict(q0, p0, previous))
        self._chart = stage.frame(self._guess)
        self._frame = stage.manifold.basis(stage.base(self._guess))
        costate = frozen(vec.components(self._frame, p0))
        self.first = jnp.concatenate([jnp.zeros(stage.dimension, costate.dtype), costate])
        self.sizes = jnp.concatenate([stage.sizes(self._guess), jnp.broadcast_to(positive(frozen(vec.size(p0))), costate.shape)])

    def of(self, stage: Stage) -> Self:
        """The equations of another stage with the same kind of unknowns, in the same chart."""
        new = copy(self)
        new.stage = stage
        return new

    def unknowns(self, c: Array) -> Any:
        """The stage's unknowns with coordinates ``c``."""
        return self.stage.move(self._guess, self._chart, c[: self.stage.dimension])

    def residual(self, c: Array, q0: Ambient, p0: Ambient) -> Array:
        """The equations for a step from ``(q0, p0)``, zero at a solution ``c``."""
        size = self.stage.dimension

        def generating(d: Array, p1: Ambient) -> tuple[Array, Ambient]:
            y = self.stage.move(self._guess, self._chart, d)
            r1, r2 = self.stage.ends(y)
            return vec.pairing(p1, r2) - vec.pairing(p0, r1) - self.stage.cost(y), r1

        stationarity, r1 = jax.grad(generating, has_aux=True)(c[:size], vec.combine(self._frame, c[size:]))
        return jnp.concatenate([vec.components(self._frame, vec.subtract(r1, q0)), stationarity])

    def end(self, c: Array) -> tuple[Ambient, Ambient, Any]:
        """``(q1, p1)`` and the stage's unknowns."""
        y = self.unknowns(c)
        q1 = self.stage.ends(y)[1]
        return q1, self.stage.manifold.projection(q1, vec.combine(self._frame, c[self.stage.dimension :])), y


def lifted_step(stage: Stage, q0: Ambient, p0: Ambient, previous: Any) -> StepResult:
    """Step ``(q0, p0) -> (q1, p1)``: a stationary point of the stage's generating function that starts at ``q0``.

    Solves ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` for the unknowns ``y`` and ``p1``; then ``q1 = R2``. Differentiable by the
    implicit function theorem.
    """
    equations = StepEquations(stage, q0, p0, previous)
    c, converged = find_root(
        lambda c: equations.residual(c, q0, p0), equations.first, equations.sizes, stage.small_step_inverse()
    )
    q1, p1, y = equations.end(c)
    finite = jnp.isfinite(vec.size((q1, p1)))
    return StepResult(q1, p1, y, converged & finite)
