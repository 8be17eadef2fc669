"""The boundary-value problem: from a problem and its boundary conditions to a solution."""

from numbers import Number
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import InvalidInputError, Manifold, NotOnManifoldError
from ...manifolds.manifold import default_tolerance, working_precision
from ...manifolds.numerics.ambient import Ambient, is_count, is_finite_number
from ...manifolds.numerics.reading import reads_once
from ...retractions import DiscretizationMap
from ..compilation import call_compiled
from ..functions import require_concrete
from ..options import HORIZON, known_options
from ..problem import OptimalControlProblem, resting_control
from ..results import Result, warn_about_precision
from ..singular import Classification, SingularIntegrator, classify
from ..stages import ControlStage
from .assembly import DiscreteTrajectory, Iterate
from .boundary import NodeCondition, boundary_conditions, require_known_ends
from .diagnostics import Diagnostics, diagnose
from .globalisation import solve_kkt
from .guess import Guess, default_guess
from .singular import EndConditions, Request, solve_on_final_manifold
from .solution import Checks, Solution, Statistics

DEFAULT_TOLERANCE_POWER = 0.7
MOST_STEPS = 10_000_000  # with arrays much longer XLA ends the process


@known_options
@reads_once
def solve(
    problem: OptimalControlProblem,
    discretization: DiscretizationMap,
    start: Any,
    end: Any,
    horizon: float,
    steps: int,
    guess: Guess | Solution | None = None,
    tolerance: float | None = None,
    max_iterations: int = 100,
    throw: bool = True,
    classification: Classification | None = None,
    integrator: SingularIntegrator | None = None,
) -> Solution:
    """Solve an optimal control problem between two boundary conditions over ``[0, horizon]`` with ``steps`` equal steps.

    ``start`` and ``end`` are points; ``None`` is free, and so is a ``None`` in the tuple of a product: ``end=(R1, None)``
    prescribes the attitude only. The discrete extremal solves the equations of the presymplectic integrator at every
    step; Newton's method on the KKT system of the whole trajectory finds it. ``guess``: by default the curve of the
    retraction from start to end (a walk towards the end outside its image); or a ``Guess``, or a ``Solution`` with as many steps.

    A singular problem is classified, and its interior singular extremal found by multiple shooting on ``P_f`` with the steps of
    ``singular_integrator``; ``classification`` and ``integrator``, if given, save the work and the choice.

    Converged where the relative gaps and the relative stationarity are below ``tolerance`` (default ``eps^0.7``, 1e-11 in
    double precision) and Newton's next step is below its square root. Raises ``InvalidInputError``, ``NotOnManifoldError`` or
    ``DomainError`` for input that cannot be solved as given (of a singular problem: boundary data off ``P_f``), and, if
    ``throw``, ``ConvergenceError`` if the conditions are not met; otherwise read ``success``.
    """
    require_concrete("solve", start, end, horizon, problem, guess)
    _check_arguments(problem, discretization, horizon, steps, max_iterations)
    warn_about_precision()
    steps, limit, h = int(steps), _checked_tolerance(tolerance), np.asarray(horizon / steps, working_precision())
    first, last = boundary_conditions(problem.manifold, start, end, guess is not None)
    if guess is not None:
        guess = _checked_guess(problem, guess.guess() if isinstance(guess, Solution) else guess, steps)
    known = first.point if guess is None else jax.tree.map(lambda leaf: leaf[0], guess.states)
    regular = _is_regular(problem, known, last)
    c = classify(problem) if classification is None and not regular else classification
    _check_method(problem, discretization, c, integrator)
    if c is not None and not c.regular:
        request = Request(problem, discretization, EndConditions(problem, first, last), guess, h, steps, limit, max_iterations)
        solution = solve_on_final_manifold(request, c, integrator)
        return solution.require_success() if throw else solution
    if guess is None:
        require_known_ends(problem.manifold, start, end)
        guess = default_guess(problem, discretization, first.point, last.point, steps)
    stage = ControlStage(problem=problem, discretization=discretization, step=h)
    discrete = DiscreteTrajectory(stage, first, last, problem.final_cost)
    output, *seconds = call_compiled(_kernel, discrete, guess, limit, np.asarray(max_iterations))
    _require_tangent_dynamics(problem, float(output.diagnostics.normal))
    solution = _record(output, discretization.theta, float(horizon), *seconds)
    return solution.require_success() if throw else solution


def _is_regular(problem: OptimalControlProblem, known: Ambient, last: NodeCondition) -> bool:
    """Whether the problem is regular at a point; raises where its functions are not what a solution can be found with."""
    regular = problem.check(known, resting_control(problem.controls))
    if problem.terminal_cost is None or all(part.fixed for part in last.parts):
        problem.require_cost(known)
    return regular


def _check_method(
    problem: OptimalControlProblem,
    discretization: DiscretizationMap,
    classification: Classification | None,
    integrator: SingularIntegrator | None,
) -> None:
    """Raise if the classification or the integrator belongs to something else than the problem."""
    if classification is not None and not (isinstance(classification, Classification) and classification.is_of(problem)):
        raise InvalidInputError(
            f"classification must be that of the problem with its functions as they are, got {classification!r}; try "
            "classify(problem)"
        )
    if integrator is None:
        return
    if classification is None or classification.regular:
        raise InvalidInputError(f"the problem is regular, and solve takes no integrator for it: leave {integrator!r} out")
    if not (isinstance(integrator, SingularIntegrator) and eqx.tree_equal(integrator.lift.discretization, discretization)):
        raise InvalidInputError(
            f"integrator must be one on P_f by the same discretization, with one stage a step, got {integrator!r}; "
            "try singular_integrator(classification, discretization), and a Composition of it in integrate"
        )


def _check_arguments(problem: Any, discretization: Any, horizon: Any, steps: Any, max_iterations: Any) -> None:
    if not isinstance(problem, OptimalControlProblem):
        raise InvalidInputError(f"solve takes an OptimalControlProblem, got {problem!r}")
    if not isinstance(discretization, DiscretizationMap):
        raise InvalidInputError(
            f"solve takes a discretization map, got {discretization!r}; try Midpoint(default_retraction(manifold))"
        )
    problem.check_discretization(discretization)
    if not (is_finite_number(horizon) and horizon > 0):
        hint = "" if isinstance(horizon, Number) else f"; {HORIZON}"
        raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}{hint}")
    for name, count in (("steps", steps), ("max_iterations", max_iterations)):
        if not is_count(count):
            raise InvalidInputError(f"{name} must be a whole number of at least 1, got {count!r}")
    if steps > MOST_STEPS:
        raise InvalidInputError(f"steps must be at most {MOST_STEPS}, for want of memory, got {steps!r}")


def _checked_tolerance(tolerance: float | None) -> np.ndarray:
    limit = np.finfo(working_precision()).eps ** DEFAULT_TOLERANCE_POWER if tolerance is None else tolerance
    if not (is_finite_number(limit) and limit > 0):
        raise InvalidInputError(f"tolerance must be a positive finite number, got {tolerance!r}")
    return np.asarray(limit, working_precision())


def _require_tangent_dynamics(problem: OptimalControlProblem, normal: float) -> None:
    """Raise if the dynamics leaves the tangent spaces somewhere on the trajectory; at its first point it was checked before."""
    if normal > default_tolerance():
        raise NotOnManifoldError(
            f"dynamics leaves the tangent space of {problem.manifold} along the trajectory: its relative normal part reaches "
            f"{normal:.3g}, expected 0; return a tangent vector, for rotations R @ hat(w), not hat(w)"
        )


def _checked_guess(problem: OptimalControlProblem, guess: Guess, steps: int) -> Guess:
    """The guess as arrays with its costates filled in; raises where a shape is wrong."""
    if not isinstance(guess, Guess):
        raise InvalidInputError(f"guess must be a Guess or a Solution, got {guess!r}; try Guess(states, controls)")
    costates = guess.costates
    if costates is None:
        costates = jax.tree.map(lambda s: np.zeros((steps + 1, *s.shape), s.dtype), problem.manifold.ambient)
    filled = Guess(guess.states, guess.controls, costates)
    expected = (
        ("states", problem.manifold, steps),
        ("controls", problem.controls, steps),
        ("costates", problem.manifold, steps + 1),
    )
    for name, manifold, count in expected:
        given = getattr(filled, name)
        shapes = jax.tree.map(lambda s, c=count: (c, *s.shape), manifold.ambient)
        got = jax.tree.map(np.shape, given)
        if shapes != got:
            raise InvalidInputError(f"guess: {name} must have shapes {shapes}, got {got}")
        numbers = [np.issubdtype(np.asarray(leaf).dtype, np.number) for leaf in jax.tree.leaves(given)]
        kept = zip(jax.tree.leaves(given), jax.tree.leaves(manifold.ambient), strict=True)
        if not (all(numbers) and all(np.isrealobj(leaf) or np.issubdtype(s.dtype, np.complexfloating) for leaf, s in kept)):
            raise InvalidInputError(f"guess: {name} must be real numbers, complex where points of {manifold} are; try jnp.real")
        if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(given)):
            raise InvalidInputError(f"guess: {name} has entries that are NaN or infinite")
    kinds = Guess(problem.manifold.ambient, problem.controls.ambient, problem.manifold.ambient)
    filled = jax.tree.map(lambda kind, leaf: jnp.asarray(leaf, kind.dtype), kinds, filled)
    for name, value in call_compiled(_worst_violations, problem.manifold, filled.states)[0].items():
        if not value <= default_tolerance():
            raise InvalidInputError(f"guess: states are not on {problem.manifold}: {name} reaches {value:.3g}, expected 0")
    return filled


def _worst_violations(manifold: Manifold, points: Ambient) -> dict[str, Array]:
    return jax.tree.map(jnp.max, jax.vmap(manifold.violations)(points))


class _Output(NamedTuple):
    unknowns: Any
    states: Ambient
    costates: Ambient
    cost: Array
    gap: Array
    stationarity: Array
    strict_minimum: Array
    iterations: Array
    success: Array
    result: Result
    diagnostics: Diagnostics


def _kernel(discrete: DiscreteTrajectory, guess: Guess, tolerance: Array, max_iterations: Array) -> _Output:
    """Everything that runs on arrays, in one compiled function."""
    stage = cast(ControlStage, discrete.stage)
    newton = solve_kkt(discrete, Iterate((guess.states, guess.controls), guess.costates), tolerance, max_iterations)
    found = newton.assembled
    costates = jax.vmap(stage.manifold.projection)(found.nodes, found.costates)
    diagnostics = diagnose(stage, newton.iterate.unknowns, found.nodes, costates)
    trajectory = newton.iterate.unknowns, found.nodes, costates
    checks = found.cost, newton.residuals.gap, newton.residuals.stationarity, newton.strict_minimum
    return _Output(*trajectory, *checks, newton.iterations, newton.result == Result.successful, newton.result, diagnostics)


def _record(output: _Output, theta: float, horizon: float, compiling: float, running: float) -> Solution:
    """The solution from the kernel's output, and the seconds that it took to compile and to run."""
    found: Any = jax.tree.map(np.asarray, output)
    diagnostics = found.diagnostics
    steps = len(diagnostics.hamiltonians)
    checks = Checks.of(diagnostics, float(found.gap), float(found.stationarity), bool(found.strict_minimum))
    stage_states, controls = found.unknowns
    times = np.linspace(0.0, horizon, steps + 1)
    return Solution(
        times=times,
        states=found.states,
        costates=found.costates,
        stage_times=times[:-1] + theta * horizon / steps,
        stage_states=stage_states,
        stage_costates=diagnostics.stage_costates,
        controls=controls,
        hamiltonians=diagnostics.hamiltonians,
        momenta=diagnostics.momenta,
        body_costates=diagnostics.body,
        spatial_costates=diagnostics.spatial,
        cost=float(found.cost),
        success=bool(found.success),
        result=Result[found.result],
        checks=checks,
        statistics=Statistics(int(found.iterations), compiling, running),
    )
