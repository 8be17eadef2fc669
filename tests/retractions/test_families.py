"""Retractions by name, batches, and wrong arguments."""

from typing import final

import jax
import numpy as np
import pytest
from retrax.manifolds import SO, SPD, Euclidean, InvalidInputError, LevelSet, Manifold, Sphere, UnknownRetractionError
from retrax.retractions import (
    QR,
    SOQR,
    Addition,
    BundleRetraction,
    Cayley,
    Exponential,
    GroupExponential,
    LevelSetProjection,
    Polar,
    ProductRetraction,
    Projection,
    ProjectionByNewton,
    RetractionFamily,
    SOCayley,
    SOPolar,
    SphereExponential,
    SphereProjection,
    default_retraction,
)

from tests.support.cases import MANIFOLDS, NESTED

MEMBERS = {
    "Exponential": (Exponential, {"R2x3": Addition, "S2": SphereExponential, "SO3": GroupExponential}),
    "Projection": (
        Projection,
        {
            "R2x3": Addition,
            "S2": SphereProjection,
            "SO3": SOPolar,
            "ellipsoid": LevelSetProjection,
            "T*S2": BundleRetraction,
            "TSO3": BundleRetraction,
        },
    ),
    "Cayley": (Cayley, {"R2x3": Addition, "SO3": SOCayley}),
    "Polar": (Polar, {"R2x3": Addition, "SO3": SOPolar}),
    "QR": (QR, {"R2x3": Addition, "SO3": SOQR}),
}
EVERY_PAIR = [(family, space) for family in MEMBERS for space in ("R2x3", "S2", "SO3", "ellipsoid", "T*S2", "TSO3")]


@pytest.mark.parametrize(("family", "space"), EVERY_PAIR, ids=["-".join(pair) for pair in EVERY_PAIR])
def test_a_family_gives_its_member_or_names_the_families_that_have_one(family, space):
    make, members = MEMBERS[family]
    manifold = MANIFOLDS[space]
    assert make.knows(manifold) == (space in members)
    if space in members:
        assert type(make(manifold)) is members[space]
        assert make(manifold).manifold == manifold
    else:
        known = [name for name, (_, others) in MEMBERS.items() if space in others]
        words = rf"{family} is not known on .*known there: {', '.join(known) or 'none'}\. Write a Retraction"
        with pytest.raises(UnknownRetractionError, match=words):
            make(manifold)


@pytest.mark.parametrize("family", MEMBERS)
def test_a_family_on_a_product_is_the_product_of_its_members(family):
    make, _ = MEMBERS[family]
    product = make(SO(3) * Euclidean(3))
    assert product.factors == (make(SO(3)), make(Euclidean(3)))
    assert product.manifold == SO(3) * Euclidean(3)


def test_a_product_with_an_unknown_factor_is_unknown():
    assert not Cayley.knows(NESTED)
    with pytest.raises(UnknownRetractionError, match="Cayley is not known on Sphere"):
        Cayley(NESTED)


def test_a_family_without_a_manifold_is_no_retraction():
    with pytest.raises(
        InvalidInputError, match=r"Cayley takes a manifold, got the class SO; try Cayley\(SO\(\.\.\.\)\)"
    ):
        Cayley(SO)
    with pytest.raises(InvalidInputError, match=r"Cayley takes a manifold, got none; try Cayley\(problem\.manifold\)"):
        Cayley()


def test_a_family_takes_new_members_for_a_class_and_its_subclasses():
    @final
    class Line(LevelSet):
        def constraint(self, x):
            return x[:1]

    family = RetractionFamily("Mine", {})
    assert not family.knows(Line(2))
    family.register(LevelSet, LevelSetProjection)
    assert family(Line(2)) == LevelSetProjection(Line(2))
    assert str(family) == "Mine"


@pytest.mark.parametrize(("space", "kind"), [("S2", SphereExponential), ("ellipsoid", LevelSetProjection)])
def test_the_default_is_the_first_family_that_knows_a_manifold(space, kind):
    assert type(default_retraction(MANIFOLDS[space])) is kind


def test_the_default_of_a_product_is_chosen_factor_by_factor():
    chosen = default_retraction(MANIFOLDS["ellipsoid"] * SO(3))
    assert chosen.factors == (LevelSetProjection(MANIFOLDS["ellipsoid"]), GroupExponential(SO(3)))


@final
class Line(Manifold):
    """A manifold that no family has heard of."""

    dimension: int = 1

    @property
    def ambient(self):
        return Euclidean(1).ambient

    def projection(self, x, a):
        return a

    def basis(self, x):
        return Euclidean(1).basis(x)

    def restore(self, x):
        return x

    def violations(self, x):
        return {}

    def random_point(self, key):
        return Euclidean(1).random_point(key)


def test_a_manifold_that_no_family_knows_has_that_of_its_newton_steps():
    with pytest.raises(UnknownRetractionError, match="known there: none"):
        Exponential(Line())
    assert default_retraction(Line()) == ProjectionByNewton(Line())
    assert default_retraction(Line() * Sphere(2)).factors == (ProjectionByNewton(Line()), Exponential(Sphere(2)))


@pytest.mark.parametrize("manifold", [SPD(2), Sphere(2)], ids=str)
def test_newton_steps_of_a_manifold_lead_to_a_point_of_it_or_nowhere(manifold):
    """However long the vector is: no violation of an inequality is small beside a large point."""
    x, lengths = manifold.random_point(jax.random.key(1)), 10.0 ** np.array([0, 2, 4, 8, 12, 16, 40, 160])
    v = -manifold.random_tangent(jax.random.key(2), x)
    for y in jax.jit(jax.vmap(lambda length: ProjectionByNewton(manifold)(x, length * v)))(lengths):
        assert np.all(np.isnan(y)) or max(manifold.violations(y).values()) <= 1e-8


@pytest.mark.parametrize("factors", [(), (Sphere(2),), (Exponential,)], ids=["none", "a manifold", "a family"])
def test_a_product_retraction_of_other_things_is_refused(factors):
    with pytest.raises(InvalidInputError, match="ProductRetraction takes one or more retractions, got"):
        ProductRetraction(*factors)
