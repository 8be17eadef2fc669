"""Problems with known answers, for examples, tests and comparisons."""

from .singular import SINGULAR, KnownClassification

__all__ = ["SINGULAR", "KnownClassification"]
