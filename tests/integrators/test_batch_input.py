"""What is wrong in a batch is named, with its member."""

import re

import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Gauss

LINE = Euclidean(1)
ZERO, ONE = np.zeros(1), np.ones(1)
METHOD = Gauss(2, Addition(LINE))


def line(running_cost):
    return OptimalControlProblem(LINE, lambda q, u, *more: u, running_cost, 1)


BATCHES = {
    "lengths": (
        {"ends": np.ones((4, 1)), "parameters": np.ones(3)},
        "wherever something varies, got ends 4, parameters 3; parameters have one too: try np.broadcast_to",
    ),
    "a parameter for all": (
        {"ends": np.ones((4, 1)), "parameters": 1.0},
        "got ends 4, parameters none; parameters have",
    ),
    "an end": ({"ends": np.array([[1.0], [np.nan], [1.0]])}, "end, member 1: .* NaN or infinite"),
    "a horizon": (
        {"horizons": np.array([1.0, 1.0, -1.0])},
        r"horizon, member 2, must be a positive finite time, got -1\.0",
    ),
    "a parameter": (
        {"parameters": np.array([1.0, np.inf, 1.0])},
        r"parameters must be finite real numbers and arrays of them, got inf as parameters\[1\]",
    ),
}


@pytest.mark.parametrize("name", BATCHES)
def test_what_is_wrong_in_a_batch_is_named(name):
    given, words = BATCHES[name]
    solver = Solver(line(lambda q, u, a: a * u @ u / 2), METHOD, 4)
    usual = {"ends": np.ones((3, 1)), "horizons": 1.0, "parameters": np.ones(3)}
    with pytest.raises(InvalidInputError, match=words):
        solver.solve_many(ZERO, **(usual | given))


def test_nothing_that_varies_is_not_a_batch():
    solver = Solver(line(lambda q, u: u @ u / 2), METHOD, 4)
    with pytest.raises(InvalidInputError, match=re.escape("got none; for a single trajectory call solve")):
        solver.solve_many(ZERO, ONE, 1.0)
