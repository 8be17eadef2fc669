"""Geometric integration and optimal control on manifolds: a manifold and a retraction are all a user has to supply."""

import logging
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from .threads import ask_for_threads

ask_for_threads()  # before anything below makes JAX compute

from ._version import __version__
from .undisturbed import put_off

with put_off():
    from . import integrators, manifolds, retractions
from .integrators import Free

if TYPE_CHECKING:
    from . import problems

__all__ = ["Free", "__version__", "integrators", "manifolds", "problems", "retractions"]

logging.getLogger(__name__).addHandler(logging.NullHandler())  # what is heard of it is the user's choice


def __getattr__(name: str) -> ModuleType:
    """``problems``, which takes as long to import as a solve, when it is asked for."""
    if name == "problems":
        return import_module(".problems", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
