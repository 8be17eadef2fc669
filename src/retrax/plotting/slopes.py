"""The errors from whose slope the conformance kit reads that a retraction agrees with the straight line."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..manifolds.numerics.differences import slope
from ..retractions import Retraction
from ..testing.checks.retraction import LENGTHS, short_errors
from ..testing.checks.retraction_facts import RetractionFacts
from ..testing.facts import SEEDS
from .axes import one


def slopes(retraction: Retraction, seeds: Iterable[int] = SEEDS, ax: Any = None) -> Any:
    """The errors ``|R(x, t u) - x - t u|`` against ``t`` for unit tangent vectors ``u``, as the conformance kit
    measures them.

    One line for each sample, its slope in the legend; dotted a line of slope 2, which a retraction has or exceeds, and
    shaded what the kit takes for rounding. Drawn as ``check_retraction`` of ManifoldsBase.jl does. Returns the axes;
    raises ``InvalidInputError`` for anything but a retraction.
    """
    facts = RetractionFacts(retraction, seeds=seeds)
    errors, floors = short_errors(facts)
    axis = one(ax)
    for site, row, floor in zip(facts.sites, errors, floors, strict=True):
        found = slope(LENGTHS, row, floor)
        words = f"slope {found:.3g}" if np.isfinite(found) else "no error"
        axis.loglog(LENGTHS, np.maximum(row, floor), ".-", label=f"{site.words}: {words}", linewidth=1)
    # Above all lines, so that it can be compared with each.
    axis.loglog(LENGTHS, 2 * np.max(errors / LENGTHS**2, initial=1e-3) * LENGTHS**2, "k:", label="slope 2")
    axis.axhspan(axis.get_ylim()[0], np.max(floors), color="0.9")
    axis.set_xlabel("t")
    axis.set_ylabel("|R(x, t u) - x - t u|")
    axis.set_title(str(retraction), fontsize="medium")
    axis.legend(fontsize="small")
    return axis
