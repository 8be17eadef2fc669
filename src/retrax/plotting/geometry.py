"""Curves in space: body axes on the sphere of directions, and paths on S^2 and in the plane and space."""

from typing import Any

import numpy as np

from ..channels import POSES, SPHERE, About, rotations
from ..integrators.quantities import with_unit
from ..manifolds import InvalidInputError
from .axes import one
from .drawn import drawn

FRAMES = 8
ARM = 0.08  # length of the axes of a frame, of the extent of the path
FLOOR = 1e-9
TICKS = 8  # on the longest axis of a box
FLATTEST = 0.2  # of a box, that its names fit
ROOM, LONGEST = 0.85, 0.7  # of a box and of its longest side in its axes: names would be cut off at 1
OFFSET = 21.0, 30.0  # of names from a box, in points of a cube: that of matplotlib, and all
OPEN, FULL = (7, 3.0), (4.5, 3.1)  # sizes and layers of dots: a full one is seen inside of an open one


def body_axes(record: Any, array: int | None = None, problem: About = None, ax: Any = None) -> Any:
    """The three body axes as curves on the sphere of directions of the inertial frame, from an open to a full dot.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with an attitude; ``InvalidInputError`` for another one.
    array : int, optional
        The index of the array in a point; by default the first attitude.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.
    ax : matplotlib Axes3D, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes3D
        The axes.
    """
    attitudes, axis = rotations(drawn(record, problem)[0], array), one(ax, "3d")
    sphere(axis)
    for k in range(3):
        curve(axis, attitudes[:, :, k], f"body axis {'xyz'[k]}")
    bare(axis)
    axis.legend(loc="upper left", fontsize="small")
    return axis


def path(record: Any, array: int | None = None, problem: About = None, frames: int = FRAMES, ax: Any = None) -> Any:
    """The path of a point on S^2, of a position in R^2 or R^3, or of a pose with some of its body axes.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with a path; ``InvalidInputError`` for another one.
    array : int, optional
        The index of the array in a point; by default the first array with a path.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.
    frames : int
        The number of body axes of a pose along its path.
    ax : matplotlib Axes, optional
        The axes; by default new axes.

    Returns
    -------
    matplotlib Axes
        The axes.
    """
    found, _ = drawn(record, problem)
    place = _place([q.space for q in found.quantities.states], found.states, array)
    quantity, values = found.quantities.states[place], found.states[place]
    is_pose = quantity.space in POSES
    n = values.shape[1] - 1 if is_pose else values.shape[1]
    points = values[:, :n, n] if is_pose else values
    axis = one(ax, "3d" if n == 3 else None)
    if quantity.space == SPHERE:
        sphere(axis)
    curve(axis, points, None)
    if is_pose:
        _frames(axis, values[:: max(1, len(values) // frames)], np.ptp(points, axis=0).max())
    if quantity.space == SPHERE:
        bare(axis)
        return axis
    for name, set_label in zip(
        "xyz", (axis.set_xlabel, axis.set_ylabel, getattr(axis, "set_zlabel", None)), strict=True
    ):
        if set_label is not None:
            set_label(with_unit(name, quantity.unit))
    if n == 3:
        _fit_box(axis)
    else:
        axis.set_aspect("equal", "datalim")
    return axis


def _place(spaces: list[str], states: list[np.ndarray], array: int | None) -> int:
    """The place of the array that has a path."""
    fit = [
        space in (*POSES, SPHERE) or (values.ndim == 2 and values.shape[1] in (2, 3))
        for space, values in zip(spaces, states, strict=True)
    ]
    chosen = range(len(fit)) if array is None else [array]
    for place in chosen:
        if place in range(len(fit)) and fit[place]:
            return place
    what = "no array" if array is None else f"no array {array}"
    raise InvalidInputError(
        f"the record has {what} with a path on S^2, in R^2 or R^3, or of poses, it has "
        f"{', '.join(space or 'unknown' for space in spaces)}; try plotting.histories"
    )


def sphere(axis: Any) -> None:
    """The unit sphere as wires."""
    polar, azimuth = np.mgrid[0 : np.pi : 19j, 0 : 2 * np.pi : 37j]
    points = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    axis.computed_zorder = False  # else wires are drawn over curves that lie on them
    axis.plot_wireframe(*points, color="0.85", linewidth=0.5, zorder=0)


def curve(axis: Any, points: np.ndarray, name: str | None) -> None:
    """A curve from an open dot to a full one."""
    (drawn,) = axis.plot(*points.T, label=name)
    colour = drawn.get_color()
    for place, face, (size, layer) in ((0, "white", OPEN), (-1, colour, FULL)):
        axis.plot(*points[[place]].T, "o", color=colour, markerfacecolor=face, markersize=size, zorder=layer)


def bare(axis: Any) -> None:
    """A cube about the unit sphere, with equal scales, and nothing but the picture."""
    axis.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axis.set_box_aspect((1, 1, 1), zoom=1.4)
    axis.set_axis_off()


def _fit_box(axis: Any) -> None:
    """Equal scales in a box that leaves room for its names, with fewer ticks on its short sides, where their numbers
    would lie over each other."""
    limits = np.array([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()])
    lengths = np.ptp(limits, axis=1)
    longer = np.maximum(lengths, FLATTEST * lengths.max())
    sides = limits.mean(axis=1)[:, None] + np.outer(longer, [-0.5, 0.5])
    for set_side, side in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), sides, strict=True):
        set_side(*side)
    axis.set_aspect("equal")
    diagonal = np.linalg.norm(longer)
    axis.set_box_aspect(tuple(longer), zoom=min(ROOM, LONGEST * diagonal / longer.max()))
    for k, (name, side) in enumerate(zip("xyz", (axis.xaxis, axis.yaxis, axis.zaxis), strict=True)):
        axis.locator_params(axis=name, nbins=max(2, round(TICKS * longer[k] / longer.max())))
        # Matplotlib sets names off by shares of the two other sides.
        across = np.linalg.norm(np.delete(longer, k)) / (np.sqrt(2 / 3) * diagonal)
        side.labelpad = OFFSET[1] / across - OFFSET[0]


def _frames(axis: Any, poses: np.ndarray, extent: float) -> None:
    """Body axes at some poses, each pointing where its column does."""
    n, arm = poses.shape[1] - 1, ARM * extent if extent > FLOOR else 1.0
    for pose in poses:
        for k, colour in zip(range(n), ("C3", "C2", "C0"), strict=False):
            ends = np.stack([pose[:n, n], pose[:n, n] + arm * pose[:n, k]])
            axis.plot(*ends.T, color=colour, linewidth=1)
