"""The types of a pass, as ``pursuit_kernels.pursue`` takes and gives them: for who compiles it without a call."""

from numba import types
from numba.core.typing.templates import signature

from .trial_kernels import ADDRESSES, F1, INDICES, PLACES, REAL, TRUTH, WHOLE

TWO, THREE = types.UniTuple(REAL, 2), types.UniTuple(REAL, 3)
FIVE, SEVEN, NINE = types.UniTuple(REAL, 5), types.UniTuple(REAL, 7), types.UniTuple(REAL, 9)
VECTORS = types.UniTuple(F1, 3)
LIMITS = types.Tuple((REAL, FIVE, REAL, REAL))
RULES = types.Tuple(
    (REAL, types.Tuple((NINE, FIVE)), SEVEN, THREE, TWO, REAL, TWO, types.Tuple((REAL, THREE)), THREE, LIMITS)
)

GIVEN = ADDRESSES, INDICES, F1, VECTORS, VECTORS, PLACES, RULES, F1, WHOLE, TRUTH
PURSUE = signature(types.UniTuple(WHOLE, 2), *GIVEN)
