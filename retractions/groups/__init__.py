"""Retractions of matrix Lie groups."""

from .special_orthogonal import SOQR, SOCayley, SOExponential, SOPolar

__all__ = ["SOQR", "SOCayley", "SOExponential", "SOPolar"]
