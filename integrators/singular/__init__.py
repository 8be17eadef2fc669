"""Singular problems: integrators on the final constraint manifold."""

from .strategies import ControlAffineSplitting, RattleIntegrator, leaf_flow

__all__ = ["ControlAffineSplitting", "RattleIntegrator", "leaf_flow"]
