"""Geometric integration and optimal control on manifolds: a manifold and a retraction are all a user has to supply."""

from . import integrators, manifolds, problems, retractions
from ._version import __version__
from .integrators import Free

__all__ = ["Free", "__version__", "integrators", "manifolds", "problems", "retractions"]
