"""Flows that are held: the trajectories of ``integrate``, functions read once."""

import gc
import weakref
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Flow, PresymplecticIntegrator, SymplecticIntegrator, integrate, integrate_many
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError
from retrax.retractions import Cayley, CotangentLift, Exponential, Gauss, Midpoint, Projection

from .problems import ENERGIES, KINEMATIC, SO3, SPHERE, pendulum_energy

KEYS = jax.random.split(jax.random.key(5), 4)
LINE = Euclidean(1)


def starts_of(manifold) -> tuple:
    q = jax.vmap(manifold.random_point)(KEYS)
    return q, jax.vmap(manifold.random_tangent)(KEYS, q)


CASES = {
    "Gauss": (ENERGIES["SO3"], SymplecticIntegrator(Gauss(2, Cayley(SO3))), "automatic"),
    "a lift, by XLA": (pendulum_energy, SymplecticIntegrator(CotangentLift(Midpoint(Projection(SPHERE)))), "xla"),
    "optimal control": (KINEMATIC, PresymplecticIntegrator(CotangentLift(Midpoint(Cayley(SO3)))), "automatic"),
}


@pytest.mark.usual("optimal control")
@pytest.mark.parametrize("name", CASES)
def test_a_flow_has_the_trajectories_of_integrate(name):
    """From any start, with any step size, one or many."""
    system, method, evaluator = CASES[name]
    flow, starts = Flow(system, method, evaluator), starts_of(method.manifold)
    for index, h in ((0, 0.1), (2, -0.05)):
        start = jax.tree.map(lambda a, i=index: a[i], starts)
        mine, theirs = flow.integrate(start, h, 4, 2), integrate(system, method, start, h, 4, 2, evaluator=evaluator)
        assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (mine, theirs)), strict=True))
        assert mine.evaluator == theirs.evaluator
    sizes = np.linspace(0.05, 0.1, 4)
    mine, theirs = (
        flow.integrate_many(starts, sizes, 4),
        integrate_many(system, method, starts, sizes, 4, evaluator=evaluator),
    )
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (mine, theirs)), strict=True))


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
@pytest.mark.usual(1)
def test_a_flow_reads_its_functions_once(evaluator):
    calls, stiffness = [], [1.0]

    def energy(q, p):
        calls.append(1)
        return p @ p / 2 + stiffness[0] * q @ q / 2

    method, start = SymplecticIntegrator(Gauss(1, Exponential(LINE))), (np.ones(1), np.zeros(1))
    flow = Flow(energy, method, evaluator)
    first = flow.integrate(start, 0.1, 8)
    read, stiffness[0] = len(calls), 4.0
    assert np.array_equal(flow.integrate(start, 0.1, 8).q, first.q)
    assert flow.integrate(start, 0.05, 16).times[-1] == pytest.approx(0.8)
    assert len(calls) == read
    other = Flow(energy, method, evaluator).integrate(start, 0.1, 8)
    assert np.array_equal(other.q, integrate(energy, method, start, 0.1, 8, evaluator=evaluator).q)
    assert not np.allclose(other.q, first.q)


def test_bad_input_is_refused_in_every_call():
    method = SymplecticIntegrator(Gauss(2, Cayley(SO3)))
    flow = Flow(ENERGIES["SO3"], method)
    q, p = jax.tree.map(lambda a: a[0], starts_of(SO3))
    for _ in range(2):
        with pytest.raises(NotOnManifoldError, match="start"):
            flow.integrate((2 * q, p), 0.1, 2)
        with pytest.raises(InvalidInputError, match="step_size"):
            flow.integrate((q, p), 0.0, 2)
    with pytest.raises(InvalidInputError, match="must return a scalar"):
        Flow(lambda q, p: q, method).integrate((q, p), 0.1, 2)
    with pytest.raises(InvalidInputError, match="integrator"):
        Flow(ENERGIES["SO3"], None)
    with pytest.raises(InvalidInputError, match=r"Flow\.integrate"):
        jax.jit(lambda h: flow.integrate((q, p), h, 2).q)(0.1)


def test_a_flow_is_forgotten_with_what_it_read():
    def energy(q, p):
        return p @ p / 2 + jnp.cos(q[0])

    flow = Flow(partial(energy), SymplecticIntegrator(Gauss(1, Exponential(LINE))))
    flow.integrate((np.ones(1), np.zeros(1)), 0.1, 2)
    reference = weakref.ref(flow.system)
    del flow
    gc.collect()
    assert reference() is None
