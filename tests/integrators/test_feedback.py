"""Feedback along extremals, against solves from disturbed starts, Riccati equations and rotation vectors."""

from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import SE, SO, DomainError, Euclidean, InvalidInputError, Sphere, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Exponential, Gauss, Midpoint, Projection, default_retraction
from scipy.linalg import solve_continuous_are
from scipy.spatial.transform import Rotation

from .problems import INERTIA, REST, RIGID, rotation

SPHERE, SE3, LINE, PLANE = Sphere(2), SE(3), Euclidean(1), Euclidean(2)
SIZES = 2e-2, 1e-2, 5e-3
SYSTEM, INPUT = np.array([[0.0, 1.0], [0.5, -0.3]]), np.array([[0.0], [1.0]])
WEIGHT, PRICE = np.diag([2.0, 0.5]), 0.4


def effort(q, u):
    return u @ u / 2


def body(q, u):
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def drifting(q, u):
    return jnp.cross(u + jnp.array([0.0, 0.3, 0.4]), q)


def craft(q, u):
    """A pose, with its twist as control."""
    return q @ SE3.hat(u)


def block(q, u):
    return jnp.stack([q[1], u[0]])


def regulated(q, u):
    return q @ WEIGHT @ q / 2 + PRICE * u @ u / 2


SLEW = OptimalControlProblem(RIGID, body, effort, 3)
POINTED = OptimalControlProblem(
    SPHERE,
    drifting,
    lambda q, u: u @ u / 2 + 0.3 * q[2] ** 2,
    3,
    terminal_cost=lambda q: q[0] ** 3 + 2 * (q[1] - 0.5) ** 2,
)
WAVE = OptimalControlProblem(
    SPHERE,
    lambda q, u, t: jnp.cross(u + jnp.array([0.0, 0.3 * jnp.sin(2 * t), 0.4]), q),
    lambda q, u, t: u @ u / 2 + 0.3 * jnp.cos(t) * q[2] ** 2,
    3,
    terminal_cost=lambda q, t: t * q[0] ** 3 + 2 * (q[1] - 0.5) ** 2,
    time_dependent=True,
)
DOCKED = OptimalControlProblem(SE3, craft, lambda q, u: u @ u / 2 + u[0] * u[4] / 4, 6)
TURN = (np.eye(3), REST), (rotation([0.5, 0.3, -0.8]), REST)


def pose(turn, place):
    return np.asarray(SE3.pose(rotation(turn), np.array(place)))


CASES = {
    "SO3 x R3": (SLEW, Midpoint(default_retraction(RIGID)), 6, *TURN, 2.0, (0, 2)),
    "S2": (POINTED, Midpoint(Projection(SPHERE)), 6, np.array([1.0, 0, 0]), None, 1.5, (0, 3)),
    "S2 by Gauss": (POINTED, Gauss(2, Exponential(SPHERE)), 5, np.array([1.0, 0, 0]), None, 1.5, (0, 3)),
    "S2 in explicit time": (WAVE, Midpoint(Projection(SPHERE)), 6, np.array([1.0, 0, 0]), None, 1.5, (0, 3)),
    "SE3": (
        DOCKED,
        Midpoint(default_retraction(SE3)),
        5,
        np.eye(4),
        pose([0.4, -0.5, 0.6], [1, 0.3, -0.5]),
        1.0,
        (0, 3),
    ),
    "SE3 by Gauss": (
        DOCKED,
        Gauss(2, Exponential(SE3)),
        4,
        np.eye(4),
        pose([0.4, -0.5, 0.6], [1, 0.3, -0.5]),
        1.0,
        (0, 2),
    ),
    "SO3 x R3 by Gauss": (SLEW, Gauss(2, default_retraction(RIGID)), 5, *TURN, 2.0, (0, 3)),
}
USUAL = "SO3 x R3", "S2", "S2 in explicit time", "SE3"


def slopes(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("name", [n if n in USUAL else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
@pytest.mark.usual(1)
def test_controls_and_costs_are_those_of_solves_from_disturbed_starts(name):
    problem, method, steps, start, end, horizon, nodes = CASES[name]
    solver, manifold, draw = Solver(problem, method, steps), problem.manifold, np.random.default_rng(3)
    solution = solver.solve(start, end, horizon, tolerance=1e-12)
    feedback = solver.feedback(solution)
    for k in nodes:
        q, p, t = *(jax.tree.map(itemgetter(k), part) for part in (solution.q, solution.p)), solution.t[k]
        rest = solver.with_steps(steps - k)
        begin = {"start_time": t} if problem.time_dependent else {}
        base = rest.solve(q, end, horizon - t, tolerance=1e-12, **begin)
        way = draw.standard_normal(manifold.dimension)
        way /= np.linalg.norm(way)
        of_control, of_cost = [], []
        for size in SIZES:
            step = vec.combine(manifold.basis(q), jnp.asarray(size * way))
            aside = jax.tree.map(np.asarray, method.retraction(q, step))
            other = rest.solve(aside, end, horizon - t, guess=base, tolerance=1e-12, **begin)
            of_control.append(np.max(np.abs(feedback(t, aside) - other(other.t[0]).controls)))
            known = base.cost - float(vec.pairing(p, step)) + size**2 * way @ feedback.cost_hessians[k] @ way / 2
            of_cost.append(abs(other.cost - known))
        moved = np.max(np.abs(other(other.t[0]).controls - solution(t).controls))
        assert of_control[-1] < 0.1 * moved
        np.testing.assert_allclose(slopes(of_control), 2.0, atol=0.15)
        np.testing.assert_allclose(slopes(of_cost), 3.0, atol=0.2)


def test_middle_of_a_long_horizon_has_the_gains_of_the_algebraic_riccati_equation():
    problem = OptimalControlProblem(PLANE, lambda q, u: SYSTEM @ q + INPUT @ u, regulated, 1)
    expected = solve_continuous_are(SYSTEM, INPUT, WEIGHT, PRICE * np.eye(1))
    gain = -INPUT.T @ expected / PRICE
    of_cost, of_gain = [], []
    solver = Solver(problem, Gauss(2, Exponential(PLANE)), 60)
    for steps in (60, 120):
        own = solver.with_steps(steps)
        feedback = own.feedback(own.solve(np.array([1.0, 0.0]), np.zeros(2), 20.0))
        of_cost.append(np.max(np.abs(feedback.cost_hessians[steps // 2] - expected)))
        found = [feedback(10.0, e) - feedback(10.0, np.zeros(2)) for e in np.eye(2)]
        of_gain.append(np.max(np.abs(np.stack(found, axis=1) - gain)))
    # A Cayley transform of the Hamiltonian system has the same stable subspace, so that P is exact for any step.
    assert max(of_cost) < 1e-8
    assert slopes(of_gain)[0] > 1.7
    assert of_gain[-1] < 2e-2


def test_gains_toward_a_prescribed_end_are_those_of_the_closed_form():
    problem = OptimalControlProblem(LINE, lambda q, u: u, effort, 1)
    solver = Solver(problem, Midpoint(Exponential(LINE)), 8)
    feedback = solver.feedback(solver.solve(0.0, 1.0, 2.0))
    left = 2.0 - feedback.times[:-1]
    np.testing.assert_allclose(feedback.gains[:, 0, 0], -1 / left, rtol=1e-10)
    np.testing.assert_allclose(feedback.cost_hessians[:-1, 0, 0], 1 / left, rtol=1e-10)
    assert feedback.until == feedback.times[-2]
    np.testing.assert_allclose(feedback(0.5, np.array([1.0])), 0.5 - 0.75 / 1.5, atol=1e-10)
    np.testing.assert_allclose(feedback(1.9, np.array([5.0])), 0.5, atol=1e-10)  # no later correction is possible


def test_feedback_turns_the_shortest_way_and_says_where_there_is_none():
    group = SO(3)
    problem = OptimalControlProblem(group, lambda q, u: q @ hat(u), effort, 3)
    solver = Solver(problem, Midpoint(default_retraction(group)), 4)
    feedback = solver.feedback(solver.solve(np.eye(3), np.eye(3), 1.0))
    angles = np.deg2rad([170.0, 179.0, 181.0, 190.0, -179.0])
    states = np.stack([rotation([0, 0, angle]) for angle in angles])
    found = feedback(0.0, states)
    back = -Rotation.from_matrix(states).as_rotvec()
    np.testing.assert_allclose(found, back, rtol=1e-6, atol=1e-8)  # the gain is -1 / (T - t)
    with pytest.raises(DomainError, match="half a turn"):
        feedback(0.0, np.diag([-1.0, -1.0, 1.0]))


@pytest.mark.parametrize("method", [Midpoint(Exponential(PLANE)), Gauss(2, Exponential(PLANE))], ids=["one", "two"])
def test_active_torque_limits_have_no_gain(method):
    problem = OptimalControlProblem(PLANE, block, regulated, 1, control_bounds=(-1.0, 1.0))
    solver = Solver(problem, method, 20)
    solution = solver.solve(np.array([2.0, 0.0]), None, 5.0)
    feedback = solver.feedback(solution)
    held = np.abs(solution.u[:, 0]) > 1 - 1e-6
    assert 2 < np.sum(held) < len(held) - 5
    assert np.all(feedback.gains[held] == 0.0)
    assert np.all(np.any(feedback.gains[~held] != 0.0, axis=(1, 2)))
    free = int(np.flatnonzero(~held)[0]) // method.stages + 2
    draw = np.random.default_rng(0)
    states = solution(np.linspace(0, 5, 40)).states + 2 * draw.standard_normal((30, 40, 2))
    controls = feedback(np.linspace(0, 5, 40), states)
    assert controls.shape == (30, 40, 1)
    assert np.all(np.abs(controls) <= 1.0)
    for k in (0, free):  # linear beside an inactive bound, with no gain beside an active bound
        aside = solution.q[k] + np.array([1e-3, -2e-3])
        other = solver.with_steps(20 - k).solve(aside, None, 5.0 - solution.t[k], tolerance=1e-12)
        first, moved = other(0.0).controls, np.abs(other(0.0).controls - solution(solution.t[k]).controls)
        np.testing.assert_allclose(feedback(solution.t[k], aside), np.clip(first, -1, 1), atol=1e-8)
        assert moved > 1e-4 or k == 0


def test_active_state_constraint_is_held():
    limits = {"speed": lambda q: -0.6 - q[1]}
    problem = OptimalControlProblem(PLANE, block, regulated, 1, node_constraints=limits)
    method, steps = Midpoint(Exponential(PLANE)), 20
    solver = Solver(problem, method, steps)
    solution = solver.solve(np.array([2.0, 0.0]), None, 5.0, tolerance=1e-12)
    feedback, held = solver.feedback(solution), np.abs(solution.q[:, 1] + 0.6) < 1e-6
    assert 2 < np.sum(held) < steps - 5
    for k in (0, int(np.flatnonzero(held)[0]), int(np.flatnonzero(held)[-1]) + 2):
        aside = solution.q[k] + np.array([1e-3, 5e-4])
        other = solver.with_steps(steps - k).solve(aside, None, 5.0 - solution.t[k], tolerance=1e-12)
        np.testing.assert_allclose(feedback(solution.t[k], aside), other.u[0], atol=1e-7)
        assert np.abs(other.u[0] - solution.u[k]) > 1e-3


def test_a_free_horizon_and_free_parameters_keep_the_values_that_were_found():
    """The law is that of the solution with these values, from a time of its own on."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, t, mass: jnp.stack([q[1], (u[0] + 0.1 * jnp.sin(t)) / mass]),
        lambda q, u, t, mass: 1 + u @ u / 2 + (mass - 2) ** 2,
        1,
        time_dependent=True,
    )
    solver, ends = Solver(problem, Midpoint(Exponential(PLANE)), 8), ([0.0, 0.0], [1.0, 0.0])
    found = solver.solve(*ends, Free(2.0), parameters=Free(1.5), start_time=0.5)
    fixed = solver.solve(*ends, found.horizon, parameters=found.parameters, start_time=0.5)
    law, other = solver.feedback(found), solver.feedback(fixed)
    np.testing.assert_allclose(law.times, other.times, rtol=1e-7)
    assert law.until == pytest.approx(other.until, rel=1e-7)
    assert 0.5 < law.until < found.t[-1]
    last = np.searchsorted(law.times, law.until) + 1
    np.testing.assert_allclose(law.gains[:last], other.gains[:last], rtol=1e-5)
    np.testing.assert_allclose(law.cost_hessians[:last], other.cost_hessians[:last], rtol=1e-5)
    aside = found.q[2] + [0.01, -0.02]
    assert law(found.t[2], aside) == pytest.approx(other(fixed.t[2], aside), rel=1e-6)


def test_what_has_no_feedback_is_named():
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: 1 + u @ u / 2, 1)
    solver = Solver(problem, Midpoint(Exponential(LINE)), 4)
    found = solver.solve(0.0, 1.0, 2.0)
    with pytest.raises(InvalidInputError, match="this solver found"):
        Solver(problem, Midpoint(Exponential(LINE)), 4).feedback(found)
    feedback = solver.feedback(found)
    with pytest.raises(InvalidInputError, match="outside the horizon"):
        feedback(3.0, 0.0)
    with pytest.raises(InvalidInputError, match="point of"):
        feedback(1.0, np.zeros(3))
