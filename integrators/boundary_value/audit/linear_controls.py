"""The entries of the control in which the Hamiltonian is linear along a solution: second derivatives vanish there."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds import Euclidean
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ..solution.record import Solution


@final
class ControlCurvature:
    """Second derivatives of the Hamiltonian of a problem by the controls, traced once."""

    def __init__(self, problem: OptimalControlProblem, parameters: Any) -> None:
        self.problem, self.state, self.control = (
            problem,
            PointLayout.of(problem.manifold),
            PointLayout.of(problem.controls),
        )
        self.parameter = parameter_layout(parameters)
        sizes = self.state.size, self.state.size, self.control.size, 1, self.parameter.size
        self._curvatures: PointwiseFunction = AutomaticEvaluator().values(self._curvatures_of, *sizes)

    def __call__(self, solution: Solution, parameters: Any) -> np.ndarray:
        """The sums of the sizes of the derivatives at the stages, shape ``(N s, m)``.

        The sums are 0 where the Hamiltonian is linear in an entry, and not finite on a curved space.
        """
        if not isinstance(self.problem.controls, Euclidean):
            return np.full((len(solution.stage_times), self.control.size), np.inf)
        layouts = (
            (self.state, solution.stage_states),
            (self.state, solution.stage_costates),
            (self.control, solution.controls),
        )
        given = self.parameter.rows(parameters, 0)
        rows = (layout.rows(points, 1) for layout, points in layouts)
        return self._curvatures(*rows, solution.stage_times[:, None], given[None])[0]

    def _curvatures_of(self, q: Array, p: Array, u: Array, time: Array, parameters: Array) -> tuple[Array]:
        bound = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])

        def hamiltonian(u: Array) -> Array:
            return bound.hamiltonian(self.state.point(q), self.state.point(p), self.control.point(u))

        return (jnp.sum(jnp.abs(jax.hessian(hamiltonian)(u)), axis=1),)
