"""Thousands of solves over parameters, on any executor, into a folder in which nothing is lost."""

from .record import Sweep, load_sweep
from .study import Study
from .sweep import sweep

__all__ = ["Study", "Sweep", "load_sweep", "sweep"]
