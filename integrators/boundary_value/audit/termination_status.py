"""Success or failure at the end of an iteration, and the reason in words."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from ....compute.at_points import evaluate_at_each
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.user_functions import imprecise
from ...problem_checks.smoothness.kinks import find_kinks
from ...reporting.results import sentence
from ..solution.record import Solution
from ..transcription.discrete_extremals import DiscreteExtremals

NEARLY_SOLVED = (
    0.1  # relative: the cost of what lacks more, or violates inequalities by more, tells nothing of a minimum
)


def explain_failure(problem: OptimalControlProblem, solution: Solution) -> Solution:
    """The solution, with a possible reason in a function if there is no success."""
    if solution.success or solution.statistics.stopped or solution.result.startswith(sentence("concave")):
        return solution
    q, u = vec.taken((solution.stage_states, solution.controls), 0)
    if solution.result.startswith(sentence("not_finite")):
        where = _not_finite(problem, solution)
        return replace(solution, result=f"{solution.result} {where}") if where else solution
    functions = {"dynamics": problem.dynamics, "running_cost": problem.running_cost}
    reason = imprecise(functions, q, u) or find_kinks(problem, solution)
    return (
        replace(solution, result=f"The conditions are not met, and this may be why: {reason}.") if reason else solution
    )


def _not_finite(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on the function that is not finite, or has no finite derivative, at the first stage where there is one."""
    parts = {"dynamics": problem.velocity, "running_cost": problem.cost_rate}

    def at_stage(point: tuple[Ambient, Ambient]) -> Any:
        return [(f(*point), *(jax.jacrev(f, k)(*point) for k in (0, 1))) for f in parts.values()]

    points = solution.stage_states, solution.controls
    with np.errstate(all="ignore"):
        found = evaluate_at_each(at_stage, points)
    for k in range(len(solution.stage_times)):
        (q, u), own = vec.taken((points, found), k)
        for name, parts_of in zip(parts, own, strict=True):
            lost = [not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(part)) for part in parts_of]
            if any(lost):
                by = "states" if lost[1] else "controls"
                what = "is not finite" if lost[0] else f"has no finite derivative by the {by}"
                return (
                    f"{name} {what} at q = {q}, u = {u}; try a function that is smooth there, as sqrt(x @ x + 1e-6) in "
                    "place of a norm."
                )
    return ""


def add_compile_time(solution: Solution, seconds: float) -> Solution:
    """The solution with so many more seconds to trace and compile; the same one if there are none."""
    if not seconds:
        return solution
    spent = solution.statistics
    return replace(solution, statistics=replace(spent, compile_seconds=spent.compile_seconds + seconds))


def termination_statuses(found: DiscreteExtremals, tolerance: float) -> tuple[np.ndarray, list[str]]:
    """Whether each finished iteration has success, and the results of all in words."""
    largest = found.residuals.largest
    finite = np.isfinite(largest) & np.isfinite(found.cost)
    success = found.claimed & finite
    if (success & found.strict_minimum).all():
        return success, [sentence("successful")] * len(success)
    meets = np.max(np.abs(found.missing), axis=1) <= tolerance
    apart = (found.residuals.stationarity <= tolerance) & meets & (found.residuals.defect > np.sqrt(tolerance))
    residuals = found.residuals
    trespass = np.maximum(residuals.defect, np.maximum(residuals.violation, residuals.excess))
    undetermined = (largest <= tolerance) & (not found.stopped)
    ways = {
        "not_finite": ~finite,
        "stationary": found.claimed & ~found.strict_minimum,
        "successful": found.claimed,
        "infeasible": found.infeasible,
        "wrong_point": apart,
        "falling": found.falling & (trespass <= NEARLY_SOLVED) & (not found.stopped),
        "singular": (~found.solvable & ~meets) | undetermined,
        "stopped": np.full(len(largest), found.stopped),
        "too_many_iterations": found.limited,
    }
    first = np.select(list(ways.values()), range(len(ways)), len(ways))
    names = [*ways, "no_improvement"]
    return success, [sentence(names[k]) for k in first]
