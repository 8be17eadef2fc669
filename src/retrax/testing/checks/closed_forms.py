"""Facts about what a retraction knows in closed form beside its values: charts, pairs, midpoints."""

import jax.numpy as jnp

from ...retractions import MidpointRetraction, Retraction
from ..numerics import flat, unflat
from ..properties import Sample
from ..report import Comparison, Inapplicable, fact
from .retraction_properties import RetractionFacts

NO_MIDPOINT = "no midpoint is claimed"


def _closed_forms(retraction: Retraction, sample: Sample) -> dict:
    """``R(x, v)`` and ``R(x, -v)`` beside the chart and the pair, from the coordinates of ``v``."""
    back, v = unflat(retraction.manifold), sample["v"]
    x = back(sample["x"])
    pair = retraction.both_ways(x, back(v))
    return {
        "values": jnp.stack(
            [flat(retraction(x, back(v))), flat(retraction(x, back(v))), flat(retraction(x, back(-v)))]
        ),
        "closed": jnp.stack(
            [flat(retraction.chart(x, retraction.frame(x), sample["frame"] @ v)), flat(pair[1]), flat(pair[0])]
        ),
    }


@fact
def closed_forms_are_the_retraction_itself(facts: RetractionFacts) -> Comparison | Inapplicable:
    """``chart(x, frame(x), c) = R(x, sum_k c_k E_k)`` and ``both_ways(x, v) = (R(x, -v), R(x, v))``, which integrators
    call."""
    if facts.subject.closed_forms.isdisjoint({"chart", "both_ways"}):
        return Inapplicable("chart and both_ways are derived from the values")
    f = facts.measure(_closed_forms, "inside")
    return facts.compare(
        "the difference of a closed form from the values", f, f["closed"], f["values"], facts.tolerance
    )


@fact
def midpoint_lies_midway(facts: RetractionFacts) -> Comparison | Inapplicable:
    """The midpoint ``m`` of two points has ``R_m^-1(x0) = -R_m^-1(x1)``."""
    if not isinstance(facts.subject, MidpointRetraction):
        return Inapplicable(NO_MIDPOINT)
    f = facts.midpoints_nearby()
    return facts.compare("|R_m^-1(x0) + R_m^-1(x1)|", f, f["to x"] + f["to y"], 0.0, 10 * facts.tolerance)


@fact
def midpoint_has_the_derivatives_of_its_differences(facts: RetractionFacts) -> Comparison | Inapplicable:
    """Reverse mode through the midpoint, by both points, agrees with differences of its values."""
    if not isinstance(facts.subject, MidpointRetraction):
        return Inapplicable(NO_MIDPOINT)
    f = facts.midpoints_nearby()
    return facts.compare_slopes("|D midpoint - differences|", f, f["slope"], f["values"], f["step"])
