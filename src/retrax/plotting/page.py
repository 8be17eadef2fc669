"""A page that moves: one HTML file with a body that turns, the histories under a common cursor, and the report."""

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from ..integrators.boundary_value.solution.multiphase_solution import PhasedSolution
from ..integrators.boundary_value.solution.record import Solution
from ..integrators.problem.quantities import with_unit
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..named_columns import BODY, SPHERE, About, View, view
from ..optional import require_package
from .axes import STYLES
from .marks import check_cones, check_pairs, circle
from .series import History, every_panel, names_and_records, picture_series

PAGE_FRAMES = 241  # times at which a page shows the motion
BODY_SIZE, BODY_ARM = 0.62, 1.0  # of the body on the sphere of directions, and of its axes
BODY_SHARE = 0.15  # of the extent of a path: a body that moves along it
DIGITS = 9  # significant digits of the numbers in a page
# A box whose three lengths differ, so that its attitude can be seen.
BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-0.65, 0.65) for z in (-0.35, 0.35)], float)
BOX_SIDES = [
    (0, 1, 3),
    (0, 3, 2),
    (4, 6, 7),
    (4, 7, 5),
    (0, 4, 5),
    (0, 5, 1),
    (2, 3, 7),
    (2, 7, 6),
    (0, 2, 6),
    (0, 6, 4),
    (1, 5, 7),
    (1, 7, 3),
]

Mesh = tuple[Any, Any]


def to_html(
    record: Any,
    path: str | Path,
    mesh: Mesh | None = None,
    title: str = "",
    problem: About = None,
    degrees: bool = False,
    cones: Sequence[Any] = (),
    obstacles: Sequence[Any] = (),
) -> None:
    """Write a page that shows a solution or a trajectory in motion, in one file that needs no network.

    Parameters
    ----------
    record : Solution, PhasedSolution, Trajectory, list or dict
        The record to show; or two to four records to compare, in a dictionary with their names.
    path : str or Path
        The file to write.
    mesh : pair of array_like, optional
        Vertices in the body frame, shape ``(V, 3)``, and triangles of their numbers, shape ``(F, 3)``; by default a
        box. For poses in the unit of the position; for attitudes the size plays no part.
    title : str
        The title of the page; by default the class of the record, or the names of the records.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its spaces; a solution has its own.
    degrees : bool
        Whether angles and their rates are shown in degrees instead of radians.
    cones : sequence of pairs
        Cones to draw on the sphere: the direction of the axis, shape ``(3,)``, and the half-angle in rad.
    obstacles : sequence of pairs
        Discs or balls to draw beside a path in R^2 or R^3: the centre, and the radius in the unit of the path.

    Raises
    ------
    InvalidInputError
        For another record, mesh, cone or obstacle, for more than four records, and for records that move in different
        spaces.
    MissingPackageError
        Without plotly.

    Notes
    -----
    An attitude is shown as a body that turns, with the traces of its axes on the sphere of directions of the inertial
    frame; a pose as a body that moves; a point on S^2, or in R^2 or R^3, on its path. Beside it are the histories with
    the values at the cursor, below it is the report. A slider drags the time, and a click on a history goes to its
    time. Solutions are drawn between their nodes by their polynomials, controls within their bounds. Records to compare
    share one clock, and each has a line style and a body of its own; a shorter record stays at its end. The library
    that draws is Plotly's, 4.8 MB of the file; its button that uploads a chart is off.
    """
    every, records, body = picture_series(record, problem), names_and_records(record)[1], _check_mesh(mesh)
    if len(records) > len(STYLES):
        raise InvalidInputError(
            f"a page shows at most {len(STYLES)} records, got {len(records)}; try a few of them, or plotting.histories"
        )
    plotly = require_package("plotly.offline", "to_html").get_plotlyjs()
    times, scene = _motion(records, problem, body)
    marks = _marks(scene, check_cones(cones), obstacles)
    panels = [[_panel(own, place) for place, own in enumerate(rows) if own] for rows in every_panel(every, degrees)]
    data = {"times": times, "clock": with_unit("time", every.time), "names": every.names, **scene, **marks}
    data |= {"histories": panels, "borders": every.borders}
    reports = [f"{name}\n\n{each}".lstrip() for name, each in zip(every.names, records, strict=True)]
    words = {
        "title": html.escape(title or ", ".join(filter(None, every.names)) or type(records[0]).__name__),
        "report": html.escape("\n\n\n".join(reports)),
        # A script ends at the first "</script", wherever that is.
        "data": json.dumps(_plain(data), separators=(",", ":"), allow_nan=False).replace("</", "<\\/"),
        "plotly": plotly,
    }
    page = resources.files("retrax.plotting").joinpath("page.html").read_text(encoding="utf-8")
    parts = page.split("{{")
    filled = [parts[0]] + [words[part.partition("}}")[0]] + part.partition("}}")[2] for part in parts[1:]]
    Path(path).write_text("".join(filled), encoding="utf-8")


class _Body(NamedTuple):
    vertices: np.ndarray
    faces: np.ndarray
    given: bool


def _check_mesh(mesh: Any) -> _Body:
    """The body that is drawn; raises for what is not a mesh."""
    if mesh is None:
        return _Body(BOX, np.array(BOX_SIDES), given=False)
    if not isinstance(mesh, Sequence) or len(mesh) != 2:
        raise InvalidInputError(f"mesh must be a pair (vertices, triangles), got {brief(mesh)}")
    vertices, faces = np.asarray(mesh[0], float), np.asarray(mesh[1])
    fit = vertices.ndim == 2 and vertices.shape[1:] == (3,) and vertices.size > 0 and np.all(np.isfinite(vertices))
    whole = faces.ndim == 2 and faces.shape[1:] == (3,) and faces.dtype.kind in "iu"
    if not fit or not whole or not np.all((faces >= 0) & (faces < len(vertices))):
        raise InvalidInputError(
            "mesh must be finite vertices of shape (V, 3) and triangles of shape (F, 3) with their numbers from 0 to "
            f"V - 1, got arrays of shapes {vertices.shape} and {faces.shape}"
        )
    return _Body(vertices, faces, given=True)


def _motion(records: list[Any], problem: About, body: _Body) -> tuple[np.ndarray, dict[str, Any]]:
    """Times of the frames, and what is drawn in space at each; records with another space in a phase have no scene."""
    phases = [record.phases if isinstance(record, PhasedSolution) else [record] for record in records]
    views = [[view(phase, problem) for phase in own] for own in phases]
    times = _frame_times(phases, views)
    if any(each.quantities.states != own[0].quantities.states for own in views for each in own):
        return times, {}
    states = [_states_at(times, own, found) for own, found in zip(phases, views, strict=True)]
    return times, _scene([own[0] for own in views], states, body)


def _is_smooth(record: Any) -> bool:
    """Whether a record has states between its nodes: a solution with polynomials."""
    return isinstance(record, Solution) and record.interpolant is not None and record.success


def _frame_times(phases: Sequence[Sequence[Any]], views: list[list[View]]) -> np.ndarray:
    """Times of the frames: the nodes of trajectories with the same nodes, otherwise equal steps from the first time to
    the last."""
    nodes = [found.times for own in views for found in own]
    if not any(_is_smooth(phase) for own in phases for phase in own):
        grids = [np.concatenate([found.times for found in own]) for own in views]
        if all(np.array_equal(grid, grids[0]) for grid in grids):
            return grids[0]
    return np.linspace(min(own[0] for own in nodes), max(own[-1] for own in nodes), PAGE_FRAMES)


def _states_at(times: np.ndarray, phases: Sequence[Any], views: list[View]) -> list[np.ndarray]:
    """States of a record at the times of the frames, from its polynomials, nearest nodes or ends."""
    begins = [found.times[0] for found in views[1:]]
    place = np.searchsorted(begins, times, side="right")
    parts = []
    for number, (phase, found) in enumerate(zip(phases, views, strict=True)):
        own = np.clip(times[place == number], found.times[0], found.times[-1])
        if not own.size:  # a phase that is shorter than a frame
            continue
        if _is_smooth(phase):
            parts.append([np.asarray(leaf) for leaf in jax.tree.leaves(phase(own).states)])
        else:
            nearest = np.abs(own[:, None] - found.times).argmin(axis=1)
            parts.append([values[nearest] for values in found.states])
    return [np.concatenate(rows) for rows in zip(*parts, strict=True)]


def _marks(scene: dict[str, Any], cones: list[tuple[np.ndarray, float]], obstacles: Any) -> dict[str, Any]:
    """Circles of cones on the sphere, or balls beside a path, a disc in the plane being a flat one."""
    if scene.get("sphere"):
        return {"cones": [circle(*cone).T for cone in cones]}
    flat = scene.get("plane", False)
    balls = check_pairs("obstacles", obstacles, 2 if flat else 3)
    return {"balls": [(np.pad(centre, (0, 3 - len(centre))), radius) for centre, radius in balls]}


def _scene(views: list[View], states: list[list[np.ndarray]], body: _Body) -> dict[str, Any]:
    """The spatial scene with the motion of each record; empty if the records have nothing to draw in space."""
    found = [_moving(each, own) for each, own in zip(views, states, strict=True)]
    kinds = {kind for kind, _, _ in found}
    if len(kinds) > 1:
        raise InvalidInputError(
            f"the records of a page move in one space, got {', '.join(sorted(kind or 'none' for kind in kinds))}; try "
            "plotting.histories"
        )
    kind, values = kinds.pop(), [values for _, _, values in found]
    if kind in BODY:
        return _of_body(values, body, kind == "SE(3)")
    if not kind:
        return {}
    quantity = found[0][1]
    points = [{"points": np.pad(each, ((0, 0), (0, 3 - each.shape[1])))} for each in values]
    what = {"name": quantity.name, "unit": quantity.unit, "sphere": kind == SPHERE, "plane": kind == "R^2"}
    return {"motions": points, **what}


def _moving(found: View, states: list[np.ndarray]) -> tuple[str, Any, Any]:
    """The space, the quantity and the values to draw, or nothing.

    These are the first attitude or pose, else the first point on S^2, or in R^2 or R^3.
    """
    pairs = list(zip(found.quantities.states, states, strict=True))
    for quantity, values in pairs:
        if quantity.space in BODY:
            return quantity.space, quantity, values
    flat = [(q, v) for q, v in pairs if v.ndim == 2 and v.shape[1] in (2, 3) and np.isrealobj(v)]
    for quantity, values in sorted(flat, key=lambda pair: pair[0].space != SPHERE):
        return SPHERE if quantity.space == SPHERE else f"R^{values.shape[1]}", quantity, values
    return "", None, None


def _of_body(records: list[np.ndarray], body: _Body, moves: bool) -> dict[str, Any]:
    """Bodies that turn, all of one size, and move if the records are poses."""
    size = float(np.max(np.linalg.norm(body.vertices, axis=1))) or 1.0
    paths = [values[:, :3, 3] if moves else None for values in records]
    scale = BODY_SIZE / size
    if moves:
        extent = float(np.max(np.ptp(np.concatenate([values[:, :3, 3] for values in records]), axis=0))) or 1.0
        scale = 1.0 if body.given else BODY_SHARE * extent / size
    return {
        "motions": [{"rotations": v[:, :3, :3], "positions": path} for v, path in zip(records, paths, strict=True)],
        "mesh": {"vertices": body.vertices, "faces": body.faces},
        "scale": scale,
        "arm": 1.6 * scale * size if moves else BODY_ARM,
        "sphere": not moves,
    }


def _panel(own: list[History], record: int) -> dict[str, Any]:
    """The histories of one record in a panel, phases one behind the other."""
    first = own[0].channel
    return {
        "record": record,
        "title": first.title,
        "times": np.concatenate([history.times for history in own]),
        "names": first.labels,
        "columns": np.concatenate([history.channel.values for history in own]).T,
        "held": own[0].is_held,
        "bounds": sorted({bound for pair in first.bounds for bound in pair if np.isfinite(bound)}),
    }


def _plain(value: Any) -> Any:
    """Nested lists of numbers, rounded to what can be seen; None for numbers that are not finite, which JSON has
    not."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value
