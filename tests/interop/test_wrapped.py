"""Spaces of the peers that we do not have: derivatives by differences, good enough for symplectic steps; and those refused."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from retrax.integrators import SymplecticIntegrator
from retrax.integrators.initial_value import lifted_step
from retrax.interop import from_geomstats, from_pymanopt
from retrax.interop.peers import import_peer
from retrax.retractions import CotangentLift, Midpoint

from tests.support.numerics import NODES, SEEDS, compiled, differences

theirs = import_peer("pymanopt.manifolds")


def geomstats_space(module, name, *arguments, **options):
    """A space of ``geomstats.geometry``."""
    return getattr(import_peer(f"geomstats.geometry.{module}"), name)(*arguments, **options)


BALL = from_geomstats(geomstats_space("poincare_ball", "PoincareBall", 2))


def energy(q, p):
    """Kinetic energy of the hyperbolic metric with a potential and a magnetic term."""
    return (1 - q @ q) ** 2 * (p @ p) / 8 + jnp.sin(q[0]) + q[1] ** 2 * p[0]


@cache
def midpoint_steps():
    """Midpoint steps from a batch of points of T*Q, compiled."""
    stage = SymplecticIntegrator(CotangentLift(Midpoint(BALL.retraction))).stage(energy, 0.1)

    def step(z):
        result = lifted_step(stage, z[:2], z[2:], (z[:2], z[2:], z[2:]))
        return jnp.concatenate([result.q, result.p]), result.converged

    return compiled(jax.vmap(step))


@settings(max_examples=3)
@given(seed=SEEDS)
def test_the_midpoint_step_of_a_wrapped_space_is_symplectic(seed):
    rng, h = np.random.default_rng(seed), 1e-2
    angle, radius = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.6)
    z = np.concatenate([radius * np.array([np.cos(angle), np.sin(angle)]), rng.standard_normal(2)])
    around = z + h * NODES[:, None, None] * np.eye(4)
    ends, converged = midpoint_steps()(around.reshape(-1, 4))
    assert np.all(converged)
    jacobian = differences(ends.reshape(6, 4, 4), h).T
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    np.testing.assert_allclose(jacobian.T @ form @ jacobian, form, atol=1e-9)


@given(seed=SEEDS)
def test_derivatives_of_a_wrapped_retraction_are_those_of_its_formula(seed):
    x, v, w, dx = derivatives()[0](seed)
    wrapped, exact = derivatives()[1](x, v, w, dx)
    for order, tolerance in ((0, 1e-15), (1, 1e-11), (2, 1e-9)):
        np.testing.assert_allclose(wrapped[order], exact[order], atol=tolerance, rtol=tolerance)


@cache
def derivatives():
    """Random vectors on a sphere, and derivatives of order 0, 1, 2 of pymanopt's projection retraction there, and of ours."""
    space = theirs.SphereSubspaceIntersection(np.eye(3))
    manifold, retraction, _, _ = from_pymanopt(space)

    def drawn(seed):
        keys = jax.random.split(jax.random.key(seed), 4)
        x = manifold.random_point(keys[0])
        return x, *(0.7 * manifold.random_tangent(key, x) for key in keys[1:])

    def formula(x, v):
        y = x + v
        return y / jnp.linalg.norm(y)

    def facts(x, v, w, dx):
        def values(function):
            curve = lambda t, s: function(formula(x, s * dx), tangential(formula(x, s * dx), v + t * w))  # noqa: E731
            first = jax.grad(lambda t: jnp.sum(jnp.sin(curve(t, 0.0))))(0.3)
            second = jax.jacfwd(jax.jacrev(curve, argnums=1), argnums=0)(0.3, 0.2)
            return curve(0.3, 0.2), first, second

        return values(retraction), values(formula)

    def tangential(x, a):
        return a - (x @ a) * x

    return compiled(drawn), compiled(facts)


REFUSED = {
    "quotient": (lambda: from_pymanopt(theirs.PSDFixedRank(4, 2)), "stand for classes"),
    "another quotient": (lambda: from_pymanopt(theirs.Elliptope(4, 2)), "span 4 dimensions where it says 3"),
    "complex": (lambda: from_pymanopt(theirs.ComplexCircle(3)), "points are complex"),
    "coordinates": (lambda: from_geomstats(geomstats_space("hypersphere", "Hypersphere", 2, intrinsic=True)), "in angles"),
    "no metric": (lambda: from_geomstats(geomstats_space("poincare_ball", "PoincareBall", 2, equip=False)), "no metric"),
    "no manifold": (lambda: from_pymanopt("S2"), "takes a pymanopt manifold"),
    "no space": (lambda: from_geomstats("S2"), "takes a real manifold of geomstats"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_in_words(name):
    make, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        make()


def test_points_that_the_library_takes_for_none_are_refused():
    assert BALL.manifold.contains(np.array([0.3, 0.4]))
    assert "the library" in BALL.manifold.contains(np.array([3.0, 4.0])).reason
