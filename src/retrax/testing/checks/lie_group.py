"""Facts about matrix Lie groups: the group, its Lie algebra, adjoint actions, momenta."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import MatrixLieGroup
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ..numerics import flat, unflat
from ..properties import SAMPLE_SEEDS, Sample, examine, largest_entries
from ..report import Comparison, Report, fact
from ..sites import Site
from .manifold import MANIFOLD_CHECKS, ManifoldFacts, max_violation


class LieGroupFacts(ManifoldFacts):
    """Measured facts of a matrix Lie group, at random elements and elements of its algebra, beside the facts of
    manifolds."""

    kind = MatrixLieGroup
    subject: MatrixLieGroup

    def __init__(
        self,
        group: MatrixLieGroup,
        *,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        super().__init__(group, seeds=seeds, points=points, tolerance=tolerance)

    def draw(self, kind: str, site: Site) -> Sample:
        """Elements ``x``, ``y``, ``z``, a covector ``p`` at ``x``, coordinates ``b``, ``c`` of elements of the
        algebra."""
        rng = np.random.default_rng(site.seed)
        y, z = (self.sampler.random(int(other)) for other in rng.integers(2**31, size=2))
        b, c = rng.standard_normal((2, self.manifold.dimension)) / np.sqrt(max(self.manifold.dimension, 1))
        drawn = super().draw(kind, site)
        return {**drawn, "y": y, "z": z, "p": drawn["v"], "b": b, "c": c}


def _products(group: MatrixLieGroup, sample: Sample) -> dict:
    """Products of three elements in both ways, with the identity and with the inverse, and their violations."""
    x, y, z = (unflat(group)(sample[name]) for name in "xyz")
    xy, back = group.compose(x, y), group.inverse(x)
    return {
        "left first": flat(group.compose(xy, z)),
        "right first": flat(group.compose(x, group.compose(y, z))),
        "with identity": jnp.stack([flat(group.compose(x, group.identity)), flat(group.compose(group.identity, x))]),
        "with inverse": jnp.stack([flat(group.compose(x, back)), flat(group.compose(back, x))]),
        "identity": flat(group.identity),
        "violation": jnp.stack([max_violation(group, a) for a in (group.identity, xy, back)]),
    }


def _actions(group: MatrixLieGroup, sample: Sample) -> dict:
    """Adjoint actions of the group and of its algebra."""
    x, y = (unflat(group)(sample[name]) for name in "xy")
    b, c = sample["b"], sample["c"]
    moved = x @ group.hat(c) @ group.inverse(x)
    bracket = group.vee(group.hat(b) @ group.hat(c) - group.hat(c) @ group.hat(b))
    return {
        "Ad": group.Ad(x) @ c,
        "moved": group.vee(moved),
        "outside": flat(group.hat(group.vee(moved)) - moved),
        "Ad of product": group.Ad(group.compose(x, y)),
        "product of Ad": group.Ad(x) @ group.Ad(y),
        "ad": group.ad(b) @ c,
        "bracket": bracket,
        "slope of Ad": jax.jvp(group.Ad, (group.identity,), (jnp.asarray(group.hat(b), x.dtype),))[1] @ c,
        "ad of bracket": group.ad(bracket),
        "bracket of ad": group.ad(b) @ group.ad(c) - group.ad(c) @ group.ad(b),
    }


def _trivialisations(group: MatrixLieGroup, sample: Sample) -> dict:
    """The left-trivialised tangent vector ``x hat(c)``, and body and spatial momenta of the covector ``p``."""
    x, p = (unflat(group)(sample[name]) for name in "xp")
    a = group.hat(sample["c"])
    return {
        "algebra": flat(a),
        "trivialised": flat(group.left_trivialise(x, x @ a)),
        "coordinates": group.vee(a),
        "tangent": flat(x @ a),
        "projected": flat(group.projection(x, x @ a)),
        "body": group.body(x, p),
        "body pairing": jnp.stack([group.body(x, p) @ sample["c"], vec.pairing(p, x @ a)]),
        "spatial pairing": jnp.stack([group.spatial(x, p) @ sample["c"], vec.pairing(p, a @ x)]),
        "spatial moved": group.Ad(x).T @ group.spatial(x, p),
        "covector": group.body(x, group.covector(x, sample["c"])),
    }


@fact
def products_and_inverses_stay_in_the_group(facts: LieGroupFacts) -> Comparison:
    """The identity, ``x y`` and ``x^-1`` satisfy the group's equations."""
    f = facts.measure(_products, "points")
    limit = 10 * facts.tolerance * (1 + largest_entries(f["with inverse"]) + largest_entries(f["left first"]))
    return facts.bound("the largest violation of the equations", f, largest_entries(f["violation"]), limit)


@fact
def multiplication_is_associative(facts: LieGroupFacts) -> Comparison:
    """``(x y) z = x (y z)``."""
    f = facts.measure(_products, "points")
    return facts.compare("|(x y) z - x (y z)|", f, f["left first"], f["right first"], 10 * facts.tolerance)


@fact
def identity_is_neutral(facts: LieGroupFacts) -> Comparison:
    """``x e = e x = x``."""
    f = facts.measure(_products, "points")
    return facts.compare("|x e - x| or |e x - x|", f, f["with identity"], f["x"][:, None], facts.tolerance)


@fact
def inverse_undoes_an_element(facts: LieGroupFacts) -> Comparison:
    """``x x^-1 = x^-1 x = e``."""
    f = facts.measure(_products, "points")
    return facts.compare(
        "|x x^-1 - e| or |x^-1 x - e|", f, f["with inverse"], f["identity"][:, None], 10 * facts.tolerance
    )


@fact
def coordinates_stand_for_elements_of_the_algebra(facts: LieGroupFacts) -> Comparison:
    """``vee(hat(c)) = c``."""
    f = facts.measure(_trivialisations, "points")
    return facts.compare("|vee(hat(c)) - c|", f, f["coordinates"], f["c"], facts.tolerance)


@fact
def tangent_vectors_are_trivialised_from_the_left(facts: LieGroupFacts) -> Comparison:
    """``x A`` is tangent at ``x`` for ``A`` in the algebra, and is trivialised to ``A``."""
    f = facts.measure(_trivialisations, "points")
    got, expected = (np.stack([f[a], f[b]], axis=1) for a, b in (("trivialised", "projected"), ("algebra", "tangent")))
    return facts.compare("|x^-1 (x A) - A| or |P x A - x A|", f, got, expected, 10 * facts.tolerance)


@fact
def Ad_is_conjugation(facts: LieGroupFacts) -> Comparison:
    """``hat(Ad(x) c) = x hat(c) x^-1``, which is in the algebra."""
    f = facts.measure(_actions, "points")
    got = np.concatenate([f["Ad"], f["outside"]], axis=1)
    expected = np.concatenate([f["moved"], 0 * f["outside"]], axis=1)
    return facts.compare("|hat(Ad(x) c) - x hat(c) x^-1|", f, got, expected, 10 * facts.tolerance)


@fact
def Ad_is_a_homomorphism(facts: LieGroupFacts) -> Comparison:
    """``Ad(x y) = Ad(x) Ad(y)``."""
    f = facts.measure(_actions, "points")
    return facts.compare("|Ad(x y) - Ad(x) Ad(y)|", f, f["Ad of product"], f["product of Ad"], 10 * facts.tolerance)


@fact
def ad_is_the_commutator_and_the_derivative_of_Ad(facts: LieGroupFacts) -> Comparison:
    """``hat(ad(b) c) = [hat(b), hat(c)]``, and ``ad(b)`` is the derivative of ``Ad`` at the identity along
    ``hat(b)``."""
    f = facts.measure(_actions, "points")
    got = np.stack([f["ad"], f["slope of Ad"]], axis=1)
    return facts.compare("the largest difference of the three", f, got, f["bracket"][:, None], 10 * facts.tolerance)


@fact
def ad_satisfies_the_Jacobi_identity(facts: LieGroupFacts) -> Comparison:
    """``ad([b, c]) = ad(b) ad(c) - ad(c) ad(b)``."""
    f = facts.measure(_actions, "points")
    return facts.compare(
        "|ad([b, c]) - [ad(b), ad(c)]|", f, f["ad of bracket"], f["bracket of ad"], 10 * facts.tolerance
    )


@fact
def body_and_spatial_momenta_pair_with_velocities(facts: LieGroupFacts) -> Comparison:
    """``body(x, p) . c = <p, x hat(c)>`` and ``spatial(x, p) . c = <p, hat(c) x>``."""
    f = facts.measure(_trivialisations, "points")
    pairs = np.stack([f["body pairing"], f["spatial pairing"]], axis=1)
    return facts.compare(
        "|body . c - <p, x C>| or |spatial . c - <p, C x>|", f, pairs[..., 0], pairs[..., 1], 10 * facts.tolerance
    )


@fact
def Ad_takes_the_spatial_momentum_to_the_body_momentum(facts: LieGroupFacts) -> Comparison:
    """``body(x, p) = Ad(x)^T spatial(x, p)``."""
    f = facts.measure(_trivialisations, "points")
    return facts.compare("|body - Ad(x)^T spatial|", f, f["body"], f["spatial moved"], 10 * facts.tolerance)


@fact
def covector_inverts_the_body_momentum(facts: LieGroupFacts) -> Comparison:
    """``body(x, covector(x, mu)) = mu``."""
    f = facts.measure(_trivialisations, "points")
    return facts.compare("|body(x, covector(x, mu)) - mu|", f, f["covector"], f["c"], 10 * facts.tolerance)


LIE_GROUP_CHECKS = (
    *MANIFOLD_CHECKS,
    products_and_inverses_stay_in_the_group,
    multiplication_is_associative,
    identity_is_neutral,
    inverse_undoes_an_element,
    coordinates_stand_for_elements_of_the_algebra,
    tangent_vectors_are_trivialised_from_the_left,
    Ad_is_conjugation,
    Ad_is_a_homomorphism,
    ad_is_the_commutator_and_the_derivative_of_Ad,
    ad_satisfies_the_Jacobi_identity,
    body_and_spatial_momenta_pair_with_velocities,
    Ad_takes_the_spatial_momentum_to_the_body_momentum,
    covector_inverts_the_body_momentum,
)


def check_lie_group(
    group: MatrixLieGroup,
    *,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object satisfies the interface of ``MatrixLieGroup``, including ``Manifold``.

    Parameters
    ----------
    group : MatrixLieGroup
        The group.
    seeds, points, tolerance, only, skip, throw
        As in ``check_manifold``; points have the shape of ``manifold.ambient``.

    Returns
    -------
    Report
        The outcomes.

    Raises
    ------
    ConformanceError
        If a fact does not hold and ``throw`` is true.
    """
    return examine(
        LieGroupFacts(group, seeds=seeds, points=points, tolerance=tolerance), LIE_GROUP_CHECKS, only, skip, throw
    )
