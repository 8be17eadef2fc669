"""Requirements on a problem: terms that an algorithm treats, and the manifold of a method."""

from ...manifolds import InvalidInputError
from ...manifolds.manifold import same_manifold
from ...retractions import CollocationMethod, DiscretizationMap
from ..problem.optimal_control_problem import OptimalControlProblem


def require_treated(problem: OptimalControlProblem, what: str, *treated: str) -> None:
    """Raise if the problem has bounds, constraints, an initial cost or a time that ``what`` does not treat."""
    limits, boundary = problem._limits, problem._boundary
    has = {
        "control bounds": any(limits.bounded.values()),
        "constraints": bool(limits.functions),
        "node constraints": bool(limits.node_functions),
        "an initial cost": problem.initial_cost is not None,
        "an explicit time": problem.time_dependent,
        "boundary constraints": bool(boundary.functions),
        "periodic ends": boundary.turn is not None,
    }
    left = [words for words, there in has.items() if there and words not in treated]
    if left:
        raise InvalidInputError(
            f"the problem has {' and '.join(left)}, which {what} does not treat; expected a problem without; try "
            "one that has none"
        )


def require_same_manifold(problem: OptimalControlProblem, method: DiscretizationMap | CollocationMethod) -> None:
    """Raise if a discretization map or a collocation method acts on another manifold than the problem."""
    if not same_manifold(method.manifold, problem.manifold):
        came, expected = method.manifold, problem.manifold
        raise InvalidInputError(f"the method acts on {came}, the problem on {expected}; use one manifold")
