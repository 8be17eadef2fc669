"""Kinks in the controls, which may be why a solve did not succeed: places where a derivative by the controls jumps."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from ..control_probing import SMOOTH_COSTS
from .jumps import largest, largest_jump
from .problem_jumps import control_lines, control_size, rate_names, rates, search_on_curves, without_rounding
from .step_primitives import find_step_primitives

KINK_STAGES = 5  # of a trajectory from whose controls is looked
# Distances from a control, times the largest control, between which is looked: no kink at a round number is at an end.
KINK_DISTANCES = np.linspace(-1.86, 2.02, 5)


def find_kinks(problem: OptimalControlProblem, solution: Any) -> str:
    """Words on the largest kink of a function along the controls of a record; empty if none is found.

    From a few stages along every coordinate of U, jumps of the derivatives are searched for. Kinks without a
    comparison, a sign or an absolute value, such as the tip of a cone, are not found.
    """
    points = solution.stage_states, solution.controls, solution.stage_times
    rows = [np.asarray(leaf).reshape(len(points[2]), -1) for leaf in jax.tree.leaves(points[:2])]
    stages = np.flatnonzero(np.all([np.isfinite(row).all(axis=1) for row in rows], axis=0))
    if not (problem.controls.dimension and stages.size):
        return ""
    points = vec.taken(points, stages[np.linspace(0, len(stages) - 1, KINK_STAGES).round().astype(int)])
    if not find_step_primitives(lambda u: _slopes(problem, vec.taken(points[0], 0), u), vec.taken(points[1], 0)):
        return ""
    lines = control_lines(problem, points, KINK_DISTANCES)
    search = search_on_curves(_slopes, problem, None, (None, None), vec.taken(lines[0], 0))
    found = search.crossings((None, None), *lines)
    kink = largest_jump(search.jumps(found, largest(found.ends.values)))
    if kink is None:
        return ""
    _, u, time = kink.point
    name = rate_names(problem)[kink.entry // problem.controls.dimension]
    size = control_size(problem, points[1])
    place = jax.tree.map(lambda leaf: without_rounding(leaf, size), u)
    return (
        f"{name} has a kink or a jump in the controls at u = {place}: its derivative by them changes there by "
        f"{kink.change:.3g} (q as at t = {float(time):.6g}); expected a smooth function of u, because the conditions "
        "dH/du = 0 do not hold at a kink, and Newton's method does not pass one; try "
        f"{SMOOTH_COSTS[name != 'running_cost']}"
    )


def _slopes(problem: OptimalControlProblem, q: Ambient, u: Ambient, _: None = None) -> Array:
    """The derivatives of the entries of the functions by each coordinate of the control."""
    here = jnp.zeros(problem.controls.dimension)
    return jnp.ravel(jax.jacfwd(lambda way: rates(problem, q, problem._steer(u, way)))(here))
