"""Units in which a trajectory's KKT system is free of the units that its problem is written in.

A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest to a
deviation ``e`` costs ``e' G^-1 e / 2`` with the Gramian ``G_{k+1} = A G_k A' + B W B'`` of the linearised steps, ``W`` the
inverse curvature of the cost in the controls; both ends are fixed, so the smaller of the Gramians from the start and from the
end counts. One factor is left, the size of the trajectory: what its ends, its guess and the slope of the cost ask for.
"""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float


@final
class Units(NamedTuple):
    """Natural sizes of a step of the stages' unknowns and of the nodes' gaps, and of the cost of a stage."""

    unknowns: Float[np.ndarray, "B z"]
    nodes: Float[np.ndarray, "B n"]
    cost: Float[np.ndarray, " B"]
