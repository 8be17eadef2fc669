"""Curves in space: body axes on the sphere of directions, and paths on S^2 and in the plane and space."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..integrators.problem.quantities import with_unit
from ..manifolds import InvalidInputError
from ..named_columns import POSES, SPHERE, About, View, rotations
from .axes import legend, one, record_handles, styles
from .marks import check_cones, check_pairs
from .series import picture_series

DRAWN_FRAMES = 8  # body frames along a path in a picture, by default
FRAME_ARM = 0.08  # length of the axes of a frame, of the extent of the path
SMALLEST_EXTENT = 1e-9  # in the unit of length: a path of less is a point, whose frames have arms of length one
TICKS = 8  # on the longest axis of a box
FLATTEST = 0.2  # of a box, that its names fit
BOX_SHARE, LONGEST_SIDE = 0.85, 0.7  # of a box and of its longest side in its axes: names would be cut off at 1
OFFSET = 21.0, 30.0  # of names from a box, in points of a cube: that of matplotlib, and all
OPEN, FULL = (7, 3.0), (4.5, 3.1)  # sizes and layers of dots: a full one is seen inside of an open one


def body_axes(
    record: Any, array: int | None = None, problem: About = None, ax: Any = None, cones: Sequence[Any] = ()
) -> Any:
    """The three body axes, columns of the attitude, as curves on the sphere of directions of the inertial frame.

    Parameters
    ----------
    record : Solution, Trajectory, PhasedSolution, Solutions, list or dict
        The records, as in ``histories``.
    array : int, optional
        The index of the array with the attitude in the state; by default the first array on SO(3) or SE(3).
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.
    ax : matplotlib axes, optional
        Axes in three dimensions; by default those of a new figure.
    cones : sequence of pairs
        Cones to draw: the direction of the axis in the inertial frame, shape ``(3,)``, and the half-angle in rad.

    Returns
    -------
    matplotlib axes
        The axes of the picture, in three dimensions.

    Raises
    ------
    InvalidInputError
        For a record without an attitude, and for other cones.

    Notes
    -----
    Each curve leads from an open to a full dot, and is faint behind the sphere. The axes x, y, z are inertial.
    """
    every = picture_series(record, problem)
    attitudes = [[rotations(found, array) for found in parts] for parts in every.parts]
    axis = _sphere(one(ax, "3d"), cones)
    for number, (own, style) in enumerate(zip(attitudes, styles(every), strict=True)):
        for k in range(3):
            for part, matrices in enumerate(own):
                name = f"body axis {'xyz'[k]}" if number == part == 0 else None
                curve(axis, matrices[:, :, k], name, on_sphere=True, color=f"C{k}", **style)
    legend(axis, record_handles(every))
    return axis


def path(
    record: Any,
    array: int | None = None,
    problem: About = None,
    frames: int = DRAWN_FRAMES,
    ax: Any = None,
    cones: Sequence[Any] = (),
    obstacles: Sequence[Any] = (),
) -> Any:
    """The path of a point on S^2, of a position in R^2 or R^3, or of a pose.

    Parameters
    ----------
    record : Solution, Trajectory, PhasedSolution, Solutions, list or dict
        The records, as in ``histories``.
    array : int, optional
        The index of the array in the state; by default the first array that has a path.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.
    frames : int
        The number of places along the path of a pose at which its body axes are drawn.
    ax : matplotlib axes, optional
        Axes in three dimensions for S^2 and R^3, otherwise flat; by default those of a new figure.
    cones : sequence of pairs
        Cones to draw on S^2: the direction of the axis, shape ``(3,)``, and the half-angle in rad.
    obstacles : sequence of pairs
        Discs or balls to draw in R^2 or R^3: the centre, and the radius in the unit of the path.

    Returns
    -------
    matplotlib axes
        The axes of the picture.

    Raises
    ------
    InvalidInputError
        For a record without a path, for paths in different spaces, and for other cones or obstacles.
    """
    every = picture_series(record, problem)
    paths = [[_path(found, array) for found in parts] for parts in every.parts]
    first = paths[0][0]
    n = first.points.shape[1]
    if len({(each.on_sphere, each.points.shape[1]) for own in paths for each in own}) > 1:
        raise InvalidInputError("the records have paths in different spaces; try array= for the array to draw")
    axis = one(ax, "3d" if n == 3 else None)
    if first.on_sphere:
        _sphere(axis, cones)
    _add_obstacles(axis, check_pairs("obstacles", () if first.on_sphere else obstacles, n))
    for number, (own, style, name) in enumerate(zip(paths, styles(every), every.names, strict=True)):
        colour = {"color": f"C{number}"} if first.on_sphere else {}
        for part, each in enumerate(own):
            words = name if name and part == 0 else None
            colour = {"color": curve(axis, each.points, words, first.on_sphere, **style, **colour)}
            if each.poses is not None:
                places = np.linspace(0, len(each.poses) - 1, max(1, frames)).round().astype(int)
                _frames(axis, each.poses[places], np.ptp(each.points, axis=0).max())
    legend(axis)
    if not first.on_sphere:
        _name_sides(axis, first.unit, n)
    return axis


class _Path(NamedTuple):
    points: np.ndarray
    poses: np.ndarray | None
    unit: str
    on_sphere: bool


def _path(found: View, array: int | None) -> _Path:
    """The path of the array at a place, or of the first array that has a path."""
    place = _place([q.space for q in found.quantities.states], found.states, array)
    quantity, values = found.quantities.states[place], found.states[place]
    if quantity.space in POSES:
        n = values.shape[1] - 1
        return _Path(values[:, :n, n], values, quantity.unit, on_sphere=False)
    return _Path(values, None, quantity.unit, quantity.space == SPHERE)


def _name_sides(axis: Any, unit: str, n: int) -> None:
    """Equal scales, and names with units."""
    for name in "xyz"[:n]:
        getattr(axis, f"set_{name}label")(with_unit(name, unit))
    if n == 3:
        _fit_box(axis)
    else:
        axis.set_aspect("equal", "datalim")


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


def _sphere(axis: Any, cones: Any) -> Any:
    """The axes with the unit sphere and cones."""
    from .sphere import add_sphere

    add_sphere(axis, check_cones(cones))
    return axis


def _add_obstacles(axis: Any, obstacles: list[tuple[np.ndarray, float]]) -> None:
    """Discs in the plane, balls as wires in space."""
    for centre, radius in obstacles:
        if len(centre) == 2:
            from matplotlib.patches import Circle

            axis.add_patch(Circle((centre[0], centre[1]), radius, facecolor="0.85", edgecolor="0.4", zorder=0))
        else:
            from .sphere import wires

            wires(axis, centre, radius, color="0.8")


def curve(axis: Any, points: np.ndarray, name: str | None, on_sphere: bool, **style: Any) -> Any:
    """A curve from an open dot to a full one, which is faint behind the sphere if it is on one; returns its colour."""
    add = axis.plot
    if on_sphere:
        from .sphere import plot

        add = partial(plot, axis)
    (line,) = add(*points.T, label=name, **style)
    colour = line.get_color()
    for place, face, (size, layer) in ((0, "white", OPEN), (-1, colour, FULL)):
        dot = {"marker": "o", "linestyle": "none", "markerfacecolor": face, "markersize": size, "zorder": layer}
        add(*points[[place]].T, color=colour, **dot)
    return colour


def _fit_box(axis: Any) -> None:
    """Make the scales equal in a box that leaves room for its names, with fewer ticks on its short sides."""
    limits = np.array([axis.get_xlim(), axis.get_ylim(), axis.get_zlim()])
    lengths = np.ptp(limits, axis=1)
    longer = np.maximum(lengths, FLATTEST * lengths.max())
    sides = limits.mean(axis=1)[:, None] + np.outer(longer, [-0.5, 0.5])
    for set_side, side in zip((axis.set_xlim, axis.set_ylim, axis.set_zlim), sides, strict=True):
        set_side(*side)
    axis.set_aspect("equal")
    diagonal = np.linalg.norm(longer)
    zoom = min(BOX_SHARE, LONGEST_SIDE * diagonal / longer.max())
    axis.set_box_aspect(tuple(longer), zoom=zoom)
    axis.set_box_aspect(tuple(longer), zoom=zoom * _growth(axis, sides))
    for line in axis.lines:
        line.set(clip_on=False, in_layout=False)  # at the square, which the box may leave
    for k, (name, side) in enumerate(zip("xyz", (axis.xaxis, axis.yaxis, axis.zaxis), strict=True)):
        axis.locator_params(axis=name, nbins=max(2, round(TICKS * longer[k] / longer.max())))
        # Matplotlib sets names off by shares of the two other sides.
        across = np.linalg.norm(np.delete(longer, k)) / (np.sqrt(2 / 3) * diagonal)
        side.labelpad = OFFSET[1] / across - OFFSET[0]


def _growth(axis: Any, sides: np.ndarray) -> float:
    """How much larger a box fits into the place of its axes than into the square in which Matplotlib draws it."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    axis.apply_aspect()
    x, y, z = np.stack(np.meshgrid(*sides, indexing="ij")).reshape(3, -1)
    drawn = np.ptp(axis.transData.transform(np.transpose(proj_transform(x, y, z, axis.get_proj())[:2])), axis=0)
    place = axis.get_position(original=True).size * axis.figure.bbox.size
    return float(np.min(place / drawn) / np.min(np.min(place) / drawn))


def _frames(axis: Any, poses: np.ndarray, extent: float) -> None:
    """Body axes at some poses, each pointing where its column does."""
    n, arm = poses.shape[1] - 1, FRAME_ARM * extent if extent > SMALLEST_EXTENT else 1.0
    for pose in poses:
        for k, colour in zip(range(n), ("C3", "C2", "C0"), strict=False):
            ends = np.stack([pose[:n, n], pose[:n, n] + arm * pose[:n, k]])
            axis.plot(*ends.T, color=colour, linewidth=1)
