"""Calls of a solver: batches, parameters, callbacks, steps of their own lengths, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Result, Solver, discretization_error, solve
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Exponential, Gauss, Midpoint, default_retraction

from .problems import half_square
from .test_swing_up import LINE, RIGS, CartPole

HANGING, UPRIGHT, MOVED = np.zeros(4), np.array([0.0, np.pi, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
METHOD, STEPS = Midpoint(Exponential(LINE)), 50


def swinging(q, u, rig):
    return CartPole(*rig).on_the_line(q, u)


@pytest.fixture(scope="module")
def solver():
    return Solver(OptimalControlProblem(LINE, swinging, half_square, 1), METHOD, STEPS)


def test_a_batch_of_swing_ups_has_the_solutions_of_its_members(solver):
    rigs, horizons = np.array(RIGS).T, np.linspace(1.5, 3.0, len(RIGS))
    many = solver.solve_many(HANGING, UPRIGHT, horizons, parameters=tuple(rigs))
    assert many.success.all()
    assert many.converged == many.distinct == len(many) == len(RIGS)
    for one, rig, horizon in zip(many, RIGS, horizons, strict=True):
        alone = solver.solve(HANGING, UPRIGHT, float(horizon), parameters=rig)
        assert one.statistics.iterations == alone.statistics.iterations
        assert one.cost == pytest.approx(alone.cost, rel=1e-9)
        np.testing.assert_allclose(one.controls, alone.controls, atol=1e-7 * np.max(np.abs(alone.controls)))


def test_parameters_are_those_of_the_call(solver):
    for rig in RIGS[:2]:
        read = OptimalControlProblem(LINE, CartPole(*map(jnp.asarray, rig)).on_the_line, half_square, 1)
        passed = solver.solve(HANGING, UPRIGHT, 3.0, parameters=rig)
        assert passed.cost == pytest.approx(
            solve(read, HANGING, UPRIGHT, 3.0, method=METHOD, steps=STEPS).cost, rel=1e-10
        )


@pytest.mark.parametrize("last", [0, 1, 3])
def test_a_callback_ends_the_iteration(solver, last):
    seen = []

    def watch(iteration):
        seen.append(iteration)
        return iteration.number == last

    stopped = solver.solve(HANGING, UPRIGHT, 3.0, parameters=RIGS[0], callback=watch, throw=False)
    assert [iteration.number for iteration in seen] == [*range(last + 1)]
    assert not stopped.success
    assert stopped.result == Result[Result.stopped]
    assert stopped.checks.defect == pytest.approx(seen[-1].defect[0])


def test_an_interrupt_leaves_what_was_reached(solver):
    def interrupt(iteration):
        if iteration.number == 2:
            raise KeyboardInterrupt

    stopped = solver.solve(HANGING, UPRIGHT, 3.0, parameters=RIGS[0], callback=interrupt, throw=False)
    assert stopped.result == Result[Result.stopped]
    assert np.all(np.isfinite(stopped.controls))


@pytest.mark.parametrize("ratio", [1.0, 1.5, 3.0])
@pytest.mark.usual(1)
def test_unequal_steps_reach_the_same_optimum(ratio):
    problem = OptimalControlProblem(LINE, lambda q, u: swinging(q, u, RIGS[0]), half_square, 1)
    method = Gauss(3, Exponential(LINE))
    lengths = np.geomspace(1, ratio, 24)
    found = solve(problem, HANGING, MOVED, 3.0, method=method, steps=lengths)
    np.testing.assert_allclose(np.diff(found.times), 3 * lengths / lengths.sum())
    largest = len(lengths) * lengths.max() / lengths.sum()  # beside an equal step; the method is of order 6
    fine = solve(problem, HANGING, MOVED, 3.0, method=method, steps=48)
    assert found.cost == pytest.approx(fine.cost, rel=1e-6 * largest**6)


def test_a_batch_without_one_length_is_refused(solver):
    with pytest.raises(InvalidInputError, match="got starts 2, ends 3, parameters 2; parameters have"):
        solver.solve_many(np.zeros((2, 4)), np.zeros((3, 4)), 1.0, parameters=tuple(np.array(RIGS[:2]).T))
    with pytest.raises(InvalidInputError, match=r"got starts 0, .*; a batch has one member or more$"):
        solver.solve_many(np.zeros((0, 4)), np.zeros(4), 1.0, parameters=RIGS[0])


def test_the_error_of_a_solution_is_that_with_its_parameters(solver):
    found = solver.solve(HANGING, MOVED, 3.0, parameters=RIGS[0])
    error = discretization_error(solver.problem, METHOD.retraction, found, RIGS[0])
    other = discretization_error(solver.problem, METHOD.retraction, found, RIGS[1])
    assert error.largest["R^4"] < 0.1 * other.largest["R^4"]
    with pytest.raises(InvalidInputError, match="functions take parameters, and none are given"):
        discretization_error(solver.problem, METHOD.retraction, found)


@pytest.fixture(scope="module")
def weighted():
    """A cart that pays for the square and the size of its force and for where it is, by weights that are parameters."""

    def cost(q, u, weights):
        return weights[0] * u @ u / 2 + weights[1] * jnp.abs(u[0]) + weights[2] * q @ q / 2

    problem = OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), cost, 1)
    return Solver(problem, Midpoint(default_retraction(Euclidean(2))), 8)


@pytest.mark.parametrize("weight", [1.0, 1e-3, 1e-6, 0.0])
def test_parameters_that_leave_a_kink_alone_are_refused_after_others(weighted, weight):
    for price in (1.0, 0.3, 1e-3):
        assert weighted.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=np.array([price, 0, 0])).success
    asked = np.array([weight, 1.0 - (weight > 0), 0.0])
    if weight:
        assert weighted.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=asked).success
    else:
        with pytest.raises(InvalidInputError, match="kink"):
            weighted.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=asked)


@pytest.mark.slow
def test_parameters_that_make_the_problem_singular_are_seen_after_others(weighted):
    """Without a price of the force the discrete problem still has a strict minimum, with impulses at the ends."""
    for price, singular in ((1.0, False), (1e-6, False), (0.0, True)):
        asked = np.array([price, 0.0, 1.0])
        solution = weighted.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=asked, throw=False)
        assert (solution.singular is not None) == singular
        assert solution.success != singular
