"""Steps are solved as exactly in units of atoms as in those of planets, and begin where the step before ended."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    DiracIntegrator,
    DiracSystem,
    OptimalControlProblem,
    PresymplecticIntegrator,
    Result,
    SymplecticIntegrator,
    integrate,
)
from retrax.manifolds import SO, Euclidean, Sphere, hat
from retrax.retractions import Addition, Cayley, CotangentLift, Exponential, Gauss, Midpoint, default_retraction

PLANE = Euclidean(2)
TAPE = ["tape", pytest.param("xla", marks=pytest.mark.slow)]
MIDPOINT = SymplecticIntegrator(CotangentLift(Midpoint(Addition(PLANE))))
GAUSS = SymplecticIntegrator(Gauss(2, Addition(PLANE)))


class Kepler(eqx.Module):
    """A mass that is attracted by the origin."""

    mass: jax.Array
    attraction: jax.Array

    def __call__(self, q, p):
        return p @ p / (2 * self.mass) - self.attraction * self.mass / jnp.sqrt(q @ q)


def orbit(method, evaluator, length, time, mass):
    """Positions and momenta along an orbit, in its own units."""
    energy = Kepler(jnp.asarray(mass), jnp.asarray(length**3 / time**2))
    momentum = mass * length / time
    start = np.array([length, 0.0]), momentum * np.array([0.0, 0.8])
    path = integrate(energy, method, start, 0.1 * time, 20, evaluator=evaluator)
    return np.concatenate([path.q / length, path.p / momentum], axis=1)


UNITS = [
    (1e-3, 1.0, 1.0),
    (1e-10, 1e-15, 1e-30),
    (1e-20, 1.0, 1.0),
    (1.0, 1.0, 1e-25),
    (1e12, 1e7, 1e30),
    (1e-10, 1e10, 1e-30),
]


@pytest.mark.parametrize("method", [MIDPOINT, GAUSS], ids=["midpoint", "gauss"])
@pytest.mark.parametrize("evaluator", TAPE)
@pytest.mark.usual(1)
def test_an_orbit_is_the_same_in_all_units(method, evaluator):
    expected = orbit(method, evaluator, 1.0, 1.0, 1.0)
    for units in UNITS:
        assert np.abs(orbit(method, evaluator, *units) - expected).max() < 1e-11, units


@pytest.mark.slow
@pytest.mark.parametrize("stages", [1, 2, 4])
@pytest.mark.parametrize("evaluator", TAPE)
def test_a_fall_from_rest_is_the_same_in_all_units(stages, evaluator):
    """A momentum of exactly zero has no size: what the force adds to it in a step has."""
    method = SymplecticIntegrator(Gauss(stages, Addition(PLANE)))

    def fall(length, time, mass):
        energy = Kepler(jnp.asarray(mass), jnp.asarray(length**3 / time**2))
        path = integrate(energy, method, (length * np.ones(2), np.zeros(2)), 0.1 * time, 10, evaluator=evaluator)
        return np.concatenate([path.q / length, path.p * time / (mass * length)], axis=1)

    for units in UNITS:
        assert np.abs(fall(*units) - fall(1.0, 1.0, 1.0)).max() < 1e-11, units


def test_derivatives_of_an_orbit_are_the_same_in_all_units():
    def end(units, push):
        length, time, mass = units
        energy = Kepler(jnp.asarray(mass), jnp.asarray(length**3 / time**2))
        start = jnp.array([length, 0.0]), mass * length / time * jnp.stack([0.0 * push, push])
        return integrate(energy, MIDPOINT, start, 0.1 * time, 20).q[-1] / length

    slope = jax.jit(jax.jacfwd(end, argnums=1))
    expected = slope(tuple(jnp.ones(3)), 0.8)
    for units in UNITS:
        assert jnp.abs(slope(tuple(map(jnp.asarray, units)), 0.8) - expected).max() < 1e-10 * jnp.abs(expected).max(), (
            units
        )


@pytest.mark.parametrize("evaluator", TAPE)
def test_an_extremal_is_the_same_in_all_units(evaluator):
    """``q' = v, v' = u - a sin(q / l)``, cost ``c |u|^2 / 2``, in units as small as one likes."""

    class Pendulum(eqx.Module):
        length: jax.Array
        attraction: jax.Array

        def __call__(self, q, u):
            return jnp.stack([q[1], u[0] - self.attraction * jnp.sin(q[0] / self.length)])

    method, found = PresymplecticIntegrator(CotangentLift(Midpoint(Addition(PLANE)))), []
    for length, cost in ((1.0, 1.0), (1e-12, 1.0), (1.0, 1e-20), (1e-15, 1e25), (1e15, 1e-25)):
        weight, move = jnp.asarray(cost), Pendulum(jnp.asarray(length), jnp.asarray(length))
        problem = OptimalControlProblem(PLANE, move, eqx.Partial(lambda c, q, u: c * u @ u / 2, weight), 1)
        start = length * np.array([1.0, 0.3]), cost * length * np.array([0.5, -0.7])
        path = integrate(problem, method, start, 0.2, 10, evaluator=evaluator)
        found.append(
            np.concatenate([path.q[1:] / length, path.p[1:] / (cost * length), path.controls / length], axis=1)
        )
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-11


@pytest.mark.parametrize("evaluator", TAPE)
def test_what_is_as_small_as_the_rounding_of_the_rest_does_not_end_a_trajectory(evaluator):
    space = PLANE * Euclidean(1)
    method = SymplecticIntegrator(CotangentLift(Midpoint(default_retraction(space))))

    def energy(q, p):
        # The last position is pushed by what is zero but for rounding.
        push = jnp.cos(q[0][0]) ** 2 + jnp.sin(q[0][0]) ** 2 - 1.0
        return (p[0] @ p[0] + p[1] @ p[1]) / 2 + q[0] @ q[0] / 2 + push * q[1][0] + q[1] @ q[1] / 2

    for size in (0.0, 1e-300, 1e-30, 1e-17, 1e-12, 1e-3):
        start = (np.array([1.0, 0.2]), np.array([size])), (np.array([0.3, -0.4]), np.array([size]))
        path = integrate(energy, method, start, 0.1, 50, evaluator=evaluator)
        assert Result[path.result] == Result[Result.successful]
        assert np.abs(path.q[1]).max() < 2 * size + 1e-14


def test_a_long_step_that_is_solved_begins_where_it_should():
    """Beyond a right angle from the middle of a step two points have the same coordinates in its frame."""
    sphere = Sphere(2)
    method = SymplecticIntegrator(CotangentLift(Midpoint(Exponential(sphere))))
    start, solved = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])), []
    for h in (1.0, 3.0, 3.13, 3.15, 3.2, 3.3, 3.5, 4.0, 5.0):
        path = integrate(lambda q, p: p @ p / 2, method, start, h, 3, throw=False)
        spin = np.cross(path.q, path.p)[:, 2]
        assert np.abs(spin - 1).max() < 1e-9, h
        solved.append(path.result == Result.successful)
    assert any(solved)


@pytest.mark.slow
def test_a_long_turn_that_is_solved_keeps_its_momentum():
    group = SO(3)
    inertia = jnp.array([1.0, 2.0, 3.0])

    def energy(q, p):
        body = jnp.stack([jnp.sum(p * (q @ hat(e))) for e in jnp.eye(3)])
        return body @ (body / inertia) / 2

    method = SymplecticIntegrator(CotangentLift(Midpoint(Cayley(group))))
    start = np.eye(3), np.asarray(hat(jnp.array([0.3, 0.8, -0.5]))) / 2
    for h in (0.5, 1.5, 2.5, 3.3, 4.0, 6.0):
        path = integrate(energy, method, start, h, 5, throw=False)
        spatial = path.p @ path.q.mT - path.q @ path.p.mT
        assert np.abs(spatial - spatial[0]).max() < 1e-9, h


@pytest.mark.slow
def test_a_nonholonomic_particle_is_the_same_in_all_units():
    space = Euclidean(3)
    method, found = DiracIntegrator(CotangentLift(Midpoint(Addition(space)))), []
    for length, mass in ((1.0, 1.0), (1e-12, 1e-20)):
        system = DiracSystem(
            space,
            lambda q, p, m=mass, size=length: p @ p / (2 * m) + m * size**2 * jnp.cos(q[0] / size),
            lambda q, size=length: jnp.stack([-q[1] / size, 0.0, 1.0])[None],
        )
        q0 = length * jnp.array([0.2, 0.3, 0.0])
        p0 = system.project(q0, mass * length * jnp.array([1.1, 0.7, 0.0]))
        path = integrate(system, method, (q0, p0), 0.1, 10)
        found.append(np.concatenate([path.q / length, path.p / (mass * length)], axis=1))
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-11
