"""Matrix Lie groups."""

from .matrix_lie_group import MatrixLieGroup
from .metric import LeftInvariantMetric
from .special_euclidean import SE
from .special_linear import SL
from .special_orthogonal import SO, hat, vee
from .unitary import SU, U

__all__ = ["SE", "SL", "SO", "SU", "LeftInvariantMetric", "MatrixLieGroup", "U", "hat", "vee"]
