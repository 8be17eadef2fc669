"""Tracking problems, against the solutions that they follow and the regulators.

On the sphere with q' = u x q and a reference that turns with constant u, the deviation in turning coordinates is
a point of the sphere with q' = w x q. Its distance from a fixed point obeys e' = -w: the scalar regulator, at
any distance.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import retrax as rx
from retrax.integrators.closed_loop.reference import ReferencePath
from retrax.manifolds import DomainError, InvalidInputError
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

LINE, SPHERE, BODY = rx.Euclidean(1), rx.Sphere(2), rx.SO(3) * rx.Euclidean(3)
INERTIA, TURN = np.array([3.0, 2.0, 1.5]), np.array([0.2, -0.3, 0.9])
WEIGHT, PRICE, HORIZON = 3.0, 0.5, 1.5
RATE = np.sqrt(WEIGHT / PRICE)  # of the regulator
REST, TARGET = np.zeros(3), Rotation.from_rotvec([0.5, 1.0, -0.8]).as_matrix()
FIRST = np.array([1.0, 0.0, 0.0])


def regulated(deviation, horizon, gain=1.0):
    """The least cost of e' = -gain w from a deviation, for a cost of W e^2 and P w^2, by its Riccati equation."""
    return np.sqrt(WEIGHT * PRICE) / gain * np.tanh(gain * RATE * horizon) * deviation**2 / 2


def body(q, u):
    return q[0] @ rx.hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def solver_of(problem, steps=10, stages=3):
    return rx.Solver(problem, rx.Gauss(stages, rx.default_retraction(problem.manifold)), steps)


@cache
def turned():
    """A rigid body that turns with the least torque."""
    problem = rx.OptimalControlProblem(BODY, body, lambda q, u: u @ u / 2, 3)
    return problem, solver_of(problem).solve((np.eye(3), REST), (TARGET, REST), 2.0)


def on_sphere(times):
    """Points that turn from the first axis."""
    return Rotation.from_rotvec(np.multiply.outer(times, TURN)).apply(FIRST)


@cache
def sphere_problem():
    return rx.OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, 3)


def aside(point, deviation):
    """The point of the sphere at a distance from another one."""
    way = np.cross(point, [0.3, 0.5, -0.8])
    return np.cos(deviation) * point + np.sin(deviation) * way / np.linalg.norm(way)


@cache
def sphere_solver():
    """The solver that follows a point which turns, a table of 61 points in 3 s."""
    times = np.linspace(0, 3, 61)
    follow = rx.tracking(sphere_problem(), (times, on_sphere(times)), WEIGHT, PRICE, controls=np.tile(TURN, (61, 1)))
    return solver_of(follow)


@pytest.mark.slow
def test_following_a_solution_costs_nothing_and_has_its_controls():
    problem, solution = turned()
    follow = rx.tracking(problem, solution, weights=[1.0, 1.0, 1.0, 0.1, 0.1, 0.1], end_weights=2.0)
    found = solver_of(follow).solve((np.eye(3), REST), None, 2.0)
    assert found.status == "minimum"
    assert found.cost < 1e-20
    np.testing.assert_allclose(found.controls, solution.controls, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.states[0], solution.states[0], rtol=0, atol=1e-9)


def test_a_solver_of_a_problem_with_explicit_time_is_made_before_its_first_solve():
    timed = rx.OptimalControlProblem(LINE, lambda q, u, t: u, lambda q, u, t: u @ u / 2 + t, 1, time_dependent=True)
    found = solver_of(timed).solve([0.0], [1.0], 2.0)
    assert found.cost == pytest.approx(1 / 4 + 2)


@pytest.mark.slow
def test_a_table_of_a_solution_leads_near_to_it():
    problem, solution = turned()
    times = np.linspace(0, 2, 31)
    follow = rx.tracking(problem, (times, solution(times).states), controls=solution(times).controls)
    start = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix(), REST
    found = solver_of(follow).solve((np.eye(3), REST), None, 2.0)
    assert found.success
    assert found.cost < 1e-7
    table = times, solution(times).states
    follow = rx.tracking(problem, table, [50.0] * 3 + [1.0] * 3, 0.1, controls=solution(times).controls)
    away = solver_of(follow).solve(start, None, 2.0)
    apart = [np.linalg.norm(Rotation.from_matrix(a.T @ b).as_rotvec()) for a, b in
             zip(away.states[0], solution(away.times).states[0], strict=True)]  # fmt: skip
    assert away.success
    assert apart[0] == pytest.approx(0.2)
    assert max(apart[-3:]) < 0.02


@pytest.mark.parametrize("deviation", [0.0, 1e-6, 1e-3, 0.1, 1.0, 2.5])
@pytest.mark.usual(2)
def test_deviations_on_the_sphere_cost_as_the_regulator_says(deviation):
    found = sphere_solver().solve(aside(FIRST, deviation), None, HORIZON)
    assert found.status == "minimum"
    assert found.cost == pytest.approx(regulated(deviation, HORIZON), rel=2e-6, abs=1e-9)


@pytest.mark.parametrize("begin", [0.0, 0.37, 1.0, 1.5])
def test_a_reference_is_followed_from_a_start_time(begin):
    start = aside(on_sphere([begin])[0], 0.4)
    found = sphere_solver().solve(start, None, HORIZON, start_time=begin)
    assert found.cost == pytest.approx(regulated(0.4, HORIZON), rel=2e-6)


@pytest.mark.parametrize("gain", [0.5, 2.0])
@pytest.mark.usual(1)
def test_dynamics_keep_their_time_and_their_parameters(gain):
    problem = rx.OptimalControlProblem(
        LINE, lambda q, u, t, gain: gain * u + jnp.cos(t), lambda q, u, t: u @ u, 1, time_dependent=True,
        constraints={"near": lambda q, u, t: (q[0] - jnp.sin(t)) ** 2 - 1},
    )  # fmt: skip
    follow = rx.tracking(problem, lambda t: jnp.sin(t)[None], WEIGHT, PRICE)
    for begin in (0.0, 2.0):
        found = solver_of(follow).solve([np.sin(begin) + 0.3], None, HORIZON, parameters=gain, start_time=begin)
        assert found.success
        assert found.cost == pytest.approx(regulated(0.3, HORIZON, gain), rel=1e-7)


def test_the_end_has_a_weight_of_its_own():
    problem = rx.OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u, 1)
    follow = rx.tracking(problem, lambda t: jnp.ones(1), 0.0, 1.0, end_weights=4.0)
    found = solver_of(follow).solve([0.0], None, 1.0)
    assert found.u[0, 0] == pytest.approx(0.8)
    assert found.cost == pytest.approx(0.4)


def test_tables_are_followed_with_an_error_of_fourth_order():
    spline = RotationSpline([0, 1, 2, 3], Rotation.from_rotvec([[0, 0, 0], [1, 0.3, 0], [1, 1, 1], [0, 2, 0.5]]))
    swing = CubicSpline([0, 1, 2, 3], [[0, 0, 1], [1, 0, 0], [0, 2, 0], [1, 1, 1]])
    fine, errors = np.linspace(0.1, 0.9, 40), []
    for count in (8, 16, 32):
        times = np.linspace(0, 1, count)
        table = times, (spline(times).as_matrix(), swing(times))
        path = ReferencePath.through("the reference", rx.default_retraction(BODY), table, "nan")
        rotations, vectors = jax.vmap(path)(fine)
        errors.append(np.max(np.abs(rotations - spline(fine).as_matrix())))
        assert np.max(np.abs(vectors - swing(fine))) < 1e-12  # of a cubic
        assert np.max(np.abs(np.swapaxes(rotations, 1, 2) @ rotations - np.eye(3))) < 1e-13
        before, after = (jax.jvp(path, (times[3] + s,), (1.0,))[1][0] for s in (-1e-9, 1e-9))
        assert np.max(np.abs(before - after)) < 1e-6  # the velocity is continuous
    assert errors[0] / errors[1] > 11
    assert errors[1] / errors[2] > 11


def test_a_receding_horizon_follows_a_moving_point():
    controller = rx.RecedingHorizon(sphere_solver(), None, horizon=1.0)
    loop = rx.simulate(sphere_problem(), controller, aside(FIRST, 0.5), horizon=2.0, sample_time=0.1)
    assert controller.statistics.fallbacks == 0
    apart = np.arccos(np.clip(np.sum(loop.states * on_sphere(loop.times), axis=1), -1, 1))
    factor = np.cosh(RATE * 0.9) / np.cosh(RATE)  # of the regulator over one sample, from a plan of one second
    np.testing.assert_allclose(apart, 0.5 * factor ** np.arange(21), rtol=1e-3, atol=1e-5)


def test_a_receding_horizon_follows_with_noise():
    noise = 0.01

    def measure(q, t, rng):
        seen = q + noise * rng.normal(size=3)
        return seen / np.linalg.norm(seen)

    controller = rx.RecedingHorizon(sphere_solver(), None, horizon=1.0, hold=0.1, max_iterations=10)
    options = {"horizon": 2.0, "sample_time": 0.1, "measure": measure, "seed": 3}
    loop = rx.simulate(sphere_problem(), controller, aside(FIRST, 0.5), **options)
    apart = np.arccos(np.clip(np.sum(loop.states * on_sphere(loop.times), axis=1), -1, 1))
    assert controller.statistics.fallbacks == 0
    assert np.max(apart[10:]) < 5 * noise + 0.5 * np.exp(-RATE)


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.17])
def test_a_delay_is_made_up_for_in_the_time_of_the_loop(delay):
    """A current of 5 m/s turns three times a second; a state predicted at another time would be half a metre off."""
    problem = rx.OptimalControlProblem(
        LINE, lambda q, u, t: u + 5 * jnp.cos(3 * t), lambda q, u, t: u @ u / 2, 1, time_dependent=True
    )
    follow = rx.tracking(
        problem, lambda t: jnp.sin(t)[None], 1e4, 1.0, controls=lambda t: (jnp.cos(t) - 5 * jnp.cos(3 * t))[None]
    )
    controller = rx.RecedingHorizon(solver_of(follow), None, horizon=0.5, delay=delay)
    loop = rx.simulate(problem, controller, [0.0], horizon=1.2, sample_time=0.1, delay=delay)
    apart = np.abs(loop.states[:, 0] - np.sin(loop.times))
    assert controller.statistics.fallbacks == 0
    assert np.max(apart[6:]) < 1e-2


def test_after_its_end_a_reference_is_none_or_constant():
    problem = rx.OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    table = [0.0, 1.0], np.array([[0.0], [1.0]])
    found = solver_of(rx.tracking(problem, table)).solve([0.0], None, 2.0, throw=False)
    assert not found.success
    assert "running_cost is not finite" in found.result
    held = solver_of(rx.tracking(problem, table, WEIGHT, PRICE, outside="constant"))
    found = held.solve([0.8], None, HORIZON, start_time=1.0)
    assert found.cost == pytest.approx(regulated(0.2, HORIZON), rel=1e-7)


def test_controls_on_a_manifold_are_followed():
    problem = rx.OptimalControlProblem(LINE, lambda q, u: u[:1], lambda q, u: q @ q, rx.Sphere(1))
    times = np.linspace(0, 1, 21)
    controls = np.stack([np.cos(times), np.sin(times)], axis=1)
    follow = rx.tracking(problem, (times, np.sin(times)[:, None]), controls=controls)
    found = solver_of(follow).solve([0.0], None, 1.0)
    assert found.success
    assert found.cost < 1e-12
    with pytest.raises(InvalidInputError, match="no other default"):
        rx.tracking(problem, (times, np.sin(times)[:, None]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reference": 3.0}, "must be a Solution, a table"),
        ({"reference": ([0.0, 1.0], np.ones((2, 3)))}, "point 0 of the reference is not on"),
        ({"reference": ([0.0, 1.0], np.eye(3))}, "expected 2 points along the first axis"),
        ({"reference": ([1.0, 0.0], np.eye(3)[:2])}, "at least two numbers that increase"),
        ({"weights": [1.0, 2.0, 3.0]}, r"shape \(3,\), expected a number"),
        ({"weights": [1.0, -2.0]}, "positive semidefinite, got the weight -2"),
        ({"control_weights": [[0.0, 1.0, 0], [1.0, 0.0, 0], [0, 0, 0]]}, "control_weights must be positive"),
        ({"controls": np.zeros((2, 2))}, "expected"),
        ({"outside": "zero"}, 'must be "nan"'),
        ({"retraction": rx.default_retraction(LINE)}, "the retraction is in R"),
        ({"problem": 1}, "tracking takes an OptimalControlProblem"),
    ],
)
def test_other_arguments_raise_errors(changes, words):
    times = np.linspace(0, 1, 5)
    given = {"problem": sphere_problem(), "reference": (times, on_sphere(times))}
    with pytest.raises(InvalidInputError, match=words):
        rx.tracking(**given | changes)


def test_points_half_a_turn_apart_have_no_path():
    with pytest.raises(
        DomainError, match=r"no chart of .* from t = 0 to 1; expected points that the retraction reaches"
    ):
        rx.tracking(sphere_problem(), ([0.0, 1.0], np.array([FIRST, -FIRST])))


def test_a_solution_of_another_manifold_is_no_reference():
    with pytest.raises(InvalidInputError, match="states of the reference are in"):
        rx.tracking(sphere_problem(), turned()[1])
