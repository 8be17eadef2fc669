"""Stages: one step of a discrete variational problem, with its unknowns, its ends and its cost."""

from typing import Any

from ...former_names import former
from .collocation import CollocationStage
from .control import ControlStage
from .hamiltonian import HamiltonianStage
from .held_controls import hold_controls
from .stage import Stage

__all__ = ["CollocationStage", "ControlStage", "HamiltonianStage", "Stage", "hold_controls"]


def __getattr__(name: str) -> Any:
    return former(__name__, {"GaussStage": "CollocationStage"}, name)
