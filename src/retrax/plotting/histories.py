"""Histories of states and controls against time."""

from typing import Any

import numpy as np

from ..channels import About, Channel, control_channels, rotation_vectors, rotations, state_channels
from ..manifolds import InvalidInputError
from .axes import draw, draw_controls, one, several
from .drawn import drawn


def histories(record: Any, problem: About = None, ax: Any = None) -> np.ndarray:
    """States and controls of a solution or a trajectory against time, one panel for each.

    Rotations are shown as rotation vectors, poses as rotation vectors and positions; controls as steps where each step
    has one, which holds along it. A solution is drawn between its nodes by its polynomials. Three entries with one unit
    and without names are x, y, z. ``problem`` has the names and units of a trajectory, a manifold its spaces; a
    solution has its own. ``ax``: as many axes as there are panels. Returns the array of axes. Raises
    ``InvalidInputError`` for another record or number of axes.
    """
    found, of_controls = drawn(record, problem)
    states, own = state_channels(found), control_channels(of_controls)
    axes = several(ax, len(states) + len(own))
    for axis, channel in zip(axes[: len(states)], states, strict=True):
        draw(axis, found.times, channel, found)
    for axis, channel in zip(axes[len(states) :], own, strict=True):
        draw_controls(axis, [channel], of_controls)
    return axes


def state(record: Any, array: int = 0, problem: About = None, ax: Any = None) -> Any:
    """The history of one of the arrays of a state, at its place ``array``; of a pose its attitude and position, dashed.

    Returns the axes; raises ``InvalidInputError`` for a place that no array has.
    """
    found, _ = drawn(record, problem)
    if array not in range(len(found.states)):
        raise InvalidInputError(
            f"array must be a place of one of the {len(found.states)} arrays of a state, got {array!r}"
        )
    single = found.quantities.states[array : array + 1]
    part = found._replace(states=found.states[array : array + 1], quantities=_only(found.quantities, single))
    axis = one(ax)
    for channel, style in zip(state_channels(part), ("-", "--"), strict=False):
        draw(axis, found.times, channel, found, linestyle=style)
    return axis


def controls(record: Any, problem: About = None, ax: Any = None) -> Any:
    """The controls against time: the polynomials of each step, or steps where each step has one; of a trajectory lines
    through those of the stages.

    Returns the axes; raises ``InvalidInputError`` where there are none.
    """
    _, found = drawn(record, problem)
    channels = control_channels(found)
    if not channels:
        raise InvalidInputError(
            "the trajectory has no controls, it is one of Hamilton's equations; try plotting.histories"
        )
    return draw_controls(one(ax), channels, found)


def attitude(record: Any, array: int | None = None, problem: About = None, ax: Any = None) -> Any:
    """The attitude as a rotation vector in rad, without a jump at half a turn; of the array at a place, or of the
    first.

    Returns the axes; raises ``InvalidInputError`` for a record without an attitude.
    """
    found, _ = drawn(record, problem)
    vectors = rotation_vectors(rotations(found, array))
    return draw(one(ax), found.times, Channel("rotation vector", tuple("xyz"), ("rad",), vectors), found)


def _only(quantities: Any, states: tuple) -> Any:
    return type(quantities)(states, quantities.controls, quantities.time, quantities.cost)
