"""Facts about the inverse of a retraction: its values, its domain, its derivatives."""

import numpy as np

from ..precision import WORST, precision
from ..properties import largest_entries
from ..report import Comparison, entries, fact, number
from .derivatives import first_derivatives
from .retraction_properties import RetractionFacts


def conditioning(push: np.ndarray) -> np.ndarray:
    """Norm of the inverse of ``D_v R`` at each sample, the factor from errors of points to errors of tangent
    vectors."""
    singular = np.linalg.svd(np.nan_to_num(push), compute_uv=False)
    return 1 / np.maximum(np.min(singular, axis=1, initial=1.0), np.finfo(float).tiny)


@fact
def inverse_finds_the_tangent_vector(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v``, to rounding times the condition of ``R_x``."""
    return _inverse_error(facts, "zero", "inside")


@fact
def inverse_is_exact_up_to_the_edge_of_the_domain(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v`` up to ``sqrt(eps)`` from the edge of the domain, to rounding times the condition of
    ``R_x``."""
    return _inverse_error(facts, "far", "edge")


def _inverse_error(facts: RetractionFacts, *kinds: str) -> Comparison:
    f, push = facts.inverses(*kinds), facts.measure(first_derivatives, *kinds)["push"]
    condition = conditioning(push)
    # An inverse with fewer than three digits is none, whatever the condition; that grows as 1 / d at the distance d
    # from an edge.
    limit = np.minimum(facts.tolerance * condition * np.maximum(1.0, largest_entries(f["value"])), WORST)

    def hint(k: int) -> str:
        words = f", and D_v R is singular there, its condition is {number(condition[k])}"
        singular = words if condition[k] * precision().tiny > 1 else ""
        length = np.linalg.norm(f["v"][k])
        return (
            f"preimage misses this v, {number(float(length))} long, which the domain has{singular}; try an inverse of "
            "R_x that finds v, or a domain that ends before v"
            if length > 0
            else ""
        )

    return facts.compare("|R_x^-1(R(x, v)) - v|", f, f["back"], f["v"], limit, ("R_x^-1(R(x, v))", "v"), hint)


@fact
def inverse_keeps_the_accuracy_of_short_vectors(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(R(x, v)) = v`` for vectors from ``eps^(3/4)`` to ``eps^(1/2)`` long, to the rounding of the two
    points."""
    f = facts.inverses("tiny")
    limit = 0.01 * facts.tolerance * (1 + largest_entries(f["x"])) ** 2
    return facts.bound("|R_x^-1(R(x, v)) - v|", f, largest_entries(f["back"] - f["v"]), limit)


@fact
def retraction_inverts_its_inverse(facts: RetractionFacts) -> Comparison:
    """``R(x, R_x^-1(y)) = y`` for points ``y`` that were found without the retraction."""
    f = facts.inverses("zero")
    return facts.compare("|R(x, R_x^-1(y)) - y|", f, f["there"], f["y"], facts.tolerance)


@fact
def inverse_is_tangent(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(y)`` is a tangent vector at ``x``."""
    f = facts.inverses("zero")
    tangential = np.einsum("ki,kji,kjl->kl", f["to y"], f["frame"], f["frame"])
    return facts.compare("the normal part of R_x^-1(y)", f, tangential, f["to y"], facts.tolerance)


@fact
def inverse_is_NaN_outside_the_image(facts: RetractionFacts) -> Comparison:
    """``R_x^-1(y)`` of any point ``y``, far from ``x`` too, is tangent and leads to ``y``, or has entries that are
    NaN."""
    f = facts.inverses_of_far_points()

    def hint(k: int) -> str:
        return (
            f"y = {entries(f['far'][k])} has the inverse {entries(f['to far'][k])}; try NaN where no tangent "
            "vector leads to y"
        )

    limit = precision().half
    return facts.bound("|R(x, R_x^-1(y)) - y|, relative to the sizes of x and y,", f, f["missed"], limit, hint=hint)


@fact
def inverse_has_the_derivatives_of_its_differences(facts: RetractionFacts) -> Comparison:
    """Reverse mode through ``R_x^-1(y)``, by both points, agrees with differences of its values, at ``x = y`` and
    elsewhere."""
    f = facts.inverses_nearby("zero", "inside")
    return facts.compare_slopes("|D R_x^-1(y) - differences|", f, f["slope"], f["values"], f["step"])


INVERSE_CHECKS = (
    inverse_finds_the_tangent_vector,
    inverse_is_exact_up_to_the_edge_of_the_domain,
    inverse_keeps_the_accuracy_of_short_vectors,
    inverse_is_NaN_outside_the_image,
    retraction_inverts_its_inverse,
    inverse_is_tangent,
    inverse_has_the_derivatives_of_its_differences,
)
