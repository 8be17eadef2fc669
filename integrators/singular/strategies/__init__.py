"""Integrators on the final constraint manifold ``P_f`` of singular problems."""

from .affine import ControlAffineSplitting
from .choice import STRATEGIES, singular_integrator
from .direct import DirectIntegrator
from .dynamics import FinalDynamics
from .leaves import leaf_flow
from .project import ProjectedIntegrator
from .rattle import RattleIntegrator
from .stage import StageIntegrator
from .strategy import NotApplicableError, SingularIntegrator

__all__ = [
    "STRATEGIES",
    "ControlAffineSplitting",
    "DirectIntegrator",
    "FinalDynamics",
    "NotApplicableError",
    "ProjectedIntegrator",
    "RattleIntegrator",
    "SingularIntegrator",
    "StageIntegrator",
    "leaf_flow",
    "singular_integrator",
]
