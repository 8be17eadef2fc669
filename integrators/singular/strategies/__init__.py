"""Integrators on the final constraint manifold ``P_f`` of singular problems."""

from .affine import ControlAffineSplitting
from .chain import ReductionChain, reduce_until_regular
from .direct import DirectIntegrator
from .dynamics import FinalDynamics
from .leaves import leaf_flow
from .project import ProjectedIntegrator
from .rattle import RattleIntegrator
from .reduced import ReducedIntegrator
from .reduction import GohReduction
from .stage_integrator import StageIntegrator
from .strategy import NotApplicableError, SingularIntegrator
from .strategy_choice import STRATEGIES, Choice, singular_integrator

__all__ = [
    "STRATEGIES",
    "Choice",
    "ControlAffineSplitting",
    "DirectIntegrator",
    "FinalDynamics",
    "GohReduction",
    "NotApplicableError",
    "ProjectedIntegrator",
    "RattleIntegrator",
    "ReducedIntegrator",
    "ReductionChain",
    "SingularIntegrator",
    "StageIntegrator",
    "leaf_flow",
    "reduce_until_regular",
    "singular_integrator",
]
