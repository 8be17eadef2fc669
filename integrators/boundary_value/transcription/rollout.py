"""States to which controls lead, for guesses."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....manifolds.numerics import ambient as vec
from ....retractions import Gauss, Retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout


@final
class RollOut:
    """The classical Runge-Kutta method in the chart of a retraction around the beginning of each step, the control
    constant; the problem has parameters of this layout, if it takes any."""

    def __init__(
        self, problem: OptimalControlProblem, retraction: Retraction, parameter: PointLayout | None = None
    ) -> None:
        self.problem, self.retraction, self.manifold = problem, retraction, problem.manifold
        self.state, self.control, self.parameter = (
            PointLayout.of(problem.manifold),
            PointLayout.of(problem.controls),
            parameter,
        )
        given = 0 if parameter is None else parameter.size
        self._step = AutomaticEvaluator().values(self._step_of, self.state.size, self.control.size, 2, given)

    def states(
        self, start: np.ndarray, controls: np.ndarray, spans: tuple[np.ndarray, np.ndarray], parameters: Any = ()
    ) -> np.ndarray:
        """Flat states, shape ``(K, E)``, between the two spans of K constant controls; the time begins at zero."""
        q, found, begun, given = start[None], [], 0.0, np.array(parameters, float)[None]
        with np.errstate(all="ignore"):  # what is not finite is judged by the caller
            for u, *times in zip(controls, *spans, strict=True):
                for place, time in enumerate(times):
                    (q,) = self._step(q, u[None], np.array([[begun, time]]), given)
                    begun += time
                    if place == 0:
                        found.append(q[0])
        return np.stack(found)

    def _step_of(self, x: Array, u: Array, times: Array, given: Array) -> tuple[Array]:
        begun, h = times
        problem = self.problem if self.parameter is None else self.problem.with_parameters(self.parameter.point(given))
        point, control = self.state.point(x), self.control.point(u)
        frame = self.manifold.basis(point)

        def rate(c: Array, time: Array) -> Array:
            q, push = jax.linearize(lambda c: self.retraction(point, vec.combine(frame, c)), c)
            columns = self.state.flat_frame(jax.vmap(push)(jnp.eye(c.size)))
            velocity = self.state.flat(problem.at_time(time).velocity(q, control))
            return cho_solve((jnp.linalg.cholesky(columns @ columns.T), True), columns @ velocity)

        total, slope = jnp.zeros(self.manifold.dimension), jnp.zeros(self.manifold.dimension)
        for weight, share in ((1, 0.0), (2, 0.5), (2, 0.5), (1, 1.0)):
            slope = rate(share * h * slope, begun + share * h)
            total = total + weight * slope
        return (self.state.flat(self.retraction(point, vec.combine(frame, h / 6 * total))),)


def spans(method: Any, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The times for which the control of each stage is held before the stage and after it.

    It is held for the share of the step that the stage has as a weight of quadrature.
    """
    inside, weights = (method.nodes, method.weights) if isinstance(method, Gauss) else ([float(method.theta)], [1.0])
    begun = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    places = (begun[:, None] + np.array(inside) * steps[:, None]).ravel()
    ended = np.cumsum((steps[:, None] * np.array(weights)).ravel())
    return places - np.concatenate([[0.0], ended[:-1]]), ended - places


def rolled_out(conditions: Any, guess: Any) -> tuple[Any, np.ndarray]:
    """The guesses with the states to which their controls lead from their starts; and where these are finite."""
    if conditions.joint:
        each = [rolled_out(*of) for of in zip(conditions.phases, guess.parts, strict=True)]
        parts, finite = zip(*each, strict=True)
        return guess._replace(parts=parts), np.all(finite, axis=0)
    transcription, data, controls = conditions.transcription, conditions.data, guess.unknowns.controls
    starts, roll_out = conditions.reached(guess)[0], conditions.at_nodes.roll_out
    states = np.empty((*controls.shape[:3], starts.shape[1]))
    for k, start in enumerate(starts):
        held = spans(transcription.method, data.steps[k])
        rows = controls[k].reshape(len(held[0]), -1)
        states[k] = roll_out.states(start, rows, held, data.parameters[k]).reshape(states.shape[1:])
    costates = np.zeros_like(guess.costates)
    finite = np.all(np.isfinite(states), axis=(1, 2, 3))
    with np.errstate(all="ignore"):
        unknowns = transcription.begin(states, controls, costates, data)
    return guess._replace(unknowns=unknowns, costates=costates, slacks=None), finite
