"""Explicit Runge-Kutta methods in the charts of a retraction: where given controls lead."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Float

from ...compute.automatic import AutomaticEvaluator
from ...compute.base import Evaluator
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import Addition, CollocationMethod, DiscretizationMap, ProductRetraction, Retraction
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout


@final
class ExplicitTableau(NamedTuple):
    """The tableau of an explicit Runge-Kutta method of ``s`` stages.

    Attributes
    ----------
    matrix : array of shape (s, s)
        Strictly lower triangular.
    weights, nodes : array of shape (s,)
        Weights of the slopes, and times of the stages as fractions of the step.
    """

    matrix: np.ndarray
    weights: np.ndarray
    nodes: np.ndarray


RK4 = ExplicitTableau(np.diag([0.5, 0.5, 1.0], -1), np.array([1.0, 2.0, 2.0, 1.0]) / 6, np.array([0.0, 0.5, 0.5, 1.0]))


@cache
def dop853() -> ExplicitTableau:
    """The method of order 8 by Dormand and Prince [Hairer, Norsett, Wanner 1993]; SciPy's integrators take long to
    import."""
    from scipy.integrate import DOP853

    stages = DOP853.n_stages
    return ExplicitTableau(DOP853.A[:stages, :stages], DOP853.B[:stages], DOP853.C[:stages])


@final
class ExplicitRungeKutta:
    """The steps of an explicit Runge-Kutta method along trajectories of a problem with given controls.

    The state moves in the retraction chart around a point ``x``, where its coordinates obey ``c' = (D R)^+ X(R(c),
    u(t))``. Points are flat; the problem has parameters of the given layout, if it takes any.
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        retraction: Retraction,
        tableau: ExplicitTableau,
        parameter: PointLayout | None = None,
        evaluator: Evaluator | None = None,
    ) -> None:
        self.problem, self.retraction, self.tableau = problem, retraction, tableau
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self.parameter, given = parameter, 0 if parameter is None else parameter.size
        n, m = problem.manifold.dimension, problem.controls.dimension
        values = (evaluator or AutomaticEvaluator()).values
        self._chart = values(self._chart_of, self.state.size, n)
        self._rate = values(self._rate_of, self.state.size, n, self.control.size, m, 1, given)

    def step(
        self,
        x: np.ndarray,
        c: np.ndarray,
        times: np.ndarray,
        steps: np.ndarray,
        control: Callable[[float], tuple[np.ndarray, np.ndarray]],
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The coordinates, shape ``(K, n)``, at the ends of K steps from coordinates ``c`` in the charts around ``x``.

        ``times``, ``steps``: where they begin, and their lengths, shape ``(K, 1)``; ``control``: points of the control
        manifold and coordinates in the charts around these, at a fraction of each step.
        """
        matrix, weights, nodes = self.tableau
        slopes = np.empty((len(nodes), c.size))
        for i, node in enumerate(nodes):
            stage = c + steps * (matrix[i, :i] @ slopes[:i]).reshape(c.shape)
            slopes[i] = self._rate(x, stage, *control(node), times + steps * node, parameters)[0].ravel()
        return c + steps * (weights @ slopes).reshape(c.shape)

    def points(self, x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """The points with coordinates ``c`` in the charts around ``x``."""
        return self._chart(x, c)[0]

    def states(
        self, start: np.ndarray, controls: np.ndarray, spans: tuple[np.ndarray, np.ndarray], parameters: Any = ()
    ) -> np.ndarray:
        """States, shape ``(K, E)``, between the two spans of K constant controls; the time begins at zero."""
        q, found, begun, given = start[None], [], 0.0, np.array(parameters, float)[None]
        rest, turn = (np.zeros((1, of.dimension)) for of in (self.problem.manifold, self.problem.controls))
        with np.errstate(all="ignore"):  # what is not finite is judged by the caller
            for u, *lengths in zip(controls, *spans, strict=True):
                held = u[None], turn
                for place, length in enumerate(lengths):
                    c = self.step(q, rest, np.array([[begun]]), np.array([[length]]), lambda _, held=held: held, given)
                    q, begun = self.points(q, c), begun + length
                    if place == 0:
                        found.append(q[0])
        return np.stack(found)

    def _chart_of(self, x: Array, c: Array) -> tuple[Array]:
        point = self.state.point(x)
        return (self.state.flat(self.retraction.chart(point, self.retraction.frame(point), c)),)

    def _rate_of(self, x: Array, c: Array, base: Array, offset: Array, time: Array, parameters: Array) -> tuple[Array]:
        layout = self.parameter
        bound = self.problem if layout is None else self.problem.with_parameters(layout.point(parameters))
        u, point = self.problem._steer(self.control.point(base), offset), self.state.point(x)
        q = self.retraction.chart(point, self.retraction.frame(point), c)
        return (chart_rate(self.retraction, point, c, bound.at_time(time[0]).velocity(q, u)),)


def chart_rate(retraction: Retraction, x: Ambient, c: Array, v: Ambient) -> Float[Array, " n"]:
    """The derivative ``(D R)^+ v`` of the coordinates ``c``, in the chart around ``x``, of a point that moves with
    velocity ``v``."""
    if isinstance(retraction, ProductRetraction):
        places = np.cumsum([factor.manifold.dimension for factor in retraction.factors])[:-1]
        parts = zip(retraction.factors, x, jnp.split(c, places), v, strict=True)
        return jnp.concatenate([chart_rate(*part) for part in parts])
    if isinstance(retraction, Addition):
        return jnp.ravel(v)
    _, push = jax.linearize(lambda c: retraction.chart(x, retraction.frame(x), c), c)
    columns = jax.vmap(push)(jnp.eye(c.size, dtype=c.dtype))
    matrix = vec.flatten_frame(columns)
    return cho_solve((jnp.linalg.cholesky(matrix @ matrix.T), True), vec.components(columns, v))


def control_spans(method: DiscretizationMap | CollocationMethod, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The times for which the control of each stage is held before the stage and after it.

    It is held for the share of the step that the stage has as a weight of quadrature.
    """
    _, places = mesh_times(steps, method.nodes)
    ended = np.cumsum((steps[:, None] * method.weights).ravel())
    return places - np.concatenate([[0.0], ended[:-1]]), ended - places


def mesh_times(steps: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The times of the nodes, and of the stages at some places in each step.

    ``steps``: lengths of the steps along the last axis.
    """
    nodes = np.zeros((*steps.shape[:-1], steps.shape[-1] + 1))
    steps.cumsum(axis=-1, out=nodes[..., 1:])
    return nodes, (nodes[..., :-1, None] + steps[..., None] * places).reshape(*steps.shape[:-1], -1)
