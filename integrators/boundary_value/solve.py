"""The boundary-value problem in one call."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from ...errors import InvalidInputError
from ...former_order import accept_former_order
from ...retractions import Gauss, default_retraction
from ...tracing import reads_once
from ..problem.argument_errors import require_known_options
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.user_functions import require_concrete
from ..singular import Classification, SingularIntegrator
from .drivers.mesh_refinement import MeshRefinement
from .drivers.phases import solve_phases
from .drivers.waypoints import join_phases, phases_through
from .guess import Guess
from .inputs.arguments import BoundaryData, Method, check_accuracy, require_problem, require_refinable
from .inputs.inputs import Inputs
from .inputs.options import Options
from .iteration_reports import Iteration
from .solution.diagnostics import count_call_time
from .solution.differentiable_solution import INSTEAD
from .solution.record import Solution
from .solver import Solver

DEFAULT_ACCURACY = 1e-6  # relative error of the steps, where no steps are given
DEFAULT_STEPS = 20  # of the first mesh, which is refined to an accuracy
DEFAULT_STAGES = 3  # of the Gauss method, of order 6, where no method is given
FORMER_ORDER = "problem", "discretization", "start", "end", "horizon", "steps", "guess", "tolerance", "max_iterations"


@accept_former_order(*FORMER_ORDER)
@require_known_options
@reads_once
def solve(
    problem: OptimalControlProblem,
    start: Any,
    end: Any,
    horizon: Any,
    *,
    method: Method | None = None,
    steps: Any = None,
    accuracy: float | None = None,
    guess: Guess | Solution | None = None,
    parameters: Any = None,
    tolerance: float | None = None,
    max_iterations: int = 100,
    throw: bool = True,
    classification: Classification | None = None,
    integrator: SingularIntegrator | None = None,
    callback: Callable[[Iteration], Any] | None = None,
    verbose: bool = False,
    start_time: float = 0.0,
    through: Mapping[float, Any] | None = None,
) -> Solution:
    """Solve an optimal control problem between two boundary conditions.

    Parameters
    ----------
    problem : OptimalControlProblem
        The dynamics, the cost and the constraints.
    start, end : point, None or Free
        Points of ``problem.manifold``. ``None`` is free. In the tuple of a product, each factor may be free: ``end=(R1,
        None)`` prescribes the attitude only. ``Free(x)`` is free, with the guess ``x``.
    horizon : float or Free
        The duration ``T > 0`` in the unit of time of the dynamics. ``Free(guess, lower, upper)`` is optimised.
    method : Gauss or DiscretizationMap, optional
        The discretization, such as ``Gauss(2, retraction)`` or ``Midpoint(retraction)``; by default ``Gauss(3,
        default_retraction(problem.manifold))``, of order 6.
    steps : int or array_like of shape (N,), optional
        The number of steps ``N``, or their lengths relative to their sum. By default the mesh is refined from 20 steps
        to an ``accuracy`` of 1e-6.
    accuracy : float, optional
        The relative error of the discretization to which the mesh is refined from ``steps``.
    guess : Guess or Solution, optional
        The trajectory to begin from; by default the curve of the retraction from start to end.
    parameters : pytree of numbers, arrays and Free, optional
        Values for functions that take one argument more.
    tolerance : float, optional
        The bound of the relative defects and the relative stationarity; by default ``eps^0.7``, 1e-11 in double
        precision. The next Newton step is then below its square root.
    max_iterations : int
        The most trial points of one search; a Newton step has one to five. Up to five more follow where only a lower
        barrier is missing.
    throw : bool
        Whether to raise ``ConvergenceError`` without success; otherwise read ``solution.success``.
    classification : Classification, optional
        The result of ``classify(problem)`` for a singular problem, which saves the time to find it.
    integrator : SingularIntegrator, optional
        The integrator on the final manifold of a singular problem; by default chosen by ``singular_integrator``.
    callback : callable, optional
        A function of an ``Iteration``, called in every iteration; it stops the iteration by returning ``True``.
    verbose : bool
        Whether to print a line for each iteration.
    start_time : float
        The time at which the trajectory begins, for a problem with ``time_dependent=True``; the horizon is a duration.
    through : mapping of float to point, optional
        Waypoints by their times: points that the trajectory passes, with ``None`` for free factors as in ``end``. Each
        time is the time of a node, so ``steps`` must be given. The costates jump at the waypoints.

    Returns
    -------
    Solution
        The discrete extremal with its costates and checks.

    Raises
    ------
    InvalidInputError, NotOnManifoldError, DomainError
        For input that cannot be solved as given; for boundary data of a singular problem off ``P_f``.
    ConvergenceError
        If the conditions are not met and ``throw`` is true.

    Notes
    -----
    The discrete extremal satisfies the equations of the presymplectic integrator ``R_h^{T*Q}`` at every step
    [Barbero-Liñán and Martin de Diego 2023]. Newton's method on the KKT system of the whole trajectory finds it. The
    interior singular extremal of a singular problem is found by multiple shooting on ``P_f``.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> found = solve(line, 0.0, 1.0, 2.0)
    >>> print(f"{found.status}, cost {found.cost:.3f}")
    minimum, cost 0.250
    """
    began = time.perf_counter()
    require_concrete("solve", start, end, horizon, problem, guess, parameters, instead=INSTEAD)
    if accuracy is not None:
        check_accuracy(accuracy)
    if steps is None or accuracy is not None:
        require_refinable(problem)
    if steps is None:
        steps, accuracy = DEFAULT_STEPS, DEFAULT_ACCURACY if accuracy is None else accuracy
    method = _default_method(problem) if method is None else method
    given = BoundaryData(start, end, horizon, parameters, start_time)
    options: Any = {"tolerance": tolerance, "max_iterations": max_iterations, "callback": callback, "verbose": verbose}
    if through:
        _require_fixed_mesh(accuracy, classification, integrator)
        phases = phases_through(problem, method, steps, given, through, guess)
        found = join_phases(solve_phases(phases, throw=False, **options))
    else:
        solver = Solver(problem, method, steps)
        inputs = Inputs.of(solver._reader, given, guess, Options.of(**options), 0, classification, integrator)
        if accuracy is None:
            found = solver._solve(inputs)
        else:
            found = MeshRefinement(solver, inputs, accuracy, tolerance is None).solve()
    found = count_call_time(found, began)
    return found.require_success() if throw else found


def _require_fixed_mesh(accuracy: Any, classification: Any, integrator: Any) -> None:
    """Raise if a trajectory through waypoints has a mesh that is refined, or is of a singular problem."""
    if accuracy is not None:
        raise InvalidInputError(
            "through fixes the nodes at the waypoints, and the mesh is to be refined; expected steps and no accuracy; "
            "try steps=40, where the times of the waypoints are nodes"
        )
    if classification is not None or integrator is not None:
        raise InvalidInputError("through is for regular problems, got a classification or an integrator")


def _default_method(problem: OptimalControlProblem) -> Method:
    """The method of order 6 in the default retraction, or of the samples; raises ``InvalidInputError`` for what is no
    problem."""
    require_problem(problem)
    if problem.sampling is not None:
        return problem.sampling.method
    return Gauss(DEFAULT_STAGES, default_retraction(problem.manifold))
