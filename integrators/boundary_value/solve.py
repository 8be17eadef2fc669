"""The boundary-value problem in one call."""

from collections.abc import Callable
from typing import Any

from ...reading import reads_once
from ..functions import require_concrete
from ..options import known_options
from ..problem import OptimalControlProblem
from ..singular import Classification, SingularIntegrator
from .arguments import Given, Method, Options, check_accuracy
from .differentiable import INSTEAD
from .engine.found import Iteration
from .guess import Guess
from .refinement import Refinement
from .request import Request
from .solution import Solution
from .solver import Solver


@known_options
@reads_once
def solve(
    problem: OptimalControlProblem,
    discretization: Method,
    start: Any,
    end: Any,
    horizon: float,
    steps: Any,
    guess: Guess | Solution | None = None,
    tolerance: float | None = None,
    max_iterations: int = 100,
    throw: bool = True,
    classification: Classification | None = None,
    integrator: SingularIntegrator | None = None,
    parameters: Any = None,
    callback: Callable[[Iteration], Any] | None = None,
    verbose: bool = False,
    accuracy: float | None = None,
) -> Solution:
    """Solve an optimal control problem between two boundary conditions over ``[0, horizon]`` with ``steps`` steps.

    ``start`` and ``end`` are points; ``None`` is free, and so is a ``None`` in the tuple of a product: ``end=(R1,
    None)`` prescribes the attitude only. The discrete extremal solves the equations of the presymplectic integrator at
    every step; Newton's method on the KKT system of the whole trajectory finds it. ``guess``: by default the curve of
    the retraction from start to end (a walk towards the end outside its image); or a ``Guess``, or any ``Solution``.

    A singular problem is classified, and its interior singular extremal found by multiple shooting on ``P_f`` with the
    steps of ``singular_integrator``; ``classification`` and ``integrator``, if given, save the work and the choice.

    Converged where the relative gaps and the relative stationarity are below ``tolerance`` (default ``eps^0.7``, 1e-11
    in double precision) and Newton's next step is below its square root. Raises ``InvalidInputError``,
    ``NotOnManifoldError`` or ``DomainError`` for input that cannot be solved as given (of a singular problem: boundary
    data off ``P_f``), and, if ``throw``, ``ConvergenceError`` if the conditions are not met; otherwise read
    ``success``.
    """
    require_concrete("solve", start, end, horizon, problem, guess, parameters, instead=INSTEAD)
    if accuracy is not None:
        check_accuracy(accuracy)
    solver, given = Solver(problem, discretization, steps), Given(start, end, horizon, parameters)
    options = Options.of(tolerance, max_iterations, callback, verbose)
    request = Request.of(solver.reader, given, guess, options, classification, integrator)
    found = (
        solver.solved(request) if accuracy is None else Refinement(solver, request, accuracy, tolerance is None).solve()
    )
    return found.require_success() if throw else found
