"""The door to geomstats. Importing it imports geomstats."""

from .space import RetraxMetric, RetraxSpace
from .spaces import conventions_of, counterpart

__all__ = ["RetraxMetric", "RetraxSpace", "conventions_of", "counterpart"]
