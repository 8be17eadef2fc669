"""Warm calls: nothing is traced or computed by JAX in them, and no check is left out for that."""

import pickle
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, RegularChecks, Solver
from retrax.manifolds import SO, Euclidean, InvalidInputError, NotOnManifoldError, hat
from retrax.retractions import Addition, Cayley, Exponential, Gauss, Midpoint

from .problems import rotation

BODY = SO(3) * Euclidean(3)
RETRACTION = Cayley(BODY)
HORIZON, STEPS = 2.0, 4
MOST_CALLS, MOST_MODULES, DEEPEST = 225, 43, 15  # of a warm solve in 20 steps, as measured: to be lowered, not raised
# Modules of jax and jax._src that look up structures and settings; lib has a callback of the garbage collector.
LOOKED_UP = {"tree", "tree_util", "config", "core", "dtypes", "lax_numpy", "lib", "util", "xla_bridge"}


def slewing(q, u, weight):
    attitude, rate = q
    return attitude @ hat(rate), u


def priced(q, u, weight):
    return weight * (u @ u) / 2


def at(angle, rate=0.0):
    return rotation(angle * np.array([0.6, 0.0, 0.8])), np.full(3, rate)


@pytest.fixture(scope="module", params=[1, 2], ids=["one stage", "two stages"])
def solver(request):
    method = Midpoint(RETRACTION) if request.param == 1 else Gauss(2, RETRACTION)
    return Solver(OptimalControlProblem(BODY, slewing, priced, 3), method, STEPS)


def called_of_jax(call):
    """Modules of JAX whose functions run during a call, other than those for structures and settings."""
    seen = set()

    def watch(frame, event, argument):
        if event == "call":
            seen.add(frame.f_globals.get("__name__", ""))

    sys.setprofile(watch)
    try:
        call()
    finally:
        sys.setprofile(None)
    return {name for name in seen if name.startswith("jax") and name.rpartition(".")[2] not in LOOKED_UP}


def calls_of_library(call):
    """The functions of the library that run during a call, in order, and how deep they are in one another."""
    depths, found, own = [0], [], []

    def watch(frame, event, argument):
        if event == "call":
            own.append(frame.f_globals.get("__name__", "").partition(".")[0] == "retrax")
            if own[-1]:
                found.append((frame.f_globals["__name__"], frame.f_code.co_qualname))
                depths.append(sum(own))
        elif event == "return" and own:
            own.pop()

    sys.setprofile(watch)
    try:
        call()
    finally:
        sys.setprofile(None)
    return found, max(depths)


START, END = at(0.0), at(2.0)
CALLS = {
    "two points": {},
    "a free rate": {"end": (END[0], None)},
    "a guess, and a factor free on both sides": {"guess": "last", "start": (START[0], None), "end": (END[0], None)},
    "points that are whole numbers": {"start": (np.eye(3, dtype=int), np.zeros(3, int))},
    "a far end, for which the curve of the retraction is uneven": {"end": at(2.9)},
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.usual(2)
def test_a_warm_call_asks_nothing_of_jax(solver, name):
    options = {"start": START, "end": END, **CALLS[name]}
    guess = solver.solve(START, END, HORIZON, parameters=1.0)
    options["guess"] = guess if options.get("guess") else None

    def call(weight):
        return solver.solve(horizon=HORIZON, parameters=weight, **options)

    first = call(1.0)
    call(1.5)  # parameters with which the problem has to be shown to be regular
    assert not called_of_jax(lambda: call(1.0))
    assert not called_of_jax(lambda: call(2.5))
    assert first.success
    np.testing.assert_array_equal(call(1.0).controls, first.controls)


def test_a_warm_batch_asks_nothing_of_jax(solver):
    ends = tuple(np.stack(part) for part in zip(*(at(angle) for angle in (0.5, 1.0, 2.0)), strict=True))

    def call():
        return solver.solve_many(START, ends, HORIZON, parameters=np.array([1.0, 2.0, 3.0]))

    assert call().converged == 3
    assert not called_of_jax(lambda: list(call()))


@pytest.mark.parametrize("far", [0.0, 1e-14, 1e-5, 1e-2])
def test_warm_calls_see_what_is_off_its_manifold(solver, far):
    """An end of one member, and a state of a guess, as far from a rotation as it goes."""
    solver.solve(START, END, HORIZON, parameters=1.0)
    bent = END[0] + far * np.ones((3, 3)), END[1]
    ends = tuple(np.stack([a, b, a]) for a, b in zip(END, bent, strict=True))
    found = solver.solve(START, END, HORIZON, parameters=1.0)
    states = (
        found.stage_states[0] + far * (np.arange(len(found.stage_times)) == 2)[:, None, None],
        found.stage_states[1],
    )
    guess = Guess(states, found.controls, found.costates)
    calls = (
        (NotOnManifoldError, "end, factor 0", lambda: solver.solve(START, bent, HORIZON, parameters=1.0)),
        (NotOnManifoldError, "end, factor 0", lambda: solver.solve_many(START, ends, HORIZON, parameters=np.ones(3))),
        (InvalidInputError, "guess: states are not on", lambda: solver.solve(START, END, HORIZON, guess, 1.0)),
        (
            InvalidInputError,
            "guess: states",
            lambda: solver.solve_many(START, ends, HORIZON, [found, guess, found], np.ones(3)),
        ),
    )
    for error, words, call in calls:
        if far < 1e-10:
            call()
        else:
            with pytest.raises(error, match=words):
                call()


@pytest.mark.parametrize("place", [0, 1, 3])
def test_each_member_of_a_batch_is_shown_to_be_regular(solver, place):
    """Without a price of the controls the problem is singular; with a tiny one it is not."""
    for weight in (1.0, 1e-6, 1e-12, 0.0):
        weights = np.ones(4)
        weights[place] = weight
        ends = tuple(np.stack([part] * 4) for part in END)
        if weight:
            assert solver.solve_many(START, ends, HORIZON, parameters=weights).converged == 4
        else:
            words = f"with the parameters of member {place}(; call|: the running cost is 0 at every)"
            with pytest.raises(InvalidInputError, match=words):
                solver.solve_many(START, ends, HORIZON, parameters=weights)


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize(
    ("cost", "words"),
    [
        (lambda q, u, p: p * u @ u / 2, "with the parameters of member {}: the running cost is 0 at every"),
        (lambda q, u, p: p * u @ u / 2 + q @ q / 2, "singular with the parameters of member {}; call"),
        (lambda q, u, p: p * u @ u + (1 - p) * jnp.abs(u[0]), "parameters of member {}: running_cost has a kink"),
    ],
)
@pytest.mark.usual(2)
def test_a_member_that_is_refused_is_named(cost, words, place):
    line = Euclidean(1)
    one = Solver(OptimalControlProblem(line, lambda q, u, p: u, cost, 1), Gauss(2, Addition(line)), 5)
    weights = np.ones(3)
    weights[place] = 0.0
    with pytest.raises(InvalidInputError, match=words.format(place)):
        one.solve_many(np.zeros(1), np.ones(1), 1.0, parameters=weights)
    with pytest.raises(InvalidInputError, match=f"^with member {place}: "):
        one.solve_many(np.zeros(1), np.ones(1), Free(1.0), parameters=weights)


def test_records_of_a_batch_are_made_once_and_are_those_of_its_fields(solver):
    ends = tuple(np.stack(part) for part in zip(*(at(angle) for angle in (0.5, 1.0, 2.0)), strict=True))
    weights = np.array([1.0, 2.0, 3.0])
    many = solver.solve_many(START, ends, HORIZON, parameters=weights)
    weights[:], ends[0][:] = 0.0, 0.0  # what was given changes after the call
    last = many[2]
    assert last.parameters == 3.0
    assert last is many[-1] is many[1:][1] is list(many)[2]
    assert isinstance(last.checks, RegularChecks)
    assert [len(many[1:]), len(many[5:])] == [2, 0]
    for which in (np.array([False, True, True]), [1, 2], np.array([1, -1]), [False, True, True]):
        assert [member.cost for member in many[which]] == [many[1].cost, many[2].cost]
        np.testing.assert_array_equal(many[which].controls, many.controls[1:])
    assert len(many[[]]) == len(many[many.cost < 0]) == 0
    for name in ("times", "states", "costates", "stage_costates", "controls", "momenta", "cost", "success"):
        for whole, some, own in zip(*(jax.tree.leaves(getattr(m, name)) for m in (many, many[1:], last)), strict=True):
            np.testing.assert_array_equal(whole[2], own)
            np.testing.assert_array_equal(some[1], own)
    assert many.checks[2] == last.checks
    assert solver.sensitivity(last).horizon.cost == pytest.approx(-last.checks.hamiltonian, rel=0.1)
    again = pickle.loads(pickle.dumps(many[1:]))
    assert again.converged == 2
    np.testing.assert_array_equal(again.controls, many.controls[1:])
    with pytest.raises(IndexError):
        many[3]
    with pytest.raises(AttributeError, match=r"no attribute 'torque'; try solutions\[0\]"):
        _ = many.torque


def test_guesses_of_a_batch_are_one_for_each():
    line = Euclidean(1)
    solver = Solver(
        OptimalControlProblem(line, lambda q, u: u, lambda q, u: jnp.sum(u**2), 1), Midpoint(Exponential(line)), 2
    )
    ends = np.array([[1.0], [2.0]])
    guess = Guess(np.ones((2, 1)), np.ones((2, 1)))
    assert solver.solve_many(np.zeros(1), ends, 1.0, guess).converged == 2
    assert solver.solve_many(np.zeros(1), ends, 1.0, [guess, guess]).converged == 2
    for wrong, words in (([guess, None], "got None"), ([guess], "one length B"), ([guess, "x"], "got 'x'")):
        with pytest.raises(InvalidInputError, match=words):
            solver.solve_many(np.zeros(1), ends, 1.0, wrong)
    for wrong in (np.array([1.0, -1.0]), np.array([1.0, np.nan]), -1.0):
        with pytest.raises(InvalidInputError, match=r"horizon(, member 1,)? must be a positive finite time, got "):
            solver.solve_many(np.zeros(1), ends, wrong)
    with pytest.raises(InvalidInputError, match="one length B"):
        solver.solve_many(np.zeros((0, 1)), np.zeros(1), 1.0)


def test_a_warm_solve_passes_few_functions():
    """A function that only passes on, and a figure that nobody has read, are calls too many."""
    one = Solver(OptimalControlProblem(BODY, slewing, priced, 3), Midpoint(RETRACTION), 20)
    for _ in range(2):
        one.solve(START, END, HORIZON, parameters=1.0)
    found, depth = calls_of_library(lambda: one.solve(START, END, HORIZON, parameters=1.0))
    assert len(found) <= MOST_CALLS
    assert len({module for module, _ in found}) <= MOST_MODULES
    assert depth <= DEEPEST
