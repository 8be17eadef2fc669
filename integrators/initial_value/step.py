"""One step of the cotangent-lifted method from a point of T*Q."""

from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, Frame
from ...manifolds.numerics.root import find_root
from ...manifolds.numerics.tolerances import HALF, tolerance
from ..stages import Stage


class StepResult(NamedTuple):
    """End of a step: position, covector, the stage's unknowns, and whether the equations are solved."""

    q: Ambient
    p: Ambient
    unknowns: Any
    converged: Bool[Array, ""]


def restore(manifold: Manifold, new: StepResult) -> StepResult:
    """The end of a step moved to the manifold, from which rounding takes it."""
    q = manifold.restore(new.q)
    return new._replace(q=q, p=manifold.projection(q, new.p))


class Chart(NamedTuple):
    """The chart of the equations of a step: a prediction of the unknowns and frames there, from ``(q0, p0)``."""

    guess: Any
    frame: Any  # of the stage's unknowns
    covectors: Frame  # of ``p1``
    first: Array  # coordinates of the prediction
    sizes: Array  # typical sizes of the coordinates


class StepEquations:
    """The equations ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` of a step from near ``(q0, p0)``, in a chart around a
    prediction.

    Their unknowns are the coordinates ``c`` of the stage's unknowns ``y`` and of ``p1``, both in one frame.
    """

    def __init__(self, stage: Stage, chart: Chart) -> None:
        self.stage, self.chart = stage, chart

    @classmethod
    def near(cls, stage: Stage, q0: Ambient, p0: Ambient, previous: Any) -> Self:
        """The equations around the unknowns that the stage predicts."""
        frozen = jax.lax.stop_gradient
        guess = frozen(stage.predict(q0, p0, previous))
        frame = stage.manifold.basis(stage.base(guess))
        costate = frozen(vec.components(frame, p0))
        first = jnp.concatenate([jnp.zeros(stage.dimension, costate.dtype), costate])
        sizes = frozen(stage.sizes(guess, p0))
        return cls(stage, Chart(guess, stage.frame(guess), frame, first, sizes))

    @property
    def first(self) -> Array:
        """Coordinates of the prediction."""
        return self.chart.first

    @property
    def sizes(self) -> Array:
        """Typical sizes of the coordinates."""
        return self.chart.sizes

    def unknowns(self, c: Array) -> Any:
        """The stage's unknowns with coordinates ``c``."""
        return self.stage.move(self.chart.guess, self.chart.frame, c[: self.stage.dimension])

    def residual(self, c: Array, q0: Ambient, p0: Ambient) -> Array:
        """The equations for a step from ``(q0, p0)``, zero at a solution ``c``."""
        size = self.stage.dimension

        def generating(d: Array, p1: Ambient) -> tuple[Array, Ambient]:
            y = self.stage.move(self.chart.guess, self.chart.frame, d)
            r1, r2 = self.stage.ends(y)
            return vec.pairing(p1, r2) - vec.pairing(p0, r1) - self.stage.cost(y), r1

        stationarity, r1 = jax.grad(generating, has_aux=True)(c[:size], vec.combine(self.chart.covectors, c[size:]))
        return jnp.concatenate([vec.components(self.chart.covectors, vec.subtract(r1, q0)), stationarity])

    def result(self, c: Array, q0: Ambient) -> StepResult:
        """The end of the step whose unknowns have the coordinates ``c``, converged where it is finite and begins at
        ``q0``."""
        q1, p1, y = self.end(c)
        return StepResult(q1, p1, y, jnp.isfinite(vec.size((q1, p1))) & self.begins(c, q0))

    def begins(self, c: Array, q0: Ambient) -> Bool[Array, ""]:
        """Whether the step begins at ``q0``: two points may have the same coordinates in the frame of the equations."""
        frame, x = self.chart.covectors, self.stage.base(self.chart.guess)
        apart = vec.subtract(self.stage.ends(self.unknowns(c))[0], q0)
        unseen = vec.subtract(apart, vec.combine(frame, vec.components(frame, apart)))

        def small(rest: Array, begun: Array, base: Array) -> Array:
            size = jnp.maximum(vec.size(begun), vec.size(base))
            return vec.size(rest) <= tolerance(size, HALF) * size

        return jnp.all(jnp.stack(jax.tree.leaves(jax.tree.map(small, unseen, q0, x))))

    def end(self, c: Array) -> tuple[Ambient, Ambient, Any]:
        """``(q1, p1)`` and the stage's unknowns."""
        y = self.unknowns(c)
        q1 = self.stage.ends(y)[1]
        return q1, self.stage.manifold.projection(q1, vec.combine(self.chart.covectors, c[self.stage.dimension :])), y


def lifted_step(stage: Stage, q0: Ambient, p0: Ambient, previous: Any) -> StepResult:
    """Step ``(q0, p0) -> (q1, p1)``: a stationary point of the stage's generating function that starts at ``q0``.

    Solves ``R1 = q0`` and ``d_y S(y; p0, p1) = 0`` for the unknowns ``y`` and ``p1``; then ``q1 = R2``. Differentiable
    by the implicit function theorem.
    """
    equations = StepEquations.near(stage, q0, p0, previous)
    c, converged = find_root(
        lambda c: equations.residual(c, q0, p0), equations.first, equations.sizes, stage.small_step_inverse()
    )
    result = equations.result(c, q0)
    return result._replace(converged=result.converged & converged)
