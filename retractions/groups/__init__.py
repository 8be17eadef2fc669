"""Retractions of matrix Lie groups."""

from .frobenius import FrobeniusExponential
from .group_map import GroupRetraction, SymmetricGroupRetraction, Translated
from .matrix_group import GroupCayley, GroupExponential
from .special_euclidean import SEDecoupled
from .special_orthogonal import SOQR, SOCayley, SOPolar
from .unitary import UQR, UPolar

__all__ = [
    "SOQR",
    "UQR",
    "FrobeniusExponential",
    "GroupCayley",
    "GroupExponential",
    "GroupRetraction",
    "SEDecoupled",
    "SOCayley",
    "SOPolar",
    "SymmetricGroupRetraction",
    "Translated",
    "UPolar",
]
