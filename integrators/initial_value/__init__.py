"""Initial-value problems on T*Q: one lifted step, the integrators made of it, and trajectories."""

from .batch import integrate_many
from .composition import KAHAN_LI_6, KAHAN_LI_8, SUZUKI, TRIPLE_JUMP, YOSHIDA_6, Composition
from .flow import Flow
from .geodesic import GeodesicRetraction
from .integrate import integrate
from .integrator import Integrator, LiftedIntegrator, PresymplecticIntegrator, SymplecticIntegrator
from .preservation import symplecticity_defect
from .trajectory import Trajectory, load_trajectory

__all__ = [
    "KAHAN_LI_6",
    "KAHAN_LI_8",
    "SUZUKI",
    "TRIPLE_JUMP",
    "YOSHIDA_6",
    "Composition",
    "Flow",
    "GeodesicRetraction",
    "Integrator",
    "LiftedIntegrator",
    "PresymplecticIntegrator",
    "SymplecticIntegrator",
    "Trajectory",
    "integrate",
    "integrate_many",
    "load_trajectory",
    "symplecticity_defect",
]
