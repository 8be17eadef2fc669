"""Files of batches of solutions: an archive with the file of each member, and a line that says what it is."""

import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from ....manifolds import InvalidInputError
from ...reporting.archives import read_archive
from ...reporting.records import BATCH_ENTRY
from ...reporting.text import brief

BATCH_SCHEMA = "retrax.Solutions 1"


class Record(Protocol):
    """A record that can be written to a file."""

    def save(self, path: str | Path) -> None: ...


def save_batch(members: Sequence[Record], path: str | Path) -> None:
    """Write the members of a batch to one file; raises what ``Solution.save`` raises, before the file is there."""
    with tempfile.TemporaryDirectory() as folder:
        places = [Path(folder) / f"{k}.npz" for k in range(len(members))]
        for member, place in zip(members, places, strict=True):
            member.save(place)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(BATCH_ENTRY, f"{BATCH_SCHEMA}\n{len(members)} members\n")
            for place in places:
                archive.write(place, place.name)


def unpack_batch(path: Path, folder: Path) -> list[Path]:
    """The files of the members of a batch, written to a folder."""
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
