"""Singular problems: their classification, and integrators on the final constraint manifold."""

from . import integrability, strategies
from .integrability import *
from .strategies import *

__all__: list[str] = []
__all__ += integrability.__all__
__all__ += strategies.__all__
