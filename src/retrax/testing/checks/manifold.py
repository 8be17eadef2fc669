"""Facts about manifolds: points, tangent spaces, projections, equations."""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import HomogeneousSpace, Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ..numerics import along, ambient_size, flat, unflat
from ..precision import precision
from ..probes import least_spread, least_visible_normal
from ..properties import SAMPLE_SEEDS, Facts, Sample, examine, largest_entries
from ..report import Batch, Comparison, Inapplicable, Report, entries, fact, number
from ..sites import Site

CURVATURE = 100.0  # the largest second derivative that is taken for one
# Of an equation that is left out a displacement off the manifold shows 1e-2 or less in these units, of one that is
# there about 1; of random directions the rarest has 0.1 or more, of those along a smaller manifold rounding or its
# curvature.
SEEN, POINT_SPREAD = 0.05, 0.02


class ManifoldFacts(Facts):
    """Measured facts of a manifold, at random, special and given points."""

    kind = Manifold
    subject: Manifold

    def __init__(
        self,
        manifold: Manifold,
        *,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        super().__init__(manifold, seeds, points, tolerance)
        self.kernels[self._displace.__name__] = self._displace  # made of compiled parts

    def draw(self, kind: str, site: Site) -> Sample:
        """The point with a random tangent vector, the basis there, and unit ambient vectors ``a`` and ``d``."""
        v, basis = self.sampler.at(site.x, site.seed)
        a, d = np.random.default_rng(site.seed).standard_normal((2, site.x.size))
        return {"x": site.x, "v": v, "basis": basis, "a": a / np.linalg.norm(a), "d": d / np.linalg.norm(d)}

    def displacements(self) -> Batch:
        """How much the equations see of displacements along normals."""
        return self.measure(self._displace, "points")

    def _displace(self, sample: Sample) -> Sample:
        seen, normal = least_visible_normal(lambda y: self.violation(y)[0], sample["x"], sample["basis"])
        return {"seen": seen, "normal": normal}


def max_violation(manifold: Manifold, x: Any) -> jax.Array:
    """Largest violation of the manifold's equations; 0 where there are none."""
    return vec.size(manifold.violations(x))


def _projection(manifold: Manifold, sample: Sample) -> dict:
    """The matrix of the projection, and its derivative along ``d``."""
    back, x, a, d = unflat(manifold), sample["x"], sample["a"], sample["d"]

    def project(x: jax.Array, e: jax.Array) -> jax.Array:
        return flat(manifold.projection(back(x), back(e)))

    return {
        "projector": jax.vmap(lambda e: project(x, e))(jnp.eye(x.size)).T,
        "slope": jax.jvp(lambda x: project(x, a), (x,), (d,))[1],
        "values": along(lambda t: project(x + t * d, a), precision().step),
    }


def _basis(manifold: Manifold, sample: Sample) -> dict:
    """The derivative of the basis along a unit tangent vector, and of the projection of its vectors as they are
    there."""
    back, x = unflat(manifold), sample["x"]
    unit = sample["v"] / jnp.linalg.norm(sample["v"])

    def project(x: jax.Array, e: jax.Array) -> jax.Array:
        return flat(manifold.projection(back(x), back(e)))

    basis, rate = jax.jvp(lambda x: vec.flatten_frame(manifold.basis(back(x))), (x,), (unit,))
    bent = jax.vmap(lambda e: jax.jvp(lambda x: project(x, e), (x,), (unit,))[1])(basis)
    return {"basis": basis, "rate": rate, "bent": bent}


def _equations(manifold: Manifold, sample: Sample) -> dict:
    """Violations at the point, on its tangent line, and after restoring."""
    back, x, a = unflat(manifold), sample["x"], sample["a"]
    unit = sample["v"] / jnp.linalg.norm(sample["v"])

    def violation(y: jax.Array) -> jax.Array:
        return max_violation(manifold, back(y))

    def restore(y: jax.Array) -> jax.Array:
        return flat(manifold.restore(back(y)))

    distances = jnp.asarray(precision().distances, x.dtype)
    return {
        "on": violation(x),
        "tangent line": jax.vmap(lambda t: violation(x + t * unit))(distances),
        "restored": restore(x),
        "after restoring": jax.vmap(lambda t: violation(restore(x + t * a)))(distances),
    }


def _generators(manifold: HomogeneousSpace, sample: Sample) -> dict:
    """The generators of the action, and the momentum of the covector ``a``."""
    x, p = (unflat(manifold)(sample[name]) for name in "xa")
    return {"generators": vec.flatten_frame(manifold.generators(x)), "momentum": manifold.momentum(x, p)}


@fact
def random_points_are_on_the_manifold(facts: ManifoldFacts) -> Comparison:
    """Random points satisfy the manifold's equations."""
    f = facts.measure(_equations, "points")
    return facts.bound(
        "the largest violation of the equations", f, f["on"], facts.tolerance * (1 + largest_entries(f["x"]))
    )


@fact
def random_points_differ(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """Random points from different keys are different."""
    f = facts.measure(_equations, "points")
    if facts.manifold.dimension == 0 or len(facts.sites) < 2:
        return Inapplicable("there is one point")
    gaps = np.max(np.abs(f["x"][:, None] - f["x"][None]), axis=2)
    others = gaps[~np.eye(len(gaps), dtype=bool)].reshape(len(gaps), -1)
    return facts.bound(
        "the distance to the nearest other point", f, np.min(others, axis=1), precision().tiny, "at least"
    )


@fact
def random_points_spread_in_every_direction(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """Random points do not lie on a smaller manifold: from one to its neighbours lead all tangent directions."""
    f, d = facts.measure(_equations, "points"), facts.manifold.dimension
    if d == 0:
        return Inapplicable("there is one point")
    if not facts.seeds:
        return Inapplicable("without a seed no random point is drawn")
    spread = least_spread(facts.sampler, d)
    return facts.bound(
        "the mean square of the rarest direction, relative to that of random ones,",
        f,
        np.full(len(f["x"]), spread),
        POINT_SPREAD,
        "at least",
        lambda _: (
            "random points lie on a smaller manifold than this one; try to draw as many random numbers as it has "
            "dimensions"
        ),
    )


@fact
def random_tangents_are_tangent(facts: ManifoldFacts) -> Comparison:
    """Random tangent vectors are left as they are by the projection."""
    f = facts.measure(_projection, "points")
    projected = np.einsum("kij,kj->ki", f["projector"], f["v"])
    return facts.compare("|P v - v|", f, projected, f["v"], facts.tolerance)


@fact
def projection_is_idempotent(facts: ManifoldFacts) -> Comparison:
    """Projecting twice is projecting once: ``P P = P``."""
    f = facts.measure(_projection, "points")
    return facts.compare("|P P - P|", f, f["projector"] @ f["projector"], f["projector"], facts.tolerance)


@fact
def projection_is_symmetric(facts: ManifoldFacts) -> Comparison:
    """The projection is orthogonal: ``<P a, b> = <a, P b>``."""
    f = facts.measure(_projection, "points")
    transposed = np.swapaxes(f["projector"], 1, 2)

    def hint(k: int) -> str:
        p = f["projector"][k]
        if not np.allclose(p @ p, p, atol=precision().half):
            return ""
        return (
            "P projects along vectors that are not normal, as one that is orthogonal for another metric does; "
            "try that of <a, b>"
        )

    return facts.compare("|P - P'|", f, f["projector"], transposed, facts.tolerance, hint=hint)


@fact
def tangent_spaces_have_the_dimension(facts: ManifoldFacts) -> Comparison:
    """The trace of the projection, which is its rank, is the manifold's dimension."""
    f = facts.measure(_projection, "points")
    rank = np.trace(f["projector"], axis1=1, axis2=2)

    def hint(k: int) -> str:
        return f"the trace is {number(rank[k])} and the dimension is {facts.manifold.dimension}"

    return facts.bound("|trace P - dimension|", f, np.abs(rank - facts.manifold.dimension), precision().half, hint=hint)


@fact
def basis_is_orthonormal(facts: ManifoldFacts) -> Comparison:
    """The basis of the tangent space is orthonormal: ``<E_i, E_j> = 1`` for ``i = j``, 0 otherwise."""
    f = facts.measure(_projection, "points")
    gram = f["basis"] @ np.swapaxes(f["basis"], 1, 2)
    return facts.compare("|<E_i, E_j> - I|", f, gram, np.eye(gram.shape[1]), facts.tolerance)


@fact
def basis_spans_the_image_of_the_projection(facts: ManifoldFacts) -> Comparison:
    """The projection is ``a -> sum_i <E_i, a> E_i``."""
    f = facts.measure(_projection, "points")
    spanned = np.swapaxes(f["basis"], 1, 2) @ f["basis"]
    return facts.compare("|sum E_i E_i' - P|", f, spanned, f["projector"], facts.tolerance)


@fact
def derivative_of_the_basis_keeps_it_an_orthonormal_basis(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """Along curves the basis stays tangent and orthonormal: ``DE - P DE = DP E``, ``<DE_i, E_j> + <E_i, DE_j> = 0``."""
    if facts.manifold.dimension == 0:
        return Inapplicable("there is no tangent vector")
    f = facts.measure(_basis, "points")
    turned = f["rate"] @ np.swapaxes(f["basis"], 1, 2)
    normal = f["rate"] - turned @ f["basis"]
    got = np.concatenate([normal, turned + np.swapaxes(turned, 1, 2)], axis=2)
    expected = np.concatenate([f["bent"], np.zeros_like(turned)], axis=2)

    def hint(k: int) -> str:
        constant = "the basis is constant to JAX, as behind stop_gradient or a callback: its derivative is zero"
        return "" if np.any(f["rate"][k]) else constant

    return facts.compare("|D E - P D E - D P E|", f, got, expected, 10 * facts.tolerance, hint=hint)


@fact
def derivative_of_the_projection_is_that_of_differences(facts: ManifoldFacts) -> Comparison:
    """Automatic differentiation of ``P_x a`` by ``x`` gives its derivative: the frames of the bundles stand on it."""
    f = facts.measure(_projection, "points")
    return facts.compare_slopes("|D_x P_x a - differences|", f, f["slope"], f["values"], precision().step)


@fact
def tangent_lines_touch_the_manifold(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """At ``x + t v`` with a unit tangent vector ``v`` the equations are violated by ``O(t^2)``."""
    f = facts.measure(_equations, "points")
    if facts.manifold.dimension == 0:
        return Inapplicable("there is no tangent vector")
    rate = np.max((f["tangent line"] - f["on"][:, None]) / precision().distances ** 2, axis=1)
    return facts.bound("the violation at x + t v over t^2", f, rate, CURVATURE * (1 + largest_entries(f["x"])))


@fact
def equations_see_normal_displacements(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """At ``x + t n`` the equations are violated by ``t`` times something, for every normal vector ``n``."""
    if facts.manifold.dimension == ambient_size(facts.manifold):
        return Inapplicable("the manifold is open in its ambient space")
    f = facts.displacements()

    def hint(k: int) -> str:
        return (
            "the largest of the violations does not grow with t along the normal vector n = "
            f"{entries(f['normal'][k])}; try violations that have every equation, with its absolute value and not its "
            "square"
        )

    what = "the violation at x + t n over t, for a short t relative to a longer one,"
    return facts.bound(what, f, f["seen"], SEEN, "at least", hint)


@fact
def restore_is_the_identity_on_the_manifold(facts: ManifoldFacts) -> Comparison:
    """A point of the manifold is restored to itself."""
    f = facts.measure(_equations, "points")
    return facts.compare("|restore(x) - x|", f, f["restored"], f["x"], facts.tolerance)


@fact
def restore_makes_errors_second_order(facts: ManifoldFacts) -> Comparison:
    """A point at distance ``t`` from the manifold is restored to one that violates the equations by ``O(t^2)``."""
    # A bound instead of a slope: along some directions the error changes sign, which no power of the distance does.
    f = facts.measure(_equations, "points")
    rate = np.max((f["after restoring"] - f["on"][:, None]) / precision().distances ** 2, axis=1)
    return facts.bound(
        "the violation after restoring x + t a over t^2", f, rate, CURVATURE * (1 + largest_entries(f["x"]))
    )


@fact
def generators_of_the_action_span_the_tangent_spaces(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """The infinitesimal generators of the group's action are tangent, and every tangent vector is a combination of
    them."""
    if not isinstance(facts.manifold, HomogeneousSpace):
        return Inapplicable("no group is said to act on this manifold")
    f = facts.measure(_generators, "points")
    coordinates = f["generators"] @ np.swapaxes(f["basis"], 1, 2)
    normal = largest_entries(f["generators"] - coordinates @ f["basis"])
    reached = np.linalg.pinv(coordinates) @ coordinates
    missed = largest_entries(reached - np.eye(reached.shape[1]))

    def hint(k: int) -> str:
        parts = np.max(np.abs(f["generators"][k] - coordinates[k] @ f["basis"][k]), axis=1)
        return f"generator {np.argmax(parts)} is not tangent" if normal[k] >= missed[k] else ""

    what = "the larger of normal part and missed directions"
    return facts.bound(what, f, np.maximum(normal, missed), 10 * facts.tolerance, hint=hint)


@fact
def momentum_pairs_covectors_with_the_generators(facts: ManifoldFacts) -> Comparison | Inapplicable:
    """``momentum(x, p)_i = <p, xi_i(x)>`` for any ambient covector ``p``."""
    if not isinstance(facts.manifold, HomogeneousSpace):
        return Inapplicable("no group is said to act on this manifold")
    f = facts.measure(_generators, "points")
    paired = np.einsum("kij,kj->ki", f["generators"], f["a"])
    return facts.compare("|J(x, p) - <p, xi(x)>|", f, f["momentum"], paired, 10 * facts.tolerance)


MANIFOLD_CHECKS = (
    random_points_are_on_the_manifold,
    random_points_differ,
    random_points_spread_in_every_direction,
    random_tangents_are_tangent,
    projection_is_idempotent,
    projection_is_symmetric,
    tangent_spaces_have_the_dimension,
    basis_is_orthonormal,
    basis_spans_the_image_of_the_projection,
    derivative_of_the_projection_is_that_of_differences,
    derivative_of_the_basis_keeps_it_an_orthonormal_basis,
    tangent_lines_touch_the_manifold,
    equations_see_normal_displacements,
    restore_is_the_identity_on_the_manifold,
    restore_makes_errors_second_order,
    generators_of_the_action_span_the_tangent_spaces,
    momentum_pairs_covectors_with_the_generators,
)


def check_manifold(
    manifold: Manifold,
    *,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object satisfies the interface of ``Manifold``, at random and special points.

    Parameters
    ----------
    manifold : Manifold
        The manifold.
    seeds : iterable of int
        One random point for each seed.
    points : iterable of points
        More points, in the shape of ``manifold.ambient``, besides identity, zero, poles and barycentres.
    tolerance : float, optional
        The allowed rounding in values and first derivatives, relative to ``1 +`` their size; by default 4500 machine
        epsilons, 1e-12 in double precision.
    only : str or iterable of str, optional
        The names of the checks to run; by default all.
    skip : dict of str to str, optional
        The names of checks to leave out, with reasons.
    throw : bool
        Whether to raise ``ConformanceError`` if a fact does not hold.

    Returns
    -------
    Report
        The outcomes.
    """
    return examine(
        ManifoldFacts(manifold, seeds=seeds, points=points, tolerance=tolerance), MANIFOLD_CHECKS, only, skip, throw
    )
