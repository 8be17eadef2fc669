"""A page that moves: one HTML file with a body that turns, the histories under a common cursor, and the report."""

import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from ..channels import BODY, SPHERE, About, Channel, View, control_channels, state_channels, view
from ..integrators import Solution
from ..integrators.quantities import with_unit
from ..integrators.text import brief
from ..manifolds import InvalidInputError
from ..optional import needed

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


def to_html(record: Any, path: str | Path, mesh: Mesh | None = None, title: str = "", problem: About = None) -> None:
    """Write a page that shows a solution or a trajectory in motion, in one file that needs no network.

    Parameters
    ----------
    record : Solution or Trajectory
        The record.
    path : str or Path
        The file, of at least 4.8 MB: it contains the library Plotly.
    mesh : tuple of arrays, optional
        Vertices in the body frame, shape ``(V, 3)``, and triangles of their indices, shape ``(F, 3)``; by default a
        box. For poses the vertices are in the unit of the position; otherwise their scale has no effect.
    title : str
        The title of the page.
    problem : OptimalControlProblem or Manifold, optional
        The names and units of a trajectory, or its manifold.

    Raises
    ------
    InvalidInputError
        For another record or mesh.
    MissingPackageError
        Without plotly.

    Notes
    -----
    An attitude is a body that rotates, with the traces of its axes on the sphere of directions. A pose is a body that
    moves. A point on S^2, or in R^2 or R^3, moves on its path. Beside it are the histories with a cursor, below it the
    report. Play the time, drag the slider, or click on a history. A solution is drawn between its nodes by its
    polynomials.
    """
    found = view(record, problem)
    body = _checked(mesh)
    plotly = needed("plotly.offline", "to_html").get_plotlyjs()
    times, states = _frames(record, found)
    scene = _scene(found, states, body)
    data = {"times": times, "clock": with_unit("time", found.quantities.time), **scene, "histories": _histories(found)}
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


def _frames(record: Any, found: View) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times and states of the frames: of a solution between its nodes where it has polynomials, else the nodes."""
    if isinstance(record, Solution) and record.interpolant is not None and record.success:
        times = np.linspace(found.times[0], found.times[-1], FRAMES)
        return times, [np.asarray(leaf) for leaf in jax.tree.leaves(record(times).states)]
    return found.times, found.states


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
        return {"points": points, "name": quantity.name, "sphere": quantity.space == SPHERE}
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


def _histories(found: View) -> list[dict[str, Any]]:
    panels = [(found.stage_times, channel) for channel in control_channels(found)]
    panels = [(found.times, channel) for channel in state_channels(found)] + panels
    return [_panel(times, channel) for times, channel in panels]


def _panel(times: np.ndarray, channel: Channel) -> dict[str, Any]:
    return {"title": channel.title, "times": times, "names": channel.labels, "columns": channel.values.T}


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
