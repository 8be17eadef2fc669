"""Integrators on the final constraint manifold ``P_f`` of singular problems."""

from .affine import ControlAffineSplitting
from .leaves import leaf_flow
from .rattle import RattleIntegrator

__all__ = ["ControlAffineSplitting", "RattleIntegrator", "leaf_flow"]
