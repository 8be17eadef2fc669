"""A record as it is drawn: a solution between its nodes by the polynomials of its method."""

from typing import Any

import jax
import numpy as np

from ..channels import About, View, view
from ..integrators import Solution

POINTS = 400  # of a curve, or two of a step


def drawn(record: Any, problem: About = None) -> tuple[View, View]:
    """The view of a record as its states are drawn, and as its controls are.

    Of a solution states are shown between its nodes, and controls from the beginning of each step to its end, where
    those of the next may be others; one control of a step holds along it. A trajectory is shown at its nodes, and so is
    a solution that has no polynomials, or a step that does not fit into a chart.
    """
    found = view(record, problem)
    if not isinstance(record, Solution) or record.interpolant is None:
        return found, found
    places = np.linspace(0.0, 1.0, 1 + max(2, POINTS // record.steps))
    sample = record.interpolant.within(record, places, costates=False)
    states, controls = (
        [np.asarray(leaf).reshape(sample.times.size, *np.shape(leaf)[2:]) for leaf in jax.tree.leaves(tree)]
        for tree in (sample.states, sample.controls)
    )
    if not all(np.all(np.isfinite(leaf)) for leaf in (*states, *controls)):
        return found, found
    times = sample.times.ravel()
    smooth = found._replace(times=times, states=states, stage_times=times, controls=controls)
    return smooth, found if found.is_held else smooth
