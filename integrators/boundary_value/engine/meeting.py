"""Where the steps of trajectories meet."""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .transcription import Nodes

# Times the largest entry of a column of the nodes, a turn by 64 degrees: ends further apart meet along an arc.
FAR = 0.9


@final
class Meeting(NamedTuple):
    """Nodes ``q_0 ... q_N``, and at each the beginning of the step after it minus the end of the one before.

    Between ends that are far apart the node is amid them: seen from one of them, an end beyond a quarter turn comes
    nearer by turning away. There the gap is that along the arc, of which a step sees less.
    """

    nodes: Float[np.ndarray, "B N+1 E"]
    gaps: Float[np.ndarray, "B N+1 E"]
    asked: Float[np.ndarray, "B N+1 E"] | None  # what a step sees of the gaps; None where that is all
    largest: Float[np.ndarray, "B E"]  # of the gaps along the chords


def meeting(
    begins: Float[np.ndarray, "B N E"],
    finishes: Float[np.ndarray, "B N E"],
    ends: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    at_nodes: Nodes,
) -> Meeting:
    """Where steps with these beginnings and ends meet.

    ``ends``: the first and the last point, (B, E), and which of their entries are prescribed.
    """
    from . import extent_kernels

    batch, count, size = begins.shape
    nodes, gaps = np.empty((2, batch, count + 1, size))
    largest, far, work = np.empty((batch, size)), np.empty((batch, count + 1), bool), np.empty((2, size))
    out = nodes, gaps, far, largest
    if not extent_kernels.meet(begins, finishes, ends, at_nodes.layout.columns, FAR, work, out):
        return Meeting(nodes, gaps, None, largest)
    arcs, shares = np.ones_like(gaps), np.ones_like(gaps)
    # The node there is the end of the step before, but for the last one.
    before = np.array(nodes)
    before[:, -1] -= gaps[:, -1]
    nodes[far], arcs[far], shares[far] = at_nodes.amid(before[far], before[far] + gaps[far])
    return Meeting(nodes, arcs * gaps, shares * gaps, largest)
