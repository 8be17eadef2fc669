"""Boundary-value problems of singular extremals: multiple shooting on the final manifold ``P_f``."""

from .end_conditions import EndConditions
from .extremals import solve_on_final_manifold
from .segments import Shooting, StepwiseGauge

__all__ = ["EndConditions", "Shooting", "StepwiseGauge", "solve_on_final_manifold"]
