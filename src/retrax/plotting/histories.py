"""Histories of states and controls against time."""

from typing import Any

import numpy as np

from ..manifolds import InvalidInputError
from ..named_columns import About, NamedColumn, View, attitude_of, rotation_vectors
from .axes import draw, one, several
from .series import History, as_one, every_panel, of_controls, of_states, panels_of, picture_series


def histories(record: Any, problem: About = None, ax: Any = None, degrees: bool = False) -> np.ndarray:
    """States and controls against time, one panel for each.

    Parameters
    ----------
    record : Solution, Trajectory, ClosedLoop, PhasedSolution, Solutions, list or dict
        One record; the members of a batch; or records to compare, in a dictionary with their names. Four named records
        have line styles of their own, more are thin lines.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its spaces; a solution has its own.
    ax : array of matplotlib axes, optional
        As many axes as there are panels; by default a new figure.
    degrees : bool
        Whether angles and their rates are drawn in degrees instead of radians.

    Returns
    -------
    ndarray of matplotlib axes
        One for each array of the state, then one for each array of the controls; two for a pose.

    Raises
    ------
    InvalidInputError
        For another record, or another number of axes.

    Notes
    -----
    Rotations are drawn as rotation vectors, poses as rotation vectors and positions. A solution is drawn between its
    nodes by its polynomials, and controls within their bounds, which are dashed; a control that holds along a step is
    drawn as a step. Vertical lines are the ends of phases. Three entries with one unit and without names are x, y, z.
    """
    every = picture_series(record, problem)
    panels = every_panel(every, degrees)
    axes = several(ax, len(panels))
    for axis, panel in zip(axes, panels, strict=True):
        draw(axis, panel, every)
    return axes


def state(record: Any, array: int = 0, problem: About = None, ax: Any = None, degrees: bool = False) -> Any:
    """The history of one array of the state; of a pose its attitude and its position.

    Parameters
    ----------
    record : Solution, Trajectory, ClosedLoop, PhasedSolution, Solutions, list or dict
        The records, as in ``histories``.
    array : int
        The index of the array in the state.
    problem, ax, degrees
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib axes
        The axes of the picture.

    Raises
    ------
    InvalidInputError
        For another record, and for a place that no array has.
    """

    def own(found: View) -> list[History]:
        if array not in range(len(found.states)):
            raise InvalidInputError(
                f"array must be a place of one of the {len(found.states)} arrays of a state, got {array!r}"
            )
        return of_states(found.only(array))

    every = picture_series(record, problem)
    return draw(one(ax), as_one(panels_of(every, own, degrees)), every, "state")


def controls(record: Any, problem: About = None, ax: Any = None, degrees: bool = False) -> Any:
    """The controls against time, within their bounds, which are dashed.

    Parameters
    ----------
    record : Solution, Trajectory, ClosedLoop, PhasedSolution, Solutions, list or dict
        The records, as in ``histories``.
    problem, ax, degrees
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib axes
        The axes of the picture.

    Raises
    ------
    InvalidInputError
        For another record, and where there are no controls.

    Notes
    -----
    The polynomials of each step are drawn, or steps where each step has one control; of a trajectory lines through the
    controls of the stages.
    """
    every = picture_series(record, problem)
    panels = panels_of(every, of_controls, degrees)
    if not panels:
        raise InvalidInputError(
            "the trajectory has no controls, it is one of Hamilton's equations; try plotting.histories"
        )
    return draw(one(ax), as_one(panels), every, "controls")


def attitude(
    record: Any, array: int | None = None, problem: About = None, ax: Any = None, degrees: bool = False
) -> Any:
    """The attitude as a rotation vector, without a jump at half a turn.

    Parameters
    ----------
    record : Solution, Trajectory, ClosedLoop, PhasedSolution, Solutions, list or dict
        The records, as in ``histories``.
    array : int, optional
        The index of the array with the attitude in the state; by default the first array on SO(3) or SE(3).
    problem, ax, degrees
        As in ``histories``, with one ``Axes``.

    Returns
    -------
    matplotlib axes
        The axes of the picture.

    Raises
    ------
    InvalidInputError
        For a record without an attitude.
    """

    def own(found: View) -> list[History]:
        name, matrices = attitude_of(found, array)
        vectors = rotation_vectors(matrices)
        return [History(found.times, NamedColumn(f"{name}, rotation vector", tuple("xyz"), ("rad",), vectors))]

    every = picture_series(record, problem)
    return draw(one(ax), as_one(panels_of(every, own, degrees)), every, "rotation vector")
