"""Functions that jump in the states: nothing of it ends in a success."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.integrators.boundary_value.audit.smoothness_along_solution import NEAR_MARGIN
from retrax.integrators.problem_checks.smoothness.jumps import JumpSearch
from retrax.integrators.problem_checks.smoothness.step_primitives import with_margins
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Exponential, Gauss, Projection

from .test_passed_jumps import beyond

PLANE = Euclidean(2)
METHOD, AT, END = Gauss(2, Addition(PLANE)), np.array([0.3, 0.2]), np.array([1.0, 0.0])
PLACE = 0.313  # of the jump


def cart(q: Array, u: Array, *_: Any) -> Array:
    return jnp.stack([q[1], u[0]])


def solver_of(price: Any, **options: Any) -> Solver:
    return Solver(OptimalControlProblem(PLANE, cart, price, 1, **options), METHOD, 10)


STEPS = (
    lambda q: jnp.where(q[0] > PLACE, 1.0, 0.0),
    lambda q: jnp.floor(3 * q[0] - 0.2),
    lambda q: jnp.sign(q[0] - PLACE),
    lambda q: jnp.round(q[0]),
    lambda q: (q[0] > PLACE).astype(float),
)
CONTINUOUS = (
    lambda q: jnp.where(q[0] > PLACE, (q[0] - PLACE) * 5, 0.0),
    lambda q: jnp.interp(q[0], jnp.array([0.0, PLACE, 0.7, 1.0]), jnp.array([1.0, 0.1, 0.3, 2.0])),
    lambda q: jnp.sign(q[0] - PLACE) * (q[0] - PLACE),
    lambda q: jnp.where(q[0] < 9e9, jnp.tanh(300 * (q[0] - PLACE)), 0.0) / 300,
    lambda q: jnp.abs(q[0] - jnp.round(q[0])),
)
JUMP, KINK = np.eye(len(STEPS)), np.eye(len(CONTINUOUS))


def price(q: Array, u: Array, weights: tuple[Array, Array]) -> Array:
    steps, kinks = (jnp.stack([f(q) for f in functions]) for functions in (STEPS, CONTINUOUS))
    return u @ u / 2 + weights[0] @ steps + weights[1] @ kinks


@pytest.fixture(scope="module")
def solver() -> Solver:
    """One, for all sweeps: what jumps, and how high, are its parameters."""
    return solver_of(price)


@pytest.mark.slow
def test_a_jump_that_is_passed_is_seen_from_a_height_on(solver):
    heights = np.array([0.0, *10.0 ** np.arange(-15, 3, 4), -1e-2])
    found = solver.solve_many(
        0 * END, END, 1.0, parameters=(np.outer(heights, JUMP[0]), np.outer(0 * heights, KINK[0]))
    )
    assert list(found.success) == [abs(height) < 2e-5 for height in heights]  # of a cost of 18 a 1e-6th
    for height, solution in zip(heights, found, strict=True):
        if not solution.success:
            assert f"running_cost jumps by {height:.3g} where the trajectory passes q = [0.313 " in solution.result
            assert "a comparison" in solution.result
            assert "solve_phases" in solution.result
    assert not solver.solve(0 * END, END, 1.0, parameters=(JUMP[0], 0 * KINK[0]), throw=False).success


@pytest.mark.parametrize("k", range(len(STEPS)))
@pytest.mark.usual(1)
def test_every_kind_of_step_is_seen(solver, k):
    solution = solver.solve(0 * END, END, 1.0, parameters=(JUMP[k], 0 * KINK[0]), throw=False)
    assert not solution.success
    assert "running_cost jumps by" in solution.result


def decomposed(q: Array, u: Array, height: Array) -> Array:
    """What XLA computes for want of scalars, with a jump."""
    matrix = jnp.array([[2 + q[0] ** 2, q[1]], [q[1], 3.0]])
    return u @ u / 2 + 1e-3 * jnp.linalg.eigvalsh(matrix)[0] + height * STEPS[0](q)


@contextmanager
def in_precision(double: bool) -> Iterator[None]:
    """A time in which JAX computes in double precision, or in single precision without a warning of that."""
    jax.config.update("jax_enable_x64", double)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.usual(1)
def test_a_jump_is_seen_where_xla_computes_too(double):
    with in_precision(double):
        by_xla = solver_of(decomposed)
        found = [by_xla.solve(0 * END, END, 1.0, parameters=h, throw=False) for h in (0.0, 1e-7, 1e-2, -1e-2, 1.0)]
    assert by_xla.evaluator.startswith("xla")
    assert [solution.success for solution in found] == [True, True, False, False, False]
    assert all("jumps by" in solution.result for solution in found[2:])


def test_a_jump_with_the_number_of_rounds_of_a_loop_is_seen():
    counted = solver_of(lambda q, u, height: u @ u / 2 + height * beyond(q[0] / PLACE - 1))
    for height in (0.0, 1e-9, 0.5):
        found = counted.solve(0 * END, END, 1.0, parameters=height, throw=False)
        assert found.success == (height < 1e-6), found.result
        assert found.success or "running_cost jumps by 0.5 where the trajectory passes" in found.result


SINGLE = {
    "round": lambda q, place: jnp.round(q[0] - place + 0.5),
    "floor": lambda q, place: jnp.floor(q[0] - place + 3),
    "remainder": lambda q, place: (q[0] - place + 5) % 1.0,
    "whole": lambda q, place: (q[0] - place + 5).astype(int).astype(q.dtype),
    "sign": lambda q, place: jnp.sign(q[0] - place),
    "comparison": lambda q, place: jnp.where(q[0] > place, 1.0, 0.0),
    "flat": lambda q, place: jnp.sign(jnp.sinh(30 * (q[0] - place)) ** 13),
}


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("name", SINGLE)
@pytest.mark.usual(2)
def test_jumps_are_seen_wherever_they_are(name, double):
    """Beside zero and far from it, where states and margins are rounded, in both precisions."""
    step = SINGLE[name]
    with in_precision(double):
        solver = solver_of(lambda q, u, place: u @ u / 2 + 0.1 * step(q, place))
        for begin in (0.0, 30.0) if name != "flat" else (0.0,):
            start = np.array([begin, 0.0])
            for place in begin + np.array([0.313, 0.5, 0.7071]):
                found = solver.solve(start, start + END, 1.0, parameters=place, throw=False)
                assert "running_cost jumps by" in found.result, (begin, place)


@pytest.mark.parametrize("family", [Exponential, Projection])
@pytest.mark.usual(1)
def test_a_jump_is_told_from_the_steps_that_a_retraction_computes(family):
    """It lies on the way of the trajectory, and others lie beside it."""
    sphere = Sphere(2)
    begin, end = np.eye(3)[:2]

    def price(q: Array, u: Array, given: tuple[Array, Array]) -> Array:
        height, place = given
        beside = sum(jnp.where(q[0] > 5.0 + k, 1.0, 0.0) for k in range(6))
        return u @ u / 2 + height * jnp.where(q[2] >= place, 1.0, 0.0) + beside

    problem = OptimalControlProblem(sphere, lambda q, u, _: jnp.cross(u, q), price, 3)
    solver = Solver(problem, Gauss(2, family(sphere)), 8)
    for height, place, is_jump in ((0.1, 0.0, True), (0.0, 0.0, False), (0.1, 1e-3, False), (1e-9, 0.0, False)):
        found = solver.solve(begin, end, 1.0, parameters=(height, place), throw=False)
        assert found.success != is_jump, (height, place, found.result)


@pytest.mark.parametrize("k", range(len(CONTINUOUS)))
def test_steps_that_make_no_jump_are_not_refused(solver, k):
    solution = solver.solve(0 * END, END, 1.0, parameters=(0 * JUMP[0], KINK[k]), throw=False)
    assert "jumps" not in solution.result
    assert solution.success or k in (1, 2, 4)  # Newton's method may stop at a kink, and then says so


def test_a_jump_that_is_not_passed_is_none(solver):
    """The end moves through the place of the jump; an end on it passes nothing."""
    for end in (0.2, PLACE - 1e-9, PLACE, PLACE + 1e-2, 0.4):
        solution = solver.solve(0 * END, np.array([end, 0.0]), 1.0, parameters=(JUMP[0], 0 * KINK[0]), throw=False)
        assert solution.success == (end <= PLACE), end


def free(q: Array, u: Array, *_: Any) -> Array:
    return u


def placed(q: Array, u: Array, weights: Array) -> Array:
    """Steps of several kinds at places that are data: of controls, of states, and a window of states."""
    of_control, aslant, of_state, width, place = weights
    steps = of_control * (u[0] > place), aslant * (u[0] > place + q[1]), of_state * (q[0] >= place)
    return u @ u / 2 + sum(steps) + jnp.where(jnp.abs(q[0] - PLACE) < width, 1.0, 0.0)


@pytest.fixture(scope="module")
def with_places() -> Solver:
    return solver_of(placed)


def succeeds(solver: Solver, start: Any, end: Any, weights: Any) -> tuple[bool, str]:
    """Whether it is solved, and what is said where it is not."""
    try:
        solution = solver.solve(np.array(start), np.array(end), 1.0, parameters=np.array(weights), throw=False)
    except InvalidInputError as error:
        return False, str(error)
    return solution.success, solution.result


@pytest.mark.slow
def test_a_jump_in_the_controls_is_none_that_depends_on_where_it_is(with_places):
    """Beside strong curvature, through all controls of the trajectory, which are between -6 and 6, and beyond them."""
    for place in (-20.0, -5.9, -1e-3, 1e-7, 2.77, 5.999, 9.0):
        for steps in ((0.1, 0.0), (0.0, 0.1)):
            solved, said = succeeds(with_places, (0.0, 0.0), (1.0, 0.0), (*steps, 0.0, 0.0, place))
            assert not solved, place
            assert "running_cost jumps in the controls at u = [" in said, place


def test_a_jump_beyond_the_bounds_is_none():
    bounded = solver_of(lambda q, u: u @ u / 2 + jnp.where(u[0] > 7.0, 1.0, 0.0), control_bounds=(-6.5, 6.5))
    assert bounded.solve(0 * END, END, 1.0).success


@pytest.mark.parametrize("width", [0.0, 1e-9, 1e-7, 1e-4, 1e-2])
@pytest.mark.usual(1)
def test_a_narrow_window_is_seen(with_places, width):
    solved, said = succeeds(with_places, (0.0, 0.0), (1.0, 0.0), (0.0, 0.0, 0.0, width, 0.0))
    assert solved == (width == 0), said
    assert solved or "passes q = [0.3" in said


def test_a_trajectory_that_lies_on_a_jump_is_no_minimum():
    """It is at 0.3 throughout; the place of the jump moves through it."""
    solver = Solver(OptimalControlProblem(PLANE, free, lambda q, u, place: u @ u / 2 + (q[0] >= place), 2), METHOD, 5)
    for away in (0.0, 1e-15, 1e-12, 1e-6, 1e-3):
        for place in {0.3 - away, 0.3 + away}:
            solved, said = succeeds(solver, (0.3, 0.0), (0.3, 1.0), place)
            assert solved == (away > 1e-9), place
            assert solved or "beside the trajectory, at q = [0.3" in said


def test_a_jump_that_a_trajectory_touches_is_seen(with_places):
    """It goes out and back; the place moves through the farthest point, which is that of a parabola between two
    nodes."""
    smooth = with_places.solve(np.array([0.0, 1.0]), np.zeros(2), 1.0, parameters=np.array([0, 0, 0, 0, 0.0]))
    at = np.array([0.31, 0.35, 0.39])
    a, b, c = np.polyfit(at, smooth(at).states[:, 0], 2)
    for away in (-1e-2, -1e-6, -1e-10, 0.0, 1e-10, 1e-6, 1e-2):
        solved, said = succeeds(with_places, (0.0, 1.0), (0.0, 0.0), (0.0, 0.0, 1.0, 0.0, c - b * b / (4 * a) + away))
        assert solved == (away > 1e-9), (away, said)


def test_a_terminal_cost_that_jumps_where_the_trajectory_ends_has_no_minimum():
    """The place moves through the end, which is free; an end that is prescribed may be on it."""

    def final(q: Array, place: Array) -> Array:
        return q @ q / 2 + jnp.where(q[0] >= place, 0.0, 0.1)

    problem = OptimalControlProblem(PLANE, free, lambda q, u, place: u @ u / 2 + 0 * place, 2, terminal_cost=final)
    solver = Solver(problem, METHOD, 5)
    reached = 0.5  # u = -q_N, from 1
    for away in (0.0, 1e-14, 1e-10, 1e-5, 1e-2):
        for place in {reached - away, reached + away}:
            solution = solver.solve(np.array([1.0, 0.0]), None, 1.0, parameters=np.array(place), throw=False)
            assert solution.success == (away > 1e-9), place
            assert solution.success or "terminal_cost jumps by" in solution.result
            assert not (solution.checks.strict_minimum and not solution.success)
    assert solver.solve(np.array([1.0, 0.0]), np.array([reached, 0.0]), 1.0, parameters=np.array(reached)).success


@pytest.mark.slow
def test_jumps_of_dynamics_and_constraints_are_named_on_manifolds_too():
    group = SO(3)

    def turn(q: Array, u: Array) -> Array:
        return (
            q @ jnp.array([[0.0, -u[0], 0.0], [u[0], 0.0, 0.0], [0.0, 0.0, 0.0]]) * jnp.where(q[1, 0] > 0.5, 0.8, 1.0)
        )

    problem = OptimalControlProblem(group, turn, lambda q, u: u @ u / 2, 1)
    last = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    solution = solve(problem, np.eye(3), last, 1.0, method=Gauss(2, Cayley(group)), steps=10, throw=False)
    assert not solution.success
    assert "dynamics jumps by" in solution.result
    zones = {"zone": lambda q, u: q[1] - jnp.where(q[0] > PLACE, 3.0, 2.5)}
    solution = solver_of(lambda q, u: u @ u / 2, constraints=zones).solve(0 * END, END, 1.0, throw=False)
    assert not solution.success
    assert "constraints['zone'] jumps by" in solution.result


def test_a_jump_in_time_counts_where_the_horizon_moves_it():
    def price(q: Array, u: Array, t: Array) -> Array:
        return u @ u / 2 + jnp.where(t > 0.613, 1.0, 2.0)

    solver = solver_of(price, time_dependent=True)
    assert solver.solve(0 * END, END, 1.0).success
    solution = solver.solve(0 * END, END, Free(1.0, lower=0.1, upper=3.0), throw=False)
    assert not solution.success
    assert "near t = 0.613" in solution.result


def stair(q: Array, u: Array, height: float) -> Array:
    return u @ u / 2 + height * jnp.where(q[0] > PLACE, 1.0, 0.0)


@pytest.mark.slow
def test_phases_are_what_the_message_says():
    """On each side of the jump nothing jumps, and the costate does: by the height over the rate."""
    height, smooth = 2.0, []
    for side in (0.0, height):
        smooth.append(OptimalControlProblem(PLANE, cart, lambda q, u, side=side: u @ u / 2 + side, 1))
    first = Phase(smooth[0], METHOD, 10, Free(0.4, lower=0.01), start=0 * END)
    last = Phase(smooth[1], METHOD, 10, Free(0.6, lower=0.01), end=END)
    at_jump = {"at the jump": lambda ends: ends[0].end[0] - PLACE}
    found = solve_phases([first, last], horizon=1.0, boundary_constraints=at_jump)
    passed = solver_of(lambda q, u: stair(q, u, height)).solve(0 * END, END, 1.0, throw=False)
    assert found.success
    assert found.cost < passed.cost - 1e-3
    before, after = (phase.costates for phase in found.phases)
    rate = found.phases[1].states[0, 1]
    assert abs(abs(after[0, 0] - before[-1, 0]) * rate - height) < 0.02 * height
    jumping = OptimalControlProblem(PLANE, cart, lambda q, u: stair(q, u, height), 1)
    ended = solve_phases([phase._replace(problem=jumping, duration=0.5) for phase in (first, last)], throw=False)
    assert not ended.success
    assert "running_cost jumps by" in ended.result


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usual(1)
def test_a_small_rotation_passes_no_step_of_its_logarithm(seed):
    """Steps of the branch for large rotations would else be searched along every trajectory, or beside it."""
    retraction, axis = Exponential(SO(3)), np.random.default_rng(seed).normal(size=3)

    def margins(angle):
        turned = retraction(jnp.eye(3), hat(angle * axis / np.linalg.norm(axis)))
        return with_margins(lambda a: jnp.ravel(retraction.preimage(jnp.eye(3), a)), turned)[1].values

    found = np.asarray(jax.vmap(margins)(np.linspace(-0.09, 0.09, 20)))
    sides = found >= 0
    assert sides.size > 0
    assert np.min(np.abs(found)) > NEAR_MARGIN
    np.testing.assert_array_equal(sides, np.broadcast_to(sides[:1], sides.shape))


@pytest.mark.parametrize("share", [*10.0 ** np.arange(-10.0, 0.0), 0.9, 1.1])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_margin_that_is_zero_between_two_ends_is_found_and_no_other(share, side):
    """The margin is a parabola that changes by 1 on the line, with its least value on one side of zero or the other."""

    def window(_, x):
        return jnp.reshape(jnp.where(x**2 + side * share < 0, 1.0, 0.0), 1)

    search = JumpSearch(window, lambda row, s: (1.6 * s - row,), (), np.ones(()))
    lines, ends = np.array([0.6]), np.array([[0.0, 1.0]])
    found = search.crossings((), lines, ends)
    assert bool(search.jumps(found, np.ones(1))) == (side < 0 and share < 1)
    assert len(found.line) == (share < 1)
