"""The functions of one step of a discrete optimal control problem, in the coordinates of the ambient space."""

from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..integrators import ControlStage, Guess, OptimalControlProblem
from ..integrators.problem.path_constraints import entry_words
from ..integrators.problem.point_layout import PointLayout
from ..manifolds.numerics import ambient as vec
from ..retractions import CollocationMethod, DiscretizationMap
from ..tape import Tape
from .equations import equations


class Part(NamedTuple):
    """A part of the unknowns of a step."""

    name: str
    shape: tuple[int, ...]


@final
class Transcription:
    """The functions of one step and of a node, in flat ambient coordinates.

    Unknowns of a step: its centre ``x`` and the controls ``u_i``, points of the ambient spaces with the equations
    ``c(x) = 0`` of the manifolds. For a Gauss method with several points also its velocities ``v_i``, ambient vectors
    with ``Dc(x) v_i = 0``, and slacks ``s_i`` in ``D R_x(xi_i)[v_i] = X(q_i, u_i) + Dc(q_i)' s_i``: the equation holds
    in the tangent space, whose codimension the slacks have. So do ends meet: ``begin - end = Dc(m)' s`` with ``m`` in
    the middle. For a manifold whose equations are quadratic this and ``c(begin) = c(end)`` give ``s = 0`` unless ``m``
    is zero: exactly opposite ends meet too, by slacks without bound, and an optimum with large slacks is none.
    """

    def __init__(self, problem: OptimalControlProblem, method: DiscretizationMap | CollocationMethod) -> None:
        self.problem, self.method, self.manifold, self.controls = problem, method, problem.manifold, problem.controls
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self.stages = method.stages
        self.slack = self.state.size - self.manifold.dimension
        s, several = self.stages, self.stages > 1
        self.parts = [
            Part("centre", (self.state.size,)),
            Part("controls", (s, self.control.size)),
            *([Part("velocities", (s, self.state.size)), Part("slacks", (s, self.slack))] if several else []),
        ]
        self.size = sum(int(np.prod(part.shape)) for part in self.parts)

    def split(self, y: Any) -> dict[str, Any]:
        """The parts of the unknowns of steps, along the last axis."""
        found, begin = {}, 0
        for part in self.parts:
            end = begin + int(np.prod(part.shape))
            found[part.name] = y[..., begin:end].reshape(*y.shape[:-1], *part.shape)
            begin = end
        return found

    def join(self, parts: dict[str, np.ndarray]) -> np.ndarray:
        """The unknowns of steps from arrays with the steps along the first axis."""
        return np.concatenate([parts[part.name].reshape(len(parts["centre"]), -1) for part in self.parts], axis=1)

    def begin(self, guess: Guess, count: int) -> np.ndarray:
        """The unknowns of steps with states and controls of a guess at their stages, and with the velocities of the
        dynamics."""
        states = self.state.rows(guess.states, 1).reshape(count, self.stages, -1)
        controls = self.control.rows(guess.controls, 1).reshape(count, self.stages, -1)
        if self.stages == 1:
            return self.join({"centre": states[:, 0], "controls": controls})
        centres, velocities = Tape.trace(self._begin, jnp.asarray(states[0]), jnp.asarray(controls[0]))(
            np.moveaxis(states, 0, -1), np.moveaxis(controls, 0, -1)
        )
        slacks = np.zeros((count, self.stages, self.slack))
        centres, velocities = np.moveaxis(centres, -1, 0), np.moveaxis(velocities, -1, 0)
        return self.join({"centre": centres, "controls": controls, "velocities": velocities, "slacks": slacks})

    def _begin(self, states: Array, controls: Array) -> tuple[Array, Array]:
        """The centre amid some states, and the velocities there."""
        half = self.stages // 2
        x, points = self.state.point(states[half]), [self.state.point(q) for q in states]
        if self.stages % 2 == 0:
            y = points[half - 1]
            x = self.method.retraction(y, self.manifold.projection(y, vec.scale(0.5, vec.subtract(x, y))))
        moving = zip(points, controls, strict=True)
        velocities = [self.manifold.projection(x, self.problem.velocity(q, self.control.point(u))) for q, u in moving]
        return self.state.flat(x), jnp.stack([self.state.flat(v) for v in velocities])

    def step(self, y: Array, h: Array) -> tuple[Array, ...]:
        """Beginning, end and cost of a step, equations between its unknowns, and inequalities at its points."""
        parts = self.split(y)
        x, controls = self.state.point(parts["centre"]), [self.control.point(u) for u in parts["controls"]]
        held = [equations(self.manifold, x), *(equations(self.controls, u) for u in controls)]
        if self.stages == 1:
            method = self.method.discretization_map
            stage = ControlStage(self.problem, method, h[0])
            begin, end = stage.ends((x, controls[0]))
            points = [x]
        else:
            points, (begin, end), inner = self._collocate(x, parts, controls, h[0])
            held += inner
        weights = self.method.weights
        rates = [self.problem.cost_rate(q, u) for q, u in zip(points, controls, strict=True)]
        cost = h[0] * sum(b * rate for b, rate in zip(weights, rates, strict=True))
        limits = [self.problem.inequalities(q, u) for q, u in zip(points, controls, strict=True)] if self.limits else []
        ends = self.state.flat(begin), self.state.flat(end), jnp.reshape(cost, (1,))
        stages = jnp.concatenate([self.state.flat(q) for q in points])
        return *ends, jnp.concatenate(held), jnp.concatenate([jnp.zeros(0), *limits]), stages

    @property
    def limits(self) -> int:
        """Number of inequalities of the problem."""
        return len(getattr(self.problem, "_inequality_names", ()))

    @property
    def node_limits(self) -> int:
        """Number of inequalities of the problem at a node."""
        return len(entry_words(getattr(self.problem, "_node_sizes", {})))

    def at_node(self, node: Array) -> tuple[Array]:
        """The inequalities at a node."""
        return (self.problem.node_inequalities(self.state.point(node)),)

    def meeting(self, after: Array, before: Array, slack: Array) -> tuple[Array]:
        """The residual of the condition that two ends meet, shape ``(E,)``."""
        return (after - before - self._normal((after + before) / 2, slack),)

    def last(self, node: Array) -> tuple[Array, Array]:
        """Terminal cost at the last node, and its ambient derivative."""
        value, slope = jax.value_and_grad(lambda q: self.problem.final_cost(self.state.point(q)))(node)
        return jnp.reshape(value, (1,)), slope

    def _normal(self, q: Array, slack: Array) -> Array:
        """The normal vector ``Dc(q)' s``."""
        if not self.slack:
            return jnp.zeros_like(q)
        return jax.grad(lambda q: equations(self.manifold, self.state.point(q)) @ slack)(q)

    def _collocate(self, x: Any, parts: dict[str, Any], controls: list[Any], h: Array) -> tuple[list, tuple, list]:
        """Points, ends and equations of a Gauss method."""
        method: Any = self.method
        retraction, velocities = method.retraction, [self.state.point(v) for v in parts["velocities"]]
        points, held = [], []
        for i, (v, u, slack) in enumerate(zip(velocities, controls, parts["slacks"], strict=True)):
            held.append(jax.jvp(lambda a: equations(self.manifold, a), (x,), (v,))[1])
            xi = _sum(h * method.centred[i], velocities)
            q, velocity = jax.jvp(lambda a: retraction(x, a), (xi,), (v,))
            lacking = self.state.flat(vec.subtract(velocity, self.problem.velocity(q, u)))
            held.append(lacking - self._normal(self.state.flat(q), slack))
            points.append(q)
        half = _sum(h * method.weights / 2, velocities)
        return points, retraction.both_ways(x, half), held


def _sum(weights: Array, vectors: list[Any]) -> Any:
    total = vec.scale(weights[0], vectors[0])
    for weight, vector in zip(weights[1:], vectors[1:], strict=True):
        total = vec.add(total, vec.scale(weight, vector))
    return total
