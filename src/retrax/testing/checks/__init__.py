"""The checks, one module for each kind of object that they are about."""

from .cotangent_lift import COTANGENT_LIFT_CHECKS, CotangentLiftFacts, check_cotangent_lift
from .discretization import DISCRETIZATION_CHECKS, DiscretizationFacts, check_discretization_map
from .lie_group import LIE_GROUP_CHECKS, LieGroupFacts, check_lie_group
from .manifold import MANIFOLD_CHECKS, ManifoldFacts, check_manifold
from .metric import METRIC_CHECKS, MetricFacts, check_metric
from .retraction import RETRACTION_CHECKS, check_retraction
from .retraction_properties import RetractionFacts

__all__ = [
    "COTANGENT_LIFT_CHECKS",
    "DISCRETIZATION_CHECKS",
    "LIE_GROUP_CHECKS",
    "MANIFOLD_CHECKS",
    "METRIC_CHECKS",
    "RETRACTION_CHECKS",
    "CotangentLiftFacts",
    "DiscretizationFacts",
    "LieGroupFacts",
    "ManifoldFacts",
    "MetricFacts",
    "RetractionFacts",
    "check_cotangent_lift",
    "check_discretization_map",
    "check_lie_group",
    "check_manifold",
    "check_metric",
    "check_retraction",
]
