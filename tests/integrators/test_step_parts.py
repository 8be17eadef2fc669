"""Parts of steps, of their records and of what is decided by them, one by one: what no trajectory as a whole shows at
once."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.automatic import AutomaticEvaluator, XlaEvaluator
from retrax.compute.tape_evaluator import TapeEvaluator
from retrax.integrators import (
    KAHAN_LI_6,
    KAHAN_LI_8,
    SUZUKI,
    TRIPLE_JUMP,
    YOSHIDA_6,
    Composition,
    Guess,
    Integrator,
    OptimalControlProblem,
    Solution,
    SwitchingStructure,
    solve,
    step_errors,
)
from retrax.integrators.boundary_value.audit.switching_structure import control_arcs
from retrax.integrators.boundary_value.reformulations.switching_arcs import SwitchingArcs
from retrax.integrators.boundary_value.transcription.functions.collocation import CollocationFunctions
from retrax.integrators.boundary_value.transcription.iterate import Data
from retrax.integrators.initial_value.step import StepEquations, StepResult, restore
from retrax.integrators.problem_checks.control_probing import flat_directions
from retrax.integrators.stages import CollocationStage, ControlStage, HamiltonianStage
from retrax.manifolds import SO, Euclidean, Sphere
from retrax.manifolds.numerics.tolerances import EPS, REGULAR
from retrax.retractions import Addition, Gauss, Midpoint, Projection, Theta

from tests.support.numerics import compiled

LINE, PLANE, SPHERE = Euclidean(1), Euclidean(2), Sphere(2)
THETAS = [0.0, 0.3, 0.5, 1.0]


def half_square(q, u):
    return u @ u / 2


INTEGRATOR = OptimalControlProblem(LINE, lambda q, u: u, half_square, 1)


@pytest.mark.parametrize("theta", THETAS)
def test_stages_of_a_record_are_at_theta(theta):
    solution = solve(
        INTEGRATOR, np.zeros(1), np.ones(1), 1.0, method=Theta(Addition(LINE), theta), steps=[0.2, 0.5, 0.3]
    )
    np.testing.assert_allclose(solution.stage_times, [0.2 * theta, 0.2 + 0.5 * theta, 0.7 + 0.3 * theta], atol=1e-15)
    np.testing.assert_allclose(solution.stage_states[:, 0], solution.stage_times, atol=1e-14)


@pytest.mark.parametrize(
    ("weights", "order"), [(TRIPLE_JUMP, 4), (SUZUKI, 4), (YOSHIDA_6, 6), (KAHAN_LI_6, 6), (KAHAN_LI_8, 8)], ids=str
)
def test_weights_of_compositions_meet_the_order_conditions_of_one_power(weights, order):
    """Sums of odd powers of the weights vanish [Hairer, Lubich, Wanner 2006, V.3.2]; those of Yoshida have 14
    digits."""
    w = np.array(weights)
    for power in range(3, order, 2):
        assert abs(np.sum(w**power)) < (1e-12 if weights == YOSHIDA_6 else 1e-14) * np.sum(np.abs(w) ** power)


class Forward(Integrator):
    """Steps of the line that are solved forward in time only."""

    manifold = LINE
    control_times = np.zeros(())

    def check(self, system: Any, q: Any, p: Any) -> None: ...

    def begin(self, system: Any, q: Any, p: Any) -> Any:
        return q

    def control(self, unknowns: Any) -> Any:
        return unknowns

    def step(self, system: Any, h: Any, q: Any, p: Any, previous: Any) -> StepResult:
        return StepResult(q + h, p, q, jnp.asarray(h > 0))


@pytest.mark.parametrize(("weights", "solved"), [((0.5, 0.5), True), (SUZUKI, False), (TRIPLE_JUMP, False)], ids=str)
def test_a_composition_fails_with_any_of_its_substeps(weights, solved):
    integrator, start = Composition(Forward(), weights), (jnp.zeros(1), jnp.zeros(1))
    new = integrator.step(None, 1.0, *start, integrator.begin(None, *start))
    assert bool(new.converged) == solved
    np.testing.assert_allclose(new.q, 1.0, atol=1e-15)


def test_a_step_ends_on_the_manifold_from_beside_it():
    rotations = SO(3)
    beside = jnp.eye(3) + 1e-9 * jnp.array([[1.0, 2.0, 0.0], [2.0, -1.0, 3.0], [0.0, 3.0, 0.5]])
    covector = rotations.projection(beside, jnp.arange(9.0).reshape(3, 3))
    new = restore(rotations, StepResult(beside, covector, None, jnp.array(True)))
    assert rotations.contains(new.q, 1e-15)
    assert rotations.is_tangent(new.q, new.p, 1e-15)


def pendulum(theta: float, h: float) -> HamiltonianStage:
    return HamiltonianStage(lambda q, p: p @ p / 2 + q[2], Theta(Projection(SPHERE), theta), h)


TURNED = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3)
PREDICTED = {
    **{f"theta {theta}": lambda h, theta=theta: pendulum(theta, h) for theta in THETAS},
    **{f"control, theta {t}": lambda h, t=t: ControlStage(TURNED, Theta(Projection(SPHERE), t), h) for t in THETAS},
    "Gauss": lambda h: CollocationStage.of_problem(TURNED, Gauss(2, Projection(SPHERE)), h),
}


@pytest.mark.parametrize("kind", PREDICTED)
@pytest.mark.usual(2)
def test_predicted_stages_begin_where_the_step_does(kind):
    """To second order in the step, wherever the base point is."""
    q, p, u = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.4, 1.0, -0.3]), jnp.array([0.5, -1.0, 0.7])
    missed = []
    for h in (1e-2, 1e-3):
        stage = PREDICTED[kind](h)
        before = {ControlStage: (q, u), HamiltonianStage: (q, p, p)}.get(type(stage)) or stage.begin(q, p, u)
        missed.append(np.max(np.abs(stage.ends(stage.predict(q, p, before))[0] - q)))
    assert missed[0] < 1e-3
    assert missed[1] < max(missed[0] / 80, 1e-15)


@pytest.mark.parametrize("theta", THETAS)
def test_the_inverse_of_small_steps_is_that_of_the_equations(theta):
    stage = HamiltonianStage(lambda q, p: p @ p / 2 + q @ q, Theta(Addition(PLANE), theta), 0.0)
    z = jnp.array([0.3, -0.2]), jnp.array([0.5, 0.1])
    equations = StepEquations.near(stage, *z, (*z, z[1]))
    jacobian = compiled(jax.jacfwd(lambda c: equations.residual(c, *z)))(equations.first)
    np.testing.assert_allclose(stage.small_step_inverse() @ jacobian, np.eye(8), atol=1e-14)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3])
def test_directions_are_flat_through_the_power_of_the_rounding(share):
    """``[[1, 1], [1, 1 + 2 d]]`` has an eigenvalue near ``d``; along ``(1, -1)`` it is rounding below
    ``eps^REGULAR``."""
    curvatures = np.zeros((2, 2, 2))
    curvatures[0] = np.array([[1.0, 1.0], [1.0, 1.0 + 2 * share * EPS**REGULAR]])
    found = flat_directions(np.zeros((2, 2)), curvatures)
    assert len(found) == (share < 1)
    if len(found):
        np.testing.assert_allclose(np.abs(found[0] @ [1, 1]), 0.0, atol=1e-9)


def test_points_are_guessed_between_the_costates_of_the_nodes():
    method = Gauss(3, Addition(LINE))
    steps = CollocationFunctions(INTEGRATOR, method, None, AutomaticEvaluator())
    times = np.arange(3)[None, :, None] + 0.0
    between = (np.arange(2)[:, None] + method.nodes)[None, ..., None]
    data = Data(np.ones((1, 2)), np.zeros((1, 0)), None)
    begun = steps.begin(between, np.ones_like(between), 5 - 2 * times, data)
    np.testing.assert_allclose(begun.costates, 5 - 2 * between, atol=1e-14)
    np.testing.assert_allclose(begun.velocities, 1.0, atol=1e-14)


def test_the_gap_has_the_defects_of_the_points():
    """A guess whose steps meet, and whose velocities are not those of the controls."""
    nodes, stages, seen = np.linspace(0, 1, 4)[:, None], np.zeros((6, 1)), []
    states = (np.repeat(np.arange(3), 2) + np.tile(Gauss(2, Addition(LINE)).nodes, 3))[:, None] / 3
    guess = Guess(states, stages, np.zeros((4, 1)), nodes, stages)
    solution = solve(
        INTEGRATOR,
        nodes[0],
        nodes[-1],
        1.0,
        method=Gauss(2, Addition(LINE)),
        steps=3,
        guess=guess,
        callback=lambda seen_: seen.append(seen_),
    )
    assert seen[0].defect[0] == pytest.approx(1 / 3)  # of the way, that of each step
    assert solution.checks.defect < 1e-12


def test_steps_of_a_flat_space_are_followed_whole():
    """Points of a plane that begin on one circle do not stay there: a linear problem takes one step, however long it
    is."""
    problem = OptimalControlProblem(PLANE, lambda q, u: u + jnp.array([0.0, 1e3]) * q[0], half_square, 2)
    angles = np.linspace(0, np.pi / 2, 9)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    guess, seen = Guess(circle[1::2], np.zeros((4, 2))), []
    solve(
        problem,
        circle[0],
        circle[-1],
        1.0,
        method=Midpoint(Addition(PLANE)),
        steps=4,
        guess=guess,
        callback=lambda one: seen.append(one),
    )
    assert np.max(np.abs(seen[-1].fraction)) == 1.0
    assert len(seen) <= 3


BOUNDED = OptimalControlProblem(LINE, lambda q, u: u, half_square, 1, control_bounds=(-1.0, 1.0))


@pytest.mark.parametrize("jump", [0.0, 0.01, 0.15, 0.19, 0.21, 0.3, 1.5])
def test_arcs_end_by_jumps(jump):
    """A control that stays at its bound to the middle and leaves it by a jump, or without; the room is 2, a tenth of it
    tells."""
    times = np.linspace(0, 1, 21)
    stages = (times[1:] + times[:-1]) / 2
    controls = np.where(stages < 0.5, 1.0, 1.0 - jump - 1e-3 * (stages - 0.5))[:, None]
    record = object.__new__(Solution)  # with what is looked at and nothing else
    vars(record).update(times=times, stage_times=stages, controls=controls)
    found = control_arcs(BOUNDED, record)
    assert found.arcs == (2 if jump > 0.2 else 1)
    if found.jumps:
        np.testing.assert_allclose(found.times, [0, 0.5, 1], atol=1e-15)
        assert found.sides[:, 0].tolist() == [1, 0]


@pytest.mark.parametrize("duration", [0.0, 1e-9, 9e-7, 1.1e-6, 1e-3])
def test_vanished_arcs_are_left_out(duration):
    structure = SwitchingStructure(np.array([0, 0.5, 0.5 + duration, 1]), np.array([[1], [0], [1]])).without_vanished()
    assert structure.sides[:, 0].tolist() == ([1] if duration < 1e-6 else [1, 0, 1])
    assert structure.times[[0, -1]].tolist() == [0, 1]


@pytest.mark.parametrize("share", [0.01, 0.5, 0.999])
def test_the_last_arc_lasts_what_the_others_leave_of_a_given_horizon(share):
    durations = 3.0 * share * np.array([0.25, 0.75])
    arcs = SwitchingArcs(BOUNDED, np.array([[1], [-1], [0]]), 3.0, 1.0)
    found = np.asarray(arcs.durations(jnp.asarray(durations)))
    np.testing.assert_array_equal(found[:2], durations)
    assert found[2] == pytest.approx(3.0 * (1 - share), rel=1e-12)


def test_errors_of_steps_do_not_depend_on_the_origin():
    found = []
    for origin in (0.0, 1e3):
        problem = OptimalControlProblem(LINE, lambda q, u, origin=origin: u + jnp.sin(3 * (q - origin)), half_square, 1)
        start = np.array([origin])
        solution = solve(problem, start, start + 1, 1.0, method=Midpoint(Addition(LINE)), steps=6)
        found.append(step_errors(problem, solution).states)
    assert np.min(found[0]) > 1e-6
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


@pytest.mark.parametrize("pull", [-50.0, 0.5, 0.99, 1.01, 2.0])
def test_the_curvature_of_a_terminal_cost_counts(pull):
    """``int u^2 / 2 dt - pull x(T)^2 / 2`` over a unit of time: rest at zero is least for a pull below 1 only."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, half_square, 1, terminal_cost=lambda q: -pull * q @ q / 2)
    guess = Guess(np.zeros((3, 1)), np.zeros((3, 1)))
    solution = solve(problem, np.zeros(1), None, 1.0, method=Midpoint(Addition(LINE)), steps=3, guess=guess)
    assert solution.checks.strict_minimum == (pull < 1)


@pytest.mark.parametrize("place", [-0.5, -0.01, 0.01, 0.5])
def test_the_curvature_of_boundary_constraints_counts(place):
    """Straight to the point (1, 0) of the unit circle: the nearest one from (a, 0) with a > 0, the farthest with a <
    0."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: u, half_square, 2, boundary_constraints={"circle": lambda a, b: b @ b - 1}
    )
    start, way = np.array([place, 0.0]), np.array([1 - place, 0.0])
    shares = np.array([[0.25], [0.75]])
    guess = Guess(start + shares * way, np.tile(way, (2, 1)), np.tile(way, (3, 1)))
    solution = solve(problem, start, None, 1.0, method=Midpoint(Addition(PLANE)), steps=2, guess=guess)
    np.testing.assert_allclose(solution.states[-1], [1.0, 0.0], atol=1e-12)
    assert solution.checks.strict_minimum == (place > 0)


def test_evaluators_have_the_same_derivatives():
    def function(d, x):
        y = x + jnp.outer(jnp.array([1.0, -2.0, 0.5]), d).sum(axis=1)
        return jnp.sin(y) @ y, (y**3, y[:2] * y[1:]), y[0] * d[1] + x[2]

    x = np.array([[0.3, -0.2, 0.7], [1.0, 0.5, -0.4]])
    found = (evaluator.derivatives(function, 2, 3)(x) for evaluator in (TapeEvaluator(), XlaEvaluator("of this test")))
    for mine, other in zip(*found, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-13, atol=1e-14)


def test_functions_that_compute_the_same_have_one_tape():
    def tape(factor, shape=tuple):
        return TapeEvaluator().values(lambda x: shape((jnp.sin(factor * x), x)), 2).tape

    assert tape(2.0) is tape(2.0)
    assert tape(2.0) is not tape(3.0)
    assert tape(2.0) is not tape(2.0, list)


def test_functions_of_equal_values_have_the_derivatives_of_their_own_rules():
    def with_slope(factor):
        function = jax.custom_jvp(lambda d: d[0] ** 2)
        function.defjvp(lambda at, along: (function(*at), factor * along[0][0]))
        return lambda d: (function(d), d)

    for factor in (2.0, 3.0):
        _, gradient, *_ = TapeEvaluator().derivatives(with_slope(factor), 1)(np.zeros((1, 0)))
        np.testing.assert_array_equal(gradient, [[factor]])


@pytest.mark.parametrize("height", [2.0, 5.0, 50.0])
def test_from_a_hill_it_goes_down(height):
    """``height (1 - x^2)^2`` has a hill at zero, where Newton's own steps lead back to, and wells at its sides."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: half_square(q, u) + height * (1 - q @ q) ** 2, 1)
    guess = Guess(np.full((10, 1), 0.1), np.zeros((10, 1)))
    solution = solve(problem, np.array([0.1]), None, 3.0, method=Midpoint(Addition(LINE)), steps=10, guess=guess)
    assert solution.states[-1, 0] > 0.9
    assert solution.checks.strict_minimum
