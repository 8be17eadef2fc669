"""Minima, saddles and indefinite Hessians: geodesics of the sphere, both ways round."""

import re
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.integrators import Guess, OptimalControlProblem, Solution, Solver, solve
from retrax.retractions import Exponential, Midpoint, Projection

from tests.support.numerics import SEEDS, norm

from .problems import SPHERE, half_square

STEPS = 10
GEODESIC = OptimalControlProblem(SPHERE, lambda q, u: SPHERE.projection(q, u), half_square, 3)


def on_equator(angle: np.ndarray | float) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle), 0.0 * np.asarray(angle)], axis=-1)


def unit(states: np.ndarray) -> np.ndarray:
    return states / np.linalg.norm(states, axis=1, keepdims=True)


def turning(total: float) -> Guess:
    """The equator at constant speed, by ``total`` in one unit of time."""
    angles = (np.arange(STEPS) + 0.5) / STEPS * total
    return Guess(on_equator(angles), total * on_equator(angles + np.pi / 2))


@cache
def geodesics() -> Solver:
    return Solver(GEODESIC, Midpoint(Exponential(SPHERE)), STEPS)


def geodesic(angle: float, guess: Guess | None = None, **options) -> Solution:
    return geodesics().solve(on_equator(0.0), on_equator(angle), 1.0, guess, **options)


@given(angle=st.floats(0.01, 3.1))
@example(angle=np.pi / 2)
def test_the_short_way_costs_half_the_square_of_the_angle_and_is_a_strict_minimum(angle):
    solution = geodesic(angle)
    assert solution.cost == pytest.approx(angle**2 / 2, rel=1e-10)
    assert solution.checks.strict_minimum
    assert "conjugate" not in str(solution)
    (momentum,) = solution.momenta.values()
    assert norm(momentum - angle * np.array([0.0, 0.0, 1.0])) < 1e-10


def test_a_quarter_turn_is_outside_the_image_of_the_projection_and_solved_all_the_same():
    ends = on_equator(0.0), on_equator(np.pi / 2)
    solution = solve(GEODESIC, *ends, 1.0, method=Midpoint(Projection(SPHERE)), steps=STEPS)
    assert solution.checks.strict_minimum
    # Each step is a chord of length 2 tan(a/2) for an angle a.
    assert solution.cost == pytest.approx(STEPS**2 * (2 * np.tan(np.pi / 4 / STEPS)) ** 2 / 2, rel=1e-9)


@given(angle=st.floats(0.1, 3.0))
def test_the_long_way_is_an_extremal_that_is_no_minimum(angle):
    """It passes the point opposite to its start, which is conjugate to it."""
    solution = geodesic(angle, turning(angle - 2 * np.pi))
    assert solution.cost == pytest.approx((2 * np.pi - angle) ** 2 / 2, rel=1e-10)
    assert not solution.checks.strict_minimum
    assert re.search("not .*strict local minimum", str(solution))
    assert "contains conjugate points" in " ".join(str(solution).split())


def test_half_a_turn_is_one_of_many_and_no_strict_minimum():
    solution = geodesic(np.pi, turning(np.pi))
    assert solution.cost == pytest.approx(np.pi**2 / 2, rel=1e-10)
    assert not solution.checks.strict_minimum
    said = " ".join(str(solution).split())
    assert "is a saddle or contains conjugate points, such as opposite points of a sphere" in said
    assert "Try another guess, such as Guess.from_waypoints" in said


def from_a_noisy_guess(seed: int, noise: float, **options) -> Solution:
    """From states scattered about the long way, at rest: the Hessian is indefinite there."""
    noisy = turning(2.0 - 2 * np.pi).states + noise * np.random.default_rng(seed).standard_normal((STEPS, 3))
    return geodesic(2.0, Guess(unit(noisy), np.zeros((STEPS, 3))), **options)


@pytest.mark.slow
def test_indefinite_hessians_on_the_way_are_overcome():
    """Each guess leads to the short way, a strict minimum, or to the long way, known to be none."""
    solutions = [from_a_noisy_guess(seed, 0.3) for seed in range(8)]
    short = [s for s in solutions if s.checks.strict_minimum]
    assert short
    assert all(s.cost == pytest.approx(2.0, rel=1e-10) for s in short)
    long = [s for s in solutions if not s.checks.strict_minimum]
    assert all(s.cost == pytest.approx((2 * np.pi - 2.0) ** 2 / 2, rel=1e-10) for s in long)


@given(seed=SEEDS)
def test_from_wild_guesses_it_never_claims_a_minimum_that_is_none(seed):
    solution = from_a_noisy_guess(seed, 1.0, throw=False)
    if solution.success:
        turned = np.sqrt(2 * solution.cost)
        windings = np.array([turned - 2.0, turned + 2.0]) / (2 * np.pi)
        assert np.min(np.abs(windings - np.round(windings))) < 1e-9
        assert solution.checks.strict_minimum == (turned < np.pi)


def test_a_slightly_disturbed_saddle_is_left_or_found():
    """Near the long way Newton's steps lead to it and descent leads away from it: either is an answer, none is not."""
    start = turning(2.0 - 2 * np.pi)
    noisy = start.states + 0.05 * np.random.default_rng(0).standard_normal((STEPS, 3))
    solution = geodesic(2.0, start._replace(states=unit(noisy)))
    assert solution.checks.strict_minimum == (abs(solution.cost - 2.0) < 1e-9)
