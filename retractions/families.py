"""Retractions known by one name on several manifolds: ``Cayley(SO(3) * Euclidean(3))``."""

from collections.abc import Callable
from typing import Any

from ..manifolds import (
    SE,
    SO,
    SPD,
    Euclidean,
    FixedRank,
    Grassmann,
    Hyperbolic,
    InvalidInputError,
    LevelSet,
    Manifold,
    MatrixLieGroup,
    Oblique,
    Power,
    Product,
    Simplex,
    Sphere,
    Stiefel,
    Submanifold,
    U,
    UnknownRetractionError,
)
from ..manifolds.bundles import VectorBundle
from .constructions import PowerRetraction, ProductRetraction
from .cotangent_lift import BundleRetraction
from .groups import (
    SOQR,
    UQR,
    GroupCayley,
    GroupExponential,
    SEDecoupled,
    SOCayley,
    SOPolar,
    UPolar,
)
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
from .restored import ProjectionByNewton
from .retraction import Retraction
from .submanifold import Orthographic
from .vectors import (
    Addition,
    HyperbolicExponential,
    HyperbolicProjection,
    SimplexExponential,
    SphereExponential,
    SphereProjection,
)


class RetractionFamily:
    r"""Retractions that share a name, such as ``Cayley``; a call with a manifold returns its member.

    Parameters
    ----------
    name : str
        The name.
    members : dict of type to callable
        The retraction, a function of a manifold, for each class of manifolds.

    Notes
    -----
    A product is taken factor by factor, a power copy by copy, a Euclidean factor by addition. A custom class joins with
    ``register(MyManifold, MyRetraction)``. A member is a retraction: :math:`R(x, 0) = x` and
    :math:`D_v R(x, 0) = \mathrm{Id}`.

    Examples
    --------
    >>> Cayley.knows(SO(3)), Cayley.knows(Sphere(2))
    (True, False)
    """

    def __init__(self, name: str, members: dict[type[Manifold], Callable[..., Retraction]]) -> None:
        self.name = name
        self._members = {Euclidean: Addition, **members}
        self._conditions: dict[type[Manifold], Callable[[Any], bool]] = {}

    def register(
        self,
        manifold: type[Manifold],
        retraction: Callable[..., Retraction],
        where: Callable[[Any], bool] = lambda _: True,
    ) -> None:
        """Make ``retraction(m)`` the member of this family for the manifolds ``m`` of a class.

        Parameters
        ----------
        manifold : type
            The class; its subclasses are included.
        retraction : callable
            A function of a manifold that returns its retraction, such as a class.
        where : callable, optional
            Whether the family has a member for ``m``; by default always.
        """
        self._members[manifold], self._conditions[manifold] = retraction, where

    def _member(self, manifold: Manifold) -> Callable[..., Retraction] | None:
        kind = next((kind for kind in type(manifold).__mro__ if kind in self._members), None)
        if kind is None or not self._conditions.get(kind, lambda _: True)(manifold):
            return None
        return self._members[kind]

    def knows(self, manifold: Manifold) -> bool:
        """Whether the family has a member for a manifold.

        Parameters
        ----------
        manifold : Manifold
            The manifold.
        """
        if isinstance(manifold, Product):
            return all(self.knows(factor) for factor in manifold.factors)
        if isinstance(manifold, Power):
            return self.knows(manifold.factor)
        return self._member(manifold) is not None

    def __call__(self, manifold: Manifold | None = None) -> Retraction:
        if not isinstance(manifold, Manifold):
            own = manifold.__name__ if isinstance(manifold, type) else ""
            came = f"the class {own}" if own else "none" if manifold is None else repr(manifold)
            hint = f"{own}(...)" if own else "problem.manifold"
            raise InvalidInputError(f"{self.name} takes a manifold, got {came}; try {self.name}({hint})")
        if isinstance(manifold, Product):
            return ProductRetraction(*(self(factor) for factor in manifold.factors))
        if isinstance(manifold, Power):
            return PowerRetraction(self(manifold.factor), manifold.k)
        member = self._member(manifold)
        if member is not None:
            return member(manifold)
        known = [family.name for family in FAMILIES if family.knows(manifold)]
        raise UnknownRetractionError(
            f"{self.name} is not known on {manifold}; known there: {', '.join(known) or 'none'}. "
            "Write a Retraction for it, and register it with the family if it belongs there"
            + ("; the exponential of any metric is retrax.integrators.GeodesicRetraction(metric)" if known else "")
        )

    def __repr__(self) -> str:
        return self.name


def _nearest_motion(group: SE) -> SEDecoupled:
    return SEDecoupled(group, SOPolar(SO(group.n)))


Exponential: RetractionFamily = RetractionFamily(
    "Exponential",
    {
        Sphere: SphereExponential,
        Hyperbolic: HyperbolicExponential,
        Simplex: SimplexExponential,
        SPD: SPDExponential,
        MatrixLieGroup: GroupExponential,
        Stiefel: StiefelExponential,
        Grassmann: GrassmannExponential,
        Oblique: lambda m: Columnwise(m, SphereExponential(m.column)),
    },
)
Cayley: RetractionFamily = RetractionFamily(
    "Cayley", {SO: SOCayley, Stiefel: StiefelCayley, Grassmann: GrassmannCayley}
)
Cayley.register(MatrixLieGroup, GroupCayley, where=GroupCayley.applies)
Polar: RetractionFamily = RetractionFamily(
    "Polar", {SO: SOPolar, U: UPolar, Stiefel: StiefelPolar, Grassmann: GrassmannPolar}
)
QR = RetractionFamily("QR", {SO: SOQR, U: UQR, Stiefel: StiefelQR, Grassmann: GrassmannPolar})
Projection: RetractionFamily = RetractionFamily(
    "Projection",
    {
        Sphere: SphereProjection,
        Hyperbolic: HyperbolicProjection,
        SO: SOPolar,
        U: UPolar,
        SE: _nearest_motion,
        LevelSet: LevelSetProjection,
        Stiefel: StiefelPolar,
        Grassmann: GrassmannPolar,
        Oblique: lambda m: Columnwise(m, SphereProjection(m.column)),
        FixedRank: FixedRankProjection,
        Submanifold: lambda m: Orthographic(m, default_retraction(m.parent)),
        VectorBundle: lambda m: BundleRetraction(default_retraction(m.base), m),
    },
)
FAMILIES = (Exponential, Projection, Cayley, Polar, QR)


def default_retraction(manifold: Manifold) -> Retraction:
    """The first of Exponential, Projection, Cayley, Polar, QR on a manifold, otherwise ``ProjectionByNewton``.

    Parameters
    ----------
    manifold : Manifold
        The manifold; products are taken factor by factor.

    Returns
    -------
    Retraction
        A retraction: ``R(x, 0) = x``, ``D_v R(x, 0) = Id``.

    Examples
    --------
    >>> default_retraction(SO(3))
    GroupExponential(manifold=SO(n=3))
    """
    if isinstance(manifold, Product):
        return ProductRetraction(*(default_retraction(factor) for factor in manifold.factors))
    if isinstance(manifold, Power):
        return PowerRetraction(default_retraction(manifold.factor), manifold.k)
    family = next((family for family in FAMILIES if family.knows(manifold)), ProjectionByNewton)
    return family(manifold)
