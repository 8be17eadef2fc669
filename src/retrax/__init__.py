"""Geometric integration and optimal control on manifolds: ``import retrax as rx`` has the everyday names."""

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__
from .undisturbed import pause_garbage_collection

with pause_garbage_collection():
    from . import integrators, manifolds, retractions
from .former_names import find_former_modules
from .hardware_notices import leave_out
from .integrators import (
    Free,
    Guess,
    OptimalControlProblem,
    Phase,
    RecedingHorizon,
    Solver,
    classify,
    hold_controls,
    integrate,
    simulate,
    solve,
    solve_phases,
    tabulated,
    tracking,
)
from .loading import load
from .manifolds import SE, SO, SPD, SU, Euclidean, Grassmann, LevelSet, Sphere, Stiefel, hat
from .presentation import present_records
from .retractions import Cayley, Exponential, Gauss, Midpoint, Radau, default_retraction

if TYPE_CHECKING:
    from . import plotting, problems

__all__ = [
    "SE",
    "SO",
    "SPD",
    "SU",
    "Cayley",
    "Euclidean",
    "Exponential",
    "Free",
    "Gauss",
    "Grassmann",
    "Guess",
    "LevelSet",
    "Midpoint",
    "OptimalControlProblem",
    "Phase",
    "Radau",
    "RecedingHorizon",
    "Solver",
    "Sphere",
    "Stiefel",
    "__version__",
    "classify",
    "default_retraction",
    "hat",
    "hold_controls",
    "integrate",
    "integrators",
    "load",
    "manifolds",
    "plotting",
    "problems",
    "retractions",
    "simulate",
    "solve",
    "solve_phases",
    "tabulated",
    "tracking",
]
LAZY = "plotting", "problems"  # packages that take long to import

find_former_modules()
present_records()
leave_out()
logging.getLogger(__name__).addHandler(logging.NullHandler())  # what is heard of it is the user's choice


def __getattr__(name: str) -> Any:
    """The packages that are imported when they are asked for."""
    if name in LAZY:
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
