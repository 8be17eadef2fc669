"""Node costs, and the covariance of estimates, beside smoothers, least squares of SciPy, and Wahba's problem."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, load_solution, solve, solve_phases
from retrax.manifolds import SO, ConvergenceError, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.linalg import expm
from scipy.optimize import least_squares

PLANE, STEPS, HORIZON = Euclidean(2), 20, 2.0
TIMES = np.linspace(0.0, HORIZON, STEPS + 1)
SWING, INPUT, OUTPUT = np.array([[0.0, 1.0], [-4.0, -0.2]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
REST = Free(np.zeros(2))
METHODS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE)), Gauss(3, Addition(PLANE))
EVERY = pytest.mark.parametrize("method", METHODS, ids=["midpoint", "Gauss 2", "Gauss 3"])


def misfit(q: Any, k: Any, p: Any) -> Any:
    """Half the square of a measurement's error over its variance."""
    return (q[0] - p["data"][k]) ** 2 / (2 * p["noise"] ** 2)


def smoothed(data: np.ndarray, noise: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """States and covariances of the optimal linear smoother, in information form over the whole trajectory."""
    h, n, count = HORIZON / STEPS, 2, STEPS + 1
    block = np.block([[-SWING, density * INPUT @ INPUT.T], [np.zeros((2, 2)), SWING.T]])
    whole = expm(h * block)  # Van Loan's exponential
    move = whole[2:, 2:].T
    inverse = np.linalg.inv(move @ whole[:2, 2:])
    information, vector = np.zeros((count * n, count * n)), np.zeros(count * n)
    for k in range(count):
        at = slice(k * n, (k + 1) * n)
        information[at, at] += OUTPUT.T @ OUTPUT / noise**2
        vector[at] += OUTPUT[0] * data[k] / noise**2
        if k:
            both = np.hstack([-move, np.eye(n)])
            around = slice((k - 1) * n, (k + 1) * n)
            information[around, around] += both.T @ inverse @ both
    covariance = np.linalg.inv(information).reshape(count, n, count, n)
    return np.linalg.solve(information, vector).reshape(count, n), np.stack([covariance[k, :, k] for k in range(count)])


@pytest.mark.parametrize("density", [1e-3, 1.0, 1e3])
def test_estimates_and_covariances_are_those_of_the_optimal_smoother(density):
    """The noise of the process is swept from next to none to more than the measurements' own."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, p: SWING @ q + INPUT @ u,
        lambda q, u, p: u @ u / (2 * p["density"]),
        1,
        node_cost=misfit,
    )
    solver, draw = Solver(problem, METHODS[2], STEPS), np.random.default_rng(1)
    for noise in (0.01, 1.0):
        data = np.cos(2 * TIMES) + noise * draw.standard_normal(STEPS + 1)
        given = {"data": data, "noise": noise, "density": density}
        found = solver.solve(REST, None, HORIZON, parameters=given)
        states, covariances = smoothed(data, noise, density)
        assert found.status == "minimum"
        assert np.allclose(found.states, states, atol=1e-6 * np.max(np.abs(states)))
        sizes = np.max(np.abs(covariances), axis=(1, 2), keepdims=True)
        assert np.all(np.abs(solver.covariance(found).states - covariances) <= 1e-6 * sizes)
        # Between the nodes the control is the costate times the density; at a node the costate jumps.
        between = found(TIMES[:-1] + 0.9 * np.diff(TIMES))
        assert np.allclose(between.controls[:, 0], density * between.costates[:, 1], atol=2e-3 * np.ptp(found.controls))


@EVERY
def test_a_trajectory_without_controls_is_a_linear_regression(method):
    """All that is free is the start: the normal equations give it, its covariance and the least cost."""
    problem = OptimalControlProblem(PLANE, lambda q, u, p: SWING @ q, lambda q, u, p: 0.0, 0, node_cost=misfit)
    solver, h = Solver(problem, method, STEPS), HORIZON / STEPS
    if method is METHODS[0]:
        move = np.linalg.solve(np.eye(2) - h / 2 * SWING, np.eye(2) + h / 2 * SWING)
    else:
        squares = (h * SWING) @ (h * SWING)
        parts = (h / 2 * SWING, squares / 12) if method is METHODS[1] else (h / 2 * SWING + 0.0, squares / 10)
        cubes = 0.0 if method is METHODS[1] else squares @ (h * SWING) / 120
        above, below = np.eye(2) + parts[0] + parts[1] + cubes, np.eye(2) - parts[0] + parts[1] - cubes
        move = np.linalg.solve(below, above)  # the Padé approximation that the method is
    powers = np.stack([np.linalg.matrix_power(move, k) for k in range(STEPS + 1)])
    rows, noise = powers[:, 0] / 0.1, 0.1
    for seed in range(3):
        data = np.sin(2 * TIMES) + noise * np.random.default_rng(seed).standard_normal(STEPS + 1)
        found = solver.solve(REST, None, HORIZON, parameters={"data": data, "noise": noise})
        start, squares, *_ = np.linalg.lstsq(rows, data / noise, rcond=None)
        assert np.allclose(found.states[0], start, atol=1e-10)
        assert found.cost == pytest.approx(squares[0] / 2, rel=1e-10)
        first = np.linalg.inv(rows.T @ rows)
        assert np.allclose(solver.covariance(found).states, powers @ first @ powers.mT, rtol=1e-9, atol=1e-12)


def pendulum(q: Any, u: Any, p: Any) -> Any:
    """A pendulum whose gravity is to be found."""
    return jnp.array([q[1], -p["gravity"] * jnp.sin(q[0]) + u[0]])


DENSITY = 0.01
FITTED = OptimalControlProblem(PLANE, pendulum, lambda q, u, p: u @ u / (2 * DENSITY), 1, node_cost=misfit)


def midpoint_rows(z: Any, data: Any, noise: float) -> Any:
    """The residuals of the pendulum by the midpoint rule, from its start, its gravity and the noise of the process."""
    h, parameters = HORIZON / STEPS, {"gravity": z[2]}

    def step(q: Any, u: Any) -> tuple[Any, Any]:
        middle = q
        for _ in range(16):  # contracts by h / 2 sqrt(gravity), 0.15
            middle = q + h / 2 * pendulum(middle, u[None], parameters)
        return 2 * middle - q, 2 * middle - q

    _, after = jax.lax.scan(step, z[:2], z[3:])
    states = jnp.concatenate([z[None, :2], after])
    return jnp.concatenate([(states[:, 0] - data) / noise, jnp.sqrt(h / DENSITY) * z[3:]]), states


def test_a_fit_and_its_covariance_are_those_of_least_squares():
    """Of exact data the covariance is the inverse of ``J^T J``; of noisy data that of the Hessian, as it is written."""
    solver, noise = Solver(FITTED, METHODS[0], STEPS), 0.05
    rows = jax.jit(lambda z, data: midpoint_rows(z, data, noise)[0])
    states = jax.jit(lambda z: midpoint_rows(z, jnp.zeros(STEPS + 1), noise)[1])
    true = np.array([1.0, 0.0, 9.5, *np.zeros(STEPS)])
    exact = np.asarray(states(true))[:, 0]
    for data in (exact, exact + noise * np.random.default_rng(2).standard_normal(STEPS + 1)):
        given = {"data": data, "noise": noise, "gravity": Free(9.0)}
        found = solver.solve(Free(np.array([0.9, 0.1])), None, HORIZON, parameters=given)
        known = least_squares(
            lambda z, data=data: np.asarray(rows(z, data)),
            true,
            jac=lambda z, data=data: np.asarray(jax.jacfwd(rows)(z, data)),
            **dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14),
        )
        assert found.cost == pytest.approx(known.cost, rel=1e-9, abs=1e-15)
        assert np.allclose([*found.states[0], found.parameters["gravity"]], known.x[:3], atol=1e-6)
        if data is exact:
            inverse = np.linalg.inv(known.jac.T @ known.jac)
        else:
            inverse = np.linalg.inv(jax.hessian(lambda z, data=data: jnp.sum(rows(z, data) ** 2) / 2)(known.x))
        moved, own = np.asarray(jax.jacfwd(states)(known.x)), solver.covariance(found)
        assert own.parameters == pytest.approx(inverse[2:3, 2:3], rel=1e-6)
        assert np.allclose(own.states, moved @ inverse @ moved.mT, atol=1e-6 * np.max(own.states))
        assert np.allclose(own.cross, moved @ inverse[:, 2:3], atol=1e-6 * np.max(np.abs(own.cross)))


@pytest.mark.parametrize("method", [Midpoint(Cayley(SO(3))), Gauss(3, Cayley(SO(3)))], ids=["midpoint", "Gauss"])
def test_an_attitude_from_directions_is_wahbas(method):
    """The attitude of a body that rests is a rotation that the singular value decomposition gives."""
    draw, count = np.random.default_rng(3), 6
    problem = OptimalControlProblem(
        SO(3),
        lambda q, u, p: q @ hat(jnp.zeros(3)),
        lambda q, u, p: 0.0,
        0,
        node_cost=lambda q, k, p: jnp.sum((p["seen"][k] - q.T @ p["stars"][k]) ** 2) * p["weights"][k] / 2,
    )
    solver = Solver(problem, method, count - 1)
    for angle in (0.0, 1.0, 3.0):
        true = expm(np.array(hat(angle * np.array([2.0, -1.0, 2.0]) / 3)))
        stars = draw.standard_normal((count, 3))
        stars /= np.linalg.norm(stars, axis=1)[:, None]
        for noise in (0.0, 0.1):
            seen, weights = stars @ true + noise * draw.standard_normal((count, 3)), draw.uniform(0.5, 2.0, count)
            given = {"seen": seen, "stars": stars, "weights": weights}
            found = solver.solve(Free(true @ expm(np.array(hat([0.2, 0.1, -0.3])))), None, 1.0, parameters=given)
            left, _, right = np.linalg.svd(np.einsum("k,ki,kj->ij", weights, stars, seen))
            known = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
            assert np.allclose(found.states, known, atol=1e-8)
            if noise == 0.0:
                turns = np.asarray(SO(3).basis(known))
                slopes = np.einsum("aji,kj->kia", turns, stars)
                information = np.einsum("k,kia,kib->ab", weights, slopes, slopes)
                assert np.allclose(solver.covariance(found).states, np.linalg.inv(information), rtol=1e-7, atol=1e-10)


@EVERY
@pytest.mark.usual(1)
def test_estimates_have_derivatives_with_respect_to_the_measurements(method):
    """Beside central differences of solves: with more and less noise in the measurements."""
    bound = OptimalControlProblem(
        PLANE,
        lambda q, u, p: pendulum(q, u, {"gravity": 9.0}),
        lambda q, u, p: u @ u / (2 * DENSITY),
        1,
        node_cost=misfit,
    )
    solver, way = Solver(bound, method, 5), np.random.default_rng(4).standard_normal(6)
    for noise in (0.01, 0.3):
        data = np.cos(3 * np.linspace(0, 1, 6)) + 0.05 * way

        def solved(move: float, noise: float = noise, data: np.ndarray = data) -> Any:
            given = {"data": data + move * way, "noise": noise}
            return solver.solve(Free(np.array([1.0, 0.0])), None, 1.0, parameters=given)

        own, ahead, behind = solver.sensitivity(solved(0.0)).parameters["data"], solved(1e-4), solved(-1e-4)
        for name in ("cost", "states", "costates", "controls"):
            difference = (getattr(ahead, name) - getattr(behind, name)) / 2e-4
            derivative = np.tensordot(way, getattr(own, name), 1)
            assert np.allclose(derivative, difference, atol=1e-5 * np.max(np.abs(difference)))


def test_costates_of_the_midpoint_rule_jump_at_a_node_by_the_slope_of_its_cost():
    problem = OptimalControlProblem(
        PLANE, lambda q, u, p: SWING @ q + INPUT @ u, lambda q, u, p: u @ u / 2, 1, node_cost=misfit
    )
    given = {"data": np.cos(2 * TIMES), "noise": 0.1}
    found = solve(problem, REST, None, HORIZON, method=METHODS[0], steps=STEPS, parameters=given)
    slopes = (found.states[1:, 0] - given["data"][1:]) / given["noise"] ** 2
    before = found(np.nextafter(found.times[1:], 0.0)).costates
    assert np.abs(slopes).max() > 0.1
    np.testing.assert_allclose(found.costates[1:, 0] - before[:, 0], slopes, rtol=0, atol=1e-9 * np.abs(slopes).max())
    np.testing.assert_allclose(found.costates[1:, 1], before[:, 1], rtol=0, atol=1e-9 * np.abs(slopes).max())


@EVERY
@pytest.mark.usual(1)
def test_phases_and_files_keep_node_costs(method, tmp_path):
    """Two phases count their own nodes; the node between them costs what both give it."""
    halves = [np.cos(2 * part) for part in (TIMES[: STEPS // 2 + 1], TIMES[STEPS // 2 :])]
    problem = OptimalControlProblem(
        PLANE, lambda q, u, p: SWING @ q + INPUT @ u, lambda q, u, p: u @ u / 2, 1, node_cost=misfit
    )
    given = [{"data": data, "noise": 0.1} for data in halves]
    phases = [Phase(problem, method, STEPS // 2, HORIZON / 2, start=REST, parameters=own) for own in given]
    found = solve_phases(phases)

    def once(q: Any, k: Any, p: Any) -> Any:
        return misfit(q, k, p) * jnp.where(k == STEPS // 2, 2.0, 1.0)

    whole = OptimalControlProblem(problem.manifold, problem.dynamics, problem.running_cost, 1, node_cost=once)
    data = {"data": np.cos(2 * TIMES), "noise": 0.1}
    known = solve(whole, REST, None, HORIZON, method=method, steps=STEPS, parameters=data)
    assert found.cost == pytest.approx(known.cost, rel=1e-9)
    assert np.allclose(found.phases[1].states, known.states[STEPS // 2 :], atol=1e-8)
    known.save(tmp_path / "known")
    again, between = load_solution(tmp_path / "known"), TIMES[:-1] + 0.03
    assert np.array_equal(again(between).costates, known(between).costates)


@pytest.mark.parametrize("gravity", [2.0, 5.0, 8.0, 12.0, 20.0])
@pytest.mark.usual(1)
def test_a_fit_without_controls_is_a_minimum_from_poor_guesses(gravity):
    """The sizes by which the second-order conditions are judged are those of the solution, not of a guess at rest."""
    manifold = Sphere(2) * Euclidean(3)
    problem = OptimalControlProblem(
        manifold,
        lambda q, u, p: (jnp.cross(q[1], q[0]), p["gravity"] * jnp.cross(q[0], jnp.array([0.0, 0.0, -1.0]))),
        lambda q, u, p: 0.0,
        0,
        node_cost=lambda q, k, p: jnp.sum((q[0] - p["seen"][k]) ** 2) / (2 * 0.02**2),
        initial_cost=lambda q, p: 50 * (q[0] @ q[1]) ** 2,
    )
    solver = Solver(problem, Gauss(2, default_retraction(manifold)), STEPS)
    start = np.array([0.6, 0.0, -0.8]), np.array([0.0, 1.0, 0.0])
    seen = solver.solve(start, None, HORIZON, parameters={"gravity": 9.0, "seen": np.zeros((STEPS + 1, 3))}).q[0]
    free = (Free(start[0]), Free(np.zeros(3)))
    found = solver.solve(free, None, HORIZON, parameters={"gravity": Free(gravity), "seen": seen})
    assert found.status == "minimum"
    assert found.parameters["gravity"] == pytest.approx(9.0, rel=1e-8)
    assert 0.01 < np.sqrt(solver.covariance(found).parameters[0, 0]) < 1.0


def test_what_node_costs_do_not_have_is_said():
    """Too few measurements, meshes that change, other means of solution, and estimates that nothing determines."""
    given = {"data": np.zeros(STEPS + 1), "noise": 0.1, "gravity": 9.0}
    few = given | {"data": np.zeros(STEPS)}
    with pytest.raises(InvalidInputError, match=f"node_cost at node k = {STEPS}.* has index {STEPS} on axis 0"):
        solve(FITTED, REST, None, HORIZON, steps=STEPS, parameters=few)
    for options in ({}, {"steps": STEPS, "accuracy": 1e-4}):
        with pytest.raises(InvalidInputError, match="node_cost, whose index k counts the nodes"):
            solve(FITTED, REST, None, HORIZON, parameters=given, **options)
    solver = Solver(FITTED, METHODS[0], STEPS)
    found = solver.solve(REST, None, HORIZON, parameters=given)
    with pytest.raises(InvalidInputError, match="a node cost, which feedback does not treat"):
        solver.feedback(found)
    with pytest.raises(InvalidInputError, match="covariance takes a solution with success"):
        Solver(FITTED, METHODS[0], STEPS).covariance(found)
    with pytest.raises(InvalidInputError, match=r"node_cost must be a function of \(q, k\)"):
        OptimalControlProblem(PLANE, pendulum, lambda q, u, p: 0.0, 1, node_cost=lambda q: q[0])
    sphere = Sphere(2)
    blind = OptimalControlProblem(
        sphere, jnp.cross, lambda q, u: u @ u / 2, 3, node_cost=lambda q, k: (q[2] - 0.5) ** 2
    )  # nothing measures the longitude
    solver = Solver(blind, Midpoint(default_retraction(sphere)), 4)
    found = solver.solve(Free(np.array([0.8, 0.0, 0.6])), None, 1.0)
    with pytest.raises(ConvergenceError, match="do not determine the estimate"):
        solver.covariance(found)
