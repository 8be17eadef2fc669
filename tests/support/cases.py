"""Manifolds, retractions and discretization maps under test, by readable names."""

from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from retrax.manifolds import (
    SE,
    SL,
    SO,
    SPD,
    SU,
    AffineInvariantMetric,
    CanonicalMetric,
    ComplexStiefel,
    CotangentBundle,
    Euclidean,
    FixedRank,
    Grassmann,
    Hyperbolic,
    LeftInvariantMetric,
    LevelSet,
    LorentzMetric,
    Manifold,
    MatrixLieGroup,
    Metric,
    Oblique,
    Power,
    Product,
    Simplex,
    Sphere,
    Stiefel,
    Submanifold,
    TangentBundle,
    U,
)
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import (
    QR,
    Adjoint,
    BundleRetraction,
    Cayley,
    DiscretizationMap,
    Exponential,
    FixedRankOrthographic,
    FrobeniusExponential,
    Orthographic,
    Polar,
    Projection,
    RestoredAfter,
    Retraction,
    SecondOrder,
    SPDLogEuclidean,
    SPDSecondOrder,
    SphereExponential,
    StiefelCanonicalExponential,
    Theta,
    Translated,
)
from retrax.retractions.groups.functions import general


@final
class Ellipsoid(LevelSet):
    """``{x'Ax = 1}`` with ``A = diag(1, 2, 3)``."""

    def __init__(self) -> None:
        self.shape = (3,)

    def constraint(self, x: Array) -> Array:
        return x @ (jnp.array([1.0, 2.0, 3.0]) * x) - 1


@final
class Intersection(LevelSet):
    """A torus in the 2 x 2 matrices, from two equations: ``|x|^2 = 1``, ``x_00^2 + 2 x_01^2 = x_10^2 + 2 x_11^2``."""

    def __init__(self) -> None:
        self.shape = (2, 2)

    def constraint(self, x: Array) -> Array:
        return jnp.stack([jnp.sum(x * x) - 1, jnp.array([1.0, -1.0]) @ (x * x) @ jnp.array([1.0, 2.0])])


@final
class Heisenberg(MatrixLieGroup):
    """Upper triangular 3 x 3 matrices with ones on the diagonal, by a basis that is not orthogonal."""

    @property
    def algebra(self) -> np.ndarray:
        basis = np.zeros((3, 3, 3))
        basis[0, 0, 1] = basis[1, 1, 2] = basis[1, 0, 1] = basis[2, 0, 2] = 1
        return basis


@final
class FreeTheta(DiscretizationMap):
    """A discretization map of one's own: ``(R(x, -split v), R(x, (1 - split) v))`` with ``split`` an array.

    ``theta`` only helps solvers to begin; here it is right for ``split = 1/2`` alone.
    """

    inner: Retraction
    split: Array
    theta: float = eqx.field(static=True, default=0.5)

    @property
    def retraction(self) -> Retraction:
        return self.inner

    def __call__(self, x: Any, v: Any) -> tuple:
        return self.inner(x, vec.scale(-self.split, v)), self.inner(x, vec.scale(1 - self.split, v))


NESTED = Product(SO(3) * Euclidean(3), Sphere(2))

# A closed curve on the sphere.
CURVE = Submanifold(Sphere(2), lambda x: x[2:] - x[0] * x[1] - 0.25)

MANIFOLDS: dict[str, Manifold] = {
    "R2x3": Euclidean((2, 3)),
    "S2": Sphere(2),
    "S4": Sphere(4),
    "SO2": SO(2),
    "SO3": SO(3),
    "SO4": SO(4),
    "SE2": SE(2),
    "SE3": SE(3),
    "U2": U(2),
    "U3": U(3),
    "SU2": SU(2),
    "SU3": SU(3),
    "SL2": SL(2),
    "SL3": SL(3),
    "heisenberg": Heisenberg(),
    "ellipsoid": Ellipsoid(),
    "intersection": Intersection(),
    "SO3*R3": SO(3) * Euclidean(3),
    "(SO3*R3)*S2": NESTED,
    "T*S2": CotangentBundle(Sphere(2)),
    "TSO3": TangentBundle(SO(3)),
    "H2": Hyperbolic(2),
    "simplex3": Simplex(3),
    "SPD2": SPD(2),
    "S2x3": Power(Sphere(2), 3),
    "St42": Stiefel(4, 2),
    "St33": Stiefel(3, 3),
    "CSt32": ComplexStiefel(3, 2),
    "CSt11": ComplexStiefel(1, 1),
    "Gr42": Grassmann(4, 2),
    "Gr31": Grassmann(3, 1),
    "oblique32": Oblique(3, 2),
    "rank2-4x3": FixedRank(4, 3, 2),
    "rank1-3x3": FixedRank(3, 3, 1),
    "curve": CURVE,
}

_MAPPED: dict[str, Retraction] = {
    "addition-R2x3": Exponential(Euclidean((2, 3))),
    "exponential-S2": Exponential(Sphere(2)),
    "projection-S2": Projection(Sphere(2)),
    "projection-S4": Projection(Sphere(4)),
    "exponential-SO2": Exponential(SO(2)),
    "exponential-SO3": Exponential(SO(3)),
    "exponential-SO4": Exponential(SO(4)),
    "cayley-SO2": Cayley(SO(2)),
    "cayley-SO3": Cayley(SO(3)),
    "cayley-SO4": Cayley(SO(4)),
    "polar-SO3": Polar(SO(3)),
    "polar-SO4": Polar(SO(4)),
    "qr-SO3": QR(SO(3)),
    "qr-SO4": QR(SO(4)),
    "exponential-SE2": Exponential(SE(2)),
    "decoupled-SE2": Projection(SE(2)),
    "cayley-SU2": Cayley(SU(2)),
    "nearest-ellipsoid": Projection(Ellipsoid()),
    "nearest-intersection": Projection(Intersection()),
    "cayley-SO3*R3": Cayley(SO(3) * Euclidean(3)),
    "exponential-(SO3*R3)*S2": Exponential(NESTED),
    "exponential-H2": Exponential(Hyperbolic(2)),
    "projection-H2": Projection(Hyperbolic(2)),
    "softmax-simplex3": Exponential(Simplex(3)),
    "exponential-SPD2": Exponential(SPD(2)),
    "quadratic-SPD2": SPDSecondOrder(SPD(2)),
    "log-SPD2": SPDLogEuclidean(SPD(2)),
    "projection-S2x3": Projection(Power(Sphere(2), 3)),
    "bundle-T*S2": BundleRetraction(SphereExponential(Sphere(2))),
    "polar-St42": Polar(Stiefel(4, 2)),
    "qr-St42": QR(Stiefel(4, 2)),
    "cayley-St42": Cayley(Stiefel(4, 2)),
    "exponential-St32": Exponential(Stiefel(3, 2)),
    "exponential-Gr31": Exponential(Grassmann(3, 1)),
    "cayley-Gr42": Cayley(Grassmann(4, 2)),
    "polar-Gr42": Polar(Grassmann(4, 2)),
    "projection-oblique32": Projection(Oblique(3, 2)),
    "truncation-rank2-4x3": Projection(FixedRank(4, 3, 2)),
    "orthographic-rank1-3x3": FixedRankOrthographic(FixedRank(3, 3, 1)),
}

# The latter ones are not in MAPS: a map does not know from which closed form a retraction comes.
RETRACTIONS: dict[str, Retraction] = {
    **_MAPPED,
    "exponential-U2": Exponential(U(2)),
    "exponential-SU2": Exponential(SU(2)),
    "exponential-SU3": Exponential(SU(3)),
    "exponential-SE3": Exponential(SE(3)),
    "exponential-SL2": Exponential(SL(2)),
    "exponential-SL3": Exponential(SL(3)),
    "frobenius-SL2": FrobeniusExponential(SL(2)),
    "exponential-heisenberg": Exponential(Heisenberg()),
    "exponential-oblique32": Exponential(Oblique(3, 2)),
    "cayley-U2": Cayley(U(2)),
    "cayley-SU3": Cayley(SU(3)),
    "cayley-SE2": Cayley(SE(2)),
    "cayley-SE3": Cayley(SE(3)),
    "cayley-SL2": Cayley(SL(2)),
    "cayley-heisenberg": Cayley(Heisenberg()),
    "polar-U2": Polar(U(2)),
    "qr-U2": QR(U(2)),
    "canonical-St42": StiefelCanonicalExponential(Stiefel(4, 2)),
    "polar-CSt32": Polar(ComplexStiefel(3, 2)),
    "qr-CSt32": QR(ComplexStiefel(3, 2)),
    "cayley-CSt32": Cayley(ComplexStiefel(3, 2)),
    "exponential-CSt32": Exponential(ComplexStiefel(3, 2)),
    "stabilized-SO3": RestoredAfter(Cayley(SO(3))),
    "corrected-SO3": SecondOrder(QR(SO(3))),
    "translated-SE2": Translated(SE(2), general.cayley, general.cayley_inverse, side="right"),
    "translated-U2": Translated(U(2), general.cayley, general.cayley_inverse),
    "orthographic-curve": Orthographic(CURVE, Exponential(Sphere(2))),
}

# Longest tangent vector (Euclidean norm in the ambient space) that the facts about inverses use, where it is not 3.
# It is below pi, and on rotations the largest angle is at most that norm over the square root of 2.
# On projectors it is the square root of 2 times the root of the sum of squares of the singular values.
REACH = {
    "nearest": 0.3,
    "bundle": 1.0,
    "projection-H2": 0.5,
    "softmax": 0.05,
    "quadratic": 0.9,
    "exponential-Gr31": 2.2,
    "canonical": 2.8,
    "cayley-Gr42": 2.5,
    "truncation": 0.4,
    "orthographic": 0.4,
    "orthographic-curve": 0.1,
    "exponential-SL2": 1.0,
    "exponential-SL3": 1.0,
    "cayley-SL2": 1.0,
    "frobenius-SL2": 1.0,
    "corrected-SO3": 0.5,
    "translated-SE2": 1.0,
}

# Retractions of first order, and those of second order for a metric that is not the ambient one.
FIRST_ORDER = ("qr", "bundle", "softmax", "log", "translated")
METRICS: dict[str, Metric] = {
    "exponential-H2": LorentzMetric(Hyperbolic(2)),
    "projection-H2": LorentzMetric(Hyperbolic(2)),
    "exponential-SPD2": AffineInvariantMetric(SPD(2)),
    "quadratic-SPD2": AffineInvariantMetric(SPD(2)),
    "cayley-St42": CanonicalMetric(Stiefel(4, 2)),
    "canonical-St42": CanonicalMetric(Stiefel(4, 2)),
    "cayley-CSt32": CanonicalMetric(ComplexStiefel(3, 2)),
    "frobenius-SL2": LeftInvariantMetric(SL(2), SL(2).lie_algebra.gram),
}
# On these groups one-parameter subgroups are not geodesics: rigid motions are screws.
_NOT_GEODESIC = ("SE2", "SE3", "SL2", "SL3", "heisenberg")

# One retraction for each closed form of an inverse. Newton's method is compared with them, and their discretization
# maps are lifted: a lift does not know from which closed form a retraction comes.
REPRESENTATIVES = (
    "addition-R2x3",
    "exponential-S2",
    "projection-S4",
    "cayley-SO2",
    "exponential-SO3",
    "cayley-SO4",
    "polar-SO3",
    "qr-SO4",
    "nearest-ellipsoid",
    "exponential-(SO3*R3)*S2",
    "projection-H2",
    "softmax-simplex3",
    "quadratic-SPD2",
    "polar-St42",
    "cayley-Gr42",
)

# Those of them that go through the whole conformance kit in the default run, of the first and the second order, in a
# vector's coordinates and in a matrix's, with an edge and without; the slow one has all.
QUICK = ("exponential-S2", "exponential-SO3", "qr-SO4", "softmax-simplex3", "projection-H2", "polar-St42")

THETAS = (0.0, 0.3, 0.5, 1.0)

LIFTED_MAPS: dict[str, DiscretizationMap] = {
    **{f"theta=0.3, {name}": Theta(RETRACTIONS[name], 0.3) for name in REPRESENTATIVES},
    **{
        f"theta={theta}, {name}": Theta(RETRACTIONS[name], theta)
        for name in REPRESENTATIVES[:2]
        for theta in (0.0, 0.5, 1.0)
    },
    "two, cayley-SO3": Theta(Cayley(SO(3)), 0.4, QR(SO(3))),
    "adjoint, exponential-S2": Adjoint(Theta(Exponential(Sphere(2)), 0.3, Projection(Sphere(2)))),
}

MAPS: dict[str, DiscretizationMap] = {
    **{f"theta=0.3, {name}": Theta(retraction, 0.3) for name, retraction in _MAPPED.items()},
    **{f"theta=0.5, {name}": Theta(RETRACTIONS[name], 0.5) for name in REPRESENTATIVES},
    **LIFTED_MAPS,
}


def reach(name: str) -> float:
    """Longest tangent vector, at least, of a retraction's domain; ``name`` may be that of a map made of it."""
    name = name.split(", ")[-1]
    return REACH.get(name, REACH.get(name.split("-")[0], 3.0))


def order(name: str) -> int:
    """Order of a retraction, for its metric in ``METRICS`` or that of the ambient space."""
    family, _, space = name.partition("-")
    return 1 if family in FIRST_ORDER or (family in ("exponential", "cayley") and space in _NOT_GEODESIC) else 2
