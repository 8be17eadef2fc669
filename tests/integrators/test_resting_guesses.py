"""Systems without drift from the default guess: at rest, where controls do not move what they have to, to first
order."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solver, default_guess, solve
from retrax.manifolds import SE, Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

SPACE, FOUR = Euclidean(3), Euclidean(4)
METHODS = pytest.mark.parametrize("method", [Midpoint, lambda r: Gauss(2, r)], ids=["midpoint", "Gauss"])
STEPS = 20


def energy(q: Any, u: Any) -> Any:
    return u @ u / 2


def brockett(q: Any, u: Any) -> Any:
    """Of Heisenberg's group: the third coordinate is the area that the others go around."""
    return jnp.stack([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2])


HEISENBERG = OptimalControlProblem(SPACE, brockett, energy, 2)
LEAST = 2 * np.pi  # times the area over the horizon


@pytest.fixture(scope="module", params=[Midpoint, lambda r: Gauss(2, r)], ids=["midpoint", "Gauss"])
def upwards(request):
    return Solver(HEISENBERG, request.param(Addition(SPACE)), STEPS)


@pytest.mark.parametrize(("area", "horizon"), [(1.0, 1.0), (1e-6, 1.0), (1e6, 1e3), (1e-3, 1e-3), (1e12, 1.0)])
@pytest.mark.usual(2)
def test_an_area_is_gone_around_in_any_unit(upwards, area, horizon):
    found = upwards.solve(np.zeros(3), np.array([0.0, 0.0, area]), horizon)
    assert found.cost == pytest.approx(LEAST * area / horizon, rel=1e-2)
    assert np.ptp(found.states[:, 0]) > 0.3 * np.sqrt(area)


@pytest.mark.parametrize("beside", [0.0, 1e-12, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0])
def test_an_end_is_swept_from_above_the_start_to_far_beside_it(upwards, beside):
    """A way to one side is all that makes the controls reach the third coordinate, and next to none does not."""
    found = upwards.solve(np.zeros(3), np.array([beside, 0.0, 1.0]), 1.0, max_iterations=150)
    if found.checks.strict_minimum and beside < 1:
        assert found.cost == pytest.approx(LEAST, rel=0.06)
    elif beside < 1:  # one of a family as far as can be told, or a saddle of several turns
        turns = found.cost / LEAST
        assert turns == pytest.approx(round(turns), rel=1e-2)
    else:
        assert beside**2 / 2 < found.cost < LEAST + beside**2 / 2


@pytest.mark.parametrize("beside", [10.0**-5.5, 10.0**-4.5, 1e-4])
def test_a_family_met_loosely_is_not_left_where_the_next_step_ends_beside_the_end(upwards, beside):
    """Where all is met to the tolerance, a step lacks the square of its size afterwards: from there it moves."""
    found = upwards.solve(np.zeros(3), np.array([beside, 0.0, 1.0]), 1.0, max_iterations=150, tolerance=1e-4)
    assert found.cost == pytest.approx(LEAST, rel=1e-2)


@METHODS
@pytest.mark.parametrize("end", [[0, 0, 1.0, 0], [0, 0, 0, 1.0], [0, 0, -1.0, 1.0]])
def test_coordinates_that_brackets_of_three_fields_reach(method, end):
    """Engel's group: ``x' = u``, ``y' = v``, ``z' = x v``, ``w' = x^2 v / 2``."""
    problem = OptimalControlProblem(
        FOUR, lambda q, u: jnp.stack([u[0], u[1], q[0] * u[1], q[0] ** 2 * u[1] / 2]), energy, 2
    )
    assert solve(problem, np.zeros(4), np.array(end), 1.0, method=method(Addition(FOUR)), steps=STEPS).cost > 1


@METHODS
def test_a_vehicle_moves_sideways(method):
    group = SE(2)
    problem = OptimalControlProblem(group, lambda q, u: q @ group.hat(jnp.stack([u[1], u[0], 0 * u[0]])), energy, 2)
    aside = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    found = solve(problem, np.eye(3), aside, 1.0, method=method(Cayley(group)), steps=STEPS)
    assert found.cost == pytest.approx(5.579079358, rel=1e-2)


def test_a_batch_of_ends_is_its_members(upwards):
    ends = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    many = upwards.solve_many(np.zeros((3, 3)), ends, 1.0)
    assert np.all(many.success)
    np.testing.assert_allclose(many.cost[[0, 2]], [LEAST, 3 * LEAST], rtol=1e-2)
    assert many.cost[1] == pytest.approx(upwards.solve(np.zeros(3), ends[1], 1.0).cost, rel=1e-8)


def test_the_default_guess_is_at_rest_and_stays_what_it_is():
    guess = default_guess(HEISENBERG, Midpoint(Addition(SPACE)), np.zeros(3), np.array([0.0, 0.0, 1.0]), STEPS)
    assert isinstance(guess, Guess)
    assert not np.any(guess.controls)


@METHODS
@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.usual(2)
def test_extremals_of_several_turns_are_found_from_guesses_that_turn_as_often(method, turns):
    """``n`` circles around the area cost ``n`` times as much; those of more than one are saddles.

    From a guess near one Newton's method finds it. From farther off it may find that of fewer turns, or none: each is
    one of a family, so the systems are singular and rounding decides the way.
    """
    radius, places = 1 / np.sqrt(np.pi * turns), 2 * np.pi * turns
    own = method(Addition(SPACE))
    solver, way = Solver(HEISENBERG, own, 60), (np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.0)
    for size in (0.9, 1.04):
        begun = Guess.from_controls(
            HEISENBERG,
            own,
            way[0],
            lambda t, size=size: size * radius * places * np.array([np.cos(places * t), np.sin(places * t)]),
            1.0,
            60,
        )
        found = solver.solve(*way, guess=begun, throw=False)
        if found.success or size > 1:
            count = round(found.cost / LEAST)
            assert count == turns if size > 1 else count <= turns
            assert found.cost == pytest.approx(count * LEAST, rel=3e-2)
            assert not found.checks.strict_minimum
    assert found.success
