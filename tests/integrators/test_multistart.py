"""Extremals of one problem from drawn guesses: on a rotation group the geodesics with all numbers of turns are
known."""

from functools import cache

import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, multistart
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat
from retrax.retractions import Midpoint, default_retraction

from .problems import half_square, rotation

Q = SO(3) * Euclidean(2)
PROBLEM = OptimalControlProblem(Q, lambda q, u, given: (q[0] @ hat(u[:3]), given * u[3:]), half_square, 5)
START = np.eye(3), np.zeros(2)
ANGLE, FAR = 2.0, np.array([3.0, -1.0])
END = rotation([0.0, 0.0, ANGLE]), FAR


@cache
def solver():
    return Solver(PROBLEM, Midpoint(default_retraction(Q)), 20)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usual("0")
def test_extremals_are_the_geodesics_in_the_order_of_their_costs(seed):
    found = multistart(solver(), START, END, 1.0, count=16, seed=seed, parameters=2.0)
    assert len(found) == 16
    assert found.converged == 16
    assert np.all(np.diff(found.cost) >= 0)
    lengths = np.sort(np.abs(ANGLE + 2 * np.pi * np.arange(-4, 5)))
    costs = (lengths**2 + FAR @ FAR / 4) / 2
    assert found[0].cost == pytest.approx(costs[0], rel=1e-9)
    assert np.all(np.min(np.abs(found.cost[:, None] - costs), axis=1) < 1e-8 * costs[0])
    assert found.distinct == len(np.unique(found.cost.round(6))) > 1


def test_guesses_are_those_of_the_seed():
    one, same, other = (multistart(solver(), START, END, 1.0, count=6, seed=k, parameters=2.0) for k in (1, 1, 2))
    assert np.array_equal(one.states[0], same.states[0])
    assert [s.statistics.iterations for s in one] != [s.statistics.iterations for s in other]


def test_a_parameter_may_be_free():
    """The best one is at a bound: large steps cost nothing."""
    found = multistart(solver(), START, END, 1.0, count=3, parameters=Free(2.0, lower=1.0, upper=4.0))
    assert found[0].parameters == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"count": 0}, "count must be a whole number of at least 1, got 0"),
        ({"count": 2.0}, "count must be a whole number of at least 1, got 2.0"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"seed": True}, "seed must be"),
        ({"solver": PROBLEM}, "multistart takes a Solver"),
        ({"horizon": -1.0}, "horizon must be a positive finite time"),
        ({"start": (np.stack([np.eye(3)] * 2), np.zeros((2, 2)))}, "start.* shape"),
    ],
)
def test_wrong_arguments_are_named(wrong, words):
    given = {"solver": solver(), "start": START, "end": END, "horizon": 1.0, "parameters": 2.0, "count": 2} | wrong
    with pytest.raises(InvalidInputError, match=words):
        multistart(**given)
