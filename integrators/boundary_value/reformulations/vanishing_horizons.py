"""Horizons that tend to zero: trajectories whose cost does not depend on how fast they are run."""

from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds import Euclidean
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ..solution.record import Solution

FLAT_COST = 40.0  # times the tolerance: a share of the cost that hides what it depends on the speed by
CLOSE_ENDS = 1e-2  # relative: ends of steps that are farther apart than that are no trajectory


@final
class VanishingHorizon:
    """Tells whether the horizon of a solution of a problem tends to zero; traced once.

    At twice its speed a path costs ``int F(q, 2 u) / 2 dt``, where ``X(q, 2 u) = 2 X(q, u)``. Where that is the same,
    the conditions do not determine the horizon.
    """

    def __init__(self, problem: OptimalControlProblem, parameters: Any) -> None:
        self.problem, self.state, self.control = (
            problem,
            PointLayout.of(problem.manifold),
            PointLayout.of(problem.controls),
        )
        self.parameter = parameter_layout(parameters)
        sizes = self.state.size, self.control.size, 1, self.parameter.size
        self._at_speeds: PointwiseFunction = AutomaticEvaluator().values(self._at_speeds_of, *sizes)

    def __call__(self, solution: Solution, tolerance: float) -> bool:
        """Whether the horizon tends to zero; never if an inequality holds the trajectory, and perhaps its speed."""
        held = any(getattr(solution.checks, "active", {}).values())
        if held or not isinstance(self.problem.controls, Euclidean) or not solution.checks.defect <= CLOSE_ENDS:
            return False
        layouts = (self.state, solution.stage_states), (self.control, solution.controls)
        rows = *(layout.rows(points, 1) for layout, points in layouts), solution.stage_times[:, None]
        given = self.parameter.rows(solution.parameters, 0)[None]
        once, twice = np.moveaxis(self._at_speeds(*rows, given)[0], 1, 0)
        same = np.abs(twice - 2 * once) <= FLAT_COST * tolerance * np.max(np.abs(once), axis=0)
        return bool(np.all(same) and np.any(once[:, 1:]))

    def _at_speeds_of(self, q: Array, u: Array, time: Array, parameters: Array) -> tuple[Array]:
        """The cost rate and the velocity, at the speed as it is and at twice that."""
        bound = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])
        point, rows = self.state.point(q), []
        for speed in (1.0, 2.0):
            control = self.control.point(speed * u)
            velocity = self.state.flat(bound.velocity(point, control))
            rows.append(jnp.concatenate([jnp.reshape(bound.cost_rate(point, control), 1), velocity]))
        return (jnp.stack(rows),)
