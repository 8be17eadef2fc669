"""Stages: one step of a discrete variational problem, with its unknowns, its ends and its cost."""

from .control import ControlStage
from .gauss import GaussStage
from .hamiltonian import HamiltonianStage
from .stage import Stage

__all__ = ["ControlStage", "GaussStage", "HamiltonianStage", "Stage"]
