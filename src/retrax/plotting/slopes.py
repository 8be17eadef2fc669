"""The errors from whose slope the conformance kit reads that a retraction agrees with the straight line."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..manifolds.numerics.differences import slope
from ..retractions import Retraction
from ..testing.checks.retraction import ORDER_LENGTHS, short_errors
from ..testing.checks.retraction_properties import RetractionFacts
from ..testing.properties import SAMPLE_SEEDS
from .axes import legend, one


def slopes(retraction: Retraction, seeds: Iterable[int] = SAMPLE_SEEDS, ax: Any = None) -> Any:
    """The errors :math:`|R(x, tu) - x - tu|` against ``t`` for unit tangent vectors ``u``, as the conformance kit
    measures them.

    Parameters
    ----------
    retraction : Retraction
        The retraction; ``InvalidInputError`` for another object.
    seeds : iterable of int
        One random sample for each seed.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes: a line for each sample with its slope, a dotted line of slope 2, and the rounding shaded.

    Notes
    -----
    A retraction has a slope of at least 2. ``check_retraction`` of ManifoldsBase.jl draws the same picture.
    """
    facts = RetractionFacts(retraction, seeds=seeds)
    errors, floors = short_errors(facts)
    axis = one(ax)
    for site, row, floor in zip(facts.sites, errors, floors, strict=True):
        found = slope(ORDER_LENGTHS, row, floor)
        words = f"slope {found:.3g}" if np.isfinite(found) else "no error"
        axis.loglog(ORDER_LENGTHS, np.maximum(row, floor), ".-", label=f"{site.words}: {words}", linewidth=1)
    # Above all lines, so that it can be compared with each.
    axis.loglog(
        ORDER_LENGTHS, 2 * np.max(errors / ORDER_LENGTHS**2, initial=1e-3) * ORDER_LENGTHS**2, "k:", label="slope 2"
    )
    axis.axhspan(axis.get_ylim()[0], np.max(floors), color="0.9")
    axis.set_xlabel("t")
    axis.set_ylabel("|R(x, t u) - x - t u|")
    axis.set_title(str(retraction), fontsize="medium")
    legend(axis)
    return axis
