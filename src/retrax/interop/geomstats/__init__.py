"""The door to geomstats. Importing it imports geomstats."""

from typing import Any

import numpy as np

_numpy: Any = np
_lacks_trapz = not hasattr(np, "trapz")  # geomstats 2.8 imports the name, which NumPy 2.4 no longer has
if _lacks_trapz:
    _numpy.trapz = np.trapezoid
try:
    from .space import RetraxMetric, RetraxSpace
    from .spaces import conventions_of, counterpart
finally:
    if _lacks_trapz:
        del _numpy.trapz

__all__ = ["RetraxMetric", "RetraxSpace", "conventions_of", "counterpart"]
