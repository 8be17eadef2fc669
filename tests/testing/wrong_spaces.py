"""Manifolds, groups and metrics that are wrong in one way each."""

from collections.abc import Callable
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from retrax.manifolds import (
    SE,
    SO,
    SU,
    HomogeneousSpace,
    Manifold,
    MatrixLieGroup,
    Metric,
    Sphere,
    Stiefel,
    Submanifold,
    TangentBundle,
)
from retrax.manifolds.numerics import ambient as vec

SPHERE, ROTATIONS, FRAMES = Sphere(2), SO(3), Stiefel(4, 2)
TWO_EQUATIONS = Submanifold(Sphere(3), lambda x: x[:1] - x[1:2] * x[2] - 0.25)


@final
class MutantManifold(Manifold):
    """A manifold with some of its methods, or its dimension, instead of which others are given."""

    base: Manifold
    changes: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def __init__(self, base: Manifold, **changes: Any) -> None:
        self.base, self.changes = base, tuple(changes.items())

    def _of(self, name: str) -> Any:
        return dict(self.changes).get(name, getattr(self.base, name))

    @property
    def dimension(self):
        return self._of("dimension")

    @property
    def ambient(self):
        return self.base.ambient

    def projection(self, x, a):
        return self._of("projection")(x, a)

    def basis(self, x):
        return self._of("basis")(x)

    def restore(self, x):
        return self._of("restore")(x)

    def violations(self, x):
        return self._of("violations")(x)

    def random_point(self, key):
        return self._of("random_point")(key)


@final
class MutantSpace(HomogeneousSpace):
    """The sphere with a momentum of its own."""

    pair: Callable = eqx.field(static=True)

    @property
    def dimension(self):
        return SPHERE.dimension

    @property
    def ambient(self):
        return SPHERE.ambient

    def projection(self, x, a):
        return SPHERE.projection(x, a)

    def basis(self, x):
        return SPHERE.basis(x)

    def restore(self, x):
        return SPHERE.restore(x)

    def violations(self, x):
        return SPHERE.violations(x)

    def random_point(self, key):
        return SPHERE.random_point(key)

    def generators(self, x):
        return SPHERE.generators(x)

    def momentum(self, x, p):
        return self.pair(x, p)


@final
class MutantGroup(MatrixLieGroup):
    """Rigid motions of the plane, with the inverse of rotations."""

    @property
    def algebra(self):
        return SE(2).algebra

    def inverse(self, x):
        return x.T


@final
class MutantMetric(Metric):
    """Any inner product and any energy, and any way back to vectors."""

    manifold: Manifold
    product: Callable = eqx.field(static=True)
    energy: Callable = eqx.field(static=True)
    back: Callable | None = eqx.field(static=True, default=None)

    def inner_product(self, x, v, w):
        return self.product(x, v, w)

    def kinetic_energy(self, x, p):
        return self.energy(x, p)

    def vector(self, x, p):
        return super().vector(x, p) if self.back is None else self.back(x, p)


def oblique(x, a):
    """Projection on the tangent space of the sphere along a direction that is not the normal."""
    n = x + 0.1 * SPHERE.basis(x)[0]
    return a - n * (x @ a) / (x @ n)


def _gram(x):
    return x.conj().T @ x - jnp.eye(x.shape[1], dtype=x.dtype)


def _largest(a):
    return jnp.max(jnp.abs(a))


def _together(combine):
    """The two violations of the tangent bundle of the sphere as one number."""
    return lambda x: {"both": combine(jnp.stack(list(TangentBundle(SPHERE).violations(x).values())))}


def _one_of_two(x):
    return {"norm": jnp.abs(jnp.sum(x * x) - 1)}


# The equations of each are there, but for what its name says.
VIOLATIONS: dict[str, Manifold] = {
    "violations without `det = 1`": MutantManifold(SU(2), violations=lambda x: {"gram": _largest(_gram(x))}),
    "violations of the diagonal alone": MutantManifold(
        FRAMES, violations=lambda x: {"gram": _largest(jnp.diagonal(_gram(x)))}
    ),
    "violations added up with their signs": MutantManifold(
        FRAMES, violations=lambda x: {"gram": jnp.abs(jnp.sum(_gram(x)))}
    ),
    "violations of the first of two equations": MutantManifold(TWO_EQUATIONS, violations=_one_of_two),
    "violations of which the smaller counts": MutantManifold(TangentBundle(SPHERE), violations=_together(jnp.min)),
    "violations multiplied with each other": MutantManifold(TangentBundle(SPHERE), violations=_together(jnp.prod)),
    "violations without the absolute value": MutantManifold(SPHERE, violations=lambda x: {"|x|^2 - 1": x @ x - 1}),
    "violations that are squared": MutantManifold(SPHERE, violations=lambda x: {"squared": (x @ x - 1) ** 2}),
    "violations without the last row": MutantManifold(SE(2), violations=lambda x: {"gram": _largest(_gram(x[:2, :2]))}),
}


def on_the_equator(key):
    a = jax.random.normal(key, (2,))
    return jnp.append(a / jnp.linalg.norm(a), 0.0)


def on_a_spiral(key):
    """Points of a curve on the sphere that lies in no plane."""
    z, turns = jnp.tanh(jax.random.normal(key)), 2.0
    return jnp.stack([jnp.sqrt(1 - z * z) * jnp.cos(turns * z), jnp.sqrt(1 - z * z) * jnp.sin(turns * z), z])


INERTIA = jnp.array([1.0, 2.0, 3.0])


def _body(x, v):
    return ROTATIONS.vee(x.T @ v)


def weighted(x, v, w):
    """The inner product of a rigid body."""
    return _body(x, v) @ (INERTIA * _body(x, w))


def weighted_energy(x, p):
    mu = ROTATIONS.body(x, p)
    return mu @ (mu / INERTIA) / 2


def lopsided(x, v, w):
    a, b = _body(x, v), _body(x, w)
    return weighted(x, v, w) + 0.1 * (a[0] * b[1] - a[1] * b[0])


METRICS: dict[str, Metric] = {
    "a metric that is not symmetric": MutantMetric(ROTATIONS, lopsided, weighted_energy),
    "a metric without an axis": MutantMetric(
        ROTATIONS, lambda x, v, w: weighted(x, v, w) - 3 * _body(x, v)[2] * _body(x, w)[2], weighted_energy
    ),
    "a metric whose product is not linear": MutantMetric(
        ROTATIONS, lambda x, v, w: jnp.sqrt(weighted(x, v, v) * weighted(x, w, w)), weighted_energy
    ),
    "a metric with the energy of another": MutantMetric(
        ROTATIONS, weighted, lambda x, p: vec.pairing(ROTATIONS.projection(x, p), p) / 2
    ),
    "a metric with twice the energy": MutantMetric(ROTATIONS, weighted, lambda x, p: 2 * weighted_energy(x, p)),
    "a metric whose energy sees normal parts": MutantMetric(SPHERE, lambda x, v, w: v @ w, lambda x, p: p @ p / 2),
    "a metric whose vectors have normal parts": MutantMetric(
        SPHERE, lambda x, v, w: v @ w, lambda x, p: SPHERE.projection(x, p) @ p / 2, lambda x, p: p
    ),
    "a metric whose energy has no derivative by the point": MutantMetric(
        ROTATIONS, weighted, lambda x, p: weighted_energy(jax.lax.stop_gradient(x), p)
    ),
}
