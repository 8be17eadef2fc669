"""How an iteration ended, in words."""

from dataclasses import replace

import jax
import numpy as np

from ..kinks import kinks_near
from ..problem import OptimalControlProblem
from ..results import Result
from .engine.newton import Found
from .solution import Solution


def explained(problem: OptimalControlProblem, solution: Solution) -> Solution:
    """The solution, where it has no success with what in a function may be why."""
    if solution.success or solution.result == Result[Result.stopped]:
        return solution
    q, u = (jax.tree.map(lambda leaf: leaf[0], part) for part in (solution.stage_states, solution.controls))
    reason = problem.imprecise(q, u) or kinks_near(problem, solution)
    return replace(solution, result=f"The conditions are not met, and this may be why: {reason}.") if reason else solution


def outcomes(found: Found, tolerance: float, max_iterations: int) -> list[Result]:
    """The result codes of finished iterations."""
    largest, results = found.residuals.largest, []
    meets = np.max(np.abs(found.missing), axis=1) <= tolerance
    for k in range(len(largest)):
        undetermined = largest[k] <= tolerance and not found.claimed[k] and not found.stopped
        if not (np.isfinite(largest[k]) and np.isfinite(found.assembled.cost[k])):
            result = Result.not_finite
        elif found.claimed[k]:
            result = Result.successful
        elif found.residuals.stationarity[k] <= tolerance and meets[k] and found.residuals.gap[k] > np.sqrt(tolerance):
            result = Result.wrong_point
        elif (not found.solvable[k] and not meets[k]) or undetermined:
            result = Result.singular
        elif found.stopped:
            result = Result.stopped
        elif found.iterations[k] >= max_iterations:
            result = Result.too_many_iterations
        else:
            result = Result.no_improvement
        results.append(result)
    return results
