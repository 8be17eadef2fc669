"""Reasons in the functions of a problem for a solution without success."""

from typing import Any

import jax
import numpy as np

from ....compute.at_points import evaluate_at_each
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.user_functions import imprecise
from ...problem_checks.smoothness.kinks import find_kinks
from ..solution.record import Solution


def find_reason(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on a function that is imprecise or has a kink where the iteration ended; empty if there is none."""
    q, u = vec.taken((solution.stage_states, solution.controls), 0)
    functions = {"dynamics": problem.dynamics, "running_cost": problem.running_cost}
    return imprecise(functions, q, u) or find_kinks(problem, solution)


def find_undefined(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on the function that is not finite, or has no finite derivative, at the first stage where there is one."""
    parts = {"dynamics": problem.velocity, "running_cost": problem.cost_rate}

    def at_stage(point: tuple[Ambient, Ambient]) -> Any:
        return [(f(*point), *(jax.jacrev(f, k)(*point) for k in (0, 1))) for f in parts.values()]

    points = solution.stage_states, solution.controls
    with np.errstate(all="ignore"):
        at_stages = evaluate_at_each(at_stage, points)
    for k in range(len(solution.stage_times)):
        (q, u), functions = vec.taken((points, at_stages), k)
        for name, parts_of in zip(parts, functions, strict=True):
            lost = [not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(part)) for part in parts_of]
            if any(lost):
                by = "states" if lost[1] else "controls"
                what = "is not finite" if lost[0] else f"has no finite derivative by the {by}"
                return (
                    f"{name} {what} at q = {q}, u = {u}; try a function that is smooth there, as sqrt(x @ x + 1e-6) in "
                    "place of a norm."
                )
    return ""
