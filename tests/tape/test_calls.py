"""Calls of tapes: odd arguments and values, several threads, copies, and the child of a fork."""

import copy
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.tape_evaluator import TapeEvaluator
from retrax.manifolds import SO
from retrax.retractions import Cayley
from retrax.tape import Tape
from retrax.tape.instructions import UnknownInstructionError
from retrax.tape.program import assemble

ODD = {
    "the same": lambda a: a,
    "backwards": lambda a: a[::-1],
    "constants": lambda a: jnp.array([1.0, 0.0, 2.0**70]),
    "one of four": lambda a: a[2] + 1.0,
    "nothing": lambda a: jnp.zeros(0),
    "constants of functions": lambda a: jnp.sin(a[:1]) ** jnp.array([1.5, 2.5]),
}


@pytest.mark.parametrize("name", ODD)
def test_arguments_that_are_values_constants_and_arguments_that_nothing_uses(name):
    x = np.arange(12.0).reshape(4, 3)
    expected = jax.vmap(ODD[name], -1, -1)(x)
    np.testing.assert_allclose(Tape.trace(ODD[name], x[:, 0])(x), expected, rtol=1e-14)
    function = TapeEvaluator().values(lambda a: (ODD[name](a),), 4)
    for _ in range(2):
        np.testing.assert_allclose(function.at(1, x.T)[0], np.moveaxis(expected, -1, 0), rtol=1e-14)


def turned(x, v):
    cayley = Cayley(SO(3))
    return (cayley(x.reshape(3, 3), x.reshape(3, 3) @ jnp.cross(jnp.eye(3), v)).ravel(), v @ v)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 8, 20, 1000, 5000])
def test_functions_of_any_number_of_points(count):
    """Of few points, which run in one memory, and of so many that threads share them; twice, with a shared argument."""
    draw = np.random.default_rng(count).normal
    x, v = draw(size=(count, 9)), draw(size=(count, 3))
    function, tape = TapeEvaluator().values(turned, 9, 3), Tape.trace(turned, np.ones(9), np.ones(3))
    expected = [np.moveaxis(a, -1, 0) for a in tape(x.T, v.T)]
    found = [function.at(1, x, v) for _ in range(2)]
    for values in found:
        np.testing.assert_array_equal(values[0], expected[0])
        np.testing.assert_array_equal(values[1], expected[1])
    if count:
        shared = function.at(1, x[:1], v)
        np.testing.assert_array_equal(shared[0], function.at(1, np.repeat(x[:1], count, axis=0), v)[0])


def test_threads_call_one_function_at_once():
    """Each has the values of its own arguments, in arrays of its own."""
    function, draw = TapeEvaluator().values(turned, 9, 3), np.random.default_rng(6).normal
    calls = [(draw(size=(12, 9)), draw(size=(12, 3))) for _ in range(400)]
    expected = [function.at(1, *call) for call in calls]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda call: function.at(1, *call), calls))
    for one, other in zip(found, expected, strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_copies_of_a_tape_that_has_run_give_the_same_numbers():
    x = np.random.default_rng(8).standard_normal((3, 8))
    tape = Tape.trace(lambda w: jnp.cross(w, w[::-1]) - 2.0, x[:, 0])
    expected = tape(x)
    np.testing.assert_array_equal(copy.deepcopy(tape)(x), expected)
    np.testing.assert_array_equal(tape(x), expected)


def test_a_function_that_casadi_calls_is_no_instruction():
    symbol, x = ca.SX.sym("symbol"), ca.SX.sym("x", 2)
    inner = ca.Function("inner", [symbol], [symbol**2], {"never_inline": True})
    with pytest.raises(UnknownInstructionError):
        assemble(x, ca.vertcat(inner(x[0]) * x[1]))


FORK = """
import os
import jax.numpy as jnp, numpy as np
from retrax.compute import threads
from retrax.tape import Tape
threads.WORTH_A_THREAD = 1
threads.os.cpu_count = lambda: 4
tape = Tape.trace(lambda w: jnp.exp(w @ w.T), np.eye(4))
x = np.ones((4, 4, 1000))
tape(x)
child = os.fork()
if not child:
    tape(x)
    os._exit(7)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_the_child_of_a_fork_runs_tapes_in_threads_of_its_own():
    command = [sys.executable, "-W", "ignore", "-c", FORK]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "7\n", "")
