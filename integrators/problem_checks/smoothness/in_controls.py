"""Jumps in the controls: values that change where no derivative does, such as rounded values and whole numbers."""

from typing import TYPE_CHECKING

import jax
import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import working_precision
from ...problem.path_constraints import OF_CONTROL
from .discontinuity_search import DiscontinuitySearch, FlatPoint, Jump, Lines, largest_jump, rate_names, rates
from .kinks import without_rounding
from .step_primitives import find_step_primitives

if TYPE_CHECKING:
    from ...problem.optimal_control_problem import OptimalControlProblem

CONTROL_SIZES = 10.0 ** np.arange(-4, 7)  # sizes of controls between which a jump is looked for
SMOOTH_STEPS = (
    "try jnp.tanh(u / a) with a small a in place of a step, or, for controls from a finite set, a problem for each of "
    "them"
)
BOUND_ROUNDING = 1e-9  # of a bound: a control beyond it by more is not admitted


def require_no_jumps(problem: "OptimalControlProblem", q: Ambient, u: Ambient) -> None:
    """Raise if a function of the problem jumps in the controls, along a coordinate of these from ``u``.

    Only functions that compute steps of the controls are looked at.
    """
    found = find_step_primitives(lambda u: rates(problem, q, u), u)
    if not found:
        return
    given = None, None
    crossings = DiscontinuitySearch(rates, problem, None, given)
    states, controls = crossings.state.rows(q, 0)[None], crossings.control.rows(u, 0)[None]
    jump = find_control_jump(crossings, given, control_lines(problem, states, controls, np.zeros(1), CONTROL_SIZES))
    if jump:
        raise InvalidInputError(control_jump_words(problem, jump, found))


def control_lines(
    problem: "OptimalControlProblem", states: np.ndarray, controls: np.ndarray, times: np.ndarray, scales: np.ndarray
) -> Lines:
    """Lines from each of some controls along every coordinate to both sides, in pieces between these distances."""
    count, n, m = len(times), problem.manifold.dimension, problem.controls.dimension
    grid = np.concatenate([-scales[::-1], [0.0], scales]).astype(working_precision())
    k, entry, piece = (
        part.ravel() for part in np.meshgrid(range(count), range(m), range(len(grid) - 1), indexing="ij")
    )
    found = Lines.through(states[k], controls[k], times[k], np.zeros((len(k), n)), np.eye(m)[entry])
    return found._replace(low=grid[piece], high=grid[piece + 1])


def find_control_jump(
    crossings: DiscontinuitySearch, given: FlatPoint, lines: Lines, sizes: np.ndarray | None = None
) -> Jump | None:
    """The largest jump on these lines at controls that the bounds admit."""
    located, _ = crossings.located(given, lines, crossings.seen(given, lines))
    bounds = crossings.problem.control_bounds
    return largest_jump(
        [jump for jump in crossings.jumps(located, sizes) if bounds is None or _is_admissible(jump.control, *bounds)]
    )


def _is_admissible(u: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    slack = BOUND_ROUNDING * np.maximum(1.0, np.abs(u))
    return bool(np.all(u >= lower - slack) and np.all(u <= upper + slack))


def control_jump_words(problem: "OptimalControlProblem", jump: Jump, steps: list[str], at: str = "") -> str:
    """Words on a jump; ``at`` names the state."""
    name = rate_names(problem)[jump.entry]
    place = jax.tree.map(lambda leaf: without_rounding(leaf, float(np.max(np.abs(leaf), initial=0.0))), jump.control)
    hint = OF_CONTROL if name in problem._limits.function_words else SMOOTH_STEPS
    return (
        f"{name} jumps in the controls at u = {place}{at}: it computes {' and '.join(steps)} from them, and no "
        "derivative tells of the jump; expected a smooth function of u, because the conditions dH/du = 0 do not see a "
        f"jump; {hint}"
    )
