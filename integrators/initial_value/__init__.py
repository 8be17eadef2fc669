"""Initial-value problems on T*Q: one lifted step, the integrators made of it, and trajectories."""

from .integrator import Integrator, PresymplecticIntegrator, SymplecticIntegrator
from .step import StepResult, lifted_step
from .trajectory import Trajectory, integrate

__all__ = [
    "Integrator",
    "PresymplecticIntegrator",
    "StepResult",
    "SymplecticIntegrator",
    "Trajectory",
    "integrate",
    "lifted_step",
]
