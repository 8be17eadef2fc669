"""Solutions with inequalities as guesses: their multipliers say how low the barrier begins, and never what is found."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.integrators import Free, Guess, OptimalControlProblem, Phase, Solver, continuation, solve_phases
from retrax.integrators.problem.free_quantities import with_guess
from retrax.manifolds import Euclidean, InvalidInputError, hat
from retrax.retractions import Cayley, Gauss, Midpoint, default_retraction

from .problems import INERTIA, REST, RIGID, rotation

HORIZON, STEPS, LIMIT = 3.0, 20, 0.85
AXIS, START = np.array([0.6, 0.0, 0.8]), (np.eye(3), REST)
SAME = 2e-7  # of a cost, relative: what the last barrier leaves
PLANE, METHOD = Euclidean(2), Gauss(2, default_retraction(Euclidean(2)))


def at(angle):
    return rotation(angle * AXIS), REST


def body(q, u):
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


@cache
def slew():
    problem = OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2, 3, control_bounds=(-LIMIT, LIMIT))
    return Solver(problem, Midpoint(Cayley(RIGID)), STEPS)


@cache
def solved(angle=1.0, steps=STEPS):
    return slew().with_steps(steps).solve(START, at(angle), HORIZON)


@pytest.mark.parametrize("name", ["keep-out-cone", "aly-chan", "fishing", "free-flying-robot", "betts"])
@pytest.mark.usual(1)
def test_a_solution_is_found_again_from_itself(name):
    """Among them one that is singular, and one whose inequality does not see the controls."""
    known = problems.get(name)
    solver = Solver(known.problem, known.discretization, known.steps)
    first = solver.solve(known.start, known.end, known.horizon, guess=known.guess)
    again = solver.solve(known.start, known.end, with_guess(known.horizon, first.horizon), guess=first)
    assert again.statistics.iterations < first.statistics.iterations / 2
    assert again.cost == pytest.approx(first.cost, rel=1e-8, abs=1e-9)


def test_the_nearer_the_end_the_fewer_iterations():
    """Through the decision whether the multipliers fit: from the solution itself to ends that are far from its own."""
    assert solved().checks.active["control_bounds upper"] > 3
    moves, counts, own = np.geomspace(1e-7, 1.5, 15), [], solved().guess()
    for move in moves:
        guesses = solved(), None, Guess(own.states, own.controls)
        warm, cold, bare = (slew().solve(START, at(1.0 - move), HORIZON, guess=guess, throw=False) for guess in guesses)
        assert warm.success == cold.success
        counts.append([found.statistics.iterations for found in (warm, cold, bare)])
        if cold.success:
            assert warm.cost == pytest.approx(cold.cost, rel=SAME)
    warm, cold, bare = np.array(counts).T
    assert np.all(warm[moves < 1e-3] <= 2)
    assert np.all(warm <= cold + 4)
    assert np.all(warm <= bare)


@pytest.mark.parametrize("factor", [0.0, 1e-8, 1e-3, 0.5, 0.99, 2.0, 30.0, 1e4, 1e8, "other side"])
def test_wrong_multipliers_lead_to_the_same_optimum(factor):
    guess = solved().guess()
    lower, upper = guess.multipliers.values()
    wrong = (upper, lower) if isinstance(factor, str) else (factor * lower, factor * upper)
    named = dict(zip(guess.multipliers, wrong, strict=True))
    found = slew().solve(START, at(1.0), HORIZON, guess=guess._replace(multipliers=named))
    assert found.cost == pytest.approx(solved().cost, rel=SAME)


@pytest.mark.parametrize("steps", [7, 13, 45])
def test_other_steps(steps):
    cold, warm = solved(steps=steps), slew().with_steps(steps).solve(START, at(1.0), HORIZON, guess=solved())
    assert warm.cost == pytest.approx(cold.cost, rel=SAME)
    assert warm.statistics.iterations < cold.statistics.iterations


def test_members_of_a_batch_begin_as_they_would_alone():
    guess, ends = solved().guess(), (np.stack([at(a)[0] for a in (1.0, 1.01, 0.9)]), np.zeros((3, 3)))
    guesses = [guess, guess._replace(multipliers=None), guess]
    found = slew().solve_many(START, ends, HORIZON, guesses=guesses)
    for k, own in enumerate(guesses):
        alone = slew().solve(START, (ends[0][k], REST), HORIZON, guess=own)
        assert found[k].statistics.iterations == alone.statistics.iterations
        assert found[k].cost == pytest.approx(alone.cost, rel=1e-12)


def push_in_two_ways(q, u):
    return jnp.stack([q[1], u[0] + 0.1 * u[1]])


def pushed(cost=1.0, lower=-np.inf, upper=np.inf):
    problem = OptimalControlProblem(
        PLANE, push_in_two_ways, lambda q, u: cost * (u @ u) / 2, 2, control_bounds=(lower, upper)
    )
    return Solver(problem, Midpoint(default_retraction(PLANE)), 20)


ENDS = np.zeros(2), np.array([1.1, 0.0])


@pytest.mark.parametrize("cost", [1e-8, 1e8])
def test_controls_that_are_confined_unlike_are_found_in_any_unit_of_the_cost(cost):
    limits = np.array([[-9.0, -0.03], [90.0, 0.03]])
    own, other = (pushed(unit, *limits).solve(*ENDS, 1.0) for unit in (1.0, cost))
    assert other.statistics.iterations == own.statistics.iterations
    assert other.cost == pytest.approx(cost * own.cost, rel=1e-9)


@pytest.mark.parametrize("way", [1e-6, 4e-4, 1e-3, 1e-2])
@pytest.mark.usual(1)
def test_a_guess_next_to_a_bound_does_not_loosen_what_success_means(way):
    """The way to the only bound says nothing of how far a control can go."""
    lower = np.array([-np.inf, 1.0])
    states = np.linspace(*ENDS, 20)
    guess = Guess(states, np.tile([0.0, 1.0 + way], (20, 1)))
    found, cold = (pushed(lower=lower).solve(*ENDS, 1.0, guess=given) for given in (guess, None))
    assert found.cost == pytest.approx(cold.cost, rel=2e-9)


def moving(q, u, t):
    return jnp.stack([q[1], u[0] * (1 + 0.3 * jnp.sin(t))])


def test_a_free_horizon_with_a_bound_that_pulls_and_a_time():
    """What is added to the states has covectors too, and a guess that is a solution knows them."""
    problem = OptimalControlProblem(
        PLANE, moving, lambda q, u, t: 1.0 + u @ u / 2, 1, time_dependent=True, control_bounds=(-0.8, 0.8)
    )
    solver, way = Solver(problem, METHOD, 12), (np.zeros(2), np.array([1.0, 0.0]))
    free = solver.solve(*way, Free(2.0))
    for upper in (np.inf, 0.99 * free.horizon):
        horizon = Free(0.9 * free.horizon, upper=upper)
        first = solver.solve(*way, horizon)
        again = solver.solve(*way, Free(first.horizon, upper=upper), guess=first)
        assert again.statistics.iterations <= 4 < first.statistics.iterations
        assert again.cost == pytest.approx(first.cost, rel=SAME)


def test_phases_begin_with_the_multipliers_of_theirs():
    problem = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: u @ u / 2, 1, control_bounds=(-5.0, 5.0)
    )
    phases = [
        Phase(problem, METHOD, 6, 0.5, start=REST[:2]),
        Phase(problem, METHOD, 6, 0.5, end=np.array([1.0, 0.0])),
    ]
    first = solve_phases(phases)
    again = solve_phases(phases, guess=first)
    assert first.phases[0].checks.active["control_bounds upper"]
    assert again.phases[0].statistics.iterations <= 3 < first.phases[0].statistics.iterations
    assert again.cost == pytest.approx(first.cost, rel=SAME)


def test_a_continuation_with_limits_keeps_the_multipliers():
    path = continuation(slew(), lambda place: {"start": START, "end": at(0.6 + 0.5 * place), "horizon": HORIZON})
    cold = [slew().solve(START, at(0.6 + 0.5 * place), HORIZON) for place in path.places]
    assert path.success
    assert path.solution.checks.active["control_bounds upper"]
    assert path.solution.cost == pytest.approx(cold[-1].cost, rel=SAME)
    counts = [[found.statistics.iterations for found in own[1:]] for own in (path.solutions, cold)]
    assert sum(counts[0]) < 0.8 * sum(counts[1])


@pytest.mark.parametrize("share", [1e-9, 0.05, 0.15])
def test_what_is_left_of_a_plan_is_the_guess_of_the_next(share):
    after = share * HORIZON
    guess, reached = solved().guess(after=after), solved()(after)
    for leaf, place in zip(guess.nodes, reached.states, strict=True):
        np.testing.assert_allclose(leaf[0], place, atol=1e-12)
    np.testing.assert_allclose(guess.costates[1][-1], solved().costates[1][-1], atol=1e-12)
    left = [slew().solve(reached.states, at(1.0), HORIZON - after, guess=one) for one in (guess, None)]
    assert left[0].cost == pytest.approx(left[1].cost, rel=SAME)
    assert left[0].statistics.iterations < left[1].statistics.iterations


def test_what_is_left_of_a_plan_has_the_multipliers_of_its_own_time():
    rows = {"control_bounds upper": solved().stage_times[:, None] * np.ones(3)}
    guess = replace(solved(), multipliers=rows).guess(after=0.3 * HORIZON)
    step = HORIZON / STEPS
    np.testing.assert_allclose(guess.multipliers["control_bounds upper"][0], 0.3 * HORIZON + 0.35 * step)


@pytest.mark.parametrize("after", [-0.1, HORIZON, np.nan])
def test_a_time_at_which_nothing_is_left_is_said(after):
    with pytest.raises(InvalidInputError, match="expected a time in it"):
        solved().guess(after=after)


ROWS = np.zeros((STEPS, 3))
WRONG = {
    "belong to 'cone'": {"cone": ROWS},
    "of shape \\(20, k\\)": {"control_bounds lower": ROWS[1:]},
    "real numbers": {"control_bounds lower": 1j * ROWS},
    "finite and not negative": {"control_bounds lower": ROWS - 1},
    "must be finite": {"control_bounds upper": ROWS + np.nan},
    "2 entries at a stage, expected 3; try guess._replace\\(multipliers=None\\)": {"control_bounds lower": ROWS[:, :2]},
}


@pytest.mark.parametrize("words", WRONG)
def test_what_are_no_multipliers_is_said(words):
    own = solved().guess()
    with pytest.raises(InvalidInputError, match=words):
        slew().solve(START, at(1.0), HORIZON, guess=own._replace(multipliers=WRONG[words]))


def test_a_solution_of_a_problem_with_other_inequalities_is_a_guess():
    problem = OptimalControlProblem(
        RIGID, body, lambda q, u: u @ u / 2, 3, constraints={"ball": lambda q, u: u @ u - 9}
    )
    found = Solver(problem, Midpoint(Cayley(RIGID)), STEPS).solve(START, at(1.0), HORIZON, guess=solved())
    assert found.success
    assert Guess(*solved().guess()[:5]).multipliers is None
