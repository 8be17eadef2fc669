"""Files of batches of solutions: an archive with the file of each member, and a line that says what it is."""

import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ....manifolds import InvalidInputError, Manifold
from ....retractions import Retraction
from ...reporting.archives import read_archive
from ...reporting.records import BATCH_ENTRY
from ...reporting.text import brief

if TYPE_CHECKING:
    from .batch import Solutions
    from .record import Solution

BATCH_SCHEMA = "retrax.Solutions 1"


def save_batch(members: Sequence["Solution"], path: str | Path) -> None:
    """Write the members of a batch to one file; raises what ``Solution.save`` raises, before the file is there."""
    with tempfile.TemporaryDirectory() as folder:
        places = [Path(folder) / f"{k}.npz" for k in range(len(members))]
        for member, place in zip(members, places, strict=True):
            member.save(place)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(BATCH_ENTRY, f"{BATCH_SCHEMA}\n{len(members)} members\n")
            for place in places:
                archive.write(place, place.name)


def load_solutions(
    path: str | Path, retraction: Retraction | None = None, controls: Manifold | None = None
) -> "Solutions":
    """The batch in a file that ``Solutions.save`` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or Path
        The file.
    retraction, controls
        As in ``load_solution``, for every member.

    Returns
    -------
    Solutions
        The batch.

    Raises
    ------
    InvalidInputError
        If the file is something else, damaged, incomplete, or of another version; if members have different arrays.
    """
    from .batch import Solutions
    from .record import load_solution

    with tempfile.TemporaryDirectory() as folder:
        places = _unpacked(Path(path), Path(folder))
        try:
            return Solutions.of([load_solution(place, retraction, controls) for place in places])
        except (InvalidInputError, ValueError) as error:
            words = str(error).replace(f"{folder}/", "member ")
            raise InvalidInputError(f"{path} is not a saved batch: {words}") from error


def _unpacked(path: Path, folder: Path) -> list[Path]:
    """The files of the members, written to a folder."""
    try:
        content = read_archive(path)
    except InvalidInputError as error:
        raise InvalidInputError(f"{path} is not a saved batch: {error}; expected a file from Solutions.save") from error
    names = list(content)
    count = len(content) - 1
    expected = [f"{k}.npz" for k in range(count)]
    head = content.pop(BATCH_ENTRY, b"").decode("utf-8", errors="replace")
    if head != f"{BATCH_SCHEMA}\n{count} members\n" or sorted(content) != sorted(expected) or not count:
        begins = head.partition("\n")[0]
        raise InvalidInputError(
            f"{path} is not a saved batch: it begins with {brief(begins)} and has {len(names)} entries, expected "
            f"{BATCH_SCHEMA!r} and a file for each of one or more members, from Solutions.save; try "
            "load_solution for a "
            "single one"
        )
    for name in expected:
        (folder / name).write_bytes(content[name])
    return [folder / name for name in expected]
