"""The records of what an iteration found."""

from collections.abc import Iterator
from typing import Any, final

import jax
import numpy as np

from ..problem import OptimalControlProblem
from ..results import Result
from .arguments import Options, require_tangent_dynamics
from .engine.layout import Layout
from .engine.newton import Found
from .engine.transcription import Data
from .interpolation import Interpolant
from .outcome import outcomes
from .posed import Traced
from .solution import Checks, Solution, Statistics


@final
class Recording:
    """Makes the records of extremals of a problem, with the stages of a step at some places, fractions of it."""

    def __init__(self, problem: OptimalControlProblem, stages: np.ndarray, interpolant: Interpolant) -> None:
        self.problem, self.stages, self.interpolant = problem, stages, interpolant
        self.state, self.control = Layout.of(problem.manifold), Layout.of(problem.controls)

    def records(
        self, traced: Traced, data: Data, found: Found, options: Options, seconds: tuple[float, float]
    ) -> Iterator[Solution]:
        """The records of all members; ``seconds`` to trace and to run."""
        nodes, costates = found.assembled.nodes, found.assembled.costates
        costates = traced.nodes.projected(nodes, costates)
        stages = traced.steps.at_stages(found.iterate.unknowns, costates, data)
        diagnostics = traced.diagnosis((nodes, costates), stages, data.parameters)
        results = outcomes(found, options.tolerance, options.max_iterations)
        multipliers = _multipliers(traced.example, found)
        for k, result in enumerate(results):
            own: Any = jax.tree.map(lambda leaf, k=k: leaf[k], diagnostics)
            require_tangent_dynamics(self.problem, float(own.normal))
            times = np.concatenate([[0.0], np.cumsum(data.steps[k])])
            gap, stationarity = float(found.residuals.gap[k]), float(found.residuals.stationarity[k])
            yield Solution(
                times=times,
                states=self.state.points(nodes[k]),
                costates=self.state.points(costates[k]),
                stage_times=(times[:-1, None] + data.steps[k][:, None] * self.stages).ravel(),
                stage_states=self.state.points(stages[0][k]),
                stage_costates=self.state.points(stages[2][k]),
                controls=self.control.points(stages[1][k]),
                hamiltonians=own.hamiltonians,
                momenta=own.momenta,
                body_costates=own.body,
                spatial_costates=own.spatial,
                cost=float(found.assembled.cost[k]),
                success=bool(result == Result.successful),
                result=Result[result],
                checks=Checks.of(own, gap, stationarity, bool(found.strict_minimum[k])),
                statistics=Statistics(int(found.iterations[k]), *seconds),
                interpolant=self.interpolant,
                multipliers={name: rows[k] for name, rows in multipliers.items()},
            )


def _multipliers(problem: OptimalControlProblem, found: Found) -> dict[str, np.ndarray]:
    """Multipliers of the inequalities at the stages, by their names."""
    slacks = found.iterate.slacks
    if slacks is None:
        return {}
    rows = slacks.multipliers
    return problem.by_constraint(rows.reshape(len(rows), -1, rows.shape[3]))
