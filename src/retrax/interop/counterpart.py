"""The counterpart here of a space of another library."""

from typing import NamedTuple

from ..manifolds import Manifold, Metric
from ..retractions import Retraction
from .conventions import Conventions


class Counterpart(NamedTuple):
    """A manifold, retraction and metric of retrax for a space of another library, with its conventions.

    Attributes
    ----------
    manifold : Manifold
        The manifold.
    retraction : Retraction
        The retraction.
    metric : Metric
        The metric; the embedded metric if the metric of the space is not known.
    conventions : Conventions
        ``point(x)`` and ``tangent(x, v)`` map to retrax, ``lift(q)`` and ``coordinates(x, w)`` map back.
    """

    manifold: Manifold
    retraction: Retraction
    metric: Metric
    conventions: Conventions
