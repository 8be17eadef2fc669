"""What a space of another library becomes here."""

from typing import NamedTuple

from ..manifolds import Manifold, Metric
from ..retractions import Retraction
from .conventions import Conventions


class Counterpart(NamedTuple):
    """Our manifold, retraction and metric for a space of another library, and how that writes points and tangent
    vectors.

    ``metric`` is the embedded one where theirs is not known here.

    ``conventions.point(x)`` and ``conventions.tangent(x, v)`` take theirs to ours, ``conventions.lift(q)`` and
    ``conventions.coordinates(x, w)`` ours to theirs.
    """

    manifold: Manifold
    retraction: Retraction
    metric: Metric
    conventions: Conventions
