"""What a solution claims - success, a strict minimum, its residuals - on both sides of where it stops being true."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solution, Solver, solve
from retrax.manifolds import ConvergenceError, Euclidean, Sphere
from retrax.retractions import Addition, Exponential, Gauss, Midpoint

from .problems import half_square

LINE, SPHERE, STEPS = Euclidean(1), Sphere(2), 9
ARCS = OptimalControlProblem(SPHERE, SPHERE.projection, half_square, 3)


@cache
def along_arcs():
    return Solver(ARCS, Midpoint(Exponential(SPHERE)), STEPS)


def arc(degrees: float) -> Solution:
    """The great circle of this length, from a guess along it."""

    def at(angle: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)

    length = np.deg2rad(degrees)
    angles = (np.arange(STEPS) + 0.5) / STEPS * length
    guess = Guess(at(angles), length * at(angles + np.pi / 2))
    ends = at(np.array([0.0, length]))
    return along_arcs().solve(*ends, 1.0, guess=guess, throw=False)


@pytest.mark.parametrize("degrees", [*range(5, 180, 5), 179, 179.9, 180.1, 181, 200, 265, 275, 350])
@pytest.mark.usual(2)
def test_a_great_circle_is_a_strict_minimum_up_to_half_a_turn_wherever_nodes_fall(degrees):
    """Its ends are conjugate at 180 degrees; at 90, where several of these have a node, a free end is at a focal
    point."""
    solution = arc(degrees)
    assert solution.success
    assert solution.cost == pytest.approx(np.deg2rad(degrees) ** 2 / 2, rel=1e-10)
    assert solution.checks.strict_minimum == (degrees < 180)


OSCILLATOR = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (u @ u - q @ q) / 2, 1)
HALF_PERIOD = 2 * STEPS * np.tan(np.pi / 2 / STEPS)  # of the discrete oscillator, whose steps turn by 2 arctan(h / 2)


@cache
def oscillations():
    return Solver(OSCILLATOR, Midpoint(Exponential(LINE)), STEPS)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("distance", [0.0, *10.0 ** np.arange(-15, 0)])
@pytest.mark.usual(3)
def test_an_oscillator_over_half_a_period_is_solved_as_far_as_the_system_determines_it(distance, sign):
    """The extremal from 0 to 1 costs ``cot(turn) / 2``; over half a period there is none, near it rounding decides."""
    horizon = HALF_PERIOD + sign * distance
    solution = oscillations().solve(np.zeros(1), np.ones(1), horizon, throw=False)
    if distance <= 1e-12:
        assert not solution.success
        assert "singular" in solution.result
        return
    assert solution.success or distance < 1e-9
    if solution.success:
        turn = 2 * STEPS * np.arctan(horizon / STEPS / 2)
        # The horizon and the steps are rounded, and with them the distance, the inverse condition of the system.
        known = 16 * np.finfo(float).eps * horizon / distance
        assert solution.cost == pytest.approx(1 / (2 * np.tan(turn)), rel=1e-8 + known)
        assert not solution.checks.strict_minimum or sign < 0
        assert solution.checks.strict_minimum or sign > 0 or distance < 1e-4


class Pull(eqx.Module):
    """A terminal cost ``c a'q``, whose gradient at ``a`` is normal to the sphere."""

    strength: jax.Array

    def cost(self, q: jax.Array) -> jax.Array:
        return self.strength * q[2]


@pytest.mark.parametrize("strength", [-2.0, 0.5, 0.99, 1.01, 2.0, 5.0])
@pytest.mark.usual(2)
def test_a_terminal_cost_bends_with_its_normal_gradient(strength):
    """Rest at the pole where ``c q_z`` is greatest: a way of length s costs ``s^2 / 2 + c cos s``, least at 0 for c < 1
    only."""
    pole, pull = np.array([0.0, 0.0, 1.0]), Pull(jnp.asarray(strength))
    problem = OptimalControlProblem(SPHERE, SPHERE.projection, half_square, 3, terminal_cost=pull.cost)
    guess = Guess(np.tile(pole, (3, 1)), np.zeros((3, 3)))
    solution = solve(problem, pole, None, 1.0, method=Midpoint(Exponential(SPHERE)), steps=3, guess=guess)
    assert solution.cost == pytest.approx(strength, abs=1e-14)
    assert solution.checks.strict_minimum == (strength < 1)


def hurried() -> ConvergenceError:
    """Too few steps for a cost that is not quadratic, with linear dynamics: its ends meet, but it is not stationary."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: half_square(q, u) + jnp.cosh(3 * q[0]), 1)
    with pytest.raises(ConvergenceError) as raised:
        solve(problem, np.zeros(1), np.full(1, 2.0), 1.0, method=Midpoint(Exponential(LINE)), steps=4, max_iterations=1)
    return raised.value


def test_the_error_holds_what_was_reached_with_defect_and_stationarity_in_their_places():
    reached = hurried().solution
    checks = reached.checks
    assert not reached.success
    assert checks.defect < 1e-13 < 1e-3 < checks.stationarity
    assert f"defect {checks.defect:.1e}, stationarity {checks.stationarity:.1e}" in str(reached)
    assert np.all(np.diff(reached.states[:, 0]) > 0)
    assert np.isfinite(reached.cost)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("cost", "running_cost has no finite derivative by the states at q = "),
        ("dynamics", "dynamics has no finite derivative by the states at q = "),
    ],
)
def test_a_norm_at_rest_is_named_with_its_place(part, words):
    """Its values are finite, and so are its derivatives by the controls, which are looked at before."""
    plane = Euclidean(2)
    size = {part: lambda q: jnp.linalg.norm(q)}
    problem = OptimalControlProblem(
        plane,
        lambda q, u: u * (1 + size.get("dynamics", jnp.zeros_like)(q)),
        lambda q, u: u @ u + size.get("cost", lambda q: 0.0)(q),
        2,
    )
    found = solve(problem, np.zeros(2), np.zeros(2), 1.0, method=Midpoint(Addition(plane)), steps=4, throw=False)
    assert not found.success
    assert words in found.result
    assert "sqrt(x @ x + 1e-6) instead of norm(x)" in found.result


@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize(
    ("limits", "name"),
    [
        ({"constraints": {"speed": lambda q, u: jnp.linalg.norm(q[2:]) - 2.0}}, "constraints['speed']"),
        ({"node_constraints": {"speed": lambda q: jnp.linalg.norm(q[2:]) - 2.0}}, "node_constraints['speed']"),
    ],
)
@pytest.mark.usual(1)
def test_a_limit_of_a_norm_at_rest_is_named_at_once(limits, name, stages):
    """No step leads away from a point without derivatives, so each search ends where it begins."""
    space = Euclidean(4)
    problem = OptimalControlProblem(space, lambda q, u: jnp.concatenate([q[2:], u]), lambda q, u: u @ u, 2, **limits)
    found = solve(problem, np.zeros(4), np.eye(4)[0], 1.0, method=Gauss(stages, Addition(space)), steps=6, throw=False)
    assert not found.success
    assert found.statistics.iterations <= 10
    assert f"{name} has no finite derivative by the states at q = [" in found.result
    assert "x @ x - a**2 instead of norm(x) - a" in found.result
    assert "\n" not in found.result
