"""A page that moves: one HTML file with a body that turns, the histories under a common cursor, and the report."""

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from ..channels import BODY, SPHERE, About, View, view
from ..integrators import PhasedSolution, Solution
from ..integrators.quantities import with_unit
from ..integrators.text import brief
from ..manifolds import InvalidInputError
from ..optional import needed
from .drawn import History, every_panel, shown
from .marks import checked_cones, checked_pairs, circle

FRAMES = 241
BODY_SIZE, ARM = 0.62, 1.0  # of the body on the sphere of directions, and of its axes
SHARE = 0.15  # of the extent of a path: a body that moves along it
DIGITS = 9
# A box whose three lengths differ, so that its attitude can be seen.
BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-0.65, 0.65) for z in (-0.35, 0.35)], float)
SIDES = [
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
    record : Solution, PhasedSolution or Trajectory
        The record to show.
    path : str or Path
        The file to write.
    mesh : pair of array_like, optional
        Vertices in the body frame, shape ``(V, 3)``, and triangles of their numbers, shape ``(F, 3)``; by default a
        box. For poses in the unit of the position; for attitudes the size plays no part.
    title : str
        The title of the page; by default the class of the record.
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
        For another record, mesh, cone or obstacle.
    MissingPackageError
        Without plotly.

    Notes
    -----
    An attitude is shown as a body that turns, with the traces of its axes on the sphere of directions of the inertial
    frame; a pose as a body that moves; a point on S^2, or in R^2 or R^3, on its path. Beside it are the histories with
    the values at the cursor, below it is the report. A slider drags the time, and a click on a history goes to its
    time. Solutions are drawn between their nodes by their polynomials, controls within their bounds. The library that
    draws is Plotly's, 4.8 MB of the file; its button that uploads a chart is off.
    """
    every, body = shown([record], problem), _checked(mesh)
    plotly = needed("plotly.offline", "to_html").get_plotlyjs()
    times, scene = _motion(record, problem, body)
    marks = _marks(scene, checked_cones(cones), obstacles)
    panels = [_panel(rows[0]) for rows in every_panel(every, degrees)]
    data = {"times": times, "clock": with_unit("time", every.time), **scene, **marks}
    data |= {"histories": panels, "borders": every.borders}
    words = {
        "title": html.escape(title or type(record).__name__),
        "report": html.escape(str(record)),
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


def _checked(mesh: Any) -> _Body:
    """The body that is drawn; raises for what is not a mesh."""
    if mesh is None:
        return _Body(BOX, np.array(SIDES), given=False)
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


def _motion(record: Any, problem: About, body: _Body) -> tuple[np.ndarray, dict[str, Any]]:
    """Times of the frames, and what is drawn in space at each; of phases in one space only."""
    phases = record.phases if isinstance(record, PhasedSolution) else [record]
    whole = record.horizon if isinstance(record, PhasedSolution) else None
    times, views = [], []
    for phase in phases:
        found = view(phase, problem)
        count = FRAMES if whole is None else 1 + max(1, round((FRAMES - 1) * phase.horizon / whole))
        own, states = _frames(phase, found, count)
        times.append(own)
        views.append(found._replace(times=own, states=states))
    if any(each.quantities.states != views[0].quantities.states for each in views):
        return np.concatenate(times), {}
    states = [np.concatenate(rows) for rows in zip(*(each.states for each in views), strict=True)]
    return np.concatenate(times), _scene(views[0], states, body)


def _frames(record: Any, found: View, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times and states of the frames: of a solution between its nodes where it has polynomials, else the nodes."""
    if isinstance(record, Solution) and record.interpolant is not None and record.success:
        times = np.linspace(found.times[0], found.times[-1], count)
        return times, [np.asarray(leaf) for leaf in jax.tree.leaves(record(times).states)]
    return found.times, found.states


def _marks(scene: dict[str, Any], cones: list[tuple[np.ndarray, float]], obstacles: Any) -> dict[str, Any]:
    """Circles of cones on the sphere, or balls beside a path, a disc in the plane being a flat one."""
    if scene.get("sphere"):
        return {"cones": [circle(*cone).T for cone in cones]}
    flat = scene.get("plane", False)
    balls = checked_pairs("obstacles", obstacles, 2 if flat else 3)
    return {"balls": [(np.pad(centre, (0, 3 - len(centre))), radius) for centre, radius in balls]}


def _scene(found: View, states: list[np.ndarray], body: _Body) -> dict[str, Any]:
    """What is drawn in space: of the first attitude or pose, else of the first point on S^2, or in R^2 or R^3; or
    nothing."""
    spaces = [quantity.space for quantity in found.quantities.states]
    for space, values in zip(spaces, states, strict=True):
        if space in BODY:
            return _of_body(values, body, space == "SE(3)")
    pairs = list(zip(found.quantities.states, states, strict=True))
    flat = [(q, v) for q, v in pairs if v.ndim == 2 and v.shape[1] in (2, 3) and np.isrealobj(v)]
    for quantity, values in sorted(flat, key=lambda pair: pair[0].space != SPHERE):
        points = np.pad(values, ((0, 0), (0, 3 - values.shape[1])))
        kind = {"sphere": quantity.space == SPHERE, "plane": values.shape[1] == 2}
        return {"points": points, "name": quantity.name, "unit": quantity.unit, **kind}
    return {}


def _of_body(values: np.ndarray, body: _Body, moves: bool) -> dict[str, Any]:
    positions = values[:, :3, 3] if moves else None
    size = float(np.max(np.linalg.norm(body.vertices, axis=1))) or 1.0
    extent = 1.0 if positions is None else float(np.max(np.ptp(positions, axis=0))) or 1.0
    scale = BODY_SIZE / size if positions is None else 1.0 if body.given else SHARE * extent / size
    return {
        "rotations": values[:, :3, :3],
        "positions": positions,
        "mesh": {"vertices": body.vertices, "faces": body.faces},
        "scale": scale,
        "arm": ARM if positions is None else 1.6 * scale * size,
        "sphere": positions is None,
    }


def _panel(own: list[History]) -> dict[str, Any]:
    """A panel of histories with one title, those of phases one behind the other."""
    first = own[0].channel
    return {
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
