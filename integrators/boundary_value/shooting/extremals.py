"""Boundary-value problems for interior singular extremals: they live on the final manifold ``P_f`` of the problem."""

import time
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.jit_cache import compile_function
from ....manifolds import Euclidean, InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem_checks.smoothness.hamiltonian_jumps import Energy, Segments
from ...reporting.result_sentences import Result
from ...reporting.text import plural
from ...singular import Classification, SingularIntegrator, singular_integrator
from ...singular.integrability import FinalEquations
from ...stages import ControlStage
from ..audit.status import Status, shooting_status
from ..guess import default_guess
from ..inputs.arguments import copy_parameters
from ..inputs.inputs import Inputs
from ..iteration_reports import say
from ..solution.diagnostics import SingularArc, SingularChecks, Statistics
from ..solution.record import Solution
from ..transcription.diagnosis import Diagnosis
from .end_conditions import EndConditions, points_at_ends
from .gauss_newton import ShootingResult, meet_conditions
from .least_squares import least_squares
from .legendre_clebsch import generalised_legendre_clebsch
from .segments import Iterate, Nodes, Pair, Shooting, StepwiseGauge
from .verification import Stationarity, find_end_violation, find_violation, stationarity

MOST_SEGMENTS = 12  # segments of multiple shooting, so that its system stays small


def solve_on_final_manifold(inputs: Inputs, c: Classification) -> Solution:
    """An interior singular extremal between two boundary conditions, by multiple shooting on ``P_f``, piece after
    piece.

    Without an integrator the classification chooses one, and gauge controls are the unknowns of least norm, constant on
    every step. Raises ``InvalidInputError`` if the data of one end contradict the equations of ``P_f``.
    """
    conditions = EndConditions(inputs.problem, *inputs.conditions_of(0)).in_units_of(c)
    if inputs.integrator is not None or not c.stratified:
        return _on_piece(inputs, conditions, c)
    failed, refused = list[Solution](), list[str]()
    for i in range(len(c.strata)):
        try:
            solution = _on_piece(inputs, conditions, c.choose(i))
        except InvalidInputError as error:
            refused.append(f"piece {i} of P_f: {error}")
            continue
        if solution.success or solution.statistics.stopped:
            return solution
        failed.append(solution)
    if failed:
        return failed[0]
    raise InvalidInputError("\n".join(refused))


def _on_piece(inputs: Inputs, conditions: EndConditions, c: Classification) -> Solution:
    """An extremal on the first piece of ``P_f``."""
    shown = partial(say, inputs.options.callback)
    if inputs.integrator is None:
        shown(f"an integrator on P_f, of dimension {c.dimension}, is chosen, and compiled; integrator=... saves it")
    shooting, strategy = _shooting(inputs, c)
    shown("points of P_f are looked for that meet the ends")
    first, last = points_at_ends(c, conditions, inputs.discretization.retraction)
    _require_choice(conditions, c)
    guess = Iterate(_first_points(shooting, c, inputs, first, last), _no_gauge(shooting, c, inputs.integrator))
    prepared = time.perf_counter()
    shown(f"shooting over {plural(shooting.segments, 'segment')} of {plural(shooting.length, 'step')} is compiled")
    options = inputs.options
    found = meet_conditions(shooting, conditions, guess, options.tolerance, options.max_iterations, options.callback)
    shown("the trajectory is examined")
    outcome: Any = jax.device_get(
        _trajectory_of()(shooting, c.equations, shooting.trajectory(found.iterate, found.at.nodes))
    )
    seconds = prepared - inputs.began, time.perf_counter() - prepared
    with np.errstate(all="ignore"):  # what is not finite is judged
        arc = _arc(inputs, c, shooting, strategy, found, outcome)
        return _record(inputs, conditions, arc, shooting, found, outcome, seconds)


def _require_choice(conditions: EndConditions, c: Classification) -> None:
    """Raise where ends are prescribed, and every curve between them is an extremal.

    ``P_f`` on which all controls are free is left by no control. All curves from a point of it are extremals then, and
    the cost is stationary at each of those that end in one point: it is the same for all that can be deformed into each
    other.
    """
    parts = *conditions.start.parts, *conditions.end.parts
    which = "the control is" if c.gauge_controls == 1 else f"all {c.gauge_controls} controls are"
    if c.gauge_controls == conditions.problem.controls.dimension and all(part.fixed for part in parts):
        raise InvalidInputError(
            f"{which} free on P_f, of dimension {c.dimension}: every curve from start to end is an extremal, all of "
            "them cost the same, as where the running cost is a total derivative along the dynamics, and none is the "
            "solution; expected a cost that tells them apart, such as one with u @ u / 2 added"
        )


def _shooting(inputs: Inputs, c: Classification) -> tuple[Shooting, str]:
    """Segments of about one twelfth of the steps; a single one where nodes leave ``P_f``, or a given gauge counts the
    time.

    With the choice of the integrator in words.
    """
    length, h = -(-inputs.steps // min(MOST_SEGMENTS, inputs.steps)), jnp.asarray(inputs.h)
    integrator = inputs.integrator
    if integrator is None:
        unknown = _unknown_gauge(c)
        still = StepwiseGauge(jnp.zeros((length, unknown)), h, float(inputs.discretization.theta))
        method, choice = singular_integrator(c, inputs.discretization, gauge=still if unknown else None)
    else:
        method, choice = integrator, f"{type(integrator).__name__}, as given"
    if not method.keeps_nodes or (integrator is not None and c.gauge_controls):
        length = inputs.steps
    return Shooting(inputs.problem, method, c.manifold, h, inputs.steps, length), str(choice)


def _no_gauge(shooting: Shooting, c: Classification, integrator: SingularIntegrator | None) -> Array:
    """Gauge controls of all steps, zero; none if the integrator has a gauge of its own."""
    return jnp.zeros((shooting.segments, shooting.length, _unknown_gauge(c) if integrator is None else 0))


def _unknown_gauge(c: Classification) -> int:
    """The number of gauge controls that are unknowns of the shooting.

    Where ``omega_f`` has no kernel, controls are redundant: none moves the trajectory, and the control of least norm is
    as good as any other.
    """
    return c.gauge_controls if c.first_class or not isinstance(c.problem.controls, Euclidean) else 0


def _first_points(shooting: Shooting, c: Classification, inputs: Inputs, first: Pair, last: Pair) -> Pair:
    """Points of ``P_f`` near the guess, or near the curve of the retraction, with costates between the costates at the
    ends."""
    at = shooting.length * np.arange(shooting.segments)
    known = inputs.guess_of(0)
    if known is None:
        states = default_guess(inputs.problem, inputs.discretization, first[0], last[0], inputs.steps).states
        fractions = at / inputs.steps
        costates = jax.tree.map(lambda a, b: _blend(fractions, a, b), first[1], last[1])
    else:
        states, costates = known.states, vec.entries(known.costates, at)
    states = vec.entries(states, at)
    points = _near_final(inputs.problem.manifold, c.equations, states, costates)
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(jax.device_get(points))):
        raise InvalidInputError(
            "no points of P_f found near the guess of the trajectory; pass a guess with states and costates near P_f, "
            "for instance along integrate(problem, method, ...), where method, choice = "
            "singular_integrator(classification, discretization)"
        )
    return points


def _blend(fractions: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    s = fractions.reshape(-1, *[1] * a.ndim)
    return (1 - s) * a + s * b


@compile_function
def _near_final(manifold: Manifold, equations: FinalEquations, states: Ambient, costates: Ambient) -> Pair:
    """States with costates moved to where they violate the equations of ``P_f`` least."""

    def one(q: Ambient, p: Ambient) -> Pair:
        frame = manifold.basis(q)
        c, _ = least_squares(lambda c: equations((q, vec.combine(frame, c))), vec.components(frame, p))
        return q, vec.combine(frame, c)

    return jax.vmap(one)(states, costates)


class _ShootingTrajectory(NamedTuple):
    """An iterate: nodes, stages, cost, the largest violation of the equations of ``P_f`` at the nodes, and
    ``dH/du``."""

    nodes: Pair
    stages: Pair
    controls: Any
    cost: Array
    residual: Array
    stationarity: Stationarity


def _at_stages(shooting: Shooting, nodes: Nodes) -> Any:
    """The controls at the stages, between the controls of an integrator at the ends of its steps."""
    integrator, theta = shooting.integrator, shooting.integrator.lift.theta
    if integrator.control_times == theta:
        return nodes.controls
    begin = integrator.begin(shooting.problem, *vec.entries(nodes.z, 0))
    controls = jnp.concatenate([integrator.control(begin)[None], nodes.controls])
    return (1 - theta) * controls[:-1] + theta * controls[1:]


@lru_cache
def _trajectory_of() -> Callable[..., _ShootingTrajectory]:
    """States at the stages are base points of the discretization map between the nodes."""

    def outcome(shooting: Shooting, equations: FinalEquations, nodes: Nodes) -> _ShootingTrajectory:
        problem, discretization = shooting.problem, shooting.integrator.lift.discretization
        z, controls = nodes[0], _at_stages(shooting, nodes)
        before, after = (vec.entries(z[0], s) for s in (slice(None, -1), slice(1, None)))
        states, _ = jax.vmap(discretization.preimage)(before, after)
        stage = ControlStage(problem=problem, discretization=discretization, step=shooting.step)
        cost = jnp.sum(jax.vmap(stage.cost)((states, controls)))
        cost = cost + problem.final_cost(vec.entries(z[0], -1))
        residual = vec.largest(jax.vmap(equations)(z))
        first, last = (vec.entries(z, s) for s in (slice(None, -1), slice(1, None)))
        stages = states, jax.vmap(stage.covector)((states, controls), first[1], last[1])
        claims = stationarity(problem, (first, stages, last), controls)
        return _ShootingTrajectory(z, stages, controls, cost, residual, claims)

    return compile_function(outcome)


def _diagnostics(problem: OptimalControlProblem, outcome: _ShootingTrajectory) -> Any:
    """The values at the nodes, and the diagnostics of the trajectory."""
    state, control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
    first, second, states, costates = (state.rows(part, 1)[None] for part in (*outcome.nodes, *outcome.stages))
    stages = states, control.rows(outcome.controls, 1)[None], costates
    with np.errstate(all="ignore"):  # of an iterate that is no solution
        diagnosis = Diagnosis(problem, None, AutomaticEvaluator())
        nodes, given = diagnosis.at_nodes(first, second), np.zeros((1, 0))
        found = diagnosis.of(nodes, diagnosis.along(stages, given), stages, given)
    return vec.entries((nodes, found), 0)


def _judge(
    inputs: Inputs,
    conditions: EndConditions,
    method: SingularIntegrator,
    found: ShootingResult,
    outcome: _ShootingTrajectory,
) -> Status:
    """The status of the iteration, and of every claim where it is evaluated."""
    if found.result != Result.successful:
        return shooting_status(found.result, "", "")
    stage_times = float(inputs.h) * (np.arange(inputs.steps) + inputs.discretization.theta)
    broken = find_violation(inputs.problem, method, stage_times, outcome.stationarity, float(outcome.residual))
    broken = broken or find_end_violation(conditions, found.ends, *outcome.nodes)
    energy = Energy(method.energy, inputs.problem, method.retraction)
    jumps = [] if broken else energy.find_jumps(Segments.between(*vec.taken((outcome.nodes, outcome.controls), None)))
    return shooting_status(found.result, broken, jumps[0].words() if jumps else "")


def _record(
    inputs: Inputs,
    conditions: EndConditions,
    arc: SingularArc,
    shooting: Shooting,
    found: ShootingResult,
    outcome: _ShootingTrajectory,
    seconds: tuple[float, float],
) -> Solution:
    (states, costates), controls = outcome.nodes, outcome.controls
    nodes, diagnostics = _diagnostics(inputs.problem, outcome)
    times = np.linspace(0.0, float(inputs.h) * inputs.steps, inputs.steps + 1)
    return Solution(
        times=times,
        states=states,
        costates=costates,
        stage_times=times[:-1] + inputs.discretization.theta * float(inputs.h),
        stage_states=outcome.stages[0],
        stage_costates=outcome.stages[1],
        controls=controls,
        hamiltonians=diagnostics.hamiltonians,
        momenta=diagnostics.momenta,
        body_costates=nodes.body,
        spatial_costates=nodes.spatial,
        cost=float(outcome.cost),
        **_judge(inputs, conditions, shooting.integrator, found, outcome)._asdict(),
        checks=SingularChecks.of(
            diagnostics,
            defect=max(float(found.at.distance), *arc.conditions.values()),
            stationarity=float(outcome.residual),
        ),
        statistics=Statistics(found.iterations, *seconds, bool(found.result == Result.stopped)),
        singular=arc,
        interpolant=inputs.reader.mesh.interpolant,
        parameters=copy_parameters(inputs.known.parameters),
        quantities=inputs.problem.quantities,
    )


def _arc(
    inputs: Inputs,
    c: Classification,
    shooting: Shooting,
    strategy: str,
    found: ShootingResult,
    outcome: _ShootingTrajectory,
) -> SingularArc:
    """The record of the singular arc."""
    return SingularArc(
        dimension=c.dimension,
        kernel=c.first_class,
        gauge_controls=c.gauge_controls,
        strategy=strategy,
        presymplectic=shooting.integrator.presymplectic,
        conditions={name: float(value) for name, value in found.ends.violations.items()},
        independent=found.independent,
        second_order=generalised_legendre_clebsch(
            inputs.problem, vec.entries(outcome.nodes, slice(-1)), outcome.controls
        ),
    )
