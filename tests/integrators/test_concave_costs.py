"""Costs that are concave in a control: by Legendre and Clebsch no extremal is a minimum; and where it is one or not
shown to be."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Free,
    Guess,
    OptimalControlProblem,
    Phase,
    Solver,
    load_solution,
    solve,
    solve_phases,
)
from retrax.integrators.boundary_value.audit.concave_controls import _direction
from retrax.manifolds import SO, Euclidean, Sphere, hat
from retrax.retractions import Addition, Exponential, Gauss, Midpoint, default_retraction
from scipy.spatial.transform import Rotation

LINE, PLANE = Euclidean(1), Euclidean(2)
METHODS = {"gauss": Gauss(2, Addition(PLANE)), "midpoint": Midpoint(Addition(PLANE))}
THERE, BACK = np.zeros(2), np.array([1.0, 0.0])
DECADES = np.array([1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15])
BOTH = np.concatenate([DECADES, -DECADES[::-1]])
THRUST = {"controls": ("thrust",)}


def pushed(q, u, c):
    return jnp.array([q[1], u[0]])


@pytest.mark.parametrize("name", METHODS)
def test_the_curvature_of_a_cost_decides_through_zero(name):
    """Of ``c u^2`` the least is 12 c, and of a negative c there is none."""
    problem = OptimalControlProblem(PLANE, pushed, lambda q, u, c: c * u @ u, 1, labels=THRUST)
    solver = Solver(problem, METHODS[name], 10)
    for c in BOTH:
        found = solver.solve(THERE, BACK, 1.0, parameters=c, throw=False)
        assert found.status == ("minimum" if c > 0 else "failed"), c
        assert found.cost == pytest.approx(12 * c, rel=2e-2)
        assert ("concave in thrust at " in found.result) == (c < 0)
    many = solver.solve_many(THERE, BACK, 1.0, parameters=BOTH)
    assert list(many.status) == ["minimum" if c > 0 else "failed" for c in BOTH]
    np.testing.assert_array_equal(many.success, BOTH > 0)


@pytest.mark.parametrize("unit", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("share", [1.0, 1e-6, 1e-12])
@pytest.mark.usual(2)
def test_one_control_of_three_is_concave_in_any_units(unit, share):
    def cost(q, u, c):
        return u[0] ** 2 + c * (u[1] / unit) ** 2 + (u[2] + u[0]) ** 2

    space = Euclidean(3)
    problem = OptimalControlProblem(
        space,
        lambda q, u, c: u * jnp.array([1.0, 1 / unit, 1.0]),
        cost,
        3,
        labels={"controls": ("east", "north", "up")},
    )
    solver = Solver(problem, Gauss(2, Addition(space)), 6)
    for c in (share, -share):
        found = solver.solve(np.zeros(3), np.array([1.0, 0.3, 1.0]), 1.0, parameters=c, throw=False)
        assert found.status == ("minimum" if c > 0 else "failed")
        assert ("concave in north at 12 of 12 stages" in found.result) == (c < 0)


@pytest.mark.parametrize("stages", [1, 2])
def test_dynamics_that_are_curved_in_a_control_count(stages):
    """``y' = u^2`` is paid at the end with the other sign: the sum ``(1 - weight) u^2`` decides."""
    space = LINE * LINE
    problem = OptimalControlProblem(
        space,
        lambda q, u, weight: (u, u**2),
        lambda q, u, weight: u @ u,
        1,
        terminal_cost=lambda q, weight: -weight * q[1][0],
    )
    solver = Solver(problem, Gauss(stages, default_retraction(space)), 8)
    times = ((np.arange(8)[:, None] + solver.stages) / 8).ravel()
    for weight in (0.0, 0.9, 1 - 1e-6, 1 + 1e-6, 1.1, 3.0):
        start, end = (np.zeros(1), np.zeros(1)), (np.ones(1), None)
        costates = np.full((9, 1), 2 - 2 * weight), np.full((9, 1), weight)
        guess = Guess((times[:, None], times[:, None]), np.ones((8 * stages, 1)), costates)
        found = solver.solve(start, end, 1.0, guess, parameters=weight, throw=False)
        assert found.status == ("minimum" if weight < 1 else "failed"), weight
        assert found.cost == pytest.approx(1 - weight, abs=1e-8)
        assert ("concave in u[0] at " in found.result) == (weight > 1)


def test_bounds_that_hold_a_concave_control_make_minima():
    """Bang-bang from rest to rest, with a step or two between the bounds where it switches; no minimum along an arc
    between them."""
    names = [METHODS["gauss"], Gauss(2, Addition(LINE))]
    problems = [
        OptimalControlProblem(space, f, lambda q, u, c: c * u @ u, 1, control_bounds=(-1.0, 1.0))
        for space, f in ((PLANE, pushed), (LINE, lambda q, u, c: u))
    ]
    ends = (np.zeros(2), np.array([0.1, 0.0])), (np.zeros(1), np.array([0.3]))
    (both, single), (far, near) = (Solver(*own, 10) for own in zip(problems, names, strict=True)), ends
    for c in (1.0, 1e-6, -1e-12, -1e-6, -1.0):
        found = both.solve(*far, 1.0, parameters=c, throw=False)
        assert found.status == "minimum"
        assert found.cost == pytest.approx(0.12 * c, rel=1e-6) if c > 0 else -1 <= found.cost / -c < -0.9
        between = single.solve(*near, 1.0, parameters=c, throw=False)
        assert between.status == ("minimum" if c > 0 else "failed")
        assert between.cost == pytest.approx(0.09 * c, rel=1e-6)


@pytest.mark.parametrize("width", [0.0, 1e-3, 1e3])
def test_a_cost_without_curvature_along_some_controls_is_not_concave(width):
    """``(u_0 + a u_1)^2`` with bounds: its curvature in the other direction is rounding."""
    problem = OptimalControlProblem(
        LINE,
        lambda q, u: u[:1] + np.sqrt(3) * u[1:],
        lambda q, u: (u[0] + np.sqrt(3) * u[1]) ** 2 + width * (u[0] / 7 + np.sqrt(3) / 7 * u[1]) ** 2,
        2,
        control_bounds=(-9.0, 9.0),
    )
    found = solve(problem, np.zeros(1), np.ones(1), 1.0, method=Gauss(2, Addition(LINE)), steps=5)
    assert found.success
    assert found.cost == pytest.approx(1 + width / 49, rel=1e-7)


def test_a_coarse_mesh_hides_no_concave_control():
    """``9 q^2 - c u^2`` on steps of 1/2: each of the few that are left lowers the cost by less than it moves ``q``."""
    problem = OptimalControlProblem(LINE, lambda q, u, c: u, lambda q, u, c: 9 * q @ q + c * u @ u, 1)
    solver = Solver(problem, Midpoint(Addition(LINE)), 4)
    for c in (1.0, 1e-3, -1e-3, -1e-1):
        found = solver.solve(np.zeros(1), np.ones(1), 2.0, parameters=c, throw=False)
        assert found.status == ("minimum" if c > 0 else "failed"), c


def test_a_control_is_named_with_its_time_where_the_time_is_free():
    """``y' = v`` with the cost ``1 + u^2 + c v^2``: from its own extremal, in a time of ``sqrt(1 + c)``."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, c: u,
        lambda q, u, c: 1 + u[0] ** 2 + c * u[1] ** 2,
        2,
        labels={"controls": ("push", "pull")},
    )
    solver = Solver(problem, Gauss(2, Addition(PLANE)), 4)
    stages, nodes = ((np.arange(4)[:, None] + solver.stages) / 4).ravel(), np.arange(5) / 4
    for c in (0.5, -0.5):
        time = np.sqrt(1 + c)
        covectors = (np.tile([2 / time, 2 * c / time], (count, 1)) for count in (5, 8))
        states, at_nodes = (np.outer(share, np.ones(2)) for share in (stages, nodes))
        costates, at_stages = covectors
        guess = Guess(states, np.full((8, 2), 1 / time), costates, at_nodes, at_stages)
        found = solver.solve(np.zeros(2), np.ones(2), Free(1.3 * time), guess, parameters=c, throw=False)
        assert found.status == ("minimum" if c > 0 else "failed")
        assert found.horizon == pytest.approx(time, rel=1e-9)
        words = f"It is concave in pull at 8 of 8 stages, the first at t = {found.stage_times[0]:.6g}."
        assert (words in found.result) == (c < 0)


def half_square(q, u):
    return u @ u / 2


def test_phases_are_told_by_their_numbers():
    convex, concave = (
        OptimalControlProblem(LINE, lambda q, u: u, lambda q, u, c=c: c * u @ u, 1, labels=THRUST) for c in (1.0, -1.0)
    )
    method = Gauss(2, Addition(LINE))
    for second, status in ((convex, "minimum"), (concave, "failed")):
        first = Phase(convex, method, 4, 1.0, start=np.zeros(1), end=np.ones(1))
        found = solve_phases([first, Phase(second, method, 4, 1.0, end=np.full(1, 2.0))], throw=False)
        assert found.status == status
        assert f"status={status!r}" in repr(found)
        assert found.phases[1].status == status
        assert ("Phase 1: The derivatives of the cost vanish" in found.result) == (status == "failed")


@pytest.mark.parametrize("horizon", [0.1, 3.0, 3.14, 3.1415, 3.1417, 3.143, 3.3, 6.0])
@pytest.mark.usual(2)
def test_an_oscillator_is_a_minimum_until_its_conjugate_point(horizon, tmp_path):
    """Of the action ``int (u^2 - q^2) / 2`` with both ends fixed, at pi."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (u @ u - q @ q) / 2, 1)
    found = solve(problem, np.zeros(1), np.ones(1), horizon, method=Gauss(4, Addition(LINE)), steps=20)
    status = "minimum" if horizon < np.pi else "stationary"
    assert found.cost == pytest.approx(1 / np.tan(horizon) / 2, rel=1e-6)
    assert found.status == status
    assert found.success
    said = "not shown to be a strict local minimum"
    assert (said in found.result) == (said in " ".join(str(found).split())) == (status == "stationary")
    assert f"status={status!r}" in repr(found)
    found.save(tmp_path / "found.npz")
    assert load_solution(tmp_path / "found.npz").status == status


@cache
def great_circles(name):
    space = Sphere(2) if name == "sphere" else SO(3)
    if name == "sphere":
        problem = OptimalControlProblem(space, lambda q, u: jnp.cross(u, q), half_square, 3)
    else:
        problem = OptimalControlProblem(space, lambda q, u: q @ hat(u), half_square, 3)
    return Solver(problem, Midpoint(Exponential(space)), 12)


def turned(name, angle):
    """The point, or points, that a turn about the third axis leads to."""
    c, s, none = np.cos(angle), np.sin(angle), 0 * np.asarray(angle)
    if name == "sphere":
        return np.stack([c, s, none], axis=-1)
    return Rotation.from_rotvec(np.asarray(angle)[..., None] * np.array([0.0, 0.0, 1.0])).as_matrix()


@pytest.mark.parametrize(("name", "conjugate"), [("sphere", np.pi), ("rotations", 2 * np.pi)])
def test_great_circles_are_minima_until_the_conjugate_point(name, conjugate):
    """On the sphere half a turn away, on SO(3), which it covers twice, a whole one."""
    for share in (0.1, 0.5, 0.9, 0.99, 1.01, 1.1, 1.4):
        angle = share * conjugate
        guess = Guess(turned(name, (np.arange(12) + 0.5) / 12 * angle), np.tile([0.0, 0.0, angle], (12, 1)))
        found = great_circles(name).solve(turned(name, 0.0), turned(name, angle), 1.0, guess)
        assert found.cost == pytest.approx(angle**2 / 2, rel=1e-9)
        assert found.status == ("minimum" if share < 1 else "stationary"), share


def test_a_strict_minimum_takes_no_other_evaluation():
    """The blocks of the last iterate tell that its cost is convex."""
    problem = OptimalControlProblem(PLANE, lambda q, u: pushed(q, u, 1), half_square, 1, control_bounds=(-20.0, 20.0))
    for method in METHODS.values():
        solver = Solver(problem, method, 5)
        assert solver.solve(THERE, BACK, 1.0).status == "minimum"
        assert solver._transcription.trace(None).diagnosis._parts is None


COSTS = {
    "cosine": (lambda q, u: -jnp.cos(u[0]), np.pi / 2, 1),
    "two wells": (lambda q, u: (u[0] ** 2 - 1) ** 2, 1 / np.sqrt(3), -1),
}


@pytest.mark.parametrize("name", COSTS)
def test_a_point_of_inflection_is_where_a_constant_speed_is_no_minimum_any_more(name):
    cost, place, side = COSTS[name]
    solver = Solver(OptimalControlProblem(LINE, lambda q, u: u, cost, 1), Gauss(2, Addition(LINE)), 5)
    for share in (0.5, 0.9, 0.999, 1.001, 1.1):
        speed = np.full(1, share * place)
        guess = Guess(np.outer(np.linspace(0, 1, 10), speed), np.tile(speed, (10, 1)))
        found = solver.solve(np.zeros(1), speed, 1.0, guess, throw=False)
        assert np.ptp(found.controls) < 1e-9
        assert found.status == ("minimum" if side * share < side else "failed"), share


def test_the_sign_of_a_curvature_has_no_units():
    """Random Hessians with random active inequalities, in units of 1e-8 to 1e8, beside parts that cancel."""
    draw = np.random.default_rng(0)
    for _ in range(500):
        m = int(draw.integers(1, 6))
        turn, _ = np.linalg.qr(draw.standard_normal((m, m)))
        values = 0.01 + np.abs(draw.standard_normal(m))
        values[0] *= draw.choice([-1, 1])
        hessian, rows = turn @ np.diag(values) @ turn.T, draw.standard_normal((int(draw.integers(0, m)), m))
        free = np.linalg.svd(rows)[2][len(rows) :].T
        least = np.linalg.eigvalsh(free.T @ hessian @ free)[0]
        units = 10 ** draw.uniform(-8, 8, m)
        power = draw.standard_normal((m, m))
        both = np.stack([power + power.T, hessian + power + power.T, 0 * power]) / np.outer(units, units)
        if abs(least) > 1e-6:
            assert (_direction(np.zeros((2, m)), both, np.zeros(m), rows / units) is not None) == (least < 0)
