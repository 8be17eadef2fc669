"""The integrability algorithm in exact algebra, for problems on R^n."""

from .algorithm import SymbolicStratum
from .symbolic_classification import SymbolicClassification, classify_symbolically

__all__ = ["SymbolicClassification", "SymbolicStratum", "classify_symbolically"]
