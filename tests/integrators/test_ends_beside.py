"""Ends that are beside their manifold by less than counts are met on it, and those on another sheet are not met."""

from functools import cache

import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import SE, SO, LevelSet, NotOnManifoldError, Sphere, hat
from retrax.retractions import Cayley, Exponential, Midpoint, Projection

from .problems import rotation

SPHERE = Sphere(2)


class Sheets(LevelSet):
    """Two planes, of which the third coordinate tells."""

    def constraint(self, x):
        return x[2] ** 2 - 1.0


def effort(q, u):
    return u @ u / 2


@cache
def poses():
    group = SE(3)
    return Solver(
        OptimalControlProblem(group, lambda q, u: q @ group.hat(u), effort, 6), Midpoint(Exponential(group)), 5
    )


@cache
def attitudes():
    group = SO(3)
    return Solver(OptimalControlProblem(group, lambda q, u: q @ hat(u), effort, 3), Midpoint(Cayley(group)), 5)


@cache
def directions():
    problem = OptimalControlProblem(SPHERE, lambda q, u: SPHERE.projection(q, u), effort, 3)
    return Solver(problem, Midpoint(Projection(SPHERE)), 5)


@pytest.mark.parametrize("digits", range(8, 17))
@pytest.mark.usual(2)
def test_rotations_of_some_digits_are_ends(digits):
    exact = rotation(np.array([1.0, 0.3, -0.5]))
    end = exact.round(digits)
    found = attitudes().solve(np.eye(3), end, 1.0)
    assert max(found.checks.violations.values()) < 3e-14
    np.testing.assert_allclose(found.states[-1], end, rtol=0, atol=10.0**-digits)
    assert found.cost == pytest.approx(attitudes().solve(np.eye(3), exact, 1.0).cost, abs=10 * 10.0**-digits)


def test_rotations_of_fewer_digits_are_none():
    with pytest.raises(NotOnManifoldError, match="end: not on"):
        attitudes().solve(np.eye(3), rotation(np.array([1.0, 0.3, -0.5])).round(5), 1.0)


@pytest.mark.parametrize("off", [0.0, 1e-300, 1e-30, 1e-17, 1e-15, 1e-13, 1e-11, 1e-9])
@pytest.mark.usual(2)
def test_last_rows_of_poses_may_be_rounded(off):
    end = np.eye(4)
    end[:3, 3], end[3, :3] = [1.0, 2.0, 3.0], off
    found = poses().solve(np.eye(4), end, 1.0)
    assert found.cost == pytest.approx(7.0, abs=1e-8)
    np.testing.assert_allclose(found.states[-1, 3], [0, 0, 0, 1], atol=1e-14)


def test_both_ends_of_a_batch_may_be_long():
    longer = 1 + np.array([0.0, 1e-15, 1e-13, 1e-11, 4e-9])[:, None]
    starts, ends = np.array([1.0, 0.0, 0.0]) * longer, np.array([0.0, 1.0, 0.0]) * longer
    found = directions().solve_many(starts, ends, 1.0)
    assert found.success.all()
    np.testing.assert_allclose(found.cost, found.cost[0], rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.states[:, [0, -1]], axis=2), 1.0, atol=1e-13)


@pytest.mark.slow  # projections to a level set in every function
def test_ends_on_another_sheet_are_not_met():
    sheets = Sheets(shape=(3,))
    problem = OptimalControlProblem(sheets, lambda q, u: sheets.projection(q, u), effort, 3)
    solver = Solver(problem, Midpoint(Projection(sheets)), 4)
    start, guess = np.array([0.0, 0.0, 1.0]), None
    for height in (1.0, 1 + 1e-15, 1 + 1e-10):
        guess = solver.solve(start, np.array([1.0, 1.0, height]), 1.0)
        assert guess.cost == pytest.approx(1.0, abs=1e-8)
    assert not solver.solve(start, np.array([1.0, 1.0, -1.0]), 1.0, guess=guess, throw=False).success
