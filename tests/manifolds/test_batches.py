"""Every method that acts on one point refuses a batch that is given to it without ``jax.vmap``."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import EmbeddedMetric, InvalidInputError, Manifold, Metric

from tests.support.cases import MANIFOLDS, METRICS

ALL_METRICS: dict[str, Metric] = {"embedded-SO3": EmbeddedMetric(MANIFOLDS["SO3"]), **METRICS}


def arrays(manifold: Manifold, *batch: int) -> Any:
    """Arrays of the shape of a point, or of a batch of points."""
    return jax.tree.map(lambda leaf: np.zeros((*batch, *leaf.shape), leaf.dtype), manifold.ambient)


def sizes(manifold: Manifold) -> set[int]:
    """Lengths of batches, those that broadcast against an array of a point among them."""
    return {1, 2, manifold.dimension, *(n for leaf in jax.tree.leaves(manifold.ambient) for n in leaf.shape)}


def refuses_batches(owner: Any, manifold: Manifold) -> None:
    """Each argument of each method as a batch, the others as they should be, and all of them as batches."""
    for name, roles in owner.one_point.items():
        method, good = getattr(owner, name), [arrays(manifold)] * len(roles)
        if name == "covector":
            continue  # its other argument is not an ambient vector
        for k in sizes(manifold):
            batch = arrays(manifold, k)
            wrong = [[batch if i == j else a for j, a in enumerate(good)] for i in range(len(good))]
            for arguments in [*wrong, [batch] * len(good)]:
                with pytest.raises(InvalidInputError, match=r"has shape \(.*\).*, got \(.*\); .*jax\.vmap"):
                    method(*arguments)


@pytest.mark.parametrize("name", MANIFOLDS)
def test_methods_of_manifolds_refuse_batches(name):
    refuses_batches(MANIFOLDS[name], MANIFOLDS[name])


@pytest.mark.parametrize("name", ALL_METRICS)
def test_methods_of_metrics_refuse_batches(name):
    refuses_batches(ALL_METRICS[name], ALL_METRICS[name].manifold)


def test_arguments_by_their_names_are_checked_too():
    sphere, batch = MANIFOLDS["S2"], jnp.eye(3)
    assert jnp.array_equal(sphere.projection(a=batch[0], x=batch[1]), batch[0])
    with pytest.raises(InvalidInputError, match=r"an ambient vector of Sphere\(2\) has shape \(3,\), got \(3, 3\)"):
        sphere.projection(a=batch, x=batch[1])


def test_a_batch_is_refused_when_it_is_traced():
    with pytest.raises(InvalidInputError, match=r"a point of Sphere\(2\) has shape \(3,\), got \(5, 3\)"):
        jax.eval_shape(MANIFOLDS["S2"].basis, jax.ShapeDtypeStruct((5, 3), float))


def test_the_body_covector_of_a_batch_is_refused():
    group = MANIFOLDS["SO3"]
    with pytest.raises(InvalidInputError, match=r"a point of SO\(3\) has shape \(3, 3\), got \(3, 3, 3\)"):
        group.covector(jnp.stack([jnp.eye(3)] * 3), jnp.ones(3))
