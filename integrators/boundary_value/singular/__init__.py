"""Boundary-value problems of singular extremals: multiple shooting on the final manifold ``P_f``."""

from .conditions import EndConditions
from .extremals import Request, solve_on_final_manifold
from .shooting import Shooting, StepwiseGauge

__all__ = ["EndConditions", "Request", "Shooting", "StepwiseGauge", "solve_on_final_manifold"]
