"""States to which controls lead, for guesses."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from jaxtyping import Array

from ....manifolds.numerics import ambient as vec
from ....retractions import Retraction
from ...evaluator import Automatic
from ...layout import Layout
from ...problem import OptimalControlProblem


@final
class RollOut:
    """The classical Runge-Kutta method in the chart of a retraction around the beginning of each step, the control
    constant."""

    def __init__(self, problem: OptimalControlProblem, retraction: Retraction) -> None:
        self.problem, self.retraction, self.manifold = problem, retraction, problem.manifold
        self.state, self.control = Layout.of(problem.manifold), Layout.of(problem.controls)
        self._step = Automatic().values(self._step_of, self.state.size, self.control.size, 2)

    def states(self, start: np.ndarray, controls: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Flat states, shape ``(K, E)``, where the times ``before`` of K constant controls have passed, each lasting
        ``before + after``; the time begins at zero.
        """
        q, found, begun = start[None], [], 0.0
        with np.errstate(all="ignore"):  # what is not finite is judged by the caller
            for u, *times in zip(controls, before, after, strict=True):
                for place, time in enumerate(times):
                    (q,) = self._step(q, u[None], np.array([[begun, time]]))
                    begun += time
                    if place == 0:
                        found.append(q[0])
        return np.stack(found)

    def _step_of(self, x: Array, u: Array, times: Array) -> tuple[Array]:
        begun, h = times
        point, control = self.state.point(x), self.control.point(u)
        frame = self.manifold.basis(point)

        def rate(c: Array, time: Array) -> Array:
            q, push = jax.linearize(lambda c: self.retraction(point, vec.combine(frame, c)), c)
            columns = self.state.flat_frame(jax.vmap(push)(jnp.eye(c.size)))
            velocity = self.state.flat(self.problem.at_time(time).velocity(q, control))
            return cho_solve((jnp.linalg.cholesky(columns @ columns.T), True), columns @ velocity)

        total, slope = jnp.zeros(self.manifold.dimension), jnp.zeros(self.manifold.dimension)
        for weight, share in ((1, 0.0), (2, 0.5), (2, 0.5), (1, 1.0)):
            slope = rate(share * h * slope, begun + share * h)
            total = total + weight * slope
        return (self.state.flat(self.retraction(point, vec.combine(frame, h / 6 * total))),)
