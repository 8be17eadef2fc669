"""Singular problems: their classification, and integrators on the final constraint manifold."""

from .integrability import L_H, S_H, Classification, FinalEquations, Level, MorseTest, Stratum, classify, critical_set
from .integrability_result import Signature
from .strategies import (
    STRATEGIES,
    ControlAffineSplitting,
    DirectIntegrator,
    FinalDynamics,
    GohReduction,
    NotApplicableError,
    ProjectedIntegrator,
    RattleIntegrator,
    ReducedIntegrator,
    ReductionChain,
    SingularIntegrator,
    StageIntegrator,
    leaf_flow,
    reduce_until_regular,
    singular_integrator,
)

__all__ = [
    "L_H",
    "STRATEGIES",
    "S_H",
    "Classification",
    "ControlAffineSplitting",
    "DirectIntegrator",
    "FinalDynamics",
    "FinalEquations",
    "GohReduction",
    "Level",
    "MorseTest",
    "NotApplicableError",
    "ProjectedIntegrator",
    "RattleIntegrator",
    "ReducedIntegrator",
    "ReductionChain",
    "Signature",
    "SingularIntegrator",
    "StageIntegrator",
    "Stratum",
    "classify",
    "critical_set",
    "leaf_flow",
    "reduce_until_regular",
    "singular_integrator",
]
