"""Manifolds as zero sets of independent equations in the ambient space."""

from functools import singledispatch

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import (
    SE,
    SO,
    SPD,
    SU,
    Euclidean,
    Hyperbolic,
    InvalidInputError,
    LevelSet,
    Manifold,
    Oblique,
    Power,
    Product,
    Simplex,
    Sphere,
    Stiefel,
    U,
)
from ..manifolds.numerics.ambient import Ambient


@singledispatch
def equations(manifold: Manifold, x: Ambient) -> Array:
    """As many numbers as the manifold has codimension, zero on it, with independent differentials at its points.

    Raises ``InvalidInputError`` for a manifold of which no such equations are known.
    """
    raise InvalidInputError(
        f"no independent equations of {manifold} are known, and the problem is written in the ambient space; expected "
        "a level set, Euclidean space, a sphere, rotations, rigid motions, unitary matrices, frames, SPD or hyperbolic "
        "space, a simplex, or a product or power of these; try a LevelSet with the same points"
    )


@equations.register
def _(manifold: Euclidean, x: Array) -> Array:
    return jnp.zeros(0)


@equations.register
def _(manifold: Sphere, x: Array) -> Array:
    return jnp.stack([x @ x - 1])


@equations.register
def _(manifold: Hyperbolic, x: Array) -> Array:
    return jnp.stack([x[1:] @ x[1:] - x[0] ** 2 + 1])


@equations.register
def _(manifold: Simplex, x: Array) -> Array:
    return jnp.stack([jnp.sum(x) - 1])


@equations.register
def _(manifold: LevelSet, x: Array) -> Array:
    return manifold.equations(x)


@equations.register
def _(manifold: SO | U | Stiefel, x: Array) -> Array:
    return _gram(x)


@equations.register
def _(manifold: SE, x: Array) -> Array:
    rotation, _ = manifold.parts(x)
    return jnp.concatenate([_upper(rotation.T @ rotation - jnp.eye(manifold.n)), x[-1].at[-1].add(-1.0)])


@equations.register
def _(manifold: SU, x: Array) -> Array:
    return jnp.append(_gram(x), jnp.imag(jnp.linalg.det(x)))


@equations.register
def _(manifold: Oblique, x: Array) -> Array:
    return jnp.sum(x * x, axis=0) - 1


@equations.register
def _(manifold: SPD, x: Array) -> Array:
    return _upper(x - x.T, 1)


@equations.register
def _(manifold: Product, x: tuple) -> Array:
    return jnp.concatenate([equations(factor, part) for factor, part in zip(manifold.factors, x, strict=True)])


@equations.register
def _(manifold: Power, x: Ambient) -> Array:
    return jnp.ravel(jax.vmap(lambda part: equations(manifold.factor, part))(x))


def _upper(a: Array, offset: int = 0) -> Array:
    return a[np.triu_indices(a.shape[0], offset)]


def _gram(x: Array) -> Array:
    """The independent entries of ``x'x - I``."""
    gram = x.conj().T @ x - jnp.eye(x.shape[1])
    return jnp.concatenate([_upper(gram.real), _upper(gram.imag, 1)]) if jnp.iscomplexobj(x) else _upper(gram)
