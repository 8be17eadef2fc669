"""What a solver is asked for is checked once, however often it is solved, and reaches all that solves."""

from collections import Counter

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, classify, solve, solve_phases
from retrax.integrators.boundary_value.inputs import inputs
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData, Options
from retrax.integrators.boundary_value.inputs.inputs import Inputs
from retrax.integrators.singular.strategies import RattleIntegrator
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, CotangentLift, Gauss, Midpoint, Theta

PLANE = Euclidean(2)
METHOD = Midpoint(Addition(PLANE))
REST, AHEAD = np.zeros(2), np.array([1.0, 0.0])


def cart(q, u):
    return jnp.stack([q[1], u[0]])


QUICK = OptimalControlProblem(PLANE, cart, lambda q, u: 1 + u @ u / 2, 1)
WEIGHED = OptimalControlProblem(PLANE, lambda q, u, w: cart(q, u), lambda q, u, w: (q @ q + w * u @ u) / 2, 1)


@pytest.fixture
def checks(monkeypatch):
    """How often each check of an argument is called."""
    count = Counter()

    def counted(name):
        check = getattr(inputs, name)

        def call(*arguments):
            count[name] += 1
            return check(*arguments)

        return call

    for name in ("check_parameters", "check_classification", "_require_horizon"):
        monkeypatch.setattr(inputs, name, counted(name))
    return count


ONCE = {"check_parameters": 1, "_require_horizon": 1}


def test_a_horizon_found_again_is_not_checked_again(checks):
    """From 1e-3 the horizon is found in several solves, each guessed by the one before."""
    found = Solver(QUICK, METHOD, 6).solve(REST, AHEAD, Free(1e-3))
    assert found.horizon > 1.0
    assert checks == ONCE


def test_meshes_are_refined_after_one_check(checks):
    options = {"accuracy": 1e-6, "classification": classify(QUICK)}
    found = solve(QUICK, REST, AHEAD, 1.0, method=Gauss(2, Addition(PLANE)), steps=2, **options)
    assert found.checks.error <= 1e-6
    assert checks == {**ONCE, "check_classification": 1}


def test_phases_are_checked_once_each(checks):
    """The second duration is found again from itself, far from its guess."""
    phases = [Phase(QUICK, METHOD, 4, 1.0, REST), Phase(QUICK, METHOD, 4, Free(1e-2), None, AHEAD)]
    found = solve_phases(phases)
    assert found.success
    assert found.phases[1].horizon > 0.1
    assert checks == {name: 2 * times for name, times in ONCE.items()}


def test_what_is_not_given_is_completed():
    """A free end is as the other one, a tolerance ``eps^0.7``, free quantities as they are guessed."""
    solver = Solver(QUICK, METHOD, 6)
    asked = Inputs.of(solver._reader, BoundaryData(REST, None, Free(2.0), None), None, Options.of(None, 100))
    assert asked.needs_reformulation
    np.testing.assert_array_equal(asked.ends.end[0], REST)
    assert asked.horizons.tolist() == [2.0]
    assert asked.options.tolerance == np.finfo(float).eps ** 0.7
    assert asked.conditions_of(0)[1].fixed_leaves == (False,)
    with pytest.raises(AttributeError):
        asked.horizons = np.ones(1)


def test_an_integrator_for_a_problem_that_has_become_singular_is_not_refused_as_of_a_regular_one():
    """The weight of the control falls to zero in the second call; the integrator is of another discretization."""
    solver = Solver(WEIGHED, METHOD, 6)
    assert solver.solve(REST, AHEAD, 1.0, parameters=1.0).success
    rattle = RattleIntegrator(CotangentLift(Theta(Addition(PLANE), 0.0)), (0,))
    with pytest.raises(InvalidInputError, match="by the same discretization"):
        solver.solve(REST, AHEAD, 1.0, parameters=0.0, integrator=rattle)
    with pytest.raises(InvalidInputError, match="the problem is regular"):
        solver.solve(REST, AHEAD, 1.0, parameters=1.0, integrator=rattle)


def test_a_singular_problem_with_a_free_horizon_is_refused_with_its_own_classification():
    singular = WEIGHED.with_parameters(0.0)
    with pytest.raises(InvalidInputError, match=r"the problem is singular, .* a free horizon"):
        solve(singular, REST, AHEAD, Free(1.0), method=METHOD, steps=6, classification=classify(singular))
