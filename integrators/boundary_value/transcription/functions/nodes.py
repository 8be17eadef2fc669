"""The functions of the nodes of a problem: frames, costs of the ends, and frames of controls."""

from functools import cached_property, partial
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .....compute.base import Arrays, Evaluator, PointwiseFunction
from .....compute.binding.problem_functions import FunctionName
from .....manifolds import Euclidean
from .....manifolds.numerics import ambient as vec
from .....retractions import default_retraction
from ....problem.optimal_control_problem import OptimalControlProblem
from ....problem.point_layout import PointLayout, parameter_layout
from ....stages.explicit_runge_kutta import RK4, ExplicitRungeKutta

BESIDE = 1e-3  # of the chord, sideways: an opposite point has a direction then
MIDDLE_ROUNDS = 4  # of the walk to a middle, each of which leaves a small share of the distance


@final
class NodeFunctions:
    """The functions of the nodes of a problem, and the explicit Runge-Kutta method that rolls a guess out.

    ``functions``: the functions that the core takes, by their names.
    """

    def __init__(self, problem: OptimalControlProblem, parameters: Any, evaluator: Evaluator) -> None:
        self.problem, self.layout, self.control = (
            problem,
            PointLayout.of(problem.manifold),
            PointLayout.of(problem.controls),
        )
        self.parameter, self.dimension = parameter_layout(parameters), problem.manifold.dimension
        self.flat_controls, e = isinstance(problem.controls, Euclidean), self.layout.size
        self.functions: dict[FunctionName, PointwiseFunction] = {
            FunctionName.FRAMES: evaluator.values(self._in_frame_of, e, self.dimension, e, e),
            FunctionName.MIDDLE: evaluator.values(self._middle_of, e, e),
        }
        costs = (
            (FunctionName.START_COST, "_start_cost", problem._starts_with_cost),
            (FunctionName.END_COST, "final_cost", problem.terminal_cost is not None),
        )
        for name, of_bound, costs_something in costs:
            if costs_something:
                own = partial(self._cost_of, of_bound)
                self.functions[name] = evaluator.values(own, e, self.parameter.size)
        if not self.flat_controls:
            self.functions[FunctionName.CONTROL_FRAMES] = evaluator.values(self._control_frame_of, self.control.size)

    def in_frames(self, nodes: np.ndarray, fixed: np.ndarray, gaps: np.ndarray, covectors: np.ndarray) -> Arrays:
        """Frames of the tangent spaces, (B, N + 1, n, E), gaps and covectors in the frames, and the covectors again.

        ``fixed``: 1 for the coordinates that count, else 0, shape (B, N + 1, n).
        """
        return self.functions[FunctionName.FRAMES].at(2, nodes, fixed, gaps, covectors)

    def control_frames(self, controls: np.ndarray) -> np.ndarray | None:
        """Frames at controls of shape (B, N, s, U), shape (B, N, s, m, U), unless the space of controls is flat."""
        frames = self.functions.get(FunctionName.CONTROL_FRAMES)
        return None if frames is None else frames.at(3, controls)[0]

    @cached_property
    def roll_out(self) -> ExplicitRungeKutta:
        """The method that rolls a guess out, traced at its first use."""
        return ExplicitRungeKutta(self.problem, default_retraction(self.problem.manifold), RK4, self.parameter)

    def _middle_of(self, a: Array, b: Array) -> tuple[Array]:
        """The point of the manifold next to the middle of the chord, by a few steps along its tangential part.

        The first step goes a little sideways, because the chord to an opposite point has no tangential part.
        """
        x, y, retraction = self.layout.point(a), self.layout.point(b), default_retraction(self.problem.manifold)
        project = self.problem.manifold.projection
        draw = np.random.default_rng(0).standard_normal
        off = jax.tree.map(lambda leaf: jnp.asarray(draw(leaf.shape).astype(leaf.dtype)), self.problem.manifold.ambient)

        def out(chord: Array, part: Array, off: Array) -> Array:
            length = jnp.linalg.norm(chord)
            part = part + BESIDE * length * off
            size = jnp.linalg.norm(part)
            return jnp.where(size > 0, length / 2 / jnp.where(size > 0, size, 1.0), 0.0) * part

        chord = vec.subtract(y, x)
        m = retraction(x, jax.tree.map(out, chord, project(x, chord), project(x, off)))
        for _ in range(MIDDLE_ROUNDS):
            m = retraction(m, project(m, vec.subtract(vec.scale(0.5, vec.add(x, y)), m)))
        return (self.layout.flat(m),)

    def _in_frame_of(self, q: Array, fixed: Array, gap: Array, covector: Array) -> tuple[Array, ...]:
        frame = self.layout.flat_frame(self.problem.manifold.basis(self.layout.point(q)))
        coordinates = fixed * (frame @ covector)
        return frame, fixed * (frame @ gap), coordinates, coordinates @ frame

    def _control_frame_of(self, u: Array) -> tuple[Array]:
        return (self.control.flat_frame(self.problem.controls.basis(self.control.point(u))),)

    def _cost_of(self, name: str, q: Array, parameters: Array) -> tuple[Array, ...]:
        """The cost of an end with its derivative, and both derivatives in the frame there."""
        cost = getattr(self.problem.with_parameters(self.parameter.point(parameters)), name)
        point, layout = self.layout.point(q), self.layout
        frame = self.problem.manifold.basis(point)
        derivative = vec.gradient(cost, point)
        push = jax.vmap(lambda e: jax.jvp(lambda x: vec.gradient(cost, x), (point,), (e,))[1])(frame)
        curvature = jax.vmap(lambda image: vec.components(frame, image))(push)
        return cost(point), layout.flat(derivative), vec.components(frame, derivative), curvature
