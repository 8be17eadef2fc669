"""The Hamiltonian and the momenta of a solution: what the report says of their constancy."""

import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, solve
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint

from tests.support.numerics import norm

from .problems import KINEMATIC
from .test_solve_input import problem, slew


@pytest.mark.parametrize(("steps", "coarse"), [(2, True), (20, False)])
def test_the_report_says_when_steps_are_too_coarse_for_the_hamiltonian(steps, coarse):
    """``F = u^2 / 2 + 50 q^4``, from 1 to 0: the spread is 0.29 of the size in 2 steps, 0.027 in 20."""
    line = Euclidean(1)
    quartic = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2 + 50 * (q @ q) ** 2, 1)
    solution = solve(quartic, np.ones(1), np.zeros(1), 1.0, method=Midpoint(Addition(line)), steps=steps)
    assert solution.success
    assert solution.checks.too_coarse == coarse
    assert ("too coarse to be trusted, increase steps" in str(solution)) == coarse


def test_a_hamiltonian_that_is_zero_gives_no_alarm():
    """``F = (x + u)^2 / 2`` vanishes along ``x' = -x``, which the midpoint rule solves in powers: all of it is
    rounding."""
    line, steps, h = Euclidean(1), 8, 1 / 8
    decay = OptimalControlProblem(line, lambda q, u: u, lambda q, u: q @ q / 2 + q @ u + u @ u / 2, 1)
    solution = solve(
        decay, np.ones(1), np.full(1, ((2 - h) / (2 + h)) ** steps), 1.0, method=Midpoint(Addition(line)), steps=steps
    )
    assert norm(solution.costates) < 1e-13
    assert not solution.checks.too_coarse
    assert solution.checks.hamiltonian_size < 1e-12


@pytest.mark.slow
def test_the_report_says_which_momenta_are_constant():
    """A top with gravity along the third axis conserves the third component alone, a free body all three. The spread of
    components that are not constant is not printed."""
    heavy = problem(cost=lambda q, u: u @ u / 2 + q[2, 0])
    tied = problem(cost=lambda q, u: u @ u / 2 + q[2, 0] + q[0, 1])
    for given, count in ((KINEMATIC, 3), (heavy, 1), (tied, 0)):
        solution = slew(given)
        assert list(solution.checks.conserved.values()) == [count]
        report = " ".join(str(solution).split())
        assert f"constant along this extremal: {count or 'none'} of 3 components" in report
        assert ("components, spread over the nodes" in report) == (count == 3)


def test_a_momentum_that_is_zero_along_the_extremal_is_not_ascribed_to_a_symmetry():
    """``F = |u|^2 / 2 + y^2`` depends on ``y``, which is zero along the extremal, and so is its costate."""
    plane = Euclidean(2)
    valley = OptimalControlProblem(plane, lambda q, u: u, lambda q, u: u @ u / 2 + q[1] ** 2, 2)
    solution = solve(valley, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(Addition(plane)), steps=4)
    assert "constant along this extremal: 2 of 2 components" in " ".join(str(solution).split())
