"""What a solver is asked for is checked once, however often it is solved, and reaches all that solves."""

import pickle
from collections import Counter
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, classify, solve, solve_phases
from retrax.integrators.boundary_value.inputs import inputs
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData
from retrax.integrators.boundary_value.inputs.inputs import Inputs
from retrax.integrators.boundary_value.inputs.options import Options
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


def test_a_problem_whose_horizon_is_far_from_its_guess_is_checked_once(checks):
    found = Solver(QUICK, METHOD, 6).solve(REST, AHEAD, Free(1e-3))
    assert found.horizon > 1.0
    assert checks == ONCE


def test_meshes_are_refined_after_one_check(checks):
    options = {"accuracy": 1e-6, "classification": classify(QUICK)}
    found = solve(QUICK, REST, AHEAD, 1.0, method=Gauss(2, Addition(PLANE)), steps=2, **options)
    assert found.checks.error <= 1e-6
    assert checks == {**ONCE, "check_classification": 1}


def test_phases_are_checked_once_each(checks):
    """The second duration is far from its guess."""
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


SINGLE = {
    "a horizon": ({"horizon": -1.0}, "horizon must be a positive finite time, got -1.0"),
    "no number": ({"horizon": np.nan}, "horizon must be a positive finite time, got nan"),
    "a free horizon": ({"horizon": Free(-1.0, upper=0.0)}, "horizon must be free around a positive finite time"),
    "a start": ({"start": np.array([np.nan, 0.0])}, "start: .* NaN or infinite"),
    "an end": ({"end": np.array([1.0, np.inf])}, "end: .* NaN or infinite"),
    "a guess": ({"guess": 1.0}, "guess must be a Guess or a Solution"),
    "no parameters": ({"parameters": None}, "the problem's functions take parameters, and none are given"),
}


@pytest.mark.parametrize("name", SINGLE)
def test_a_batch_of_one_is_refused_as_a_single_trajectory_is(name):
    given, words = SINGLE[name]
    asked = {"start": REST, "end": AHEAD, "horizon": 1.0, "guess": None, "parameters": 1.0} | given
    solver = Solver(WEIGHED, METHOD, 6)
    with pytest.raises(InvalidInputError, match=words) as single:
        solver.solve(**asked)
    many = {**asked, "parameters": None if asked["parameters"] is None else np.ones(1)}
    with pytest.raises(InvalidInputError) as batch:
        solver.solve_many(many["start"][None], many["end"], many["horizon"], many["guess"], many["parameters"])
    assert str(batch.value) == str(single.value)


@pytest.mark.parametrize("horizon", [1.0, Free(2.0), Free(0.5, upper=1.5)])
def test_a_batch_of_one_has_the_record_of_a_single_trajectory(horizon):
    quick = OptimalControlProblem(PLANE, lambda q, u, w: cart(q, u), lambda q, u, w: 1 + w * u @ u / 2, 1)
    solver = Solver(quick, METHOD, 6)
    one = solver.solve(REST, AHEAD, horizon, parameters=0.5)
    (other,) = solver.solve_many(REST[None], AHEAD, horizon, parameters=np.array([0.5]))
    assert one.checks == other.checks
    assert (one.status, one.result, one.cost) == (other.status, other.result, other.cost)
    for name in ("times", "states", "costates", "controls", "stage_costates", "hamiltonians", "parameters"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_figures_of_a_report_are_computed_when_one_is_read(monkeypatch):
    solver, computed = Solver(QUICK, METHOD, 6), []
    diagnosis = solver._transcription.trace(None).diagnosis
    terms = diagnosis._at_samples
    monkeypatch.setattr(diagnosis, "_at_samples", lambda *given: [computed.append(1), terms(*given)][1])
    found = solver.solve(REST, AHEAD, 1.0)
    assert found.status == "minimum"
    assert found.checks.defect < 1e-10
    assert not computed
    copies = pickle.loads(pickle.dumps(found.checks)), replace(found.checks), found.checks
    assert computed == [1]
    assert len({str(own) for own in copies}) == 1
    assert found.checks.hamiltonian == found.hamiltonians[0]
    with pytest.raises(AttributeError, match="no attribute 'hamiltonians'"):
        _ = found.checks.hamiltonians
