"""Powers of a manifold beside its products, and wrong arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import SO, Euclidean, InvalidInputError, Power, Product, Sphere
from retrax.retractions import Cayley, Exponential, Midpoint, PowerRetraction, default_retraction

KEY = jax.random.key(0)


def test_a_power_is_the_product_of_its_copies():
    power, product = Power(Sphere(2), 3), Product(*3 * [Sphere(2)])

    @jax.jit
    def both(key):
        x, a = power.random_point(key), jax.random.normal(key, power.ambient.shape)
        parts = product.projection(tuple(x), tuple(a)), product.basis(tuple(x))
        return (jnp.stack(parts[0]), jnp.stack(parts[1], axis=1)), (power.projection(x, a), power.basis(x))

    assert power.dimension == product.dimension
    for of_product, of_power in zip(*both(KEY), strict=True):
        np.testing.assert_allclose(of_product, of_power, atol=1e-15)


@pytest.mark.slow
def test_a_path_of_poses_is_a_point_of_a_power():
    paths = Power(SO(3) * Euclidean(3), 50)
    x = paths.random_point(KEY)
    v = jax.tree.map(lambda leaf: 0.1 * leaf, paths.random_tangent(KEY, x))
    retraction = Cayley(paths)
    assert isinstance(retraction, PowerRetraction)
    assert retraction.manifold == paths
    assert default_retraction(paths) == Exponential(paths)
    y = jax.jit(retraction)(x, v)
    assert paths.contains(y, 1e-12)
    np.testing.assert_allclose(retraction.inverse(x, y)[0], v[0], atol=1e-14)
    middle, velocity = jax.jit(Midpoint(retraction).inverse)(x, y)
    ends = Midpoint(retraction)(middle, velocity)
    np.testing.assert_allclose(ends[1][0], y[0], atol=1e-13)


def test_a_wrong_copy_is_found():
    spheres = Power(Sphere(2), 3)
    x = spheres.random_point(KEY)
    verdict = spheres.contains(x.at[1].multiply(1.1))
    assert not verdict
    assert "in the worst copy" in verdict.reason


@pytest.mark.parametrize("arguments", [(Sphere(2), 0), (Sphere(2), 2.5), (Sphere, 3), (Sphere(2), True)])
def test_a_power_of_other_things_is_refused(arguments):
    with pytest.raises(
        InvalidInputError, match=r"takes a manifold and a whole number of copies of at least 1, got .*try Power"
    ):
        Power(*arguments)
