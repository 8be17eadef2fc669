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

from ..channels import About, View, rotations, view
from ..integrators import Solution
from ..integrators.text import brief
from ..manifolds import InvalidInputError

Scalar = Literal["first", "last"]
ROUNDED = 1e-6  # by what the norm of a quaternion written with few digits is off
VERSION = "2.0"
REQUIRED = "REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE"


def to_quaternions(matrices: Any, scalar: Scalar) -> np.ndarray:
    """Unit quaternions of rotations of shape ``(..., 3, 3)``, shape ``(..., 4)``, with the scalar part ``"first"`` or
    ``"last"``.

    The second rotation of a sequence, and each after it, has the sign that is nearer to the one before. The first one
    has a scalar part that is not negative. Raises ``InvalidInputError`` for other words, and for arrays that are not
    rotations.
    """
    _require_scalar(scalar)
    given = np.asarray(matrices, float)
    if given.shape[-2:] != (3, 3) or not _are_rotations(given):
        raise InvalidInputError(f"expected rotations of shape (..., 3, 3), got {_words(given)}; try solution.states[0]")
    found = Rotation.from_matrix(given.reshape(-1, 3, 3)).as_quat()
    found[:1] *= np.where(found[:1, 3:] < 0, -1.0, 1.0)
    turns = np.where(np.sum(found[1:] * found[:-1], axis=1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(turns)[:, None]
    return _moved(found, scalar).reshape(*given.shape[:-2], 4)


def from_quaternions(quaternions: Any, scalar: Scalar) -> np.ndarray:
    """Rotations, shape ``(..., 3, 3)``, of unit quaternions of shape ``(..., 4)`` with the scalar part ``"first"`` or
    ``"last"``.

    Quaternions are divided by their norms, which may be off by rounding to six digits. Raises ``InvalidInputError`` for
    others.
    """
    _require_scalar(scalar)
    given = np.asarray(quaternions, float)
    if given.shape[-1:] != (4,) or not np.all(np.abs(np.linalg.norm(given, axis=-1) - 1) <= ROUNDED):
        raise InvalidInputError(
            f"expected quaternions of norm 1 and shape (..., 4), got {_words(given)}; try "
            "q / np.linalg.norm(q, axis=-1, keepdims=True)"
        )
    rows = given.reshape(-1, 4)
    rows = np.roll(rows, -1, axis=1) if scalar == "first" else rows
    return Rotation.from_quat(rows).as_matrix().reshape(*given.shape[:-1], 3, 3)


def to_rotation_spline(record: Any, array: int | None = None, problem: About = None) -> RotationSpline:
    """The attitudes at the nodes as SciPy's cubic spline of rotations, with continuous rate and acceleration.

    It goes through the nodes; between them ``solution(t)`` is the method's own polynomial. Raises ``InvalidInputError``
    for a record without an attitude.
    """
    found = view(record, problem)
    return RotationSpline(found.times, Rotation.from_matrix(rotations(found, array)))


def _sampled(record: Any, found: View, at: Any) -> View:
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
    """Attitudes of an object: ``times`` in seconds after ``epoch``, in ``time_system``, and ``attitudes``, shape ``(N,
    3, 3)``.

    ``attitudes`` map components in the frame ``body`` to those in the frame ``reference``.
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
    """Write the attitudes as a CCSDS attitude ephemeris message, keyword-value notation [CCSDS 504.0-B-2, 2024].

    Times are those of the record, in seconds, after ``epoch``, a ``datetime`` in ``time_system``; they are written to
    the microsecond. ``at``: ``"nodes"``, or, for a solution, times at which it is interpolated. The rotation from
    ``reference`` to ``body`` takes the frame to the one of the body, so that its quaternion, with the scalar last as
    that version prescribes, is that of the attitude. Raises ``InvalidInputError`` for a record without an attitude, one
    that does not go forward in time, words with line breaks, and times where the record is not a solution.
    """
    found = _sampled(record, view(record, problem), at)
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

    In version 1.0 ``QUATERNION_TYPE`` says where the scalar part is, and ``ATTITUDE_DIR`` from which frame to which the
    rotation leads. ``reference`` is the frame from which it does. Raises ``InvalidInputError`` for files that are
    something else.
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
    """The lines before those of the data."""
    return [
        f"CCSDS_AEM_VERS = {VERSION}",
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


def _moved(rows: np.ndarray, scalar: Scalar) -> np.ndarray:
    return np.roll(rows, 1, axis=1) if scalar == "first" else rows


def _are_rotations(given: np.ndarray) -> bool:
    """Whether these are orthogonal with determinant 1, to half of the digits."""
    errors = np.abs(np.swapaxes(given, -1, -2) @ given - np.eye(3))
    return bool(np.all(errors <= ROUNDED) and np.all(np.linalg.det(given) > 0))


def _require_scalar(scalar: Any) -> None:
    if scalar not in ("first", "last"):
        raise InvalidInputError(
            f"scalar must be 'first' or 'last', where the scalar part of a quaternion is, got {brief(scalar)}"
        )


def _words(given: np.ndarray) -> str:
    return f"an array of shape {given.shape}" + (f" that begins with {given.ravel()[:4]}" if given.size else "")
