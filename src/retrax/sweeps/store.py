"""The folder of a sweep: a file for each chunk of members, which is there whole or not at all.

Chunk files and no zarr: a rename makes a chunk appear whole, with all of its arrays at once, for any number of writers
without locks or a package; in zarr each array of a chunk is a file of its own, and nothing says when the last of them
is there.
"""

import json
import os
import socket
import uuid
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, final

import numpy as np

from ..integrators.reporting.archives import read_archived_arrays
from ..manifolds import InvalidInputError
from ..manifolds.numerics.ambient import is_count

SWEEP_SCHEMA = "retrax.Sweep 1"
SWEEP_ENTRY = "sweep.json"
IN_A_FOLDER = 1000  # files of chunks: file systems list more of them slowly


@final
class Store:
    """Where the results of a sweep lie: ``count`` members in files of ``chunk`` members each, but for the last one."""

    def __init__(self, folder: Path, count: int, chunk: int) -> None:
        self.folder, self.count, self.chunk = folder, count, chunk

    @property
    def parts(self) -> int:
        """How many chunks there are."""
        return -(-self.count // self.chunk)

    def members(self, part: int) -> np.ndarray:
        """The numbers of the members of a chunk."""
        return np.arange(part * self.chunk, min(self.count, (part + 1) * self.chunk))

    def path(self, part: int) -> Path:
        """The file of a chunk."""
        return self.folder / "chunks" / f"{part // IN_A_FOLDER:06d}" / f"{part:09d}.npz"

    def finished_chunks(self) -> list[int]:
        """The chunks that are there, in their order; a file that is cut off does not count."""
        paths = [path for path in self.folder.glob("chunks/*/*.npz") if path.stem.isdigit()]
        found = [int(path.stem) for path in paths if zipfile.is_zipfile(path)]
        return sorted(part for part in found if part < self.parts)

    def write(self, part: int, found: dict[str, Any], seconds: tuple[float, float]) -> None:
        """Write what was found of the members of a chunk, and the seconds on the clock and of the processor."""
        words, word = np.unique(np.asarray(found["result"], dtype=str), return_inverse=True)
        own = {
            "schema": SWEEP_SCHEMA,
            "part": part,
            "words": words,
            "word": word.astype(np.int32),
            "seconds": seconds,
            "worker": worker(),
        }
        own |= {name: found[name] for name in ("cost", "success", "has")}
        kept = {f"kept/{name}": array for name, array in found["kept"].items()}
        path = self.path(part)
        path.parent.mkdir(parents=True, exist_ok=True)
        with _atomic_file(path) as file:
            np.savez(file, allow_pickle=False, **own, **kept)

    def read(self, part: int) -> dict[str, Any]:
        """The record of a chunk; raises ``InvalidInputError`` if the file is something else, or damaged."""
        path, count = self.path(part), len(self.members(part))
        try:
            found: dict[str, Any] = dict(read_archived_arrays(path))
            found["result"] = found["words"][found["word"]]
            lengths = {len(found[name]) for name in ("cost", "success", "word", "has")}
            fits = str(found["schema"]) == SWEEP_SCHEMA and found["part"] == part and lengths == {count}
            fault = (
                ""
                if fits
                else f"it has {found['schema']!s:.60}, chunk {found['part']!s:.20}, {sorted(lengths)} members"
            )
        except (OSError, ValueError, KeyError, IndexError) as error:
            fault, found = str(error), {}
        if fault:
            raise InvalidInputError(
                f"{path} is not chunk {part} of the sweep: {fault}; expected a file of {SWEEP_SCHEMA!r} with {count} "
                "members; delete it, and call sweep again, which solves what is not there"
            )
        found["kept"] = {
            name.removeprefix("kept/"): found.pop(name) for name in list(found) if name.startswith("kept/")
        }
        return found


@contextmanager
def _atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """A file that has its name when it is whole, and on the disk: a machine that loses power loses nothing finished."""
    unfinished = path.with_name(f".{path.stem}.{uuid.uuid4().hex}.part")
    with unfinished.open("wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def worker() -> str:
    """The name of this process."""
    return f"{socket.gethostname()}:{os.getpid()}"


def open_store(folder: Path, count: int, chunk: int, marks: dict[str, str]) -> Store:
    """The store in a folder, new or of the same sweep; raises ``InvalidInputError`` for a folder of another sweep."""
    folder.mkdir(parents=True, exist_ok=True)
    head, wanted = folder / SWEEP_ENTRY, {"schema": SWEEP_SCHEMA, "count": count, "chunk": chunk, **marks}
    if not head.exists():
        if any(not path.match(".*.part") for path in folder.iterdir()):
            raise InvalidInputError(
                f"{folder} has other files than those of a sweep; give a new folder, or an empty one"
            )
        with _atomic_file(head) as file:
            file.write(json.dumps(wanted, indent=1).encode())
    there = _read_head(head)
    others = [name for name, value in wanted.items() if there.get(name) != value]
    if others:
        shown = ", ".join(f"{name} {there.get(name)!s:.12} for {wanted[name]!s:.12}" for name in others)
        raise InvalidInputError(
            f"{folder} has another sweep: {shown}; expected the same one, which goes on, with the same versions of "
            "JAX and of this library, which write its program; give another folder"
        )
    return Store(folder, count, chunk)


def existing(folder: Path) -> Store:
    """The store in a folder; raises ``InvalidInputError`` if there is none."""
    there = _read_head(folder / SWEEP_ENTRY)
    return Store(folder, there["count"], there["chunk"])


def _read_head(path: Path) -> dict[str, Any]:
    try:
        there = json.loads(path.read_text())
        fits = there["schema"] == SWEEP_SCHEMA and is_count(there["count"]) and is_count(there["chunk"])
        fault = "" if fits else f"the schema is {there['schema']!s:.60}, with {there['count']} members"
    except (OSError, ValueError, KeyError, TypeError) as error:
        fault, there = str(error), {}
    if fault:
        raise InvalidInputError(
            f"{path.parent} is not a sweep: {fault}; expected a file {SWEEP_ENTRY} of {SWEEP_SCHEMA!r}, from sweep"
        )
    return there
