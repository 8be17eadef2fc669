"""The steps of every strategy as functions: compiled, in batches, differentiated in both modes, beside the midpoint."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jaxtyping import Array
from retrax.integrators import singular_integrator
from retrax.integrators.compilation import compiler_options
from retrax.integrators.singular import RattleIntegrator, ReducedIntegrator, SingularIntegrator, reduce_until_regular
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import CotangentLift, Theta, default_retraction

from tests.integrators.singular.cases import classified, known, scaled
from tests.integrators.singular.test_rattle import start as sphere_start
from tests.integrators.singular.test_strategies import STARTS

CASES = {
    "direct": "academic",
    "rattle": "sphere",
    "reduced": "aly-chan",
    "stage": "massless particle",
    "project": "massless particle",
}
OFFSETS = np.array([[0.0, 0], [0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
SMALL = 1e-4


def made(strategy: str) -> SingularIntegrator:
    problem = scaled(known(CASES[strategy]).problem, (1.0, 1.0, 1.0))
    discretization = Theta(default_retraction(problem.manifold), 0.5 if strategy == "stage" else 0.3)
    if strategy == "rattle":
        return RattleIntegrator(CotangentLift(discretization), (0,))
    if strategy == "reduced":
        return ReducedIntegrator(CotangentLift(discretization), reduce_until_regular(problem))
    return singular_integrator(classified(CASES[strategy]), discretization, strategy)


@partial(eqx.filter_jit, compiler_options=compiler_options())
def facts(method: SingularIntegrator, problem, z: tuple, w: tuple) -> tuple[Array, ...]:
    """The end after two steps as a function of offsets of the start along ``w`` and of the cost: values, slopes in both modes."""

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
    name = CASES[strategy]
    problem, keys = known(name).problem, jax.random.split(jax.random.key(1))
    z = tuple(jnp.asarray(a) for a in STARTS[name])
    z = {"sphere": sphere_start, "aly-chan": lambda: z}.get(name, lambda: classified(name).manifold.nearby(z))()
    w = tuple(problem.manifold.random_tangent(key, z[0]) for key in keys)
    values, slopes, value, weights, pulled = facts(made(strategy), problem, z, w)
    np.testing.assert_allclose(values[0], value, atol=1e-13)
    differences = (values[2:4] - values[4:6]) / (2 * SMALL)
    assert np.min(np.max(np.abs(differences), axis=1)) > 1e-3
    np.testing.assert_allclose(slopes, differences, atol=1e-6)
    np.testing.assert_allclose(pulled, slopes @ weights, atol=1e-11)
