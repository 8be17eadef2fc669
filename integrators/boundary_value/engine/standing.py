"""What stands between the trials of a compiled pass."""

from typing import NamedTuple

import numpy as np


class Standing(NamedTuple):
    """What stands between the trials of a pursuit, in the order of ``pursuit_kernels``."""

    promised: float = 0.0
    turned: float = 0.0
    missing: float = 0.0
    cost: float = 0.0
    held: float = 0.0
    funnel: float = 0.0
    best: float = 0.0
    first: bool = False  # no trial was judged before
    correction: float = np.inf
    isolated: bool = False
    shift: float = 0.0


STANDING = len(Standing._fields)


def standing_with_costs(standing: Standing, most: int) -> np.ndarray:
    """What stands, as a pass takes it, and room for the cost of a guess and after each of so many steps."""
    numbers = np.zeros(STANDING + most + 1)
    numbers[:STANDING] = standing
    return numbers
