"""Reasons in the functions of a problem for a solution without success."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ....compute.at_points import evaluate_at_each
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.user_functions import imprecise
from ...problem_checks.smoothness.kinks import find_kinks
from ...reporting.text import in_line
from ..solution.factor_distances import factor_distances, long_turn_words
from ..solution.record import Solution

UNDEFINED = "is not finite", "has no finite derivative by the states", "has no finite derivative by the controls"
SMOOTH = (
    "a function that is smooth there, for example sqrt(x @ x + 1e-6) instead of norm(x), and for a limit x @ x - a**2 "
    "instead of norm(x) - a"
)
SHORT_MOVE = 1e-6  # of the fastest entry: along so short a move a distance is its length, to half of the digits


def find_reason(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on a function that is imprecise or has a kink where the iteration ended; empty if there is none."""
    q, u = vec.taken((solution.stage_states, solution.controls), 0)
    functions = {"dynamics": problem.dynamics, "running_cost": problem.running_cost}
    return imprecise(functions, q, u) or find_kinks(problem, solution)


def find_long_turn(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on a step that turns too far, by the velocities at the stages; empty if there is none.

    The distance of two points says nothing of turns by more than half a turn.
    """
    states, count = solution.stage_states, len(solution.stage_times)
    if not any(is_angle for *_, is_angle in factor_distances(problem.manifold, states, states)):
        return ""
    with np.errstate(all="ignore"):
        velocities = evaluate_at_each(lambda point: problem.velocity(*point), (states, solution.controls))
        fastest = max(float(np.max(np.abs(leaf), initial=0.0)) for leaf in jax.tree.leaves(velocities))
        ahead = jax.tree.map(lambda q, v: q + SHORT_MOVE / fastest * v, states, velocities)
        lengths = np.repeat(np.diff(solution.times), count // solution.steps) * fastest / SHORT_MOVE
        moves = list(factor_distances(problem.manifold, states, ahead))
    return long_turn_words(max(float(np.max(own * lengths)) for _, own, is_angle in moves if is_angle))


def find_undefined(problem: OptimalControlProblem, solution: Solution) -> str:
    """Words on the function that is not finite, or has no finite derivative, at the first stage or node with one."""
    limits = problem._limits

    def along(q: Ambient, u: Ambient) -> Any:
        return problem.velocity(q, u), problem.cost_rate(q, u), *limits.of_points(q, u)

    names = "dynamics", "running_cost", *limits.function_words
    count = len(names) - len(limits.node_names)
    return _undefined_words(names[:count], along, (solution.stage_states, solution.controls)) or _undefined_words(
        names[count:], limits.of_nodes, (solution.states,)
    )


def _undefined_words(names: Sequence[str], functions: Callable[..., Any], points: tuple[Ambient, ...]) -> str:
    """Words on the first of the functions that is not finite, or has no finite derivative, at one of the points."""

    def at_point(point: tuple[Ambient, ...]) -> Any:
        return [functions(*point), *(jax.jacrev(functions, k)(*point) for k in range(len(point)))]

    with np.errstate(all="ignore"):
        found = evaluate_at_each(at_point, points) if names else []
    for part, what in zip(found, UNDEFINED, strict=False):
        for name, values in zip(names, part, strict=True):
            lost = np.any(
                [~np.isfinite(leaf).reshape(len(leaf), -1).all(axis=1) for leaf in jax.tree.leaves(values)], 0
            )
            if np.any(lost):
                point = vec.taken(points, int(np.argmax(lost)))
                where = ", ".join(f"{symbol} = {in_line(value)}" for symbol, value in zip("qu", point, strict=False))
                return f"{name} {what} at {where}; try {SMOOTH}."
    return ""
