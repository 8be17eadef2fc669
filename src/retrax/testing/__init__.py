"""The conformance kit: what manifolds, groups, metrics, retractions, discretization maps and cotangent lifts must be,
measured.

By hand, ``print(check_retraction(R))``; from pytest, ``parametrize_with_checks``. ``retrax.testing.strategies`` has
hypothesis strategies for points, tangent vectors and covectors.
"""

from .checks import (
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_metric,
    check_retraction,
)
from .report import Check, ConformanceError, Outcome, Report
from .suites import list_checks, parametrize_with_checks

__all__ = [
    "Check",
    "ConformanceError",
    "Outcome",
    "Report",
    "check_cotangent_lift",
    "check_discretization_map",
    "check_lie_group",
    "check_manifold",
    "check_metric",
    "check_retraction",
    "list_checks",
    "parametrize_with_checks",
]
