"""Functions that users write are compared by their code and the data that it reads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.integrators.functions import ByData, by_data, is_transformed, reads_traced
from retrax.manifolds import Euclidean
from retrax.retractions import CotangentLift, Exponential, Midpoint

LINE = Euclidean(1)
MIDPOINT = Midpoint(Exponential(LINE))
STRENGTH = [1.0]


def scaled(k):
    return lambda x: k * x


def recursive(x):
    return recursive(x - 1) if x > 0 else x


class Craft:
    """An object whose method reads its attributes."""

    def __init__(self, gain):
        self.gain = gain

    def rate(self, q, u):
        return self.gain * u


def reads_a_global(x):
    return STRENGTH[0] * x


@pytest.mark.parametrize("make", [float, np.array, jnp.asarray, str, lambda k: {"gain": [k, None]}, scaled, Craft])
def test_what_a_closure_holds_decides(make):
    assert ByData(scaled(make(1.0))) != ByData(scaled(make(2.0)))


@pytest.mark.parametrize("make", [float, np.array, jnp.asarray, str, lambda k: {"gain": [k, None]}, scaled])
def test_a_function_written_anew_is_the_same(make):
    one, other = ByData(scaled(make(1.0))), ByData(scaled(make(1.0)))
    assert one == other
    assert hash(one) == hash(other)


def test_a_function_of_no_module_is_read():
    space = {}
    exec("def double(x):\n    return factor * x", space)
    space["factor"] = 2.0
    before = ByData(space["double"])
    assert ByData(space["double"]) == before
    space["factor"] = 3.0
    assert ByData(space["double"]) != before


def test_a_random_key_is_data_and_a_long_chain_is_read_to_an_end():
    assert ByData(scaled(jax.random.key(1))) == ByData(scaled(jax.random.key(1)))
    assert ByData(scaled(jax.random.key(1))) != ByData(scaled(jax.random.key(2)))
    chain = []
    for _ in range(5000):
        chain = [chain]
    assert ByData(scaled(chain)) == ByData(scaled(chain))


def test_other_code_is_another_function():
    assert ByData(lambda x: x + 1) != ByData(lambda x: x + 2)
    assert ByData(recursive) == ByData(recursive)
    assert ByData(recursive) != ByData(reads_a_global)


def test_attributes_and_globals_are_read_when_a_function_is_wrapped(monkeypatch):
    craft = Craft(1.0)
    before = ByData(craft.rate), ByData(reads_a_global)
    assert (ByData(craft.rate), ByData(reads_a_global)) == before
    craft.gain = 2.0
    monkeypatch.setitem(globals(), "STRENGTH", [2.0])
    assert ByData(craft.rate) != before[0]
    assert ByData(reads_a_global) != before[1]


def test_traced_values_are_seen():
    seen = []
    jax.grad(lambda k: seen.append(reads_traced({"f": scaled(k)})) or k)(1.0)
    assert seen == [True]
    assert not reads_traced(by_data({"f": scaled(1.0)}))


def test_a_changed_parameter_changes_the_solution():
    craft = Craft(2.0)

    def cost():
        problem = OptimalControlProblem(LINE, craft.rate, lambda q, u: u @ u / 2, 1)
        return solve(problem, MIDPOINT, jnp.zeros(1), jnp.ones(1), 1.0, 4)

    assert cost().cost == pytest.approx(1 / 8)
    assert cost().statistics.compile_seconds == 0, "the same problem, made anew, is compiled already"
    craft.gain = 4.0
    assert cost().cost == pytest.approx(1 / 32)


def test_a_changed_parameter_changes_the_trajectory_and_is_differentiated():
    integrator, start = SymplecticIntegrator(CotangentLift(MIDPOINT)), (jnp.ones(1), jnp.zeros(1))

    def end(k):
        return integrate(lambda q, p: p @ p / 2 + k * q @ q / 2, integrator, start, 0.1, 5).q[-1, 0]

    ends = [float(end(k)) for k in (1.0, 1.001, 1.0)]
    assert ends[0] == ends[2]
    slope = (ends[1] - ends[0]) / 1e-3
    for derivative in (jax.grad(end), jax.jit(jax.grad(end))):
        assert slope == pytest.approx(float(derivative(1.0)), rel=1e-2)


class Weighted:
    """A callable object of a user's class, which is no pytree."""

    def __init__(self, weight):
        self.weight = weight

    def __call__(self, q, p):
        return self.weight * (p @ p) / 2


def test_an_object_that_reads_a_traced_value_is_seen():
    """``integrate`` then runs as one loop that can be differentiated."""
    seen = []
    jax.grad(lambda weight: seen.append(is_transformed(Weighted(weight))) or weight)(1.0)
    assert seen == [True]
    assert not is_transformed(Weighted(1.0))
