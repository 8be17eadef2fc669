"""Searches of the core whose functions, or some of them, are callbacks to Python."""

import math
import signal
import traceback
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.base import Evaluator
from retrax.compute.binding.problem_functions import CallbackFunction, _columns
from retrax.compute.binding.search import Search, SearchStatus
from retrax.compute.binding.transcription import Transcription
from retrax.compute.tape_evaluator import TapeEvaluator
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.transcription import core_transcription
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint
from scipy.optimize import minimize

from ..integrators.problems import half_square
from .trajectories import CASES, posed, put

LINE, PLANE = Euclidean(1), Euclidean(2)
NAMES = list(CASES)
HALF = (lambda name: name % 2 == 0), (lambda name: name % 2 == 1)
SHARES = {"all": lambda name: True, "even": HALF[0], "odd": HALF[1]}


def function_of(tape_function: Any) -> CallbackFunction:
    """A tape that Python runs."""
    tape = tape_function.tape
    return CallbackFunction(tape_function, [leaf.rows for leaf in tape._leaves], list(map(math.prod, tape.shapes)))


def with_callbacks(transcription: Transcription, conditions: Any, share: Any) -> Transcription:
    """The transcription with callbacks to the tapes of some functions instead of these tapes."""
    of = transcription
    tapes = conditions.transcription.functions | conditions.at_nodes.functions
    functions = {name: function_of(tapes[name]) if share(name) else program for name, program in of.programs.items()}
    return Transcription(of.sizes, of.tableau, of.groups, of.control_groups, of.kept, of.bounds, functions)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usual(2)
def test_searches_by_callbacks_are_those_by_tapes(name, monkeypatch):
    """Of all functions, and of every second one; the same arithmetic, so that iterates are the same to rounding."""
    solver, way, options = CASES[name]()
    conditions, guess = posed(solver, way, monkeypatch, **options)
    own = core_transcription.make_transcription(conditions)
    found = []
    for share in (lambda name: False, *SHARES.values()):
        search = Search(with_callbacks(own, conditions, share), 1e-10, 100)
        put(search.trajectory, conditions, guess._replace(slacks=None))
        assert search.run() is SearchStatus.CONVERGED
        at = search.trajectory
        found.append((search.read().facts.iterations, at["TOTALS"][0], at["CENTRES"].copy(), at["CONTROLS"].copy()))
    for iterations, cost, *arrays in found[1:]:
        assert iterations == found[0][0]
        assert cost == pytest.approx(found[0][1], rel=1e-12)
        for array, expected in zip(arrays, found[0][2:], strict=True):
            np.testing.assert_allclose(array, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.fixture
def on_core(monkeypatch):
    """The searches of solves, one after the other."""
    searches = list[Search]()
    run = Search.run
    monkeypatch.setattr(Search, "run", lambda own: searches.append(own) or run(own))
    return searches


def kinds(search: Search) -> set[type]:
    """The kinds of functions of a search."""
    return set(map(type, search._of[0].programs.values()))


@pytest.mark.parametrize("name", ["a slew", "collocation with a cap at nodes", "a free end"])
@pytest.mark.usual(1)
def test_what_the_user_chooses_is_what_runs(name, on_core):
    """The same iterations and costs by tapes and by XLA."""
    solver, way, options = CASES[name]()
    expected = solver.solve(*way, tolerance=1e-10, **options)
    (tapes,) = {kind for search in on_core for kind in kinds(search)}
    on_core.clear()
    other = Solver(solver.problem, solver.method, solver.fractions, evaluator="xla")
    found = other.solve(*way, tolerance=1e-10, **options)
    assert {kind for search in on_core for kind in kinds(search)} == {CallbackFunction}
    assert tapes is not CallbackFunction
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    assert found.statistics.iterations == expected.statistics.iterations
    assert (found.result, found.checks.strict_minimum) == (expected.result, expected.checks.strict_minimum)


@jax.custom_jvp
def called(x: Any) -> Any:
    """A sine of Python's."""
    return jax.pure_callback(np.sin, jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method="broadcast_all")


called.defjvp(lambda given, steps: (called(*given), called(given[0] + jnp.pi / 2) * steps[0]))


def eigenvalue(x: Any) -> Any:
    """The largest eigenvalue of a matrix, larger than what is written out on a tape."""
    matrix = jnp.diag(jnp.arange(40.0)) + 0.1 * x
    return jnp.linalg.eigh(matrix)[0][-1] / 40


def looped(x: Any) -> Any:
    """A decay in very many steps."""
    return jax.lax.fori_loop(0, 20_000, lambda i, y: y * (1 - 1e-5), x)


UNTRACEABLE = {"a callback to Python": called, "eigenvalues": eigenvalue, "a long loop": looped}
IN_NUMPY = {
    "a callback to Python": np.sin,
    "eigenvalues": lambda x: np.linalg.eigvalsh(np.diag(np.arange(40.0)) + 0.1 * x)[-1] / 40,
    "a long loop": lambda x: x * (1 - 1e-5) ** 20_000,
}


@pytest.mark.parametrize("method", [Midpoint(Addition(LINE)), Gauss(2, Addition(LINE))], ids=["midpoint", "gauss"])
@pytest.mark.parametrize("name", UNTRACEABLE)
@pytest.mark.usual(2)
def test_what_has_no_tape_is_solved(name, method, on_core):
    """Some functions have tapes and some have none; the minimum is that of the discrete cost by SciPy."""
    term = UNTRACEABLE[name]
    problem = OptimalControlProblem(
        LINE, lambda q, u: u, lambda q, u: u @ u / 2 + term(q[0]), 1, control_bounds=(-2.0, 1.5)
    )
    solver, way = Solver(problem, method, 5), (np.zeros(1), np.ones(1), 1.0)
    found = solver.solve(*way)
    assert solver.evaluator == "xla", solver.reason
    assert on_core
    assert all(len(kinds(search)) == 2 for search in on_core)
    assert found.success
    assert found.cost == pytest.approx(least_cost(method, 5, IN_NUMPY[name]), rel=1e-8)


def least_cost(method: Any, count: int, term: Any) -> float:
    """The least cost of steps from 0 to 1 in a unit of time by SciPy."""
    gauss = method if isinstance(method, Gauss) else Gauss(1, Addition(LINE))
    h, s = 1 / count, gauss.stages

    def states(u: np.ndarray) -> np.ndarray:
        u = u.reshape(count, s)
        begins = np.concatenate([[0.0], np.cumsum(h * u @ gauss.weights)])[:-1]
        return begins[:, None] + h * u @ gauss.matrix.T

    def cost(u: np.ndarray) -> float:
        rates = u.reshape(count, s) ** 2 / 2 + np.vectorize(term)(states(u))
        return h * float(np.sum(rates @ gauss.weights))

    weights = h * np.tile(gauss.weights, count)
    ends = {"type": "eq", "fun": lambda u: weights @ u - 1, "jac": lambda u: weights}
    bounds = [(-2.0, 1.5)] * (count * s)
    found = minimize(
        cost, np.ones(count * s), bounds=bounds, constraints=[ends], options={"ftol": 1e-14, "maxiter": 500}
    )
    assert found.success, found.message
    return found.fun


class Own(Exception):
    """An error of a user."""


class Counted(Evaluator):
    """Functions whose call of some number does something else first."""

    name, reason = "counted", "of a test"

    def __init__(self, of: Evaluator) -> None:
        self.of, self.calls, self.at, self.instead = of, 0, -1, lambda: None

    def compile(self) -> None:
        """There is nothing to do."""

    def _make(self, function: Any, sizes: Any, first: int | None) -> Any:
        made = self.of._make(function, sizes, first)
        evaluate, owner = made.at, self

        class Watched:
            sizes = function_of(made)._arguments, function_of(made)._values

            def __call__(self, *arguments):
                return self.at(1, *arguments)

            def at(self, axes, *arguments):
                owner.calls += 1
                if owner.calls == owner.at:
                    owner.instead()
                return evaluate(axes, *arguments)

        found = Watched()
        found.of_any = found.at
        found.placed = lambda *given: None
        return found


@pytest.fixture
def counted(on_core):
    """A solver of a pendulum that counts its functions, a way between two states, and the calls in each search."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1], u[0] - jnp.sin(q[0])]), half_square, 1, control_bounds=(-6.0, 6.0)
    )
    evaluator = Counted(TapeEvaluator())
    solver, way = Solver(problem, Midpoint(Addition(PLANE)), 8, evaluator), (np.zeros(2), np.array([1.0, 0.0]), 1.0)
    calls = list[tuple[int, int]]()
    run = Search.run

    def counting(own: Search) -> Any:
        before = evaluator.calls
        try:
            return run(own)
        finally:
            calls.append((before, evaluator.calls))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Search, "run", counting)
        yield solver, way, evaluator, calls


def test_no_error_is_lost(counted):
    """Swept through all calls of a search; each is raised with the frames of where it came from, and forgotten."""
    solver, way, evaluator, calls = counted
    expected = solver.solve(*way)
    ((first, last),) = calls
    assert last - first > 30

    def fail():
        raise Own(f"at call {evaluator.calls}")

    evaluator.instead = fail
    for at in range(first + 1, last + 1):
        evaluator.calls, evaluator.at = 0, at
        with pytest.raises(Own, match=f"at call {at}") as caught:
            solver.solve(*way)
        assert "fail" in [frame.name for frame in traceback.extract_tb(caught.value.__traceback__)]
        assert caught.value.__context__ is None
    evaluator.calls, evaluator.at = 0, -1
    again = solver.solve(*way)
    assert (again.cost, again.statistics.iterations) == (expected.cost, expected.statistics.iterations)


def test_an_error_in_a_batch_is_raised(counted):
    """Swept through the calls of all members, which are searched side by side."""
    solver, _, evaluator, calls = counted
    starts, ends, horizons = np.zeros((4, 2)), np.array([[0.5 * k, 0.0] for k in range(4)]), np.ones(4)
    solver.solve_many(starts, ends, horizons)
    first, last = min(begin for begin, _ in calls), max(end for _, end in calls)

    def fail():
        raise Own("of a member")

    evaluator.instead = fail
    for at in range(first + 1, last + 1, 9):
        evaluator.calls, evaluator.at = 0, at
        with pytest.raises(Own, match="of a member"):
            solver.solve_many(starts, ends, horizons)
    evaluator.at = -1
    assert solver.solve_many(starts, ends, horizons).success.all()


def test_an_interrupt_in_a_function_stops_the_search(counted):
    """Swept through the calls of a search: what is returned is the best iterate so far, of finite numbers."""
    solver, way, evaluator, calls = counted
    expected = solver.solve(*way)
    ((first, last),) = calls
    evaluator.instead = lambda: signal.raise_signal(signal.SIGINT)
    stopped, costs = [], []
    for at in range(first + 1, last + 1, 3):
        evaluator.calls, evaluator.at = 0, at
        found = solver.solve(*way, throw=False)
        stopped.append(found.statistics.stopped)
        costs.append(found.cost)
        assert np.all(np.isfinite(found.states))
        assert np.all(np.isfinite(found.controls))
        assert found.success or stopped[-1]
    assert all(stopped[: -len(stopped) // 2])
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert abs(costs[-1] - expected.cost) < abs(costs[0] - expected.cost)


def test_an_interrupt_that_a_function_raises_is_one(counted):
    """As where a handler of signals raises it; of the first evaluation the guess is left."""
    solver, way, evaluator, calls = counted
    solver.solve(*way)
    ((first, last),) = calls

    def interrupt():
        raise KeyboardInterrupt

    evaluator.instead = interrupt
    for at in range(first + 1, last + 1, 3):
        evaluator.calls, evaluator.at = 0, at
        found = solver.solve(*way, throw=False)
        assert found.success or found.statistics.stopped
        assert np.all(np.isfinite(found.states))


def test_the_error_of_a_handler_of_signals_is_raised(counted):
    """Where the user has one, it is called in the function, which C has called."""
    solver, way, evaluator, calls = counted
    solver.solve(*way)
    ((first, last),) = calls

    def handler(*_):
        raise Own("of a handler")

    evaluator.instead = lambda: signal.raise_signal(signal.SIGINT)
    usual = signal.signal(signal.SIGINT, handler)
    try:
        for at in range(first + 1, last + 1, 7):
            evaluator.calls, evaluator.at = 0, at
            with pytest.raises(Own, match="of a handler"):
                solver.solve(*way)
    finally:
        signal.signal(signal.SIGINT, usual)


class Failing:
    """A square for Python, which fails at a call."""

    def __init__(self, at: int) -> None:
        self.at, self.calls = at, 0

    def __call__(self, x: Any) -> Any:
        self.calls += 1
        if self.calls == self.at:
            raise Own(f"at call {self.at}")
        return np.sin(x)


@pytest.mark.parametrize("at", [1, 10, 20])
@pytest.mark.usual(1)
def test_the_error_of_a_callback_of_jax_is_raised(at, on_core):
    own = Failing(at)

    @jax.custom_jvp
    def failing(x):
        return jax.pure_callback(own, jax.ShapeDtypeStruct(x.shape, x.dtype), x, vmap_method="broadcast_all")

    failing.defjvp(lambda given, steps: (failing(*given), failing(given[0] + jnp.pi / 2) * steps[0]))
    problem = OptimalControlProblem(LINE, lambda q, u: u - 3 * failing(q), lambda q, u: u @ u / 2, 1)
    solver = Solver(problem, Midpoint(Addition(LINE)), 5)
    with pytest.raises(jax.errors.JaxRuntimeError, match=f"at call {at}"):
        solver.solve(np.zeros(1), np.ones(1), 1.0)
    assert on_core or at == 1  # the first call may be a check of the problem
    assert solver.solve(np.zeros(1), np.ones(1), 1.0).success


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.0, 5.0])
@pytest.mark.usual(1)
def test_functions_without_a_number_are_as_on_tapes(gain, on_core):
    """Trials that leave the domain of a function, of which the larger gains have more."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1] + gain * jnp.log(1.5 - q[0]), u[0]]), half_square, 1
    )
    way, found = (np.zeros(2), np.array([1.2, 0.0]), 2.0), []
    for evaluator in ("tape", "xla"):
        solver = Solver(problem, Midpoint(Addition(PLANE)), 6, evaluator=evaluator)
        found.append(solver.solve(*way, throw=False))
    assert found[0].result == found[1].result
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-9)
    assert found[0].statistics.iterations == found[1].statistics.iterations


def test_batches_and_threads_call_back(on_core):
    """Members of a batch, and solves in several threads at a time, find what solves one after the other find."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2 + called(q[0]), 1)
    solver = Solver(problem, Midpoint(Addition(LINE)), 5)
    ends = np.linspace(0.5, 2.0, 12)[:, None]
    expected = [solver.solve(np.zeros(1), end, 1.0) for end in ends]
    assert all(one.success for one in expected)
    many = solver.solve_many(np.zeros((12, 1)), ends, np.ones(12))
    np.testing.assert_allclose(many.cost, [one.cost for one in expected], rtol=1e-12)
    with ThreadPoolExecutor(4) as pool:
        solved = list(pool.map(lambda end: solver.solve(np.zeros(1), end, 1.0), ends, timeout=120))
    np.testing.assert_allclose([one.cost for one in solved], [one.cost for one in expected], rtol=1e-12)


def test_places_that_do_not_follow_one_another_are_refused():
    table = np.array([[0, 2], [3, 2]], np.intp)
    with pytest.raises(RuntimeError, match="do not follow one another"):
        _columns(table.ctypes.data, [2])
    assert _columns(table.ctypes.data, [1, 0, 1]) == [(0, 2, 1), (0, 0, 0), (3, 2, 1)]
