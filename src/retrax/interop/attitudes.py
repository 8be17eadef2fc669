"""Attitudes as quaternions, splines and CCSDS attitude ephemerides.

A rotation ``R`` maps the components of a vector in the body frame to those in the inertial frame. Its quaternion is
that of the same map, ``(cos(a/2), sin(a/2) e)`` for the turn of ``a`` about ``e`` (Hamilton's product).
"""

import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, final

import jax
import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from ..integrators import Solution
from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError
from ..named_columns import About, View, rotations, view

Scalar = Literal["first", "last"]
ROUNDED_QUATERNION = 1e-6  # by what the norm of a quaternion written with few digits is off
AEM_VERSION = "2.0"
REQUIRED = "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE"


def to_quaternions(matrices: Any, scalar: Scalar) -> np.ndarray:
    """The unit quaternions of rotations.

    Parameters
    ----------
    matrices : array_like of shape (..., 3, 3)
        Rotation matrices.
    scalar : {"first", "last"}
        The place of the scalar part.

    Returns
    -------
    array of shape (..., 4)
        Unit quaternions. Each quaternion of a sequence has the sign that is closer to the quaternion before it; the
        first one has a nonnegative scalar part.

    Raises
    ------
    InvalidInputError
        For another word, and for arrays that are not rotations.
    """
    _require_scalar(scalar)
    given = np.asarray(matrices, float)
    if given.shape[-2:] != (3, 3) or not _are_rotations(given):
        raise InvalidInputError(f"expected rotations of shape (..., 3, 3), got {_words(given)}; try solution.states[0]")
    found = Rotation.from_matrix(given.reshape(-1, 3, 3)).as_quat()
    found[:1] *= np.where(found[:1, 3:] < 0, -1.0, 1.0)
    turns = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(turns)[:, None]
    return _reorder_scalar(found, scalar).reshape(*given.shape[:-2], 4)


def from_quaternions(quaternions: Any, scalar: Scalar) -> np.ndarray:
    """The rotations of unit quaternions.

    Parameters
    ----------
    quaternions : array_like of shape (..., 4)
        Unit quaternions; they are divided by their norms, which may be off by rounding to six digits.
    scalar : {"first", "last"}
        The place of the scalar part.

    Returns
    -------
    array of shape (..., 3, 3)
        Rotation matrices.

    Raises
    ------
    InvalidInputError
        For another word, and for quaternions of another norm.

    Examples
    --------
    >>> from retrax.interop import from_quaternions
    >>> from_quaternions([1.0, 0.0, 0.0, 0.0], "first").diagonal().tolist()
    [1.0, 1.0, 1.0]
    """
    _require_scalar(scalar)
    given = np.asarray(quaternions, float)
    if given.shape[-1:] != (4,) or not np.all(np.abs(np.linalg.norm(given, axis=-1) - 1) <= ROUNDED_QUATERNION):
        raise InvalidInputError(
            f"expected quaternions of norm 1 and shape (..., 4), got {_words(given)}; try "
            "q / np.linalg.norm(q, axis=-1, keepdims=True)"
        )
    rows = given.reshape(-1, 4)
    rows = np.roll(rows, -1, axis=1) if scalar == "first" else rows
    return Rotation.from_quat(rows).as_matrix().reshape(*given.shape[:-1], 3, 3)


def to_rotation_spline(record: Any, array: int | None = None, problem: About = None) -> RotationSpline:
    """The attitudes at the nodes as SciPy's cubic spline of rotations, with continuous rate and acceleration.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with an attitude; ``InvalidInputError`` for another one.
    array : int, optional
        The index of the array in a point; by default the first attitude.
    problem : OptimalControlProblem or Manifold, optional
        The problem or the manifold of a trajectory.

    Returns
    -------
    RotationSpline
        The spline through the nodes; between them ``solution(t)`` is the polynomial of the method.
    """
    found = view(record, problem)
    return RotationSpline(found.times, Rotation.from_matrix(rotations(found, array)))


def _sample(record: Any, found: View, at: Any) -> View:
    """The arrays at the nodes, or at times."""
    if isinstance(at, str) and at == "nodes":
        return found
    if isinstance(at, str) or not isinstance(record, Solution):
        raise InvalidInputError(f'at must be "nodes", or times if the record is a Solution, got {brief(at)}')
    sample = record(np.ravel(at))
    return found._replace(times=sample.times, states=[np.asarray(leaf) for leaf in jax.tree.leaves(sample.states)])


@final
@dataclass(frozen=True)
class AttitudeEphemeris:
    """The attitudes of an object at times after an epoch, from a CCSDS message.

    Attributes
    ----------
    times : array of shape (N,)
        Seconds after ``epoch``, in ``time_system``.
    attitudes : array of shape (N, 3, 3)
        Matrices that map components in the frame ``body`` to components in the frame ``reference``.
    epoch : datetime
        The origin of time.
    object_name, object_id : str
        The object.
    reference, body : str
        The frames.
    time_system : str
        The time system, such as ``UTC``.
    """

    times: np.ndarray
    attitudes: np.ndarray
    epoch: datetime
    object_name: str
    object_id: str
    reference: str
    body: str
    time_system: str


def to_aem(
    record: Any,
    path: str | Path,
    *,
    epoch: datetime,
    object_name: str,
    object_id: str,
    reference: str = "EME2000",
    body: str = "SC_BODY_1",
    time_system: str = "UTC",
    originator: str = "RETRAX",
    array: int | None = None,
    problem: About = None,
    at: Any = "nodes",
) -> None:
    """Write the attitudes as a CCSDS attitude ephemeris message in keyword-value notation.

    Parameters
    ----------
    record : Solution or Trajectory
        A record with an attitude that goes forward in time.
    path : str or Path
        The file.
    epoch : datetime
        The origin of the times of the record, which are in seconds.
    object_name, object_id : str
        The object.
    reference, body : str
        The frames; attitudes map ``body`` to ``reference``.
    time_system, originator : str
        The time system of ``epoch``, and the originator of the message.
    array : int, optional
        The index of the array in a point; by default the first attitude.
    problem : OptimalControlProblem or Manifold, optional
        The problem or the manifold of a trajectory.
    at : "nodes" or array_like
        The nodes, or times at which a solution is interpolated.

    Raises
    ------
    InvalidInputError
        For another record, words with line breaks, and times for a trajectory.

    Notes
    -----
    Times are written to the microsecond. The quaternion, with the scalar last, describes the rotation from
    ``reference`` to ``body``.

    References
    ----------
    CCSDS 504.0-B-2, Attitude Data Messages, 2024.
    """
    found = _sample(record, view(record, problem), at)
    quaternions = to_quaternions(rotations(found, array), "last")
    words = {"OBJECT_NAME": object_name, "OBJECT_ID": object_id, "REF_FRAME_A": reference, "REF_FRAME_B": body}
    words["TIME_SYSTEM"] = time_system
    for name, word in {**words, "ORIGINATOR": originator}.items():
        if not isinstance(word, str) or not word.strip() or "\n" in word:
            raise InvalidInputError(f"{name} must be a text on one line, got {brief(word)}")
    stamps = [_stamp(epoch + timedelta(microseconds=round(1e6 * float(t)))) for t in found.times]
    if any(a >= b for a, b in pairwise(stamps)):
        raise InvalidInputError(
            "the times of the record must ascend by a microsecond or more; try one that goes forward"
        )
    rows = [" ".join([stamp, *(f"{value:.16g}" for value in q)]) for stamp, q in zip(stamps, quaternions, strict=True)]
    text = "\n".join([*_head(words, originator, stamps), *rows, "DATA_STOP", ""])
    Path(path).write_text(text, encoding="ascii")


def from_aem(path: str | Path) -> AttitudeEphemeris:
    """Read a CCSDS attitude ephemeris message with one segment of quaternions, of version 1.0 or 2.0.

    Parameters
    ----------
    path : str or Path
        The file; ``InvalidInputError`` if it is something else.

    Returns
    -------
    AttitudeEphemeris
        The attitudes.

    Notes
    -----
    In version 1.0 ``QUATERNION_TYPE`` gives the place of the scalar part, and ``ATTITUDE_DIR`` the direction of the
    rotation. ``reference`` is the frame from which the rotation leads.
    """
    lines = [line.strip() for line in Path(path).read_text(encoding="utf-8", errors="replace").splitlines()]
    lines = [line for line in lines if line and not line.startswith("COMMENT")]
    pairs = [line.partition("=") for line in lines if "=" in line]
    words = {name.strip(): word.strip() for name, _, word in pairs}
    version, kind = words.get("CCSDS_AEM_VERS"), words.get("ATTITUDE_TYPE", "").upper()
    missing = [name for name in REQUIRED if name not in words]
    if version not in ("1.0", "2.0") or missing or lines.count("META_START") != 1 or kind != "QUATERNION":
        lacks = f" without {', '.join(missing)}" if missing else ""
        raise InvalidInputError(
            f"{path} has the version {version!r:.40} of an attitude ephemeris{lacks}, expected 1.0 or 2.0 with one "
            "segment of the type QUATERNION"
        )
    rows = [line.split() for line in lines if re.match(r"\d{4}-\d", line)]
    try:
        epochs = [_read_stamp(row[0]) for row in rows]
        quaternions = np.array([row[1:] for row in rows], float).reshape(len(rows), 4)
    except ValueError as error:
        raise InvalidInputError(f"{path} has lines of data that are not a time and four numbers ({error})") from error
    if not rows:
        raise InvalidInputError(f"{path} has no attitudes, expected one or more lines of a time and a quaternion")
    scalar: Any = words.get("QUATERNION_TYPE", "LAST").lower()
    frames = words["REF_FRAME_A"], words["REF_FRAME_B"]
    reference, body = frames if words.get("ATTITUDE_DIR", "A2B").upper() == "A2B" else frames[::-1]
    times = np.array([(epoch - epochs[0]).total_seconds() for epoch in epochs])
    own = words.get("OBJECT_NAME", ""), words.get("OBJECT_ID", "")
    attitudes = from_quaternions(quaternions, scalar)
    return AttitudeEphemeris(times, attitudes, epochs[0], *own, reference, body, words["TIME_SYSTEM"])


def _head(words: dict[str, str], originator: str, stamps: list[str]) -> list[str]:
    """The lines before the data."""
    return [
        f"CCSDS_AEM_VERS = {AEM_VERSION}",
        f"CREATION_DATE = {_stamp(datetime.now(UTC).replace(tzinfo=None))}",
        f"ORIGINATOR = {originator}",
        "",
        "META_START",
        *(f"{name} = {word}" for name, word in words.items()),
        f"START_TIME = {stamps[0]}",
        f"STOP_TIME = {stamps[-1]}",
        "ATTITUDE_TYPE = QUATERNION",
        "META_STOP",
        "",
        "DATA_START",
    ]


def _stamp(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S.%f")


def _read_stamp(text: str) -> datetime:
    """The time of ``2026-11-23T02:30:00.5`` or, with the day of the year, of ``2026-327T02:30:00.5``."""
    day, _, clock = text.removesuffix("Z").partition("T")
    whole, _, fraction = clock.partition(".")
    shape = "%Y-%j" if day.count("-") == 1 else "%Y-%m-%d"
    return datetime.strptime(f"{day}T{whole}.{fraction[:6] or '0'}", f"{shape}T%H:%M:%S.%f")


def _reorder_scalar(rows: np.ndarray, scalar: Scalar) -> np.ndarray:
    return np.roll(rows, 1, axis=1) if scalar == "first" else rows


def _are_rotations(given: np.ndarray) -> bool:
    """Whether these are orthogonal with determinant 1, to half of the digits."""
    errors = np.abs(np.swapaxes(given, -1, -2) @ given - np.eye(3))
    return bool(np.all(errors <= ROUNDED_QUATERNION) and np.all(np.linalg.det(given) > 0))


def _require_scalar(scalar: Any) -> None:
    if scalar not in ("first", "last"):
        raise InvalidInputError(
            f"scalar must be 'first' or 'last', where the scalar part of a quaternion is, got {brief(scalar)}"
        )


def _words(given: np.ndarray) -> str:
    return f"an array of shape {given.shape}" + (f" that begins with {given.ravel()[:4]}" if given.size else "")
