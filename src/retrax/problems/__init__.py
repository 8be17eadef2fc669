"""Problems with known answers, for examples, tests and comparisons: ``get("betts").solve()``."""

from . import attitude, control_limits, flat, flight, geodesics, machines, quantum, vehicles  # noqa: F401  # pyright: ignore[reportUnusedImport]  # they fill the library
from .record import KnownProblem, all, get, names
from .singular import SINGULAR, KnownClassification

__all__ = ["SINGULAR", "KnownClassification", "KnownProblem", "all", "get", "names"]
