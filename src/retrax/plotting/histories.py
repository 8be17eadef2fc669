"""Histories of states and controls against time."""

from typing import Any

import numpy as np

from ..channels import About, Channel, control_channels, rotation_vectors, rotations, state_channels
from ..manifolds import InvalidInputError
from .axes import draw, draw_controls, one, several
from .drawn import drawn


def histories(record: Any, problem: About = None, ax: Any = None) -> np.ndarray:
    """The states and controls of a record against time, one panel for each.

    Parameters
    ----------
    record : Solution or Trajectory
        The record; ``InvalidInputError`` for another one.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold; a solution has its own.
    ax : array of matplotlib Axes, optional
        As many axes as panels; by default new axes.

    Returns
    -------
    array of matplotlib Axes of shape (panels,)
        The axes.

    Notes
    -----
    Rotations are rotation vectors; poses are rotation vectors and positions. Controls are steps if each step has one
    control. A solution is drawn between its nodes by its polynomials. Three unnamed entries with one unit are x, y, z.
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
    """The history of one array of a state; a pose is drawn as attitude and, dashed, position.

    Parameters
    ----------
    record : Solution or Trajectory
        The record.
    array : int
        The index of the array in a point; ``InvalidInputError`` for another one.
    problem, ax
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib Axes
        The axes.
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
    """The controls against time: the polynomials of each step, or steps if each step has one control.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with controls; ``InvalidInputError`` for another one. Of a trajectory, lines through the controls of
        the stages.
    problem, ax
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    _, found = drawn(record, problem)
    channels = control_channels(found)
    if not channels:
        raise InvalidInputError(
            "the trajectory has no controls, it is one of Hamilton's equations; try plotting.histories"
        )
    return draw_controls(one(ax), channels, found)


def attitude(record: Any, array: int | None = None, problem: About = None, ax: Any = None) -> Any:
    """The attitude as a rotation vector in rad, without a jump at half a turn.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with an attitude; ``InvalidInputError`` for another one.
    array : int, optional
        The index of the array in a point; by default the first attitude.
    problem, ax
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    found, _ = drawn(record, problem)
    vectors = rotation_vectors(rotations(found, array))
    return draw(one(ax), found.times, Channel("rotation vector", tuple("xyz"), ("rad",), vectors), found)


def _only(quantities: Any, states: tuple) -> Any:
    return type(quantities)(states, quantities.controls, quantities.time, quantities.cost)
