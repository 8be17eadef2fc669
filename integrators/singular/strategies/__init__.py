"""Integrators on the final constraint manifold ``P_f`` of singular problems."""

from .control_affine_splitting import ControlAffineSplitting
from .final_dynamics import FinalDynamics
from .final_manifold_stages import DirectIntegrator
from .goh_chain import ReductionChain, reduce_until_regular
from .goh_reduced_integrator import ReducedIntegrator
from .goh_reduction import GohReduction
from .hamiltonian_leaf_flow import leaf_flow
from .projection import ProjectedIntegrator
from .rattle import RattleIntegrator
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
