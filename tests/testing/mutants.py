"""Objects that are wrong in one way each: what the conformance kit must catch."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from retrax.manifolds import SO, SPD, LeftInvariantMetric
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
    SPDSecondOrder,
    Theta,
)
from retrax.testing import (
    Report,
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_metric,
    check_retraction,
)

from .wrong_spaces import (
    METRICS,
    ROTATIONS,
    SPHERE,
    VIOLATIONS,
    MutantGroup,
    MutantManifold,
    MutantSpace,
    oblique,
    on_a_spiral,
    on_the_equator,
)

EXPONENTIAL, PROJECTION, DEFINITE = Exponential(SPHERE), Projection(SPHERE), SPDSecondOrder(SPD(2))
LIFT = CotangentLift(Midpoint(PROJECTION))


@final
class MutantRetraction(Retraction):
    """Any map, with the derived inverse and domain."""

    move: Callable = eqx.field(static=True)

    @property
    def manifold(self):
        return SPHERE

    def retract(self, x, v):
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

    def retract(self, x, v):
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

    def retract(self, x, v):
        return PROJECTION(x, v)

    def fibre_derivative(self, x, v, w):
        return PROJECTION.fibre_derivative(x, v, w)

    def differential_adjoint(self, x, v, xi):
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

    def retract(self, x, v):
        return PROJECTION(x, v)

    def chart(self, x, frame, c):
        return PROJECTION(x, 2 * c @ frame)

    def both_ways(self, x, v):
        return PROJECTION(x, v), PROJECTION(x, -v)

    def midpoint(self, x0, x1):
        return x0


@final
class MutantMidpoint(MidpointRetraction):
    """Great circles with a midpoint of one's own."""

    middle: Callable = eqx.field(static=True)

    @property
    def manifold(self):
        return SPHERE

    def retract(self, x, v):
        return EXPONENTIAL(x, v)

    def preimage(self, x, y):
        return EXPONENTIAL.preimage(x, y)

    def domain(self, x, v):
        return EXPONENTIAL.domain(x, v)

    def midpoint(self, x0, x1):
        return self.middle(x0, x1)


@final
class ThroughEigenvalues(Retraction):
    """``x + v + v x^-1 v / 2`` with ``x^-1`` from eigenvectors, which have no derivative where two eigenvalues are
    equal."""

    @property
    def manifold(self):
        return DEFINITE.manifold

    def retract(self, x, v):
        values, vectors = jnp.linalg.eigh(x)
        return x + v + v @ (vectors / values) @ vectors.T @ v / 2

    def preimage(self, x, y):
        return DEFINITE.preimage(x, y)

    def domain(self, x, v):
        return DEFINITE.domain(x, v)


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


def saturated(x, v):
    """Great circles that end at length 3/2."""
    return EXPONENTIAL(x, v / jnp.sqrt(jnp.maximum(1.0, v @ v / 2.25)))


def through_the_centre(x, y):
    """The inverse of the projection; of points behind the horizon, the vector that leads to their antipodes."""
    return y / (x @ y) - x


def straight_beyond(x, y):
    """The inverse of the projection; of points behind the horizon, the vector to them, which is not tangent and leads
    there."""
    height = x @ y
    return jnp.where(height > 0, y / jnp.where(height > 0, height, 1.0), y) - x


def held(function):
    """A function of two points without its derivative by the first."""
    return lambda x, y: function(jax.lax.stop_gradient(x), y)


def cancelling(x, v):
    """The projection of ``x + k v`` with ``k = 2 (1 - cos t) / t^2``, by a series below ``t = 1e-7`` only."""
    s = v @ v
    t = jnp.sqrt(jnp.where(s > 1e-14, s, 1.0))
    return PROJECTION(x, jnp.where(s > 1e-14, 2 * (1 - jnp.cos(t)) / (t * t), 1 - s / 12) * v)


def turned_from_the_right(x):
    return x @ jax.scipy.linalg.expm(ROTATIONS.hat(jnp.array([0.3, -0.2, 0.5])))


MUTANTS: dict[str, Mutant] = {
    "a manifold whose projection is missing": Mutant(check_manifold, MutantManifold(SPHERE, projection=lambda x, a: a)),
    "a manifold whose projection is not symmetric": Mutant(check_manifold, MutantManifold(SPHERE, projection=oblique)),
    "a basis that is constant to JAX": Mutant(
        check_manifold, MutantManifold(SPHERE, basis=lambda x: jax.lax.stop_gradient(SPHERE.basis(x)))
    ),
    "a manifold with a wrong dimension": Mutant(check_manifold, MutantManifold(SPHERE, dimension=3)),
    **{name: Mutant(check_manifold, manifold) for name, manifold in VIOLATIONS.items()},
    "random points on the equator alone": Mutant(check_manifold, MutantManifold(SPHERE, random_point=on_the_equator)),
    "random points on a spiral": Mutant(check_manifold, MutantManifold(SPHERE, random_point=on_a_spiral)),
    "a momentum with another sign than the generators": Mutant(
        check_manifold, MutantSpace(lambda x, p: -vec.components(SPHERE.generators(x), p))
    ),
    **{name: Mutant(check_metric, metric) for name, metric in METRICS.items()},
    "a metric with an isometry that it has not": Mutant(
        check_metric,
        LeftInvariantMetric(ROTATIONS, [1.0, 2.0, 3.0]),
        {"isometries": {"right": turned_from_the_right}},
    ),
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
        check_retraction, MutantAdjoint(lambda x, v, xi: PROJECTION.differential_adjoint(x, v, xi) + (x @ xi) * x)
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
    "derivatives that are rounding at the length 1e-6": Mutant(check_retraction, MutantRetraction(cancelling)),
    "a derivative that is NaN at the identity only": Mutant(check_retraction, ThroughEigenvalues()),
    "an inverse of a map that is constant along `v` from the length 3/2 on": Mutant(
        check_retraction, MutantInverse(saturated, EXPONENTIAL.preimage, jnp.pi)
    ),
    "an inverse of points outside the image": Mutant(
        check_retraction, MutantInverse(PROJECTION, through_the_centre, jnp.inf)
    ),
    "an inverse of points outside the image that is not tangent": Mutant(
        check_retraction, MutantInverse(PROJECTION, straight_beyond, jnp.inf)
    ),
    "an inverse without its derivative by the base point": Mutant(
        check_retraction, MutantInverse(EXPONENTIAL, held(EXPONENTIAL.preimage), jnp.pi)
    ),
    "a midpoint without its derivative by the first point": Mutant(
        check_retraction, MutantMidpoint(held(EXPONENTIAL.midpoint))
    ),
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
    "a map of the bundle that is not a lift": Mutant(check_cotangent_lift, Midpoint(BundleRetraction(PROJECTION))),
}
