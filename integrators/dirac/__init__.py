"""Dirac systems: Hamilton's equations with nonholonomic constraints."""

from .integrator import DiracIntegrator
from .system import DiracSystem

__all__ = ["DiracIntegrator", "DiracSystem"]
