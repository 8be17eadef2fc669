"""Copies and pickles of what users hold: as the original, or refused in one sentence."""

import copy
import pickle

import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Exponential, Midpoint

WAYS = {"copy": copy.copy, "deepcopy": copy.deepcopy} | {
    f"pickle {k}": lambda value, k=k: pickle.loads(pickle.dumps(value, k)) for k in range(pickle.HIGHEST_PROTOCOL + 1)
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("given", [(1.1,), (2.0, 0.1), ([1.0, 2.0], 0.0, [3.0, np.inf]), (np.eye(2),)])
def test_what_is_free_is_copied(way, given):
    free = Free(*given)
    found = WAYS[way]({"mass": (free, 2.0)})["mass"][0]
    assert repr(found) == repr(free)
    for name in ("guess", "lower", "upper"):
        np.testing.assert_array_equal(getattr(found, name), getattr(free, name))
    with pytest.raises(AttributeError, match="Free is frozen"):
        found.guess = 3.0
    if np.ndim(found.guess):
        with pytest.raises(ValueError, match="read-only"):
            found.guess[0] = 3.0


def test_a_solver_is_not_copied():
    line = Euclidean(1)
    solver = Solver(
        OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, 1), Midpoint(Exponential(line)), 3
    )
    for used in (False, True):
        assert not used or solver.solve(np.zeros(1), np.ones(1), 1.0).success
        for way in set(WAYS) - {"copy"}:
            with pytest.raises(TypeError, match=r"a Solver can be neither pickled nor .* make another one, Solver\(pr"):
                WAYS[way](solver)
        assert copy.copy(solver).problem is solver.problem
