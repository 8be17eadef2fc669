"""Singular problems: their classification, and integrators on the final constraint manifold."""

from .integrability import L_H, S_H, Classification, MorseTest, Stratum, classify
from .strategies import Choice, SingularIntegrator, singular_integrator

__all__ = [
    "L_H",
    "S_H",
    "Choice",
    "Classification",
    "MorseTest",
    "SingularIntegrator",
    "Stratum",
    "classify",
    "singular_integrator",
]
