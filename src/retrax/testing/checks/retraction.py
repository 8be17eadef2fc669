"""Facts about retractions: axioms, order, inverse and domain, derivatives."""

from collections.abc import Iterable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import Metric
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.differences import slope
from ...retractions import Retraction, acceleration
from ..numerics import flat, is_hidden, unflat
from ..precision import precision
from ..properties import SAMPLE_SEEDS, Sample, examine, largest_entries
from ..report import Comparison, Inapplicable, Report, entries, fact
from . import derivatives, inverses
from .closed_forms import (
    closed_forms_are_the_retraction_itself,
    midpoint_has_the_derivatives_of_its_differences,
    midpoint_lies_midway,
)
from .manifold import max_violation
from .retraction_properties import SAMPLE_REACH, RetractionFacts

ORDER_LENGTHS = 2.0 ** -np.arange(4, 15)  # of which those are read at which the error is above rounding


def _values(retraction: Retraction, sample: Sample) -> dict:
    """Values at ``(x, v)``, alone and in a batch, and on short multiples of ``u``; violations at the value and off
    it."""
    move, x, v = derivatives.flat_retraction(retraction), sample["x"], sample["v"]
    multiples = jnp.concatenate([v[None], 0 * v[None], jnp.asarray(ORDER_LENGTHS, v.dtype)[:, None] * sample["u"]])
    value, at_zero, *short = jax.vmap(move)(jnp.broadcast_to(x, multiples.shape), multiples)
    off = precision().half * (1 + jnp.max(jnp.abs(value))) * jnp.concatenate([sample["d"], sample["e"]])
    nearby = value + jnp.concatenate([0 * value[None], off])
    violations = jax.vmap(lambda y: max_violation(retraction.manifold, unflat(retraction.manifold)(y)))(nearby)
    rest = {"violation": violations[0], "violations nearby": violations[1:]}
    return {"value": value, "at zero": at_zero, "short": jnp.stack(short), "alone": move(x, v), **rest}


@fact
def zero_goes_to_the_base_point(facts: RetractionFacts) -> Comparison:
    """``R(x, 0) = x``."""
    f = facts.measure(_values, "zero")
    return facts.compare("|R(x, 0) - x|", f, f["at zero"], f["x"], facts.tolerance)


@fact
def derivative_at_zero_is_the_identity(facts: RetractionFacts) -> Comparison:
    """``D_v R(x, 0) = Id`` on the tangent space."""
    f = facts.measure(derivatives.first_derivatives, "zero")

    def hint(k: int) -> str:
        stretched = np.linalg.svd(np.nan_to_num(f["push"][k]), compute_uv=False)
        return "" if np.ptp(stretched) < precision().half else f"its singular values are {entries(stretched)}"

    names = ("D_v R(x, 0)", "the identity")
    return facts.compare("|D_v R(x, 0) E_i - E_i|", f, f["push"], f["frame"], facts.tolerance, names, hint)


def short_errors(facts: RetractionFacts) -> tuple[np.ndarray, np.ndarray]:
    """``|R(x, t u) - x - t u|`` for each sample and each ``t`` of ``ORDER_LENGTHS``, and for each sample what is
    rounding of it."""
    f = facts.measure(_values, "zero")
    errors = np.linalg.norm(f["short"] - f["x"][:, None] - ORDER_LENGTHS[None, :, None] * f["u"][:, None], axis=2)
    return errors, precision().floor * (1 + largest_entries(f["x"]))


@fact
def error_against_the_straight_line_is_of_second_order(facts: RetractionFacts) -> Comparison:
    """The error ``R(x, t u) - x - t u`` is ``O(t^2)`` by values alone, measured by the slope of its logarithm."""
    f, (errors, floor) = facts.measure(_values, "zero"), short_errors(facts)
    slopes = [
        slope(ORDER_LENGTHS, e, limit) if np.all(np.isfinite(e)) else np.nan
        for e, limit in zip(errors, floor, strict=True)
    ]
    hidden = [is_hidden(e, limit) for e, limit in zip(errors, floor, strict=True)]
    found = facts.bound("the slope of log error over log t", f, slopes, 1.8, "at least")
    return replace(found, hidden=np.array(hidden), because="the errors of most lengths are below rounding")


@fact
def values_stay_on_the_manifold(facts: RetractionFacts) -> Comparison:
    """``R(x, v)`` satisfies the manifold's equations to its rounding, for short vectors and up to the edge of the
    domain."""
    f = facts.measure(_values, "inside", "far", "edge")
    displaced = np.max(np.abs(f["violations nearby"] - f["violation"][:, None]), axis=1)
    # Equations such as det x = 1 magnify the rounding of large values: by as much as they do a larger displacement.
    magnified = np.maximum(1.0 + largest_entries(f["value"]), displaced / precision().half)
    # Not by so much that the points where an inequality begins to be violated count as rounding.
    limit = np.minimum(facts.tolerance * magnified, precision().quarter * (1.0 + largest_entries(f["value"])))

    def hint(k: int) -> str:
        return facts.manifold.contains(facts.sampler.unflat(f["value"][k])).reason

    return facts.bound("the largest violation of the equations", f, f["violation"], limit, hint=hint)


@fact
def batches_are_the_values_one_by_one(facts: RetractionFacts) -> Comparison:
    """``R`` under ``vmap`` has the values of ``R`` at one point."""
    f = facts.measure(_values, "zero", "inside")
    return facts.compare("the difference of the two values", f, f["value"], f["alone"], facts.tolerance)


@fact
def order_is_as_claimed(facts: RetractionFacts) -> Comparison | Inapplicable:
    """A retraction of order 2 for a metric has curves ``R(x, t w)`` without covariant acceleration at ``t = 0``."""
    if facts.order == 1:
        return Inapplicable("order 2 is not claimed")

    def accelerations(retraction: Retraction, sample: Sample) -> dict:
        back = unflat(retraction.manifold)
        return {"acceleration": flat(acceleration(retraction, facts.metric, back(sample["x"]), back(sample["w"])))}

    f = facts.measure(accelerations, "zero")
    return facts.compare("the acceleration", f, f["acceleration"], 0.0, 10 * facts.tolerance)


@fact
def domain_reaches_as_far_as_expected(facts: RetractionFacts) -> Comparison:
    """Tangent vectors up to the length ``reach`` lie in the domain, where the inverse is known to be valid."""
    f = facts.measure(_values, "zero")
    # An edge at this length is found to rounding only.
    limit = facts.reach * (1 - precision().half)
    derived = "domain" not in facts.subject.closed_forms

    def hint(_: int) -> str:
        return "the domain ends where preimage(x, R(x, v)) is not v; try another preimage" if derived else ""

    return facts.bound("the length of the domain in a random direction", f, f["edge"], limit, "at least", hint)


RETRACTION_CHECKS = (
    zero_goes_to_the_base_point,
    derivative_at_zero_is_the_identity,
    error_against_the_straight_line_is_of_second_order,
    values_stay_on_the_manifold,
    batches_are_the_values_one_by_one,
    order_is_as_claimed,
    domain_reaches_as_far_as_expected,
    *inverses.INVERSE_CHECKS,
    *derivatives.DERIVATIVE_CHECKS,
    closed_forms_are_the_retraction_itself,
    midpoint_lies_midway,
    midpoint_has_the_derivatives_of_its_differences,
)


def check_retraction(
    retraction: Retraction,
    *,
    order: int = 1,
    metric: Metric | None = None,
    reach: float = SAMPLE_REACH,
    seeds: Iterable[int] = SAMPLE_SEEDS,
    points: Iterable[Ambient] = (),
    tolerance: float | None = None,
    only: Iterable[str] | str | None = None,
    skip: dict[str, str] | None = None,
    throw: bool = True,
) -> Report:
    """Measure whether an object is a retraction with the claimed inverse, domain and derivatives.

    Parameters
    ----------
    retraction : Retraction
        The retraction.
    order : int
        2 if it is claimed to be of second order for ``metric``.
    metric : Metric, optional
        The metric; by default the embedded metric.
    reach : float
        Tangent vectors up to this length, Euclidean in the ambient space, must lie in the domain.
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
    claims = {"order": order, "metric": metric, "reach": reach}
    facts = RetractionFacts(retraction, **claims, seeds=seeds, points=points, tolerance=tolerance)
    return examine(facts, RETRACTION_CHECKS, only, skip, throw)
