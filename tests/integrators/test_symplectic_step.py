"""One step of Hamilton's equations: the definition, and what follows from it."""

from collections.abc import Callable
from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.integrators import SymplecticIntegrator, symplecticity_defect
from retrax.integrators.initial_value.step import lifted_step
from retrax.manifolds import ConvergenceError, CotangentBundle, Euclidean, PresymplecticManifold, form_matrix
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import CotangentLift, Exponential, Midpoint, Projection, default_retraction

from tests.support.cases import RETRACTIONS, THETAS, FreeTheta
from tests.support.numerics import SEEDS, compiled, norm

from .problems import (
    ENERGIES,
    MANIFOLDS,
    SPHERE,
    coupled_energy,
    hamiltonian_field,
    pendulum_energy,
)

STEPS = st.floats(0.01, 0.2)

# A second retraction of the manifolds above, and retractions of others.
OTHERS = (
    "projection-S2",
    "cayley-SO3",
    "polar-St42",
    "cayley-St42",
    "quadratic-SPD2",
    "cayley-SE3",
    "projection-H2",
    "polar-Gr42",
    "cayley-SU2",
)


SUBJECTS = {
    **{name: (default_retraction(manifold), ENERGIES[name]) for name, manifold in MANIFOLDS.items()},
    **{name: (RETRACTIONS[name], coupled_energy(RETRACTIONS[name].manifold)) for name in OTHERS},
}

on_every_manifold = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name in ("ellipsoid", "SO3", "SO3*R3") else name
        for name in MANIFOLDS
    ],
)


def with_every_theta(test: Callable) -> Callable:
    """Random points, steps and thetas, the four thetas that have names, and two points that a lax stopping rule
    misses."""
    for theta in THETAS:
        test = example(seed=1, h=0.2, theta=theta)(test)
    test = example(seed=121, h=0.1, theta=0.3)(example(seed=57, h=0.02, theta=1.0)(test))
    return given(seed=SEEDS, h=STEPS, theta=st.floats(0.0, 1.0))(test)


@cache
def kernel(name: str) -> Callable:
    """One compiled function a retraction: a step from a random point, its derivative on a basis, and the definition."""
    retraction, energy = SUBJECTS[name]
    bundle = CotangentBundle(retraction.manifold)

    def facts(seed: jax.Array, h: jax.Array, theta: jax.Array) -> dict[str, jax.Array]:
        lift = CotangentLift(FreeTheta(retraction, theta))
        stage = SymplecticIntegrator(lift).stage(energy, h)

        def step(z: tuple) -> tuple:
            result = lifted_step(stage, *z, (*z, z[1]))
            return (result.q, result.p), (result.unknowns, result.converged)

        z0 = bundle.random_point(jax.random.key(seed))
        frame = bundle.basis(z0)
        push = jax.vmap(lambda w: jax.jvp(step, (z0,), (w,), has_aux=True), out_axes=(None, 0, None))
        z1, images, ((x, v, pi), converged) = push(frame)
        tangent = jax.vmap(lambda image: bundle.projection(z1, image))(images)
        field = hamiltonian_field(bundle, energy, (x, pi))
        return {
            "converged": converged,
            "symplectic": form_matrix(bundle.two_form, z1, images) - form_matrix(bundle.two_form, z0, frame),
            "tangent": vec.subtract(images, tangent),
            "on the bundle": bundle.violations(z1),
            "definition": vec.subtract(lift((x, pi), vec.scale(h, field)), (z0, z1)),
            "velocity": vec.subtract(vec.scale(h, field[0]), v),
        }

    return compiled(facts)


@on_every_manifold
@with_every_theta
@pytest.mark.slow
def test_the_step_is_symplectic(name, seed, h, theta):
    facts = kernel(name)(seed, h, theta)
    assert facts["converged"]
    assert norm(facts["symplectic"]) < 1e-11


@on_every_manifold
@with_every_theta
def test_the_step_and_its_derivative_stay_on_the_cotangent_bundle(name, seed, h, theta):
    facts = kernel(name)(seed, h, theta)
    assert norm(facts["on the bundle"]) < 1e-12
    assert norm(facts["tangent"]) < 1e-11


@on_every_manifold
@with_every_theta
def test_the_step_is_the_cotangent_lift_of_the_hamiltonian_vector_field_at_its_stage(name, seed, h, theta):
    facts = kernel(name)(seed, h, theta)
    assert norm(facts["definition"]) < 1e-12
    assert norm(facts["velocity"]) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_with_other_retractions_and_manifolds_the_step_is_all_of_that(name, seeds):
    for seed, theta in product(seeds[:2], THETAS):
        facts = kernel(name)(seed, 0.05, theta)
        assert facts.pop("converged")
        assert norm(facts) < 1e-11, f"theta={theta}, seed={seed}: {facts}"


@cache
def sphere_step() -> Callable:
    """A step of the pendulum; theta is an argument."""

    def step(q: jax.Array, p: jax.Array, h: jax.Array, theta: jax.Array) -> tuple:
        lift = CotangentLift(FreeTheta(Projection(SPHERE), theta))
        return lifted_step(SymplecticIntegrator(lift).stage(pendulum_energy, h), q, p, (q, p, p))[:2]

    return compiled(step)


def state(seed: int) -> tuple[jax.Array, jax.Array]:
    return CotangentBundle(SPHERE).random_point(jax.random.key(seed))


@with_every_theta
def test_a_step_back_with_the_adjoint_map_returns(seed, h, theta):
    q, p = state(seed)
    there = sphere_step()(q, p, h, theta)
    back = sphere_step()(*there, -h, 1 - theta)
    assert norm((back[0] - q, back[1] - p)) < 1e-12


@with_every_theta
def test_the_step_does_not_see_the_normal_part_of_a_covector(seed, h, theta):
    q, p = state(seed)
    plain, raised = sphere_step()(q, p, h, theta), sphere_step()(q, p + 3.0 * q, h, theta)
    assert norm(vec.subtract(plain, raised)) < 1e-12


def plane_energy(q: jax.Array, p: jax.Array) -> jax.Array:
    """Not separable, not quadratic."""
    return jnp.cosh(p[0]) + p @ p / 2 + q[0] ** 4 / 4 + jnp.sin(q[0] * q[1]) + p[1] * q[0]


@cache
def plane_step() -> Callable:
    stage = SymplecticIntegrator(CotangentLift(Midpoint(Exponential(Euclidean(2))))).stage

    def step(q: jax.Array, p: jax.Array, h: jax.Array) -> tuple:
        q1, p1 = lifted_step(stage(plane_energy, h), q, p, (q, p, p))[:2]
        force, velocity = jax.grad(plane_energy, (0, 1))((q + q1) / 2, (p + p1) / 2)
        return q1 - q - h * velocity, p1 - p + h * force

    return compiled(step)


@given(seed=SEEDS, h=STEPS)
def test_in_euclidean_space_the_midpoint_map_gives_the_implicit_midpoint_rule(seed, h):
    q, p = np.random.default_rng(seed).uniform(-1, 1, (2, 2))
    assert norm(plane_step()(q, p, h)) < 1e-14


@pytest.mark.slow
def test_the_form_after_steps_of_several_lengths():
    bundle, method = CotangentBundle(SPHERE), SymplecticIntegrator(CotangentLift(Midpoint(Projection(SPHERE))))
    space, z = PresymplecticManifold(bundle, bundle.two_form), (np.array([0.6, 0.0, 0.8]), np.array([0.8, 1.0, -0.6]))
    sizes = np.array([[0.01, 0.1], [0.3, 0.2], [0.15, 0.05]])
    found = symplecticity_defect(space, method, pendulum_energy, z, sizes)
    assert found.shape == sizes.shape
    assert np.max(found) < 1e-13
    assert symplecticity_defect(space, method, pendulum_energy, z, 0.1).shape == ()
    with pytest.raises(ConvergenceError, match=r"a step of 1000 from .* take a smaller one"):
        symplecticity_defect(space, method, pendulum_energy, z, np.array([0.1, 1e3, 0.2]))


def test_steps_up_to_the_length_at_which_their_equations_lose_their_solution():
    """Of ``q' = q^2`` the midpoint ``m`` solves ``h m^2 - 2 m + 2 q = 0``, which from 1 has no root beyond 1/2."""
    line = Euclidean(1)
    bundle, method = CotangentBundle(line), SymplecticIntegrator(CotangentLift(Midpoint(Exponential(line))))
    space, z = PresymplecticManifold(bundle, bundle.two_form), (np.ones(1), np.ones(1))

    def energy(q, p):
        return p[0] * q[0] ** 2

    found = symplecticity_defect(space, method, energy, z, np.array([[0.1, 0.3], [0.4, 0.49]]))
    assert found.shape == (2, 2)
    assert np.max(found) < 1e-9
    with pytest.raises(ConvergenceError, match=r"a step of 0.51 from .* take a smaller one"):
        symplecticity_defect(space, method, energy, z, np.array([0.1, 0.51, 0.6]))
