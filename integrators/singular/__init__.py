"""Singular problems: their classification, and integrators on the final constraint manifold."""

from .integrability import (
    L_H,
    S_H,
    Classification,
    FinalEquations,
    Level,
    MorseTest,
    Signature,
    Stratum,
    classify,
    critical_set,
)
from .strategies import ControlAffineSplitting, RattleIntegrator, leaf_flow

__all__ = [
    "L_H",
    "S_H",
    "Classification",
    "ControlAffineSplitting",
    "FinalEquations",
    "Level",
    "MorseTest",
    "RattleIntegrator",
    "Signature",
    "Stratum",
    "classify",
    "critical_set",
    "leaf_flow",
]
