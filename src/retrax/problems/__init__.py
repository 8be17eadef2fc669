"""Problems with known answers, for examples, tests and comparisons: ``get("betts").solve()``."""

_LATER = "attitude, flat, flight, geodesics, machines, quantum, vehicles"  # imported once free horizons are there
from .record import KnownProblem, all, get, names
from .singular import SINGULAR, KnownClassification

__all__ = ["SINGULAR", "KnownClassification", "KnownProblem", "all", "get", "names"]
