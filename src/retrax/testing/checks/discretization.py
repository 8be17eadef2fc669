"""Facts about discretization maps: axioms, symmetry, inverse, derivatives."""

from collections.abc import Callable, Iterable

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import Product
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap
from ..draws import direction
from ..numerics import Vector, along, flat, unflat
from ..precision import WORST, precision
from ..properties import SAMPLE_SEEDS, Facts, Sample, examine, largest_entries
from ..report import Comparison, Inapplicable, Report, fact
from ..sites import Site
from .inverses import conditioning
from .manifold import max_violation

MAP_REACH = 0.3  # length of the tangent vectors of a sample, by default


class DiscretizationFacts(Facts):
    """Measured facts of a discretization map, at random points and tangent vectors.

    The kinds of samples are ``zero`` and ``inside`` (lengths up to ``reach``).
    """

    kind = DiscretizationMap
    subject: DiscretizationMap

    def __init__(
        self,
        discretization: DiscretizationMap,
        *,
        symmetric: bool = False,
        reach: float = MAP_REACH,
        seeds: Iterable[int] = SAMPLE_SEEDS,
        points: Iterable[Ambient] = (),
        tolerance: float | None = None,
    ) -> None:
        super().__init__(discretization, seeds, points, tolerance)
        self.symmetric, self.reach = symmetric, reach

    def draw(self, kind: str, site: Site) -> Sample:
        """``x`` and ``v``, a frame of ``T(TM)`` there, two points ``ends`` near ``x``, an ambient direction ``d`` of
        ``TM``."""
        x, (_, basis) = site.x, self.sampler.at(site.x, site.seed)
        rng = np.random.default_rng(site.seed)
        v = (0.0 if kind == "zero" else self.fraction(site) * self.reach) * direction(rng, basis)
        ends = np.stack([x, self.sampler.near(x, rng, 0.3 * self.reach)])
        d = rng.standard_normal((2, x.size)) / np.sqrt(x.size)
        return {"x": x, "v": v, "frame": self.sampler.bundle_frame(x, v), "ends": ends, "d": d}


def flat_ends(discretization: DiscretizationMap) -> Callable[[Vector], Vector]:
    """``(R1, R2)`` on flat vectors ``(x, v)``."""
    back = unflat(discretization.manifold)

    def ends(w: Vector) -> Vector:
        x, v = jnp.split(w, 2)
        return flat(discretization(back(x), back(v)))

    return ends


def both_ends(discretization: DiscretizationMap, sample: Sample) -> dict:
    """The two ends, their derivatives along the frame, and how much they violate the manifold's equations."""
    manifold = discretization.manifold
    value, push = jax.linearize(flat_ends(discretization), jnp.concatenate([sample["x"], sample["v"]]))
    ends = tuple(map(unflat(manifold), jnp.split(value, 2)))
    return {
        "value": value,
        "push": jax.vmap(push)(sample["frame"]),
        "violation": max_violation(Product(manifold, manifold), ends),
    }


def _reverse(discretization: DiscretizationMap, sample: Sample) -> dict:
    """The two ends at ``(x, v)``, and the exchanged ends at ``(x, -v)``."""
    ends, x, v = flat_ends(discretization), sample["x"], sample["v"]
    there, back = jax.vmap(lambda v: ends(jnp.concatenate([x, v])))(jnp.stack([v, -v]))
    return {"value": there, "exchanged": jnp.roll(back, x.size)}


def _inverse(discretization: DiscretizationMap, sample: Sample) -> dict:
    """The inverse at the two ends of ``(x, v)`` and at two points near each other, and the ends of the latter."""
    ends, back = flat_ends(discretization), unflat(discretization.manifold)
    given = jnp.stack([ends(jnp.concatenate([sample["x"], sample["v"]])), sample["ends"].reshape(-1)])
    found, nearby = jax.vmap(lambda y: flat(discretization.preimage(*map(back, jnp.split(y, 2)))))(given)
    return {"back": found, "there": ends(nearby)}


def _slopes(discretization: DiscretizationMap, sample: Sample) -> dict:
    """The derivative of the ends along ``d``, and values along it."""
    ends, w, d = flat_ends(discretization), jnp.concatenate([sample["x"], sample["v"]]), sample["d"].reshape(-1)
    return {"slope": jax.jvp(ends, (w,), (d,))[1], "values": along(lambda t: ends(w + t * d), precision().step)}


def push_of_the_fibre(f: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The tangent vectors ``e_i`` and the derivatives of both ends along ``(0, e_i)``, each of shape ``(samples, n,
    N)``."""
    fibre = f["frame"].shape[1] // 2
    first, second = np.split(f["push"][:, fibre:], 2, axis=2)
    return np.split(f["frame"][:, fibre:], 2, axis=2)[1], first, second


@fact
def zero_goes_to_the_base_point_twice(facts: DiscretizationFacts) -> Comparison:
    """``R_d(x, 0) = (x, x)``."""
    f = facts.measure(both_ends, "zero")
    return facts.compare("|R_d(x, 0) - (x, x)|", f, f["value"], np.tile(f["x"], 2), facts.tolerance)


@fact
def derivatives_of_the_ends_at_zero_differ_by_the_identity(facts: DiscretizationFacts) -> Comparison:
    """``D_v R2(x, 0) - D_v R1(x, 0) = Id`` on the tangent space."""
    f = facts.measure(both_ends, "zero")
    e, first, second = push_of_the_fibre(f)
    names = ("D_v R2(x, 0) - D_v R1(x, 0)", "the identity")
    return facts.compare("|D_v R2 E_i - D_v R1 E_i - E_i|", f, second - first, e, 10 * facts.tolerance, names)


@fact
def theta_says_where_the_base_point_sits(facts: DiscretizationFacts) -> Comparison:
    """To first order the ends are ``x - theta v`` and ``x + (1 - theta) v``."""
    f = facts.measure(both_ends, "zero")
    e, first, _ = push_of_the_fibre(f)
    return facts.compare("|D_v R1(x, 0) E_i + theta E_i|", f, first, -facts.subject.theta * e, 10 * facts.tolerance)


@fact
def ends_stay_on_the_manifold(facts: DiscretizationFacts) -> Comparison:
    """Both ends satisfy the manifold's equations."""
    f = facts.measure(both_ends, "zero", "inside")
    limit = 10 * facts.tolerance * (1 + largest_entries(f["value"]))
    return facts.bound("the largest violation of the equations", f, f["violation"], limit)


@fact
def map_is_its_own_adjoint(facts: DiscretizationFacts) -> Comparison | Inapplicable:
    """A symmetric map is its own adjoint: ``R1(x, -v) = R2(x, v)`` and ``R2(x, -v) = R1(x, v)``."""
    if not facts.symmetric:
        return Inapplicable("symmetry is not claimed")
    f = facts.measure(_reverse, "inside")
    return facts.compare("|R_d(x, v) - R_d*(x, v)|", f, f["value"], f["exchanged"], facts.tolerance)


@fact
def inverse_finds_the_tangent_vector(facts: DiscretizationFacts) -> Comparison:
    """``R_d^-1(R_d(x, v)) = (x, v)``, to rounding times the condition of ``R_d``."""
    f, ends = facts.measure(_inverse, "zero", "inside"), facts.measure(both_ends, "zero", "inside")
    condition = conditioning(ends["push"]) * np.linalg.norm(f["frame"], 2, axis=(1, 2))
    expected = np.concatenate([f["x"], f["v"]], axis=1)
    limit = np.minimum(10 * facts.tolerance * condition, WORST)
    return facts.compare("|R_d^-1(R_d(x, v)) - (x, v)|", f, f["back"], expected, limit)


@fact
def map_inverts_its_inverse(facts: DiscretizationFacts) -> Comparison:
    """``R_d(R_d^-1(x0, x1)) = (x0, x1)`` for two points near each other that were found without the map."""
    f = facts.measure(_inverse, "zero")
    ends = f["ends"].reshape(len(f["ends"]), -1)
    return facts.compare("|R_d(R_d^-1(x0, x1)) - (x0, x1)|", f, f["there"], ends, 10 * facts.tolerance)


@fact
def derivatives_of_the_ends_are_those_of_differences(facts: DiscretizationFacts) -> Comparison:
    """Automatic differentiation along ambient directions agrees with differences of values, at ``v = 0`` and
    elsewhere."""
    f = facts.measure(_slopes, "zero", "inside")
    return facts.compare_slopes("|D R_d - differences|", f, f["slope"], f["values"], precision().step)


DISCRETIZATION_CHECKS = (
    zero_goes_to_the_base_point_twice,
    derivatives_of_the_ends_at_zero_differ_by_the_identity,
    theta_says_where_the_base_point_sits,
    ends_stay_on_the_manifold,
    map_is_its_own_adjoint,
    inverse_finds_the_tangent_vector,
    map_inverts_its_inverse,
    derivatives_of_the_ends_are_those_of_differences,
)


def check_discretization_map(
    discretization: DiscretizationMap,
    *,
    symmetric: bool = False,
    reach: float = MAP_REACH,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object is a discretization map with the claimed inverse and ``theta``.

    Parameters
    ----------
    discretization : DiscretizationMap
        The map.
    symmetric : bool
        Whether it is claimed to be its own adjoint, hence of order 2.
    reach : float
        The length of the longest tangent vector, Euclidean in the ambient space.
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
    facts = DiscretizationFacts(
        discretization, symmetric=symmetric, reach=reach, seeds=seeds, points=points, tolerance=tolerance
    )
    return examine(facts, DISCRETIZATION_CHECKS, only, skip, throw)
