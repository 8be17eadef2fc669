"""The steps of every strategy as functions: compiled, in batches, differentiated in both modes, beside the midpoint.

All on curved spaces: the sphere, or a sphere or a circle in front of a problem on R^n, which turns it.
"""

from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jaxtyping import Array
from retrax.compute.jit_cache import compiler_options
from retrax.integrators import Classification, OptimalControlProblem, classify, singular_integrator
from retrax.integrators.singular import SingularIntegrator
from retrax.integrators.singular.strategies import RattleIntegrator, ReducedIntegrator, reduce_until_regular
from retrax.manifolds import Euclidean, Sphere
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import CotangentLift, Theta, default_retraction

from tests.integrators.problems import SPHERE
from tests.integrators.singular.cases import ONE, known, scaled
from tests.integrators.singular.test_rattle import start as sphere_start

AXIS = jnp.array([0.0, 0.0, 1.0])
TURNED, CYLINDER = SPHERE * Euclidean(2), Sphere(1) * Euclidean(1)


def turned(name: str) -> OptimalControlProblem:
    """A known problem in the plane whose second state (the first, of the paper's example) turns a sphere, at a cost of
    height."""
    plane, turning = known(name).problem, 0 if name == "academic" else 1
    return OptimalControlProblem(
        TURNED,
        lambda q, u: (q[1][turning] * jnp.cross(AXIS, q[0]), plane.dynamics(q[1], u)),
        lambda q, u: plane.running_cost(q[1], u) + 0.3 * q[0][0],
        plane.controls,
    )


def charged_on_a_cylinder() -> OptimalControlProblem:
    """A particle without mass in a magnetic field, ``p = A(q)``, on a circle times a line."""
    return OptimalControlProblem(
        CYLINDER,
        lambda q, u: (u[0] * jnp.stack([-q[0][1], q[0][0]]), u[1:]),
        lambda q, u: (1 + q[1][0] + q[1][0] ** 2 / 2) * u[0] - q[0][0] - q[1][0] ** 2,
        2,
    )


CURVED = {
    "turned academic": lambda: turned("academic"),
    "turned aly-chan": lambda: turned("aly-chan"),
    "cylinder": charged_on_a_cylinder,
}
CASES = {
    "direct": "turned academic",
    "rattle": "sphere",
    "reduced": "turned aly-chan",
    "stage": "cylinder",
    "project": "cylinder",
}
OFFSETS = np.array([[0.0, 0], [0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
SMALL = 1e-8  # offset off P_f that direct still takes for rounding of the start


@cache
def problem_of(strategy: str) -> OptimalControlProblem:
    name = CASES[strategy]
    return CURVED[name]() if name in CURVED else known(name).problem


@cache
def classification_of(strategy: str) -> Classification:
    return classify(scaled(problem_of(strategy), ONE))


def made(strategy: str) -> SingularIntegrator:
    problem = scaled(problem_of(strategy), ONE)
    discretization = Theta(default_retraction(problem.manifold), 0.5 if strategy == "stage" else 0.3)
    if strategy == "rattle":
        return RattleIntegrator(CotangentLift(discretization), (0,))
    if strategy == "reduced":
        return ReducedIntegrator(CotangentLift(discretization), reduce_until_regular(problem))
    return singular_integrator(classification_of(strategy), discretization, strategy)[0]


def start_of(strategy: str) -> tuple:
    """A point of ``P_f``."""
    if strategy == "rattle":
        return sphere_start()
    if strategy == "reduced":  # p_x2 = 0 and p_x1 = x2 - <p, e3 x q>
        q, p, x = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.0, 0.5, 0.0]), jnp.array([0.3, -0.2])
        return (q, x), (p, jnp.stack([x[1] - p @ jnp.cross(AXIS, q), 0.0]))
    found = classification_of(strategy)
    return found.manifold.nearby((found.stratum.q, found.stratum.p))


@partial(eqx.filter_jit, compiler_options=compiler_options())
def facts(method: SingularIntegrator, problem, z: tuple, w: tuple) -> tuple[Array, ...]:
    """The end after two steps as a function of offsets of the start along ``w`` and of the cost: values, slopes in both
    modes."""

    def end(offset: Array) -> Array:
        data = scaled(problem, (1.0, 1 + offset[1], 1.0))
        q, p = vec.add(z, vec.scale(offset[0], w))
        q = problem.manifold.restore(q)
        p = problem.manifold.projection(q, p)

        def step(last: tuple, _: None) -> tuple[tuple, Array]:
            new = method.step(data, 0.1, *last)
            return new[:3], new.converged

        last, converged = jax.lax.scan(step, (q, p, method.begin(data, q, p)), length=2)
        return jnp.where(jnp.all(converged), ravel_pytree(last[:2])[0], jnp.nan)

    units = jnp.tile(jnp.eye(2), (len(OFFSETS) // 2, 1))
    values, slopes = jax.vmap(lambda x, d: jax.jvp(end, (x,), (d,)))(SMALL * OFFSETS, units)
    value, pull = jax.vjp(end, jnp.zeros(2))
    weights = jnp.cos(jnp.arange(value.size))
    return values, slopes[:2], value, weights, pull(weights)[0]


@pytest.mark.slow
@pytest.mark.parametrize("strategy", CASES)
def test_steps_are_compiled_batched_and_differentiated(strategy):
    problem, keys, z = problem_of(strategy), jax.random.split(jax.random.key(1)), start_of(strategy)
    w = tuple(problem.manifold.random_tangent(key, z[0]) for key in keys)
    values, slopes, value, weights, pulled = facts(made(strategy), problem, z, w)
    np.testing.assert_allclose(values[0], value, atol=1e-13)
    differences = (values[2:4] - values[4:6]) / (2 * SMALL)
    assert np.min(np.max(np.abs(differences), axis=1)) > 1e-3
    np.testing.assert_allclose(slopes, differences, atol=1e-6)
    np.testing.assert_allclose(pulled, slopes @ weights, atol=1e-11)
