"""The arguments of a solve, checked and in the form that the solver computes with."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import is_count, is_finite_number
from ....manifolds.numerics.tolerances import SAME_TIME
from ....retractions import CollocationMethod, DiscretizationMap
from ...problem.free_quantities import with_guess
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.requirements import HELD, require_same_manifold, require_treated
from ...reporting.text import brief
from ...singular import Classification, SingularIntegrator

MOST_STEPS = 10_000_000  # with arrays much longer memory ends
LIMITS = "control bounds", "constraints", "node constraints"
ALONG = *LIMITS, "an initial cost", "a node cost", "an explicit time"
BETWEEN = "boundary constraints", "periodic ends"
NO_PARAMETERS = jax.tree.structure(None), ()  # the structure of no parameters, and the shapes of its leaves
Method = DiscretizationMap | CollocationMethod


class BoundaryData(NamedTuple):
    """The data that determine an extremal; ``None`` for a free end, and for no parameters."""

    start: Any
    end: Any
    horizon: Any
    parameters: Any
    start_time: Any = 0.0  # of problems with an explicit time

    def near(self, solution: Any) -> "BoundaryData":
        """The data, in which a free horizon and free parameters have their values in a solution as guesses."""
        found = solution.horizon, solution.parameters
        horizon, parameters = jax.tree.map(with_guess, (self.horizon, self.parameters), found)
        return self._replace(horizon=horizon, parameters=parameters)


def structure_of(parameters: Any, axes: int = 0) -> Any:
    """The structure and the shapes of parameters, leading axes left out."""
    if parameters is None:
        return NO_PARAMETERS
    leaves, structure = jax.tree.flatten(parameters)
    return structure, tuple([np.shape(leaf)[axes:] for leaf in leaves])


def copy_parameters(parameters: Any) -> Any:
    """Parameters as arrays of their own, for a record."""
    return jax.tree.map(np.array, parameters)


def check_parameters(problem: OptimalControlProblem, parameters: Any) -> None:
    """Raise if the problem's functions take parameters and there are none, or the other way round, or they are not
    numbers."""
    if problem.takes_parameters and parameters is None:
        raise InvalidInputError(
            f"the problem's functions take parameters, and none are given: {problem._first_with_parameters}; try "
            "parameters=..., numbers or arrays, or tuples or dictionaries of them; a state of several arrays is one "
            "argument, a tuple"
        )
    if not problem.takes_parameters and parameters is not None:
        raise InvalidInputError(
            f"parameters are given, {brief(parameters)}, and no function of the problem takes them; expected functions "
            "of (q, u, parameters)"
        )
    for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
        array, where = np.asarray(leaf), f"parameters{jax.tree_util.keystr(path)}"
        got = f"{brief(leaf)} as {where}" if array.dtype.kind not in "fiub" else ""
        if not got and not np.isfinite(array).all():
            place = np.argwhere(~np.isfinite(array))[0].tolist()
            got = f"{array[tuple(place)]} as {where}{place if place else ''}"
        if got:
            raise InvalidInputError(f"parameters must be finite real numbers and arrays of them, got {got}")


def step_fractions(steps: Any) -> np.ndarray:
    """Lengths of the steps as fractions of the horizon, from their number or from lengths."""
    if is_count(steps):
        if steps > MOST_STEPS:
            raise InvalidInputError(f"steps must be at most {MOST_STEPS}, for want of memory, got {steps!r}")
        return np.full(int(steps), 1 / int(steps))
    given = np.asarray(steps)
    if (
        np.ndim(steps) == 1
        and given.size
        and given.dtype.kind in "fiu"
        and np.all(np.isfinite(given))
        and np.all(given > 0)
    ):
        return given / np.sum(given)
    raise InvalidInputError(
        f"steps must be a whole number of at least 1, got {brief(steps)}; or the lengths of the steps, positive numbers"
    )


def require_problem(problem: Any) -> None:
    """Raise if this is no problem."""
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"solve takes an OptimalControlProblem, got {problem!r}")


def require_refinable(problem: Any) -> None:
    """Raise if this is no problem, or the index of a node has a meaning that another mesh would change."""
    require_problem(problem)
    if problem.node_cost is not None:
        raise InvalidInputError(
            "the problem has a node_cost, whose index k counts the nodes, and a refined mesh has other nodes; expected "
            "a fixed mesh; try steps=len(measurements) - 1, and no accuracy"
        )
    if problem.sampling is not None:
        raise InvalidInputError(
            f"each control is held for {problem.sampling.time:g}, and a refined mesh has other steps; expected a step "
            "for each sample; try steps=round(horizon / sample_time), and no accuracy"
        )


def check_problem(problem: Any, method: Any) -> None:
    require_problem(problem)
    if not isinstance(method, DiscretizationMap | CollocationMethod):
        raise InvalidInputError(
            f"solve takes a collocation method or a discretization map, got {brief(method)}; try "
            "Midpoint(default_retraction(manifold))"
        )
    require_treated(problem, "solve", *ALONG, *BETWEEN, HELD)
    require_same_manifold(problem, method)
    if problem.sampling is not None:
        problem.sampling.require_method(method)


def check_accuracy(accuracy: Any) -> None:
    if not (is_finite_number(accuracy) and 0 < accuracy < 1):
        raise InvalidInputError(
            f"accuracy must be a relative error between 0 and 1, got {accuracy!r}; try accuracy=1e-6"
        )


def check_classification(problem: OptimalControlProblem, classification: Any) -> None:
    """Raise unless the classification belongs to the problem."""
    if not (isinstance(classification, Classification) and classification.is_of(problem.at_time(0.0))):
        raise InvalidInputError(
            f"classification must be that of the problem with its functions as they are, got {classification!r}; try "
            "classify(problem)"
        )


def check_regular(integrator: SingularIntegrator | None) -> None:
    """Raise if there is an integrator for a regular problem."""
    if integrator is not None:
        raise InvalidInputError(
            f"the problem is regular, and solve takes no integrator for it: leave {integrator!r} out"
        )


def check_singular(
    problem: OptimalControlProblem,
    method: Method,
    fractions: np.ndarray,
    c: Classification,
    integrator: SingularIntegrator | None,
) -> None:
    """Raise unless a singular problem has extremals that are found on ``P_f``, in these steps by this method."""
    if integrator is not None and not (
        isinstance(integrator, SingularIntegrator) and eqx.tree_equal(integrator.lift.discretization, method)
    ):
        raise InvalidInputError(
            f"integrator must be one on P_f by the same discretization, with one stage a step, got {integrator!r}; "
            "try method, choice = singular_integrator(classification, discretization); a Composition is for integrate"
        )
    require_treated(problem, "solve of a singular problem", *LIMITS)
    if not isinstance(method, DiscretizationMap):
        raise InvalidInputError(
            "the problem is singular, dH/du = 0 does not determine its controls, and solve takes a discretization map "
            f"for it, got {type(method).__name__}; try Midpoint(default_retraction(manifold)), or, where it is not "
            "meant to be singular, a cost of all controls, as u @ u"
        )
    if np.ptp(fractions) > SAME_TIME:
        raise InvalidInputError("the problem is singular, and solve takes equal steps for it; give their number")
    if c.empty:
        raise InvalidInputError(
            "the problem is singular, and no point of P_f, on which its interior singular extremals lie, was "
            f"found\n{c}"
        )
    c.require_reliable()
    if problem.abnormal:
        raise InvalidInputError(
            "solve finds no abnormal singular extremals, whose conditions p = 0 meets too; integrate them from a start "
            "(q0, p0)"
        )
