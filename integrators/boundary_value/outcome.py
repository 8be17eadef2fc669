"""How an iteration ended, in words."""

from dataclasses import replace

import numpy as np

from ...manifolds.numerics import ambient as vec
from ..kinks import kinks_near
from ..problem import OptimalControlProblem
from ..results import sentence
from .engine.found import Found
from .solution import Solution

NEAR = 0.1  # relative: the cost of what lacks more, or violates inequalities by more, tells nothing of a minimum


def explained(problem: OptimalControlProblem, solution: Solution) -> Solution:
    """The solution, where it has no success with what in a function may be why."""
    if solution.success or solution.result == sentence("stopped"):
        return solution
    q, u = vec.taken((solution.stage_states, solution.controls), 0)
    reason = problem.imprecise(q, u) or kinks_near(problem, solution)
    return (
        replace(solution, result=f"The conditions are not met, and this may be why: {reason}.") if reason else solution
    )


def compiled_longer(solution: Solution, seconds: float) -> Solution:
    """The solution with so many more seconds to trace and compile; the same one if there are none."""
    if not seconds:
        return solution
    spent = solution.statistics
    return replace(solution, statistics=replace(spent, compile_seconds=spent.compile_seconds + seconds))


def outcomes(found: Found, tolerance: float) -> tuple[np.ndarray, list[str]]:
    """Which of the finished iterations have success, and the results of all of them in words."""
    largest = found.residuals.largest
    finite = np.isfinite(largest) & np.isfinite(found.assembled.cost)
    success = found.claimed & finite
    if success.all():
        return success, [sentence("successful")] * len(success)
    meets = np.max(np.abs(found.missing), axis=1) <= tolerance
    apart = (found.residuals.stationarity <= tolerance) & meets & (found.residuals.gap > np.sqrt(tolerance))
    residuals = found.residuals
    trespass = np.maximum(residuals.gap, np.maximum(residuals.violation, residuals.excess))
    undetermined = (largest <= tolerance) & (not found.stopped)
    ways = {
        "not_finite": ~finite,
        "successful": found.claimed,
        "infeasible": found.contradictory,
        "wrong_point": apart,
        "falling": found.falling & (trespass <= NEAR) & (not found.stopped),
        "singular": (~found.solvable & ~meets) | undetermined,
        "stopped": np.full(len(largest), found.stopped),
        "too_many_iterations": found.limited,
    }
    first = np.select(list(ways.values()), range(len(ways)), len(ways))
    names = [*ways, "no_improvement"]
    return success, [sentence(names[k]) for k in first]
