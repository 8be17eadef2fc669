"""Loops on tapes: a state that follows from the one before, some rounds or until it stays as it is."""

import casadi as ca
import jax
import numpy as np
import pytest
from retrax.tape import Tape
from retrax.tape.arrays import scalars
from retrax.tape.graph import Graph
from retrax.tape.instructions import CODES
from retrax.tape.packing import Leaf

from .functions import run_alone

POINTS = np.random.default_rng(0).uniform(0.5, 4.0, (2, 70))


def looped(rounds: int, twice: bool = False) -> Tape:
    """Fibonacci's numbers from two numbers on, ``(a, b) -> (b, a + b)``, and behind them the square root of the last
    one by Newton's method; ``twice``: and those from there on."""
    x = ca.SX.sym("x", 2)
    graph = Graph([x])
    state, given = ca.SX.sym("s", 2), ca.SX.sym("g", 1)
    following = ca.Function("following", [state, given], [ca.vertcat(state[1], state[0] + state[1]), ca.SX(0)])
    s, g = ca.SX.sym("s"), ca.SX.sym("g")
    root = ca.Function("root", [s, g], [(s + g / s) / 2, ca.fabs(s - g / s) <= 1e-13 * s])
    unused = graph.loop(x, x[:1], following, rounds)
    numbers = graph.loop(x, x[:1], following, rounds)
    roots = graph.loop(ca.SX(1), numbers[1] * 3 - numbers[1] * 2, root, 60)
    values = ca.vertcat(x[0] * x[1] + numbers[0], numbers[1], roots, unused[0] - unused[0])
    if twice:
        more = graph.loop(ca.vertcat(roots, numbers[1]), x[1:], following, rounds)
        values = ca.vertcat(values, more, numbers[0] + more[1])
    leaves = [Leaf((2,), False)], jax.tree.structure((0,))
    return Tape(graph, [scalars(values, values.shape[:1])], leaves, jax.tree.structure(0))


def expected(rounds: int, twice: bool) -> np.ndarray:
    def following(a, b):
        for _ in range(rounds):
            a, b = b, a + b
        return a, b

    a, b = following(*POINTS)
    found = [POINTS[0] * POINTS[1] + a, b, np.sqrt(b), 0 * a]
    return np.array([*found, *(more := following(np.sqrt(b), b)), a + more[1]] if twice else found)


@pytest.mark.parametrize("twice", [False, True])
@pytest.mark.parametrize("rounds", [1, 2, 30])
def test_loops_give_the_state_after_their_rounds(rounds, twice):
    tape = looped(rounds, twice)
    values = tape(POINTS)
    np.testing.assert_allclose(values, expected(rounds, twice), rtol=1e-14)
    np.testing.assert_allclose(np.array(tape.to_casadi()(POINTS)), values, rtol=1e-14)
    for k in range(3):
        np.testing.assert_array_equal(run_alone(tape.program, POINTS[:, k].copy()), values[:, k])


@pytest.mark.parametrize("rounds", range(1, 6))
def test_numbers_of_a_state_change_places(rounds):
    x = ca.SX.sym("x", 3)
    graph, state = Graph([x]), ca.SX.sym("s", 3)
    turned = ca.Function("turned", [state, ca.SX.sym("g", 0)], [ca.vertcat(state[2], state[0], state[1]), ca.SX(0)])
    values = graph.loop(x, ca.SX(0, 1), turned, rounds)
    tape = Tape(graph, [scalars(values, (3,))], ([Leaf((3,), False)], jax.tree.structure((0,))), jax.tree.structure(0))
    points = np.arange(27.0).reshape(3, 9)
    np.testing.assert_array_equal(tape(points), np.roll(points, rounds, axis=0))


def test_what_nothing_needs_does_not_run():
    codes = looped(3).program.codes
    assert np.count_nonzero(codes == CODES["LOOP"]) == 2


def test_the_work_of_a_loop_is_that_of_its_rounds():
    program = looped(30).program
    assert len(program.codes) < program.work < 30 * len(program.codes)
