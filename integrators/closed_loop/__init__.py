"""Closed loops: a controller that solves at each sample, and the simulation of a controller with a plant."""

from .receding_horizon import RecedingHorizon
from .record import ClosedLoop, load_closed_loop
from .simulation import simulate
from .soft_constraints import soften
from .statistics import ControllerStatistics
from .tracking import tracking

__all__ = [
    "ClosedLoop",
    "ControllerStatistics",
    "RecedingHorizon",
    "load_closed_loop",
    "simulate",
    "soften",
    "tracking",
]
