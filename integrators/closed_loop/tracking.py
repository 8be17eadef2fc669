"""Tracking problems: costs that follow a reference on a manifold."""

from collections.abc import Callable
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import Euclidean, InvalidInputError, Manifold
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import Retraction, default_retraction
from ..boundary_value.solution.record import Solution
from ..problem.argument_errors import require_known_options
from ..problem.explicit_time import with_time
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.spline_table import Outside, finite_array, require_outside
from ..reporting.text import brief
from .reference import ReferencePath

WEIGHT_ROUNDING = 1e-12  # relative to the largest eigenvalue of weights


@require_known_options
def tracking(
    problem: OptimalControlProblem,
    reference: Any,
    weights: Any = 1.0,
    control_weights: Any = 1.0,
    end_weights: Any = None,
    controls: Any = None,
    retraction: Retraction | None = None,
    outside: Outside = "nan",
) -> OptimalControlProblem:
    r"""The problem with the cost of the deviation from a reference trajectory, instead of its own cost.

    Parameters
    ----------
    problem : OptimalControlProblem
        The dynamics, bounds and constraints.
    reference : Solution, tuple or callable
        A solution; ``(times, points)``, a table of points along the first axis of their arrays; or a JAX function of
        time that returns a point.
    weights : array_like
        The weights of the state: a number, a vector of shape ``(n,)``, or a positive semidefinite matrix, in
        ``manifold.basis`` at the reference.
    control_weights : array_like
        The weights of the control in the same form, positive.
    end_weights : array_like, optional
        The weights of the last state, for a terminal cost; by default there is none.
    controls : array or callable, optional
        The reference of the controls: an array at the times of the table, or a function of time. By default the
        controls of a solution, and otherwise zero.
    retraction : Retraction, optional
        The retraction of the deviation; by default ``default_retraction(manifold)``.
    outside : str
        The reference outside of its times: ``"nan"``, so that a solve fails there, or ``"constant"``, its nearest end.

    Returns
    -------
    OptimalControlProblem
        A problem with explicit time.

    Raises
    ------
    InvalidInputError, DomainError
        For other references and weights; for points of a table that are too far apart for a chart.

    Notes
    -----
    The cost is :math:`\int (v^\top W v + w^\top W_u w)/2\,dt + v_T^\top W_T v_T/2` with the coordinates :math:`v` of
    :math:`R^{-1}_{q_r(t)}(q)`, and :math:`w` of the deviation of the control. A table becomes a cubic polynomial
    between neighbouring points, in a chart of the manifold, with a continuous velocity.

    The basis is orthonormal in the arrays of a point: on SO(3) coordinates are :math:`\sqrt 2` times the rotation
    vector. A basis that jumps along the reference, as on a sphere, needs equal weights. The inverse retraction does
    not exist everywhere, as at half a turn.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> follow = tracking(line, ([0.0, 1.0, 2.0], np.array([[0.0], [1.0], [2.0]])), weights=3.0)
    >>> float(follow.running_cost(jnp.zeros(1), jnp.zeros(1), 1.0).round(9))
    1.5
    """
    _require(problem, retraction)
    require_outside(outside)
    own, steered = retraction or default_retraction(problem.manifold), default_retraction(problem.controls)
    path, signal = _states(reference, own, outside), _controls(reference, controls, steered, outside)
    state = Deviation(path, own, _weights("weights", weights, own.manifold))
    control = Deviation(signal, steered, _weights("control_weights", control_weights, steered.manifold))
    last = None if end_weights is None else Deviation(path, own, _weights("end_weights", end_weights, own.manifold))
    bare = problem._with_arguments(terminal_cost=None, initial_cost=None)
    timed = bare if problem.time_dependent else bare._map_functions(with_time, True)
    costs: Any = {"running_cost": lambda q, u, t: state.cost(q, t) + control.cost(u, t)}
    return timed._with_arguments(**costs, terminal_cost=None if last is None else last.cost)


@final
class Deviation:
    """The deviation of points from a reference: their coordinates in charts around it, and its cost."""

    def __init__(self, path: Callable[[Any], Ambient], retraction: Retraction, weights: np.ndarray) -> None:
        self.path, self.retraction, self.weights = path, retraction, weights

    def cost(self, x: Ambient, t: Any) -> Array:
        """Half the weighted square of the coordinates of a point at a time."""
        centre = self.path(t)
        v = vec.components(self.retraction.manifold.basis(centre), self.retraction.preimage(centre, x))
        return v @ (self.weights @ v if self.weights.ndim == 2 else self.weights * v) / 2


def _states(reference: Any, retraction: Retraction, outside: Outside) -> Callable[[Any], Ambient]:
    """The reference of the states."""
    if isinstance(reference, Solution):
        path = ReferencePath.of_states(reference, outside)
        _require_same("the states of the reference are", path.retraction.manifold, retraction.manifold)
        return path
    if isinstance(reference, tuple) and len(reference) == 2:
        return ReferencePath.through("the reference", retraction, reference, outside)
    if not callable(reference):
        raise InvalidInputError(
            f"the reference must be a Solution, a table (times, points) or a function of time, got {brief(reference)}"
        )
    return reference


def _controls(reference: Any, controls: Any, retraction: Retraction, outside: Outside) -> Callable[[Any], Ambient]:
    """The reference of the controls."""
    manifold = retraction.manifold
    if callable(controls):
        return controls
    if controls is None and isinstance(reference, Solution):
        path = ReferencePath.of_controls(reference, outside)
        _require_same("the controls of the reference are", path.retraction.manifold, manifold)
        return path
    if controls is None and isinstance(manifold, Euclidean):
        return lambda t: jnp.zeros(manifold.shape)
    if controls is None or not isinstance(reference, tuple):
        raise InvalidInputError(
            f"controls must be a function of time, or an array at the times of a table (times, points), got "
            f"{brief(controls)}; controls in {manifold} have no other default"
        )
    return ReferencePath.through("the reference of the controls", retraction, (reference[0], controls), outside)


def _weights(name: str, given: Any, manifold: Manifold) -> np.ndarray:
    """Weights as a vector or a symmetric matrix; raises unless their quadratic form is positive semidefinite."""
    n = manifold.dimension
    found = finite_array(name, given)
    found = np.full(n, float(found)) if found.ndim == 0 else found
    if found.shape not in ((n,), (n, n)):
        raise InvalidInputError(
            f"{name} have the shape {found.shape}, expected a number, a vector of shape {(n,)} or a matrix of shape "
            f"{(n, n)}, the dimension of {manifold}"
        )
    symmetric = found if found.ndim == 1 else (found + found.T) / 2
    values = found if found.ndim == 1 else np.linalg.eigvalsh(symmetric)
    if np.min(values, initial=0.0) < -WEIGHT_ROUNDING * np.max(np.abs(values), initial=0.0):
        raise InvalidInputError(
            f"{name} must be positive semidefinite, got the weight {np.min(values):.3g}; a negative weight rewards a "
            "deviation"
        )
    return symmetric


def _require_same(what: str, given: Manifold, own: Manifold) -> None:
    if not same_manifold(given, own):
        raise InvalidInputError(f"{what} in {given}, expected {own}, as in the problem")


def _require(problem: Any, retraction: Any) -> None:
    """Raise unless these are a problem and a retraction of its manifold."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"tracking takes an OptimalControlProblem, got {brief(problem)}; try solver.problem")
    if problem.sampling is not None:
        raise InvalidInputError(
            "the controls of the problem are held, and its cost is that of each sample; expected a problem in "
            "continuous time; try hold_controls(tracking(problem, ...), sample_time)"
        )
    if not (retraction is None or isinstance(retraction, Retraction)):
        raise InvalidInputError(f"retraction must be a Retraction, got {brief(retraction)}; try default_retraction(Q)")
    if retraction is not None:
        _require_same("the retraction is", retraction.manifold, problem.manifold)
