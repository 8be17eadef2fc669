"""Constraints as exact penalties: slack controls with a price."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from typing import Any

from ...manifolds import Euclidean, InvalidInputError
from ...manifolds.numerics.ambient import is_finite_number
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.path_constraints import Inequalities
from ..problem.quantities import Quantities
from ..reporting.text import brief


def soften(problem: OptimalControlProblem, weights: Mapping[str, float]) -> OptimalControlProblem:
    r"""The problem with some of its constraints as exact penalties, so that a state that violates them is feasible.

    Parameters
    ----------
    problem : OptimalControlProblem
        A problem with controls in R^m and ``constraints``. Node constraints have no control, and stay hard.
    weights : mapping of str to float
        The positive weight of each soft constraint by its name: cost per unit of time and of violation.

    Returns
    -------
    OptimalControlProblem
        The problem with one more control for each soft constraint, its slack, after the ``m`` controls.

    Raises
    ------
    InvalidInputError
        For other names, weights or controls.

    Notes
    -----
    :math:`g(q, u) \le 0` becomes :math:`g(q, u) \le s` in all its entries, with the slack :math:`s \ge 0` and the cost
    :math:`w\,(s + s^2/2)` in addition. The penalty is exact [Nocedal, Wright 2006, 17.2]: where the hard constraints
    can hold and the sum of their multipliers is less than the weight, both problems have the same solution. The square
    makes the problem regular in the slack.

    Examples
    --------
    >>> line = OptimalControlProblem(
    ...     Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, 1, constraints={"wall": lambda q, u: q[0] - 1}
    ... )
    >>> soften(line, {"wall": 10.0}).controls
    Euclidean(shape=(2,))
    """
    _require(problem, weights)
    hard, names, prices = problem._limits, list(weights), [float(weight) for weight in weights.values()]
    m = problem.controls.dimension

    def without_slacks(function: Callable[..., Any]) -> Callable[..., Any]:
        return wraps(function)(lambda q, u, *more: function(q, u[:m], *more))

    def with_slack(function: Callable[..., Any], place: int) -> Callable[..., Any]:
        return wraps(function)(lambda q, u, *more: function(q, u[:m], *more) - u[place])

    def cost(q: Any, u: Any, *more: Any) -> Any:
        penalties = (price * (s + s**2 / 2) for price, s in zip(prices, u[m:], strict=True))
        return problem.running_cost(q, u[:m], *more) + sum(penalties)

    functions = tuple(
        with_slack(function, m + names.index(name)) if name in weights else without_slacks(function)
        for name, function in zip(hard.names, hard.functions, strict=True)
    )
    infinite = (float("inf"),) * m
    lower = (*(hard.lower or tuple(-bound for bound in infinite)), *(0.0 for _ in names))
    upper = (*(hard.upper or infinite), *(float("inf") for _ in names))
    limits = Inequalities(lower, upper, hard.names, functions, hard.at_first, hard.node_names, hard.node_functions)
    controls = Euclidean(m + len(names))
    unnamed = Quantities.of(problem.manifold, controls, None, None)
    return problem._with_arguments(
        dynamics=without_slacks(problem.dynamics),
        running_cost=wraps(problem.running_cost)(cost),
        controls=controls,
        constraints=limits,
        labels=replace(problem.quantities, controls=unnamed.controls),
    )


def _require(problem: Any, weights: Any) -> None:
    """Raise unless these are constraints of a problem with positive weights."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"soften takes an OptimalControlProblem, got {brief(problem)}; try solver.problem")
    if not (isinstance(problem.controls, Euclidean) and len(problem.controls.shape) == 1):
        raise InvalidInputError(
            f"soft constraints need controls in R^m, got {problem.controls}; expected Euclidean(m), to which "
            "slacks are added"
        )
    if not isinstance(weights, Mapping):
        raise InvalidInputError(f"weights must be a dictionary of numbers by the names of constraints, got {weights!r}")
    for name, weight in weights.items():
        if name not in problem.constraints:
            raise InvalidInputError(
                f"there is no constraint {name!r}, expected one of {', '.join(problem.constraints) or 'none'}; "
                "a node constraint has no control, pass the function as one of the constraints"
            )
        if not (is_finite_number(weight) and weight > 0):
            raise InvalidInputError(
                f"the weight of {name!r} must be a positive number, got {weight!r}; try ten times the largest "
                "multiplier, solution.multipliers[name].max()"
            )
