"""Guesses from controls and through waypoints."""

import threading
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver, default_guess, solve
from retrax.integrators.boundary_value.guess import DefaultGuess
from retrax.integrators.boundary_value.inputs import connecting_curve
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData
from retrax.integrators.boundary_value.inputs.connecting_curve import ConnectingCurve
from retrax.integrators.boundary_value.inputs.inputs import Inputs
from retrax.integrators.boundary_value.inputs.options import Options
from retrax.manifolds import SE, SO, DomainError, Euclidean, InvalidInputError, LevelSet, NotOnManifoldError, Sphere
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, Projection, Retraction, default_retraction
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from .problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, half_square, rotation, spacecraft

START, END = (IDENTITY, REST), (SLEW_END, REST)
METHOD = Midpoint(Cayley(RIGID))


def difference(a, b):
    return max(np.max(np.abs(x - y)) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def test_the_controls_of_a_solution_lead_to_its_states_to_second_order():
    off = []
    for steps in (10, 20, 40):
        solution = solve(SLEW, START, END, 60.0, method=METHOD, steps=steps)
        guess = Guess.from_controls(SLEW, METHOD, START, solution.controls, 60.0, steps)
        off.append(difference(guess.states, solution.stage_states))
    assert off[0] < 0.03
    np.testing.assert_allclose(np.log2(np.divide(off[:-1], off[1:])), 2, atol=0.2)


def test_a_function_of_time_is_evaluated_at_the_stages_of_uneven_steps():
    method, steps = Gauss(3, default_retraction(RIGID)), [1.0, 2.0, 1.0]
    guess = Guess.from_controls(SLEW, method, START, lambda t: np.array([t, 0.0, 0.0]), 8.0, steps)
    places = np.array([0.0, 2.0, 6.0])[:, None] + np.array([2.0, 4.0, 2.0])[:, None] * method.nodes
    np.testing.assert_allclose(guess.controls[:, 0], places.ravel(), rtol=1e-14)


@pytest.mark.parametrize("method", [METHOD, Gauss(2, default_retraction(RIGID))])
def test_two_waypoints_are_the_default_guess(method):
    assert (
        difference(Guess.from_waypoints(SLEW, method, [START, END], 9), default_guess(SLEW, method, START, END, 9)) == 0
    )


@pytest.mark.parametrize("steps", [5, [1.0, 3.0, 2.0]])
@pytest.mark.parametrize("bounds", [None, (0.5, 2.0)])
@pytest.mark.parametrize("method", [Midpoint(Projection(Sphere(2))), Gauss(2, Projection(Sphere(2)))])
@pytest.mark.usual(2)
def test_the_default_guess_is_that_of_a_solver(method, bounds, steps, monkeypatch):
    """To the last digit; and one that is changed is changed for both."""

    def turn(q, u):
        return jnp.cross(u, q)

    problem = OptimalControlProblem(Sphere(2), turn, lambda q, u: u @ u / 2, 3, control_bounds=bounds)
    ends, solver = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])), Solver(problem, method, steps)

    def begun(guess=None):
        options = Options.of(None, 1)
        inputs = Inputs.of(solver._reader, BoundaryData(*ends, 1.0, None), guess, options)
        return solver._transcription.transcribe(inputs).guess

    def begins_as_given():
        given = default_guess(problem, method, *ends, steps)
        assert bounds is None or np.all(given.controls > 0.5)
        pairs = zip(jax.tree.leaves(begun()), jax.tree.leaves(begun(given)), strict=True)
        return given, all(np.array_equal(a, b) for a, b in pairs)

    before, same = begins_as_given()
    assert same
    arrays = DefaultGuess.arrays
    monkeypatch.setattr(
        DefaultGuess, "arrays", lambda *of: (arrays(*of)[0], arrays(*of)[1] + 0.25, arrays(*of)[2] + 0.5)
    )
    after, same = begins_as_given()
    assert same
    np.testing.assert_allclose(after.controls - before.controls, 0.25)
    np.testing.assert_allclose(after.costates - before.costates, 0.5)


def test_a_default_guess_is_a_geodesic_where_tapes_give_it():
    for angle in np.deg2rad(np.linspace(10.0, 179.0, 14)):
        end = rotation(angle * np.array([1.0, 2.0, -2.0]) / 3), REST
        for method in (METHOD, Gauss(2, Cayley(RIGID))):
            states = default_guess(SLEW, method, START, end, 6).states[0]
            turned = np.arccos((np.trace(states, axis1=1, axis2=2) - 1) / 2)
            places = (np.arange(6)[:, None] + np.array(getattr(method, "nodes", [0.5]))).ravel() / 6
            np.testing.assert_allclose(turned, places * angle, atol=1e-7)


def test_the_curve_of_a_default_guess_does_not_depend_on_the_number_of_steps():
    """On SO(4) logarithms take decompositions: the Cayley map's curve is tried first, and from three quarters of half a
    turn on it is too uneven."""
    taken, start = [], ConnectingCurve(SO(4), Cayley(SO(4)))
    for angle in np.deg2rad(np.linspace(120.0, 150.0, 31)):
        plane = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        ends = np.eye(4).reshape(1, 16), block_diag(plane, np.eye(2)).reshape(1, 16)
        at = [(np.arange(n) + 0.5) / n for n in (3, 9, 81)]
        few, many, more = (start.states(*ends, places)[0][len(places) // 6] for places in at)  # at a sixth of the way
        np.testing.assert_allclose(many, few, atol=1e-12)
        np.testing.assert_allclose(more, few, atol=1e-12)
        taken.append(np.arccos(few[0]) > 1.2 * angle / 6)
    assert not taken[-1]
    assert taken == sorted(taken, reverse=True)
    assert taken[0]


class Ball(LevelSet):
    """The sphere by its equation, whose exponential has no logarithm that a tape could give."""

    def __init__(self):
        self.shape = (3,)

    def constraint(self, x):
        return x @ x - 1


class GreatCircles(Retraction):
    manifold: Ball

    def retract(self, x, v):
        return jnp.cos(vec.size(v)) * x + jnp.sinc(vec.size(v) / jnp.pi) * v

    def preimage(self, x, y):
        if isinstance(x, jax.core.Tracer):
            raise NotImplementedError("no logarithm")
        return y


def test_a_default_retraction_without_a_logarithm_is_not_asked_for_where_the_given_one_arrives(monkeypatch):
    ball = Ball()
    monkeypatch.setattr(connecting_curve, "default_retraction", lambda manifold: GreatCircles(manifold))
    way = ConnectingCurve(ball, Projection(ball))
    states = way.states(np.eye(3)[:1], np.array([[0.6, 0.8, 0.0]]), np.array([0.5]))
    assert abs(np.linalg.norm(states) - 1) < 1e-14
    with pytest.raises(NotImplementedError, match="no logarithm"):  # the projection of a chord does not go that far
        way.states(np.eye(3)[:1], -np.eye(3)[:1], np.array([0.5]))


def test_a_first_guess_that_is_interrupted_is_traced_again(monkeypatch):
    calls, curve = [], ConnectingCurve._curve

    def interrupted(self, *given):
        calls.append(given)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return curve(self, *given)

    monkeypatch.setattr(ConnectingCurve, "_curve", interrupted)
    solver = Solver(SLEW, METHOD, 10)
    with pytest.raises(KeyboardInterrupt):
        solver.solve(START, END, 60.0)
    assert solver.solve(START, END, 60.0).success


@pytest.mark.slow
def test_first_guesses_of_several_threads():
    for _ in range(5):
        solver, barrier = Solver(SLEW, METHOD, 10), threading.Barrier(6)

        def first(_, solver=solver, barrier=barrier):
            barrier.wait()
            return solver.solve(START, END, 60.0).success

        with ThreadPoolExecutor(6) as pool:
            assert all(pool.map(first, range(6)))


def test_waypoints_are_passed_at_their_times():
    aside = rotation([0.3, -0.2, 0.1]), REST
    guess = Guess.from_waypoints(SLEW, METHOD, [START, aside, END], 40, times=[0.0, 15.5, 40.0])
    np.testing.assert_allclose(guess.states[0][15], aside[0], atol=1e-12)
    assert solve(SLEW, START, END, 60.0, method=METHOD, steps=40, guess=guess).success


def test_what_is_no_guess_is_said():
    with pytest.raises(InvalidInputError, match="at least two points"):
        Guess.from_waypoints(SLEW, METHOD, [START], 9)
    with pytest.raises(InvalidInputError, match="times must be 2 ascending numbers"):
        Guess.from_waypoints(SLEW, METHOD, [START, END], 9, times=[1.0, 1.0])
    with pytest.raises(NotOnManifoldError, match="start"):
        Guess.from_waypoints(SLEW, METHOD, [START, (2 * IDENTITY, REST)], 9)
    with pytest.raises(InvalidInputError, match="controls must have shapes"):
        Guess.from_controls(SLEW, METHOD, START, np.zeros((8, 3)), 60.0, 9)
    with pytest.raises(InvalidInputError, match="horizon must be"):
        Guess.from_controls(SLEW, METHOD, START, np.zeros((9, 3)), 0.0, 9)


def test_controls_that_lead_to_infinity_are_told_with_the_time():
    runaway = OptimalControlProblem(Euclidean(1), lambda q, u: jnp.exp(q) + u, half_square, 1)
    with pytest.raises(DomainError, match="no finite state at time"):
        Guess.from_controls(
            runaway, Midpoint(default_retraction(Euclidean(1))), np.zeros(1), lambda t: np.ones(1), 20.0, 20
        )


def hung(q, u):
    """A pendulum: its angle from below, and its rate."""
    return jnp.stack([q[1], u[0] - 9.81 * jnp.sin(q[0])])


@pytest.mark.parametrize("rate", [0.0, 1e-300, *10.0 ** np.arange(-20, 1, 4)])
@pytest.mark.usual("0.0", "1e-16", "1e-08")
def test_rounding_of_a_guess_at_rest_measures_nothing(rate):
    """At ``sin(pi) = 1e-16`` a pendulum moves by rounding; so do those of guesses that hardly move."""
    plane = Euclidean(2)
    method, end = Midpoint(default_retraction(plane)), np.array([np.pi, 0.0])
    problem = OptimalControlProblem(plane, hung, half_square, 1)
    for angle in (0.0, np.pi):
        guess = Guess(np.tile([angle, rate], (20, 1)), np.zeros((20, 1)))
        solution = solve(problem, np.zeros(2), end, 2.0, method=method, steps=20, guess=guess)
        assert solution.checks.strict_minimum
        assert solution.statistics.iterations <= 30


def turned(q, u):
    return jnp.cross(u, q)


def ways(length, count):
    """A guess along the way of the solution, all of it ahead by a turn: a gap of this length before, and one after."""
    places = np.linspace(0, 1, count, endpoint=False) + 0.5 / count + length
    return np.stack([np.cos(places), np.sin(places), 0 * places], axis=1)


@pytest.mark.parametrize("place", [0, 3])
def test_gaps_through_the_length_at_which_they_are_measured_along_arcs(place):
    """From half the largest entry of a node on they are; none of the lengths around that is arrived from in more
    steps."""
    sphere = Sphere(2)
    solver = Solver(OptimalControlProblem(sphere, turned, half_square, 3), Midpoint(default_retraction(sphere)), 8)
    start, end = np.array([1.0, 0.0, 0.0]), np.array([np.cos(1.0), np.sin(1.0), 0.0])
    counts = []
    for length in (0.1, 0.4, 0.45, 0.49, 0.499, 0.501, 0.505, 0.51, 0.515, 0.55, 0.6, 0.9, 1.5):
        states = ways(0.0, 8)
        states[place:] = ways(length, 8)[place:]
        solution = solver.solve(start, end, 1.0, guess=Guess(states, np.zeros((8, 3))))
        assert solution.cost == pytest.approx(solver.solve(start, end, 1.0).cost, rel=1e-10)
        counts.append(solution.statistics.iterations)
    assert max(counts) <= 6


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0, -0.5])
def test_a_free_end_is_guessed_where_it_is_said(share):
    """From the target itself, by half of the way there, to the other way round; without a guess it is the start."""
    way = np.array([0.0, 0.0, 2.5])
    start, guessed = ((Rotation.from_rotvec(turn).as_matrix(), np.zeros(3)) for turn in (way, (1 - share) * way))
    problem = OptimalControlProblem(
        RIGID, spacecraft, half_square, 3, terminal_cost=lambda q: 50 * (3 - jnp.trace(q[0])) + 50 * q[1] @ q[1]
    )
    method = Midpoint(Cayley(RIGID))
    for end in ((Free(guessed[0]), None), (Free(guessed[0]), Free(guessed[1]))):
        last = default_guess(problem, method, start, end, 20).states[0][-1]
        middle = Rotation.from_matrix(guessed[0]) * Rotation.from_matrix(last).inv()
        assert middle.magnitude() <= 2.5 * abs(share) / 20 + 1e-12
    last = default_guess(problem, method, start, None, 20).states[0][-1]
    np.testing.assert_allclose(last, start[0], atol=1e-12)


def test_controls_lead_to_states_in_an_explicit_time():
    """``x'' = u + sin t`` has the solution ``t - sin t`` from rest without a control."""
    plane = Euclidean(2)
    problem = OptimalControlProblem(
        plane,
        lambda q, u, t: jnp.stack([q[1], u[0] + jnp.sin(t)]),
        lambda q, u, t: u @ u / 2,
        1,
        time_dependent=True,
    )
    method, steps = Midpoint(Addition(plane)), [1.0, 2.0] * 10
    guess = Guess.from_controls(problem, method, np.zeros(2), np.zeros((20, 1)), 3.0, steps)
    solver = Solver(problem, method, steps)
    times = solver.solve(np.zeros(2), None, 3.0).stage_times
    np.testing.assert_allclose(guess.states[:, 0], times - np.sin(times), atol=1e-7)
    ended = solver.solve(np.zeros(2), np.array([3.0 - np.sin(3.0), 1.0 - np.cos(3.0)]), 3.0, guess=guess)
    assert ended.cost < 1e-4


def quadrotor():
    """A quadrotor whose rotors only push: thrust along body axis z and torques, from the thrusts of four rotors."""
    space, weight = SE(3) * Euclidean(6), 0.5 * 9.81
    mixer = jnp.array([[-0.12, -0.12, 0.12, 0.12], [-0.12, 0.12, 0.12, -0.12], [0.016, -0.016, 0.016, -0.016]])
    inertia = jnp.array([2.3e-3, 2.3e-3, 4.0e-3])

    def dynamics(q, u):
        pose, (w, v) = q[0], (q[1][:3], q[1][3:])
        up = pose[2, :3]
        force = jnp.array([0.0, 0.0, 1.0]) * jnp.sum(u) - weight * up
        turning = (mixer @ u - jnp.cross(w, inertia * w)) / inertia
        return pose @ SE(3).hat(q[1]), jnp.concatenate([turning, force / 0.5 - jnp.cross(w, v)])

    def cost(q, u):
        return (u - weight / 4) @ (u - weight / 4)

    return OptimalControlProblem(space, dynamics, cost, 4, control_bounds=(0.0, weight / 2))


def test_controls_begin_inside_bounds_that_exclude_rest():
    """Without thrust no tilt moves the quadrotor: from controls at their lower bounds no flight aside is found."""
    problem, steps = quadrotor(), 12
    method = Gauss(2, Cayley(problem.manifold))
    solver, start = Solver(problem, method, steps), (np.eye(4), np.zeros(6))
    for x, y, z in [(3.0, 0.0, 0.0), (3.0, 1.0, 1.0), (0.0, 2.0, -1.0)]:
        goal = np.eye(4)
        goal[:3, 3] = x, y, z
        given = default_guess(problem, method, start, (goal, np.zeros(6)), steps)
        assert np.all((given.controls > 0) & (given.controls < problem._limits.upper[0]))
        found = solver.solve(start, (goal, np.zeros(6)), 1.5, throw=False)
        hovering = given._replace(controls=np.full((2 * steps, 4), 0.5 * 9.81 / 4))
        best = solver.solve(start, (goal, np.zeros(6)), 1.5, guess=hovering)
        assert found.success, (x, y, z)
        assert found.cost == pytest.approx(best.cost, rel=1e-9)
