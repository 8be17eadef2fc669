"""The linearised equations of the nodes in the arrays of the engine."""

from ..transcription.discrete_extremals import LinearSteps
from .conditions import Conditions
from .kkt_system import Assembled


def linear_steps(conditions: Conditions, assembled: Assembled, k: int) -> LinearSteps:
    """The linearised equations of the nodes along a member."""
    blocks, units, held = assembled.blocks, conditions.measured, assembled.blocks.held
    fixed, sizes = (conditions.fixed[k, 0], conditions.fixed[k, -1]), (units.unknowns[k], units.nodes[k])
    limits = None if held is None else held.jacobian[k]
    return LinearSteps(blocks.left[k], blocks.right[k], fixed, *sizes, assembled.frames[k, -1], limits)
