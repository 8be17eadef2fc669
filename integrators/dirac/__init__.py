"""Dirac systems: Hamilton's equations with nonholonomic constraints."""

from .dirac_integrator import DiracIntegrator
from .dirac_system import DiracSystem

__all__ = ["DiracIntegrator", "DiracSystem"]
