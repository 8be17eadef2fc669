"""Functions that are not finite everywhere: they are looked at inside the bounds of the controls and near the guess."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Midpoint

LINE = Euclidean(1)
METHOD, STEPS = Midpoint(Addition(LINE)), 6
# Running costs that are convex and fall towards infinity at the edges of their domains.
COSTS = {
    "logarithm": lambda q, u: -jnp.log(u[0]),
    "quotient": lambda q, u: 1 / u[0],
    "root": lambda q, u: -jnp.sqrt(u[0]),
    "entropy": lambda q, u: u[0] * jnp.log(u[0]),
    "between": lambda q, u: -jnp.log(u[0]) - jnp.log(1 - u[0]),
}


def moving(cost, **more):
    return OptimalControlProblem(LINE, lambda q, u: u, cost, 1, **more)


def constant(control):
    """A guess with this control, and its trajectory."""
    times = (np.arange(STEPS) + 0.5) / STEPS
    return Guess(control * times[:, None], np.full((STEPS, 1), control))


def solved(problem, mean, **more):
    return solve(problem, np.zeros(1), np.array([mean]), 1.0, method=METHOD, steps=STEPS, **more)


@pytest.mark.parametrize("name", COSTS)
@pytest.mark.parametrize("way", ["bounds at the edge", "bounds inside", "guess", "constraint and guess"])
@pytest.mark.usual(2)
def test_a_mean_control_is_found_where_costs_have_a_domain(name, way):
    """A convex cost of the control alone is least where the control is its mean."""
    mean, top = (0.3, 1.0) if name == "between" else (2.0, 50.0)
    more, given = {}, {}
    if way.startswith("bounds"):
        off = 0.0 if way == "bounds at the edge" else 0.1
        more = {"control_bounds": (off, top * (1 - off))}
    else:
        given = {"guess": constant(1.3 * mean)}
        if way != "guess":
            more = {"constraints": {"low": lambda q, u: 0.05 - u[0]}}
    found = solved(moving(COSTS[name], **more), mean, **given)
    assert found.cost == pytest.approx(float(COSTS[name](None, np.array([mean]))), rel=1e-9)
    np.testing.assert_allclose(found.controls, mean, rtol=1e-6)


@pytest.mark.parametrize("edge", [-3.0, 0.5, 7.0, 100.0])
def test_a_domain_that_begins_elsewhere(edge):
    problem = {"guess": {}, "bounds": {"control_bounds": (edge, np.inf)}}
    for way, more in problem.items():
        given = {"guess": constant(edge + 1)} if way == "guess" else {}
        found = solved(moving(lambda q, u: -jnp.log(u[0] - edge), **more), edge + 2, **given)
        assert found.cost == pytest.approx(-np.log(2), rel=1e-9)


@pytest.mark.parametrize("guess", [8.0, 1.0, 40.0])
def test_a_guess_between_bounds_that_exclude_zero(guess):
    problem = moving(COSTS["logarithm"], control_bounds=(1.0, 50.0))
    assert solved(problem, 8.0, guess=constant(guess)).cost == pytest.approx(-np.log(8), rel=1e-9)


def test_several_members_phases_and_a_free_horizon():
    problem = moving(COSTS["logarithm"], control_bounds=(0.0, 50.0))
    many = Solver(problem, METHOD, STEPS).solve_many(np.zeros((3, 1)), np.array([[0.5], [2.0], [8.0]]), 1.0)
    np.testing.assert_allclose([one.cost for one in many], -np.log([0.5, 2.0, 8.0]), rtol=1e-9)
    two = [
        Phase(problem, METHOD, 3, 1.0, start=np.zeros(1)),
        Phase(problem, METHOD, 3, 1.0, end=np.array([4.0])),
    ]
    assert solve_phases(two).cost == pytest.approx(-2 * np.log(2), rel=1e-9)
    # T (2 - log(1 / T)) is least at log T = -3.
    timed = moving(lambda q, u: 2 - jnp.log(u[0]), control_bounds=(0.0, np.inf))
    assert solve(timed, np.zeros(1), np.ones(1), Free(0.2), method=METHOD, steps=STEPS).horizon == pytest.approx(
        np.exp(-3), rel=1e-8
    )


@pytest.mark.parametrize("guessed", [False, True])
def test_a_domain_of_the_state(guessed):
    """With ``q = exp(z)`` and ``z' = u``: the cost ``(u^2 + z^2) / 2`` from ``z = 1`` is ``tanh(1) / 2``."""
    problem = OptimalControlProblem(LINE, lambda q, u: u * q, lambda q, u: (u @ u + jnp.log(q[0]) ** 2) / 2, 1)
    guess = Guess(np.full((40, 1), 2.0), np.zeros((40, 1))) if guessed else None
    found = solve(problem, np.array([np.e]), None, 1.0, method=METHOD, steps=40, guess=guess)
    assert found.cost == pytest.approx(np.tanh(1) / 2, rel=2e-3)


@pytest.mark.parametrize("more", [{}, {"constraints": {"low": lambda q, u: 1 - u[0]}}])
def test_without_bounds_and_without_a_guess_the_message_asks_for_them(more):
    words = r"not finite at q = \[0\.\], u = \[0\.\].*running and terminal cost inf.*pass a guess, or control_bounds"
    with pytest.raises(InvalidInputError, match=words):
        solved(moving(COSTS["logarithm"], **more), 2.0)
