"""Constraints whose derivative vanishes where they hold a trajectory: no strict minimum is claimed, and it is of all
others."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Guess, OptimalControlProblem, Phase, Solver, continuation, solve, solve_phases
from retrax.manifolds import Euclidean, Sphere
from retrax.retractions import Addition, Gauss, default_retraction

PLANE = Euclidean(2)
METHOD = Gauss(2, Addition(PLANE))
ENDS = np.zeros(2), np.array([1.0, 0.0])
VANISHES = "The derivative of speed"
LARGEST = 1.3  # of the speeds; 1.5 without a limit


def cart(q: Array, u: Array, *_: Any) -> Array:
    return jnp.stack([q[1], u[0]])


def half_square(q: Array, u: Array, *_: Any) -> Array:
    return u @ u / 2


def above(q: Array) -> Array:
    return jnp.maximum(q[1] - LARGEST, 0.0)


BOTH = (lambda q, u: above(q) ** 2, True), (lambda q, u: q[1] - LARGEST, False)


def problem_of(limit: Any) -> OptimalControlProblem:
    return OptimalControlProblem(PLANE, cart, half_square, 1, constraints={"speed": limit})


def check(found: Any, flat: bool) -> None:
    """A solution says that a limit is flat, and claims no strict minimum; or neither."""
    assert found.success
    assert (VANISHES in found.result) == flat, found.result
    assert found.checks.strict_minimum == (not flat)


@cache
def squared() -> Solver:
    """A limit with a slope and a flat one, by shares, in a unit: the parameters are the share, the unit and the largest
    speed."""

    def limit(q: Array, u: Array, given: Array) -> Array:
        over = q[1] - given[2]
        return given[1] * (given[0] * over + (1 - given[0]) * jnp.maximum(over, 0.0) ** 2)

    return Solver(problem_of(limit), METHOD, 10)


def solved(solver: Solver, *given: float, tolerance: float = 1e-6) -> Any:
    parameters = np.array(given) if given else None
    return solver.solve(*ENDS, 1.0, parameters=parameters, tolerance=tolerance, throw=False)


def test_no_strict_minimum_is_shown_where_a_limit_is_flat_in_any_unit():
    for unit in (1e-6, 1e-3, 1.0, 1e3):
        for share in (0.0, 1e-5, 1.0):
            check(solved(squared(), share, unit, LARGEST), share == 0)


@pytest.mark.parametrize("power", [1.1, 1.5, 2.0, 2.5, 3.0, 4.0])
@pytest.mark.usual(1)
def test_no_strict_minimum_is_shown_by_a_power_of_a_limit(power):
    """On one side, or on both; without success nothing is claimed."""
    one = solved(Solver(problem_of(lambda q, u: above(q) ** power), METHOD, 10))
    both = Solver(problem_of(lambda q, u: jnp.sign(q[1] - LARGEST) * jnp.abs(q[1] - LARGEST) ** power), METHOD, 10)
    for found in (one, solved(both)):
        assert not found.checks.strict_minimum
        assert VANISHES in found.result or not found.success
    if power > 1.5:
        check(one, True)


def test_a_flat_limit_that_holds_nowhere_takes_nothing_back():
    """Through the largest speed at a stage without it, 1.49732, where the force is next to nothing."""
    for largest in (1.3, 1.45, 1.49, 1.497, 1.4975, 1.5, 1.7, 9.0):
        for tolerance in (1e-2, 1e-4, 1e-6):
            check(solved(squared(), 1.0, 1.0, largest, tolerance=tolerance), False)
            found = solved(squared(), 0.0, 1.0, largest, tolerance=tolerance)
            check(found, largest < 1.4973)
            if largest > 1.4973:
                assert found.cost == pytest.approx(6.0, rel=1e-9)


CURVED = {
    "square": lambda q, u: q[1] ** 2 - LARGEST**2,
    "product": lambda q, u: q[0] * q[1] - 0.6,
    "power": lambda q, u: q[1] * u[0] - 3.0,
    "logarithm": lambda q, u: jnp.log(jnp.maximum(q[1] + 0.2, 1e-3) / 1.5),
    "pieces": lambda q, u: jnp.maximum(q[1] - LARGEST, 2 * (q[1] - LARGEST)),
    "touched": lambda q, u: q[1] - LARGEST - 5 * (q[0] - 0.5) ** 2,
    "bent where it holds": lambda q, u: q[1] - LARGEST + 10 * above(q) ** 2,
    "flat elsewhere": lambda q, u: jax.nn.softplus(2000 * (q[1] - LARGEST)) / 2000 - 0.01,
}


@pytest.mark.parametrize("name", CURVED)
@pytest.mark.usual(2)
def test_a_curved_limit_with_a_slope_where_it_holds_leaves_the_strict_minimum(name):
    solver = Solver(problem_of(CURVED[name]), METHOD, 20)
    for tolerance in (1e-3, 1e-6, 1e-10):
        found = solved(solver, tolerance=tolerance)
        check(found, False)
        assert found.checks.active["speed"] > 0


@pytest.mark.parametrize("radius", [0.5, 0.1, 0.02])
@pytest.mark.usual(1)
def test_a_round_obstacle_leaves_the_strict_minimum(radius):
    """``r^2 - |q - c|^2``, whose derivative is small where the obstacle is."""
    centre = np.array([0.0, 0.05 * radius])
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u: u,
        half_square,
        2,
        constraints={"speed": lambda q, u: radius**2 - jnp.sum((q - centre) ** 2)},
    )
    way = [np.array([-1.0, 0.0]), np.array([0.0, -1.5 * radius - 0.05]), np.array([1.0, 0.0])]
    guess = Guess.from_waypoints(problem, METHOD, way, 40)
    for tolerance in (1e-3, 1e-6, 1e-10):
        found = Solver(problem, METHOD, 40).solve(way[0], way[2], 1.0, guess=guess, tolerance=tolerance)
        check(found, False)


@pytest.mark.parametrize("name", ["plain", "product", "angle", "flat"])
@pytest.mark.usual(1)
def test_a_cap_of_a_sphere_takes_the_strict_minimum_back_only_where_it_is_flat(name):
    sphere, axis, angle = Sphere(2), np.array([0.0, 0.6, 0.8]), np.deg2rad(25)
    caps = {
        "plain": lambda q, u: q @ axis - np.cos(angle),
        "product": lambda q, u: (q @ axis - np.cos(angle)) * (q @ axis + 2),
        "angle": lambda q, u: angle**2 - jnp.arccos(jnp.clip(q @ axis, -1 + 1e-12, 1 - 1e-12)) ** 2,
        "flat": lambda q, u: jnp.maximum(q @ axis - np.cos(angle), 0.0) ** 2,
    }
    problem = OptimalControlProblem(
        sphere, lambda q, u: jnp.cross(u, q), half_square, 3, constraints={"speed": caps[name]}
    )
    end = np.array([0.3, -0.6, 0.8])
    solver = Solver(problem, Gauss(2, default_retraction(sphere)), 20)
    check(solver.solve(np.array([0.0, 1.0, 0.0]), end / np.linalg.norm(end), 1.0, tolerance=1e-6), name == "flat")


def test_a_second_entry_that_holds_nothing_leaves_the_strict_minimum():
    """Its derivative is that of the first one, and a loose barrier leaves both a multiplier; or it is the one that is
    flat."""
    wider = Solver(problem_of(lambda q, u: jnp.stack([q[1] - LARGEST, 2 * q[1] - 2.9])), METHOD, 10)
    flat = Solver(problem_of(lambda q, u: jnp.stack([q[1] - 1.45, above(q) ** 2])), METHOD, 10)
    for tolerance in (1e-2, 1e-4, 1e-6):
        check(solved(wider, tolerance=tolerance), False)
        check(solved(flat, tolerance=tolerance), True)


def test_a_batch_says_of_each_member_what_solve_says():
    given = np.array([[share, unit, LARGEST] for share in (0.0, 1.0) for unit in (1e-3, 1.0, 1e3)])
    many = squared().solve_many(*ENDS, 1.0, parameters=given, tolerance=1e-6)
    for found, (share, *_) in zip(many, given, strict=True):
        check(found, share == 0)


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.usual(1)
def test_phases_say_in_which_of_them_a_limit_is_flat(place):
    further = [*ENDS, np.array([2.0, 0.0])]
    for limit, flat in BOTH:
        problems = [
            OptimalControlProblem(PLANE, cart, half_square, 1),
            OptimalControlProblem(PLANE, cart, half_square, 1),
        ]
        problems[place] = problem_of(limit)
        starts = [further[0], None]
        phases = [Phase(problems[k], METHOD, 10, 1.0, starts[k], further[k + 1]) for k in (0, 1)]
        found = solve_phases(phases, tolerance=1e-6)
        check(found.phases[place], flat)
        assert found.strict_minimum == (not flat)
        assert (f"Phase {place}: {VANISHES}" in found.result) == flat


def test_what_is_asked_of_the_accuracy_changes_nothing():
    for limit, flat in BOTH:
        found = solve(
            problem_of(limit), *ENDS, 1.0, method=METHOD, steps=10, accuracy=1e-3, tolerance=1e-6, throw=False
        )
        assert (VANISHES in found.result) == flat
        assert found.checks.strict_minimum == (not flat)


def test_the_report_does_not_look_for_another_reason():
    found = solved(squared(), 0.0, 1.0, LARGEST)
    assert "not shown to be a strict local minimum" in str(found)
    assert "conjugate" not in str(found)


def test_a_path_ends_where_a_limit_becomes_flat_and_says_so():
    """The slope of the limit is lost on the way."""
    solver = squared()

    def path(s: float) -> dict[str, Any]:
        return {
            "start": ENDS[0],
            "end": ENDS[1],
            "horizon": 1.0,
            "parameters": np.array([s < 0.5, 1.0, LARGEST], float),
        }

    found = continuation(solver, path, tolerance=1e-6, smallest_step=0.1, max_iterations=300)
    assert not found.success
    assert f"of the path succeeds: {VANISHES}" in found.result


def test_a_limit_that_holds_nothing_is_not_named_where_the_iteration_fails():
    """Its derivative is next to nothing at rest, where the trajectory is far from it."""
    for limit in (lambda q, u: q[1] ** 6 - LARGEST**6, lambda q, u: jnp.exp(20 * (q[1] - LARGEST)) - 1):
        found = Solver(problem_of(limit), METHOD, 10).solve(*ENDS, 1.0, max_iterations=3, throw=False)
        assert found.checks.active == {"speed": 0}
        assert VANISHES not in found.result
    cannot_begin = Solver(problem_of(lambda q, u: q[1] - LARGEST + 5 * (q[0] - 0.5) ** 2), METHOD, 20)
    found = solved(cannot_begin)
    assert not found.success
    assert VANISHES not in found.result
