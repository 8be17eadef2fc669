"""Machine code gives the numbers of the machine, to the last bit, and takes its place while others go on."""

import copy
import gc
import os
import subprocess
import sys
import weakref
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute import threads
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError
from retrax.retractions import Addition, Cayley, Gauss, Midpoint
from retrax.tape import Tape, native, often
from retrax.tape.instructions import UnknownInstructionError
from retrax.tape.program import assembled

from .functions import SMOOTH, SPECIAL

HARD = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e308, 5e-324, 0.5, -2.5])


@pytest.fixture(autouse=True)
def nothing_else_is_made():
    """What other tests have asked for is there before each of these."""
    threads.settled()


# Arguments of functions of three numbers, at some of which values are no numbers.
ORDINARY = 0.05 + 0.9 * np.random.default_rng(0).random((3, 5))
POINTS = np.concatenate([ORDINARY, np.random.default_rng(1).choice(HARD, (3, 9))], axis=1)
CASES = {
    **{name: (f, POINTS) for name, f in SMOOTH.items()},
    **{n: (f, x[:, None]) for n, (f, x) in SPECIAL.items()},
}


@pytest.fixture
def made(monkeypatch):
    """The tapes that become machine code from now on."""
    found, make = [], Tape.compile

    def heard(self):
        before = self.code
        make(self)
        if self.code is not before:
            found.append(self)

    monkeypatch.setattr(Tape, "compile", heard)
    return found


def both(tape, *arguments):
    """The values before it is machine code, and after."""
    before = tape(*arguments)
    tape.compile()
    return before, tape(*arguments)


def equal(before, after):
    """The numbers are the same ones; what is not a number has no sign."""
    for one, other in zip(*map(jax.tree.leaves, (before, after)), strict=True):
        np.testing.assert_array_equal(one, other)
        numbers = ~np.isnan(one)
        np.testing.assert_array_equal(np.signbit(np.real(one))[numbers], np.signbit(np.real(other))[numbers])


@pytest.mark.parametrize("name", CASES)
def test_values_and_two_derivatives_are_the_same_numbers(name):
    function, x = CASES[name]
    value = Tape.trace(lambda y: jnp.sum(jnp.sin(jnp.arange(1.0, 4.0) * function(y))), x[:, 0])
    with np.errstate(all="ignore"):
        for tape in (Tape.trace(function, x[:, 0]), value.second_order()):
            equal(*both(tape, x))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 100, 257])
def test_any_number_of_points(count):
    """From less than a vector of the processor to many, of functions with one array, and with several."""
    cayley, draw = Cayley(SE(3)), np.random.default_rng(count).standard_normal
    tape = Tape.trace(lambda x, v, s: cayley(x, s * v), np.eye(4), np.zeros((4, 4)), 0.0)
    equal(*both(tape, draw((4, 4, count)), draw((4, 4, count)), draw(count)))


@pytest.mark.long("1", "2", "3")
@pytest.mark.parametrize("size", [1, 2, 3, 10, 33, 100, 10_000])
def test_pieces_of_any_length(size, monkeypatch):
    """From an instruction to all of them: what one piece leaves to others stands where these look for it."""
    monkeypatch.setattr(native, "PIECE", size)
    x = np.random.default_rng(2).standard_normal((3, 11))
    tape = Tape.trace(lambda w: jax.scipy.linalg.expm(jnp.cross(jnp.eye(3), w)) @ jnp.exp(w) + jnp.sin(w) / w, x[:, 0])
    before, after = both(tape.jacobian(), x)
    equal(before, after)


def test_arguments_that_are_values_constants_and_arguments_that_nothing_uses():
    x = np.arange(12.0).reshape(4, 3)
    odd = {
        "the same": lambda a: a,
        "backwards": lambda a: a[::-1],
        "constants": lambda a: jnp.array([1.0, 0.0, 2.0**70]),
        "one of four": lambda a: a[2] + 1.0,
        "nothing": lambda a: jnp.zeros(0),
        "constants of functions": lambda a: jnp.sin(a[:1]) ** jnp.array([1.5, 2.5]),
    }
    for function in odd.values():
        tape = Tape.trace(function, x[:, 0])
        equal(*both(tape, x))


def test_threads_change_nothing(monkeypatch):
    x = np.random.default_rng(3).standard_normal((3, 4001))
    tape = Tape.trace(lambda w: jnp.cross(w, jnp.exp(w)), x[:, 0])
    tape.compile()
    alone = tape(x)
    monkeypatch.setattr(threads, "WORTH_A_THREAD", 100)
    monkeypatch.setattr(threads.os, "cpu_count", lambda: 4)
    equal(alone, tape(x))


def test_code_lives_as_long_as_what_calls_it():
    x = np.random.default_rng(4).standard_normal((3, 8))
    tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) ** 2, x[:, 0])
    before, after = both(tape, x)
    code = tape.code
    assert code is not tape.program
    gone = weakref.ref(tape)
    del tape
    gc.collect(0)  # what is new
    assert gone() is None
    equal(before, after)
    assert code.engine is not None


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999, 1.0, 1.001, 2.0])
def test_it_is_made_after_so_many_points(share, made, monkeypatch):
    """Points are counted through the number after which it is made, call by call and all at once."""
    monkeypatch.setattr(often, "OFTEN", 1000)
    x = np.random.default_rng(5).standard_normal((3, 50))
    for calls in (1, 20):
        tape = Tape.trace(lambda w, by=calls: jnp.cross(w, w[::-1]) * by, x[:, 0])
        size = max(int(1000 * share) // calls, 1)
        for _ in range(calls):
            tape(np.resize(x, (3, size)))
        threads.settled()
        assert (tape.code is not tape.program) == (calls * max(size, often.SHORT) > 1000)
        assert made.count(tape) == (tape.code is not tape.program)


@pytest.mark.parametrize("over", [-1, 0, 1])
def test_very_long_tapes_are_made_only_if_they_are_asked_to(over, monkeypatch):
    """Through the number of instructions up to which they are made by themselves."""
    x = np.random.default_rng(9).standard_normal((3, 50))
    tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) * (7.0 + over), x[:, 0])
    monkeypatch.setattr(often, "OFTEN", 10)
    monkeypatch.setattr(often, "MOST", tape.instructions - over)
    expected = tape(x)
    threads.settled()
    assert (tape.code is tape.program) == (over > 0)
    tape.compile()
    assert tape.code is not tape.program
    equal(expected, tape(x))


def test_calls_go_on_while_it_is_made(made, monkeypatch):
    """From several threads, which all ask for it: it is made once."""
    monkeypatch.setattr(often, "OFTEN", 100)
    x = np.random.default_rng(6).standard_normal((3, 40))
    tape = Tape.trace(lambda w: jax.scipy.linalg.expm(jnp.cross(jnp.eye(3), w)), x[:, 0])
    expected = tape(x)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: tape(x), range(400)):
            equal(expected, found)
    threads.settled()
    assert made == [tape]
    equal(expected, tape(x))


def test_code_that_cannot_be_made_is_logged_and_missed_by_nobody(monkeypatch, caplog):
    monkeypatch.setattr(often, "OFTEN", 100)
    monkeypatch.setattr(native, "_engine", lambda text: 1 // 0)
    x = np.random.default_rng(7).standard_normal((3, 40))
    tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) + 0.5, x[:, 0])
    expected = [tape(x) for _ in range(4)]
    threads.settled()
    assert tape.code is tape.program
    assert "ZeroDivisionError" in caplog.text
    equal(expected[0], tape(x))


def spun(scale):
    """A rigid body that is turned at the least cost."""
    space, inertia = SO(3) * Euclidean(3), scale * np.array([1.0, 2.0, 3.0])

    def dynamics(q, u):
        return q[0] @ jnp.cross(-jnp.eye(3), q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia

    return OptimalControlProblem(space, dynamics, lambda q, u: u @ u / 2, controls=3), Cayley(space)


@pytest.mark.usual("None-1", "4.0-3")
@pytest.mark.parametrize("stages", [1, 3])
@pytest.mark.parametrize("limit", [None, 4.0])
def test_solutions_are_the_same_numbers(stages, limit, made, monkeypatch):
    """One trajectory and a batch, with limits and without, before machine code takes over and after."""
    monkeypatch.setattr(often, "OFTEN", np.inf)
    problem, cayley = spun(1.0 + stages / 7)
    if limit is not None:
        problem = OptimalControlProblem(
            problem.manifold, problem.dynamics, problem.running_cost, controls=3, control_bounds=(-limit, limit)
        )
    solver = Solver(problem, Midpoint(cayley) if stages == 1 else Gauss(stages, cayley), 12)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rest = np.zeros(3)

    def solved():
        alone = solver.solve((np.eye(3), rest), (turn, rest), 3.0)
        starts = np.stack([np.eye(3)] * 40), np.zeros((40, 3))
        many = solver.solve_many(starts, (turn, rest), np.linspace(2.5, 4.0, 40))
        return [(own.states, own.costates, own.controls, own.cost) for own in (alone, many)]

    before = solved()
    monkeypatch.setattr(often, "OFTEN", 1)
    solved()
    threads.settled()
    assert made
    equal(before, solved())


def with_parameters():
    space = Euclidean(2)
    return OptimalControlProblem(
        space, lambda q, u, k: jnp.array([q[1], u[0] - k * q[0]]), lambda q, u, k: u @ u / 2, controls=1
    ), (1.5,)


def without():
    space = Euclidean(2)
    return OptimalControlProblem(
        space, lambda q, u: jnp.array([q[1], u[0] - q[0]]), lambda q, u: u @ u / 2, controls=1
    ), (None,)


@pytest.mark.parametrize("make", [with_parameters, without])
@pytest.mark.parametrize("horizon", [2.0, Free(2.0, upper=3.0)])
def test_a_solver_compiles_when_it_is_told_to(make, horizon, made, monkeypatch):
    """With a free horizon, and with parameters, after the first call."""
    monkeypatch.setattr(often, "OFTEN", np.inf)
    problem, parameters = make()
    solver = Solver(problem, Gauss(2, Addition(problem.manifold)), 9)
    way = np.array([1.0, 0.0]), np.zeros(2), horizon
    if problem.takes_parameters:
        with pytest.raises(InvalidInputError, match=r"nothing is traced yet .* before solver.compile"):
            solver.compile()
    before = solver.solve(*way, parameters=parameters[0])
    solver.compile()
    assert made
    again, count = solver.solve(*way, parameters=parameters[0]), len(made)
    equal(*((own.states, own.costates, own.controls, own.cost) for own in (before, again)))
    solver.compile()
    assert len(made) == count


def test_what_xla_evaluates_stays_as_it_is(made, monkeypatch):
    monkeypatch.setattr(often, "OFTEN", np.inf)
    problem, _ = without()
    solver = Solver(problem, Midpoint(Addition(problem.manifold)), 5, evaluator="xla")
    solver.compile()
    assert solver.evaluator == "xla"
    assert not made


def test_a_trial_is_made_anew_of_machine_code():
    problem, _ = without()
    solver = Solver(problem, Midpoint(Addition(problem.manifold)), 6)
    way = np.array([1.0, 0.0]), np.zeros(2), 1.5
    for compiled in (False, True, True):
        solver.solve(*way)
        (steps,) = [traced.steps for traced in solver._transcription._found.values()]
        trial = steps._trial[1]
        assert trial.is_current
        assert all(own.code.engine is not None for own in trial._tapes) or not compiled
        solver.compile()


def test_copies_have_no_machine_code():
    x = np.random.default_rng(8).standard_normal((3, 8))
    tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) - 2.0, x[:, 0])
    expected = tape(x)
    tape.compile()
    other = copy.deepcopy(tape)
    assert other.code.engine is None
    equal(expected, other(x))


def test_what_casadi_calls_is_no_machine_code():
    symbol, x = ca.SX.sym("symbol"), ca.SX.sym("x", 2)
    inner = ca.Function("inner", [symbol], [symbol**2], {"never_inline": True})
    with pytest.raises(UnknownInstructionError):
        assembled(x, ca.vertcat(inner(x[0]) * x[1]))


PROCESS = """
import os, threading, time
import jax.numpy as jnp, numpy as np
from retrax.compute import threads
from retrax.tape import Tape, often
often.OFTEN = 1

def made(k):
    return Tape.trace(lambda w: jnp.exp(w @ w.T) * (1.0 + k), np.eye(4))

x = np.ones((4, 4, 10))
"""
ENDS = "for k in range(30):\n    made(k)(x)\n"
LATER = """
def run():
    threading.main_thread().join()
    made(1)(x)
    print("ended")

threading.Thread(target=run).start()
"""
FORK = """
tapes = [made(k) for k in range(12)]
for tape in tapes:
    tape(x)
for tape in tapes[::4]:
    child = os.fork()
    if not child:
        tape.compile()
        tape(x)
        threads.settled()
        os._exit(7)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
OTHER = """
tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) * 1.1 + w, np.ones(3))
x = np.random.default_rng(0).standard_normal((3, 100))
before = tape(x)
tape.compile()
print(np.array_equal(before, tape(x)))
"""


@pytest.mark.usual("ends while it is made", "forks while it is made")
@pytest.mark.parametrize(
    ("script", "says", "environment"),
    [
        pytest.param(ENDS, "", {}, id="ends while it is made"),
        pytest.param(LATER, "ended\n", {}, id="has a thread that goes on after its end"),
        pytest.param(FORK, "7\n7\n7\n", {}, id="forks while it is made"),
        pytest.param(
            OTHER, "True\n", {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}, id="is compiled for another"
        ),
    ],
)
def test_a_process(script, says, environment, tmp_path):
    own = {"NUMBA_CACHE_DIR": str(tmp_path)} if environment else {}
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROCESS + script],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, **environment, **own},
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, says, "")
