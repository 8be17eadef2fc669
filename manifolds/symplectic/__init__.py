"""Symplectic and presymplectic geometry: forms, Lagrangian submanifolds, the Tulczyjew triple."""

from .forms import difference, form_matrix, pullback_form, tangent_lift
from .lagrangian import Immersion, LagrangianVerdict, graph, is_lagrangian, preimage
from .presymplectic import PresymplecticManifold
from .triple import Phi, Phi_inverse, TulczyjewTriple, alpha, alpha_inverse, beta, beta_inverse

__all__ = [
    "Immersion",
    "LagrangianVerdict",
    "Phi",
    "Phi_inverse",
    "PresymplecticManifold",
    "TulczyjewTriple",
    "alpha",
    "alpha_inverse",
    "beta",
    "beta_inverse",
    "difference",
    "form_matrix",
    "graph",
    "is_lagrangian",
    "preimage",
    "pullback_form",
    "tangent_lift",
]
