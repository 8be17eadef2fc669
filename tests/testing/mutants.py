"""Objects that are wrong in one way each: what the conformance kit must catch."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
from retrax.manifolds import SE, SO, Manifold, MatrixLieGroup, Sphere
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import (
    QR,
    BundleRetraction,
    CotangentLift,
    DifferentiatedRetraction,
    DiscretizationMap,
    Exponential,
    Midpoint,
    MidpointRetraction,
    Projection,
    Retraction,
    Theta,
)
from retrax.testing import (
    Report,
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_retraction,
)

SPHERE = Sphere(2)
EXPONENTIAL, PROJECTION = Exponential(SPHERE), Projection(SPHERE)
LIFT = CotangentLift(Midpoint(PROJECTION))


@final
class MutantSphere(Manifold):
    """The sphere with a projection and a dimension of one's own."""

    project: Callable = eqx.field(static=True, default=SPHERE.projection)
    dimension: int = eqx.field(static=True, default=2)

    @property
    def ambient(self):
        return SPHERE.ambient

    def projection(self, x, a):
        return self.project(x, a)

    def basis(self, x):
        return SPHERE.basis(x)

    def restore(self, x):
        return SPHERE.restore(x)

    def violations(self, x):
        return SPHERE.violations(x)

    def random_point(self, key):
        return SPHERE.random_point(key)


@final
class MutantGroup(MatrixLieGroup):
    """Rigid motions of the plane, with the inverse of rotations."""

    @property
    def algebra(self):
        return SE(2).algebra

    def inverse(self, x):
        return x.T


def oblique(x, a):
    """Projection on the tangent space along a direction that is not the normal."""
    n = x + 0.1 * SPHERE.basis(x)[0]
    return a - n * (x @ a) / (x @ n)


@final
class MutantRetraction(Retraction):
    """Any map, with the derived inverse and domain."""

    move: Callable = eqx.field(static=True)

    @property
    def manifold(self):
        return SPHERE

    def __call__(self, x, v):
        return self.move(x, v)


@final
class MutantInverse(Retraction):
    """Any map with any inverse, said to be valid for vectors up to a length."""

    move: Callable = eqx.field(static=True)
    back: Callable = eqx.field(static=True)
    radius: float = eqx.field(static=True)

    @property
    def manifold(self):
        return SPHERE

    def __call__(self, x, v):
        return self.move(x, v)

    def preimage(self, x, y):
        return self.back(x, y)

    def domain(self, x, v):
        return v @ v < self.radius**2


@final
class MutantAdjoint(DifferentiatedRetraction):
    """The projection with an adjoint of one's own."""

    pull: Callable = eqx.field(static=True)

    @property
    def manifold(self):
        return SPHERE

    def __call__(self, x, v):
        return PROJECTION(x, v)

    def fibre_derivative(self, x, v, w):
        return PROJECTION.fibre_derivative(x, v, w)

    def fibre_adjoint(self, x, v, xi):
        return self.pull(x, v, xi)


def nan_at_zero(x, v):
    """Great circles with a guard on the value alone."""
    t = jnp.linalg.norm(v)
    return jnp.cos(t) * x + jnp.where(t > 0, jnp.sin(t) / t, 1.0) * v


def constant_at_zero(x, v):
    """Great circles whose value at zero is a case of its own."""
    return jnp.where(jnp.all(v == 0), x, EXPONENTIAL(x, v))


def flat_at_zero(x, v):
    """Great circles with both branches guarded: right to first order at zero, straight there."""
    s = v @ v
    t = jnp.sqrt(jnp.where(s > 0, s, 1.0))
    return jnp.where(s > 0, jnp.cos(t), 1.0) * x + jnp.where(s > 0, jnp.sin(t) / t, 1.0) * v


@final
class MutantMap(DiscretizationMap):
    """Any two ends, with a ``theta``."""

    ends: Callable = eqx.field(static=True)
    theta: float = eqx.field(static=True, default=0.5)

    @property
    def retraction(self):
        return PROJECTION

    def __call__(self, x, v):
        return self.ends(x, v)


@final
class MutantLift(DiscretizationMap):
    """The lift of the midpoint map with the sign of one of ``p``, ``pdot``, ``p0``, ``p1`` flipped."""

    signs: tuple[float, float, float, float] = eqx.field(static=True)

    @property
    def theta(self):
        return LIFT.theta

    @property
    def retraction(self):
        return LIFT.retraction

    def __call__(self, z, zdot):
        p, pdot, p0, p1 = self.signs
        (q0, a), (q1, b) = LIFT((z[0], p * z[1]), (zdot[0], pdot * zdot[1]))
        return (q0, p0 * a), (q1, p1 * b)

    def preimage(self, z0, z1):
        p, pdot, p0, p1 = self.signs
        (q, a), (qdot, b) = LIFT.preimage((z0[0], p0 * z0[1]), (z1[0], p1 * z1[1]))
        return (q, p * a), (qdot, pdot * b)


@final
class MutantForms(MidpointRetraction):
    """The projection with a chart twice as long, a pair that is exchanged and a midpoint that is none."""

    @property
    def manifold(self):
        return SPHERE

    def __call__(self, x, v):
        return PROJECTION(x, v)

    def chart(self, x, frame, c):
        return PROJECTION(x, 2 * c @ frame)

    def both_ways(self, x, v):
        return PROJECTION(x, v), PROJECTION(x, -v)

    def midpoint(self, x0, x1):
        return x0


class Mutant(NamedTuple):
    """Something wrong, and how it is checked."""

    check: Callable[..., Report]
    subject: Any
    options: Mapping[str, Any] = MappingProxyType({})


def tangential(x, y):
    """An inverse to first order."""
    return SPHERE.projection(x, y)


def scaled_logarithm(x, y):
    return EXPONENTIAL.preimage(x, y) / 2


def wrong_between(shortest, longest):
    """The logarithm, wrong for vectors of some lengths only."""

    def back(x, y):
        v = EXPONENTIAL.preimage(x, y)
        length = jnp.linalg.norm(v)
        return jnp.where((length > shortest) & (length < longest), 1.001 * v, v)

    return back


def pushed(x, v, xi):
    """The derivative where its adjoint is asked for."""
    return PROJECTION.fibre_derivative(x, v, xi)


MUTANTS: dict[str, Mutant] = {
    "a manifold whose projection is missing": Mutant(check_manifold, MutantSphere(lambda x, a: a)),
    "a manifold whose projection is not symmetric": Mutant(check_manifold, MutantSphere(oblique)),
    "a manifold with a wrong dimension": Mutant(check_manifold, MutantSphere(dimension=3)),
    "a Lie group whose inverse is the transpose": Mutant(check_lie_group, MutantGroup()),
    "`R(x, 1.01 v)`": Mutant(check_retraction, MutantRetraction(lambda x, v: PROJECTION(x, 1.01 * v))),
    "`R(x, -v)`": Mutant(check_retraction, MutantRetraction(lambda x, v: PROJECTION(x, -v))),
    "a first-order retraction that claims order 2": Mutant(check_retraction, QR(SO(3)), {"order": 2}),
    "a retraction `x + v` whose projection is missing": Mutant(check_retraction, MutantRetraction(vec.add)),
    "`exp(2 v)` with `log / 2`": Mutant(
        check_retraction, MutantInverse(lambda x, v: EXPONENTIAL(x, 2 * v), scaled_logarithm, jnp.pi / 2)
    ),
    "an adjoint that is the derivative": Mutant(check_retraction, MutantAdjoint(pushed)),
    "an adjoint that is not tangent": Mutant(
        check_retraction, MutantAdjoint(lambda x, v, xi: PROJECTION.fibre_adjoint(x, v, xi) + (x @ xi) * x)
    ),
    "an inverse valid only near zero, said to be valid farther": Mutant(
        check_retraction, MutantInverse(EXPONENTIAL, tangential, 1.0)
    ),
    "an inverse valid only near zero, with a domain as small": Mutant(
        check_retraction, MutantInverse(EXPONENTIAL, tangential, 1e-5)
    ),
    "an inverse that is wrong near the edge of its domain": Mutant(
        check_retraction, MutantInverse(EXPONENTIAL, wrong_between(3.05, jnp.pi), jnp.pi)
    ),
    "an inverse that is wrong half way to the edge of its domain": Mutant(
        check_retraction, MutantInverse(EXPONENTIAL, wrong_between(1.2, 3.05), jnp.pi)
    ),
    "a derivative that is NaN at `v = 0` only": Mutant(check_retraction, MutantRetraction(nan_at_zero)),
    "a derivative that is wrong at `v = 0` only": Mutant(check_retraction, MutantRetraction(constant_at_zero)),
    "a second derivative that is wrong at `v = 0` only": Mutant(check_retraction, MutantRetraction(flat_at_zero)),
    "a chart, a pair and a midpoint that are not those of the values": Mutant(check_retraction, MutantForms()),
    "a map whose step is too long": Mutant(
        check_discretization_map, MutantMap(lambda x, v: (PROJECTION(x, -v / 2), PROJECTION(x, 0.6 * v)))
    ),
    "a map with a wrong `theta`": Mutant(check_discretization_map, MutantMap(lambda x, v: (x, PROJECTION(x, v)), 0.5)),
    "a map that claims to be symmetric": Mutant(check_discretization_map, Theta(PROJECTION, 0.3), {"symmetric": True}),
    "a lift with the sign of `p` flipped": Mutant(check_cotangent_lift, MutantLift((-1.0, 1.0, 1.0, 1.0))),
    "a lift with the sign of `pdot` flipped": Mutant(check_cotangent_lift, MutantLift((1.0, -1.0, 1.0, 1.0))),
    "a lift with the sign of `p0` flipped": Mutant(check_cotangent_lift, MutantLift((1.0, 1.0, -1.0, 1.0))),
    "a lift with the sign of `p1` flipped": Mutant(check_cotangent_lift, MutantLift((1.0, 1.0, 1.0, -1.0))),
    "a map of the bundle that is no lift": Mutant(check_cotangent_lift, Midpoint(BundleRetraction(PROJECTION))),
}
