"""Optimal control problems whose discrete optimum is known in closed form."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.integrators import Guess, OptimalControlProblem, Solution, solve
from retrax.manifolds import Euclidean, Sphere, hat
from retrax.retractions import Cayley, Exponential, Midpoint, Theta
from scipy.optimize import brentq, minimize_scalar

from tests.support.numerics import SEEDS, norm, slope

from .problems import IDENTITY, KINEMATIC, REST, RIGID, SLEW, SLEW_END, SO3, half_square, rotation

LINE = Euclidean(1)
ANGLE, AXIS = 2.5, np.array([2.0, -1.0, 2.0]) / 3.0


@cache
def kinematic_slew(steps: int) -> Solution:
    return solve(KINEMATIC, IDENTITY, rotation(ANGLE * AXIS), 1.0, method=Midpoint(Exponential(SO3)), steps=steps)


@pytest.mark.parametrize("steps", [1, pytest.param(3, marks=pytest.mark.slow), 10])
def test_the_kinematic_slew_costs_half_the_square_of_its_angle(steps):
    assert kinematic_slew(steps).cost == pytest.approx(3.125, abs=1e-12)


@pytest.mark.parametrize("steps", [1, pytest.param(3, marks=pytest.mark.slow), 10])
def test_the_kinematic_slew_has_the_constant_body_covector_angle_times_axis(steps):
    solution = kinematic_slew(steps)
    (body,) = solution.body_costates.values()
    assert norm(body - ANGLE * AXIS) < 1e-11
    assert norm(solution.controls - ANGLE * AXIS) < 1e-11
    assert solution.checks.strict_minimum


@given(seed=SEEDS)
@pytest.mark.slow
def test_a_kinematic_slew_anywhere_costs_half_the_square_of_its_angle(seed):
    rng = np.random.default_rng(seed)
    start, axis, angle = rotation(rng.standard_normal(3)), rng.standard_normal(3), rng.uniform(0.1, 3.0)
    end = start @ rotation(angle * axis / np.linalg.norm(axis))
    solution = solve(KINEMATIC, start, end, 2.0, method=Midpoint(Exponential(SO3)), steps=3)
    assert solution.cost == pytest.approx(angle**2 / 4, rel=1e-10)


PULLED = OptimalControlProblem(
    SO3, lambda q, u: q @ hat(u), half_square, 3, terminal_cost=lambda q: jnp.sum((q - rotation(ANGLE * AXIS)) ** 2)
)


@cache
def pulled() -> Solution:
    return solve(PULLED, rotation(REST), None, 1.0, method=Midpoint(Exponential(SO3)), steps=3)


def test_a_terminal_cost_on_the_rotations_balances_the_way_against_the_rest():
    """``|R - R1|_F^2 = 4 (1 - cos(angle between))``, so the optimum is that of one angle."""
    best = minimize_scalar(
        lambda a: a**2 / 2 + 4 * (1 - np.cos(ANGLE - a)), bounds=(0, ANGLE), options={"xatol": 1e-12}
    )
    assert pulled().cost == pytest.approx(best.fun, abs=1e-12)


def test_at_a_free_end_the_costate_is_minus_the_derivative_of_the_terminal_cost():
    end, costate = pulled().states[-1], pulled().costates[-1]
    derivative = SO3.projection(jnp.asarray(end), 2 * (end - rotation(ANGLE * AXIS)))
    assert norm(costate + derivative) < 1e-11


REGULATOR = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2, 1)
PARABOLA = OptimalControlProblem(LINE, lambda q, u: u, half_square, 1, terminal_cost=lambda q: 5 * q @ q)
MIDPOINT_LINE = Midpoint(Exponential(LINE))


def test_the_regulator_costs_half_the_hyperbolic_tangent_of_one_to_order_two():
    steps = np.array([8, 16, 32])
    solutions = [solve(REGULATOR, np.ones(1), None, 1.0, method=MIDPOINT_LINE, steps=int(n)) for n in steps]
    errors = np.abs([s.cost - np.tanh(1.0) / 2 for s in solutions])
    assert slope(1.0 / steps, errors, 0.0) == pytest.approx(2.0, abs=0.01)
    assert errors[-1] < 1e-4
    assert all(norm(s.costates[-1]) < 1e-14 for s in solutions)


@pytest.mark.parametrize("theta", [0.0, 0.3, 1.0])
def test_the_regulator_solves_the_discrete_riccati_equation(theta):
    """The stage is at ``q + theta h u``: minimize ``h ((q + theta h u)^2 + u^2) / 2 + P (q + h u)^2 / 2`` backward in
    time."""
    steps, h, value = 8, 1 / 8, 0.0
    for _ in range(steps):
        uu, qu, qq = h * (theta * h) ** 2 + h + value * h**2, theta * h**2 + value * h, h + value
        value = qq - qu**2 / uu
    solution = solve(REGULATOR, np.ones(1), None, 1.0, method=Theta(Exponential(LINE), theta), steps=steps)
    assert solution.cost == pytest.approx(value / 2, abs=1e-14)
    assert solution.costates[0] == pytest.approx(-value, abs=1e-13)


@pytest.mark.parametrize("steps", [1, 8])
def test_a_terminal_cost_on_the_line_is_exact_for_any_number_of_steps(steps):
    solution = solve(PARABOLA, np.ones(1), None, 1.0, method=MIDPOINT_LINE, steps=steps)
    assert solution.cost == pytest.approx(5 / 11, abs=1e-14)
    assert solution.states[-1] == pytest.approx(1 / 11, abs=1e-13)


def test_where_the_end_rate_is_free_its_costate_vanishes():
    solution = solve(SLEW, (IDENTITY, REST), (SLEW_END, None), 60.0, method=Midpoint(Cayley(RIGID)), steps=10)
    attitude, rate = solution.states
    assert norm(attitude[-1] - SLEW_END) < 1e-11
    assert norm(rate[-1]) > 1e-2
    assert norm(solution.costates[1][-1]) < 1e-9 * norm(solution.costates[1])


def test_where_the_start_rate_is_free_its_costate_vanishes():
    solution = solve(SLEW, (IDENTITY, None), (SLEW_END, REST), 60.0, method=Midpoint(Cayley(RIGID)), steps=10)
    attitude, rate = solution.states
    assert norm(attitude[0] - IDENTITY) < 1e-15
    assert norm(rate[0]) > 1e-2
    assert norm(solution.costates[1][0]) < 1e-9 * norm(solution.costates[1])


def test_rest_at_the_best_place_is_optimal_where_both_ends_are_free():
    """Everything vanishes at this optimum, the costates and every derivative too."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: half_square(q, u) + jnp.cosh(q[0] - 0.3), 1)
    guess = Guess(np.ones((8, 1)), np.ones((8, 1)))
    solution = solve(problem, None, None, 1.0, method=MIDPOINT_LINE, steps=8, guess=guess)
    assert solution.cost == pytest.approx(1.0, abs=1e-14)
    assert norm(solution.states - 0.3) < 1e-7


def test_a_hanging_chain_is_found_with_headings_on_the_sphere():
    """``q' = u`` with ``|u| = 1``, least mean height: rods whose tension ``p = (a, 0, z)`` grows by the weight of a
    rod."""
    steps, distance, space = 10, 0.8, Euclidean(3)
    heights = (np.arange(steps) + 0.5) / steps - 0.5

    def rods(a):
        return np.stack([np.full(steps, a), np.zeros(steps), heights], axis=1) / np.hypot(a, heights)[:, None]

    tension = brentq(lambda a: np.mean(rods(a)[:, 0]) - distance, 1e-3, 10.0, xtol=1e-15)
    hanging = rods(tension)
    nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(hanging, axis=0) / steps])
    chain = OptimalControlProblem(space, lambda q, u: u, lambda q, u: q[2], Sphere(2))
    wedge = np.repeat([[0.8, 0.0, -0.6], [0.8, 0.0, 0.6]], steps // 2, axis=0)
    pull = np.stack([np.full(steps + 1, 0.5), np.zeros(steps + 1), np.linspace(-0.5, 0.5, steps + 1)], axis=1)
    guess = Guess((np.cumsum(wedge, axis=0) - wedge / 2) / steps, wedge, pull)
    solution = solve(chain, np.zeros(3), nodes[-1], 1.0, method=Midpoint(Exponential(space)), steps=steps, guess=guess)
    assert norm(solution.controls - hanging) < 1e-10
    assert norm(solution.states - nodes) < 1e-10
    assert norm(solution.stage_costates[:, 0] - tension) < 1e-10
    assert solution.checks.strict_minimum
