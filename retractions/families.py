"""Retractions known by one name on several manifolds: ``Cayley(SO(3) * Euclidean(3))``."""

from collections.abc import Callable

from ..manifolds import (
    SO,
    SPD,
    Euclidean,
    FixedRank,
    Grassmann,
    Hyperbolic,
    LevelSet,
    Manifold,
    Oblique,
    Power,
    Product,
    Simplex,
    Sphere,
    Stiefel,
    UnknownRetractionError,
)
from .constructions import PowerRetraction, ProductRetraction
from .groups import SOQR, SOCayley, SOExponential, SOPolar
from .level_set import LevelSetProjection
from .matrices import (
    Columnwise,
    FixedRankProjection,
    GrassmannCayley,
    GrassmannExponential,
    GrassmannPolar,
    SPDExponential,
    StiefelCayley,
    StiefelExponential,
    StiefelPolar,
    StiefelQR,
)
from .retraction import Retraction
from .vectors import (
    Addition,
    HyperbolicExponential,
    HyperbolicProjection,
    SimplexExponential,
    SphereExponential,
    SphereProjection,
)


class RetractionFamily:
    """Retractions that share a name. Called with a manifold it gives the one for it.

    A product is taken factor by factor, a power copy by copy, a Euclidean factor by addition. A class of one's own joins with
    ``register(MyManifold, MyRetraction)``, for ``MyManifold`` and its subclasses.
    """

    def __init__(self, name: str, members: dict[type[Manifold], Callable[..., Retraction]]) -> None:
        self.name = name
        self._members = {Euclidean: Addition, **members}

    def register(self, manifold: type[Manifold], retraction: Callable[..., Retraction]) -> None:
        """Make ``retraction(m)`` the member of this family for a manifold ``m`` of the given class."""
        self._members[manifold] = retraction

    def knows(self, manifold: Manifold) -> bool:
        """Whether the family has a member for a manifold."""
        if isinstance(manifold, Product):
            return all(self.knows(factor) for factor in manifold.factors)
        if isinstance(manifold, Power):
            return self.knows(manifold.factor)
        return any(kind in self._members for kind in type(manifold).__mro__)

    def __call__(self, manifold: Manifold) -> Retraction:
        if isinstance(manifold, Product):
            return ProductRetraction(*(self(factor) for factor in manifold.factors))
        if isinstance(manifold, Power):
            return PowerRetraction(self(manifold.factor), manifold.k)
        for kind in type(manifold).__mro__:
            if kind in self._members:
                return self._members[kind](manifold)
        known = [family.name for family in FAMILIES if family.knows(manifold)]
        raise UnknownRetractionError(
            f"{self.name} is not known on {manifold}; known there: {', '.join(known) or 'none'}. "
            "Write a Retraction for it, and register it with the family if it belongs there"
        )

    def __repr__(self) -> str:
        return self.name


Exponential = RetractionFamily(
    "Exponential",
    {
        Sphere: SphereExponential,
        Hyperbolic: HyperbolicExponential,
        Simplex: SimplexExponential,
        SPD: SPDExponential,
        SO: SOExponential,
        Stiefel: StiefelExponential,
        Grassmann: GrassmannExponential,
        Oblique: lambda m: Columnwise(m, SphereExponential(m.column)),
    },
)
Cayley = RetractionFamily("Cayley", {SO: SOCayley, Stiefel: StiefelCayley, Grassmann: GrassmannCayley})
Polar = RetractionFamily("Polar", {SO: SOPolar, Stiefel: StiefelPolar, Grassmann: GrassmannPolar})
QR = RetractionFamily("QR", {SO: SOQR, Stiefel: StiefelQR, Grassmann: GrassmannPolar})
Projection = RetractionFamily(
    "Projection",
    {
        Sphere: SphereProjection,
        Hyperbolic: HyperbolicProjection,
        SO: SOPolar,
        LevelSet: LevelSetProjection,
        Stiefel: StiefelPolar,
        Oblique: lambda m: Columnwise(m, SphereProjection(m.column)),
        FixedRank: FixedRankProjection,
    },
)
FAMILIES = (Exponential, Projection, Cayley, Polar, QR)


def default_retraction(manifold: Manifold) -> Retraction:
    """The first of Exponential, Projection, Cayley, Polar, QR that is known on a manifold; factor by factor on products."""
    if isinstance(manifold, Product):
        return ProductRetraction(*(default_retraction(factor) for factor in manifold.factors))
    if isinstance(manifold, Power):
        return PowerRetraction(default_retraction(manifold.factor), manifold.k)
    family = next((family for family in FAMILIES if family.knows(manifold)), Exponential)
    return family(manifold)
