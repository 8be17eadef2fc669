"""A solver or a flow answers with the functions that it was made of, or says that they have changed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    DiracIntegrator,
    DiracSystem,
    Flow,
    Free,
    OptimalControlProblem,
    Solver,
    SymplecticIntegrator,
)
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, CotangentLift, Gauss, Midpoint, PowerRetraction, ProductRetraction

LINE = Euclidean(1)
ZERO, ONE = np.zeros(1), np.ones(1)
METHOD = Gauss(2, Addition(LINE))


def changed(holder):
    return pytest.raises(InvalidInputError, match=f"functions compute other values than when the {holder} was made")


def line(running_cost, **options):
    return OptimalControlProblem(LINE, lambda q, u, *more: u, running_cost, 1, **options)


def starts(count):
    return np.ones((count, 1)), np.zeros((count, 1))


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
@pytest.mark.parametrize("call", [(4, 10), (3, 20)], ids=["another batch", "more steps"])
@pytest.mark.usual(1)
def test_a_flow_has_one_value_of_what_its_function_reads(evaluator, call):
    k = [1.0]
    flow = Flow(lambda q, p: k[0] * p @ p / 2 + q @ q / 2, SymplecticIntegrator(METHOD), evaluator=evaluator)
    first = flow.integrate_many(starts(3), 0.1, 10).q
    k[0] = 4.0
    np.testing.assert_array_equal(flow.integrate_many(starts(3), 0.1, 10).q, first)
    if evaluator == "tape":  # nothing is traced anew
        again = flow.integrate_many(starts(call[0]), 0.1, call[1]).q
        np.testing.assert_allclose(again[:3, :11], first, atol=1e-15)
        return
    for value in (4.0, 4.0, 1.0):  # the flow has both now
        k[0] = value
        with changed("flow"):
            flow.integrate_many(starts(call[0]), 0.1, call[1])


@pytest.mark.parametrize(
    "retraction", [ProductRetraction(Addition(LINE), Addition(LINE)), PowerRetraction(Addition(LINE), 2)]
)
def test_a_flow_on_a_product_traces_nothing_for_what_it_has_done_before(retraction):
    """Such a retraction makes its manifold anew whenever it is asked for it."""
    k = [1.0]

    def energy(q, p):
        return sum(jnp.sum(k[0] * p**2 + q**2) / 2 for q, p in zip(*map(jax.tree.leaves, (q, p)), strict=True))

    flow = Flow(energy, SymplecticIntegrator(Gauss(2, retraction)))
    start = jax.tree.map(lambda a: np.ones(a.shape), 2 * (retraction.manifold.ambient,))
    first = jax.tree.leaves(flow.integrate(start, 0.1, 10).q)
    k[0] = 4.0
    for _ in range(2):
        again = jax.tree.leaves(flow.integrate(start, 0.1, 10).q)
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
@pytest.mark.usual(1)
def test_a_flow_whose_function_stays_takes_all_sizes(evaluator):
    flow = Flow(lambda q, p: (p @ p + q @ q) / 2, SymplecticIntegrator(METHOD), evaluator=evaluator)
    first = flow.integrate_many(starts(3), 0.1, 10).q
    for count, steps in ((4, 10), (3, 20), (1, 10)):
        own = flow.integrate_many(starts(count), 0.1, steps).q
        np.testing.assert_allclose(own[0, :11], first[0], atol=1e-15)


def test_a_flow_of_a_constrained_system_says_so_too():
    k = [1.0]
    plane = Euclidean(2)
    system = DiracSystem(plane, lambda q, p: p @ p / 2, lambda q: jnp.array([[k[0], q[0]]]))
    flow = Flow(system, DiracIntegrator(CotangentLift(Midpoint(Addition(plane)))), evaluator="xla")
    start = np.ones(2), system.project(np.ones(2), np.ones(2))
    flow.integrate(start, 0.1, 4)
    k[0] = 2.0
    with changed("flow"):
        flow.integrate_many((start[0][None], start[1][None]), 0.1, 4)


def test_a_solver_has_one_value_for_all_that_may_be_free():
    k = [1.0]
    solver = Solver(line(lambda q, u: k[0] * (u @ u / 2 + 0.5)), METHOD, 4)
    first = solver.solve(ZERO, ONE, Free(0.8)).cost
    assert solver.solve(ZERO, ONE, 1.0).cost == pytest.approx(first)
    k[0] = 3.0
    assert solver.solve(ZERO, ONE, Free(0.8)).cost == first
    assert solver.solve(ZERO, ONE, 1.0).cost == pytest.approx(first)
    with changed("solver"):
        solver.solve(ZERO, ONE, Free(0.8, lower=0.1, upper=1.5))
    with changed("solver"):  # what the last call has traced is there now
        solver.solve(ZERO, ONE, Free(0.8, lower=0.1, upper=1.5))
    assert Solver(solver.problem, METHOD, 4).solve(ZERO, ONE, Free(0.8)).cost == pytest.approx(3 * first)


# What is seen of a function before it is solved with, and after, by the value of k at which the solver is made.
CHECKS = {
    "jump": (lambda k: lambda q, u: u @ u / 2 + k[0] * jnp.where(q[0] > 0.5, 1.0, 0.0), 1.0, 0.0),
    "singular": (lambda k: lambda q, u: k[0] * u @ u / 2 + q @ q, 0.0, 1.0),
    "no cost": (lambda k: lambda q, u: k[0] * u @ u / 2, 1.0, 0.0),
}


@pytest.mark.parametrize("name", CHECKS)
@pytest.mark.usual(1)
def test_what_is_checked_is_what_is_solved(name):
    make, first, later = CHECKS[name]
    k = [first]
    solver = Solver(line(make(k)), METHOD, 10)
    k[0] = later
    with changed("solver"):
        solver.solve(ZERO, ONE, 1.0, throw=False)


def test_parameters_may_change_and_what_is_read_besides_may_not():
    k = [1.0]
    solver = Solver(line(lambda q, u, a: k[0] * a * u @ u / 2), METHOD, 4)
    k[0] = 2.0  # nothing is traced yet
    costs = [float(solver.solve(ZERO, ONE, 1.0, parameters=a).cost) for a in (1.0, 3.0, 2, np.array(4))]
    assert costs == pytest.approx([1.0, 3.0, 2.0, 4.0])
    k[0] = 5.0
    kept = solver.solve(ZERO, ONE, 1.0, parameters=3.0)
    assert kept.cost == pytest.approx(3.0)
    with changed("solver"):
        solver.sensitivity(kept)


@pytest.mark.slow
def test_a_solver_of_a_singular_problem_is_held_too():
    k, plane = [1.0], Euclidean(2)
    problem = OptimalControlProblem(
        plane, lambda q, u: jnp.array([q[1], u[0]]), lambda q, u: q[0] ** 2 + k[0] * q[1] ** 2, 1
    )
    solver, ends = Solver(problem, Midpoint(Addition(plane)), 10), ((np.array([1.0, -1.0]), None), 2.0)
    first = solver.solve(*ends[0], ends[1], throw=False)
    assert solver.solve(*ends[0], ends[1], throw=False).cost == first.cost
    k[0] = 3.0
    with changed("solver"):
        solver.solve(*ends[0], ends[1], throw=False)


def test_functions_that_fail_are_told_as_ever():
    solver = Solver(line(lambda q, u, a: u @ (a * u)), METHOD, 4)
    for _ in range(2):
        with pytest.raises(
            InvalidInputError, match=r"the problem's functions fail .* parameters have the shapes \(2,\)"
        ):
            solver.solve(ZERO, ONE, 1.0, parameters=np.ones(2))
    assert solver.solve(ZERO, ONE, 1.0, parameters=2.0).success
