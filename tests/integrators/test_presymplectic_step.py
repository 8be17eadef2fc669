"""One step of an optimal control problem: Definition 1 of the paper, and what follows from it.

``(1/h) (R_d^{T*})^-1 (q0, p0; q1, p1)`` lies in ``S_H``, over its base point ``(x, pi)`` and the control ``u`` of the
stage.
"""

from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, integrate
from retrax.integrators.initial_value.step import lifted_step
from retrax.integrators.problem.pontryagin import extremal_control
from retrax.integrators.problem_checks.inspection import Inspection
from retrax.manifolds import CotangentBundle, Euclidean, InvalidInputError, Sphere, form_matrix, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.tolerances import EPS, REGULAR
from retrax.retractions import (
    CotangentLift,
    DiscretizationMap,
    Exponential,
    Midpoint,
    Projection,
    Theta,
    default_retraction,
)

from tests.support.numerics import SEEDS, compiled, norm

from .problems import INERTIA, RIGID, SO3, SPHERE


def steer(q: jax.Array, u: jax.Array) -> jax.Array:
    """A drift, and two controls that turn the sphere."""
    spin = jnp.array([u[0], u[1], 0.7]) + 0.3 * jnp.array([q[2], q[0] ** 2, 0.1 * u[0]])
    return jnp.cross(spin, q)


def steering_cost(q: jax.Array, u: jax.Array) -> jax.Array:
    """Convex in the controls, not quadratic, coupled to the state."""
    return u @ u / 2 + q @ (jnp.array([1.0, 2.0, 3.0]) * q) / 2 + 0.1 * u[0] * q[2] + 0.05 * u[1] ** 4


def underactuated(q: tuple, u: jax.Array) -> tuple:
    """Rigid body with two torques."""
    attitude, w = q
    torque = jnp.stack([u[0], u[1], 0.3 * u[0] - 0.4 * u[1]])
    return attitude @ hat(w), (torque - jnp.cross(w, INERTIA * w)) / INERTIA


def pointing_cost(q: tuple, u: jax.Array) -> jax.Array:
    return u @ u / 2 + q[1] @ q[1] / 4 - q[0][0, 0] - 0.5 * q[0][1, 2] + 0.1 * u[0] * q[1][1]


def drift(q: jax.Array, u: jax.Array) -> jax.Array:
    """Zermelo's boat: unit speed along a heading on the sphere, in a current."""
    return u + 0.2 * jnp.stack([q[1], -q[0], 0.3 * q[0] * q[2]])


PROBLEMS = {
    "steered sphere": OptimalControlProblem(SPHERE, steer, steering_cost, 2),
    "underactuated body": OptimalControlProblem(RIGID, underactuated, pointing_cost, 2),
    "heading on a sphere": OptimalControlProblem(Euclidean(3), drift, lambda q, u: q @ q / 2, Sphere(2)),
    "shortest time": OptimalControlProblem(Euclidean(3), drift, lambda q, u: 1 + q @ u, Sphere(2), abnormal=True),
}
MAPS: dict[str, DiscretizationMap] = {
    "steered sphere": Theta(Projection(SPHERE), 0.3),
    "underactuated body": Midpoint(Exponential(RIGID)),
    "heading on a sphere": Midpoint(Exponential(Euclidean(3))),
    "shortest time": Theta(Exponential(Euclidean(3)), 1.0),
}
on_every_problem = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("steered sphere", "underactuated body")))
        for name in PROBLEMS
    ],
)


def random_steps(test: Callable) -> Callable:
    """Random points and steps, and points where the best control is far from rest."""
    return given(seed=SEEDS, h=st.floats(0.01, 0.2))(example(seed=73, h=0.02)(example(seed=239, h=0.02)(test)))


def pontryagin(problem: OptimalControlProblem, q: Any, p: Any, u: Any) -> jax.Array:
    """``<p, X> - p_0 F``, with ``p_0 = 0`` in the abnormal case."""
    velocity = vec.pairing(p, problem.dynamics(q, u))
    return velocity if problem.abnormal else velocity - problem.running_cost(q, u)


@cache
def kernel(name: str) -> Callable:
    """One compiled function a problem: a step from a random point, its derivative, and how far it is from ``S_H``."""
    problem, lift = PROBLEMS[name], CotangentLift(MAPS[name])
    manifold, controls = problem.manifold, problem.controls
    bundle, turn = CotangentBundle(manifold), default_retraction(controls)

    def facts(seed: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        stage = PresymplecticIntegrator(lift).stage(problem, h)
        z0 = bundle.random_point(jax.random.key(seed))
        begin = z0[0], extremal_control(problem, *z0)

        def step(z: tuple) -> tuple:
            result = lifted_step(stage, *z, begin)
            return (result.q, result.p), (result.unknowns, result.converged)

        frame = bundle.basis(z0)
        push = jax.vmap(lambda w: jax.jvp(step, (z0,), (w,), has_aux=True), out_axes=(None, 0, None))
        z1, images, ((x, u), converged) = push(frame)

        base, rate = lift.preimage(z0, z1)
        zdot, basis = vec.scale(1 / h, rate), bundle.basis(base)
        slope = jax.vmap(lambda w: jax.jvp(lambda z: pontryagin(problem, *z, u), (base,), (w,))[1])(basis)
        contraction = jax.vmap(lambda w: bundle.two_form(base, zdot, w))(basis)
        spread = controls.basis(u)
        stationary = jax.grad(lambda c: pontryagin(problem, *base, turn(u, vec.combine(spread, c))))
        return {
            "converged": converged,
            "over the stage": vec.subtract(base[0], x),
            "velocity": vec.subtract(zdot[0], problem.dynamics(x, u)),
            "hamilton": contraction - slope,
            "control": stationary(jnp.zeros(controls.dimension)),
            "on the controls": vec.subtract(controls.restore(u), u),
            "symplectic": form_matrix(bundle.two_form, z1, images) - form_matrix(bundle.two_form, z0, frame),
        }

    return compiled(facts)


@on_every_problem
@random_steps
@pytest.mark.usual("heading on a sphere")
def test_a_step_lies_in_the_lagrangian_submanifold_of_the_problem(name, seed, h):
    facts = kernel(name)(seed, h)
    assert facts["converged"]
    assert norm(facts["over the stage"]) < 1e-11
    assert norm(facts["velocity"]) < 1e-11
    assert norm(facts["hamilton"]) < 1e-11
    assert norm(facts["control"]) < 1e-11
    assert norm(facts["on the controls"]) < 1e-14


@on_every_problem
@random_steps
@pytest.mark.usual(1)
def test_the_step_is_symplectic(name, seed, h):
    assert norm(kernel(name)(seed, h)["symplectic"]) < 1e-11


def test_a_problem_without_a_cost_of_control_is_refused_as_singular():
    problem = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), lambda q, u: q[0, 0], 3)
    integrator = PresymplecticIntegrator(CotangentLift(Midpoint(Exponential(SO3))))
    with pytest.raises(InvalidInputError, match=r"singular.*singular values \[0. 0. 0.\].*strictly convex"):
        integrate(problem, integrator, (jnp.eye(3), jnp.eye(3)), 0.1, 2)


def test_a_problem_that_costs_two_of_three_controls_is_refused_as_singular():
    problem = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), lambda q, u: (u[0] ** 2 + u[1] ** 2) / 2, 3)
    integrator = PresymplecticIntegrator(CotangentLift(Midpoint(Exponential(SO3))))
    with pytest.raises(InvalidInputError, match=r"singular values \[1. 1. 0.\]"):
        integrate(problem, integrator, (jnp.eye(3), jnp.eye(3)), 0.1, 2)


class Dependent(eqx.Module):
    """A cost of two controls that pull the same way, but for a share of the second one."""

    share: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return ((u[0] + u[1]) ** 2 + 2 * self.share * u[1] ** 2) / 2


def test_solver_and_integrator_call_the_same_problems_singular():
    """The smallest singular value of ``[[1, 1], [1, 1 + 2 d]]`` in its units, near ``d``, goes through the limit; the
    two measure it by other units, of which one is twice the other at most."""
    line = Euclidean(1)
    integrator = PresymplecticIntegrator(CotangentLift(Midpoint(Exponential(line))))
    for share in (0.0, 1e-3, 0.1, 0.3, 0.4, 2.5, 3.0, 10.0, 1e3, 1e6):
        cost = Dependent(jnp.asarray(share * EPS**REGULAR))
        problem = OptimalControlProblem(line, lambda q, u: u[:1] + u[1:], cost, 2)
        regular = Inspection(problem, jnp.ones(1), jnp.zeros(2)).is_regular
        assert regular == (share > 1)
        with nullcontext() if regular else pytest.raises(InvalidInputError, match="the problem is singular here"):
            integrator.check(problem, jnp.ones(1), jnp.zeros(1))


@pytest.mark.parametrize("costate", [0.0, 1e-17])
def test_a_costate_that_is_the_rounding_of_zero_is_no_size_to_measure_by(costate):
    line = Euclidean(1)
    regulator = OptimalControlProblem(line, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2, 1)
    integrator = PresymplecticIntegrator(CotangentLift(Midpoint(Exponential(line))))
    path = integrate(regulator, integrator, (jnp.ones(1), jnp.full(1, costate)), 0.1, 1)
    assert path.p[-1] == pytest.approx(0.1 / (1 - 0.05**2), rel=1e-13)
