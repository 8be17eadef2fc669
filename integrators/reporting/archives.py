"""Archives that the library wrote, which are read as a whole, within the size of their file, or not at all."""

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...manifolds import InvalidInputError

MENDING = "save it again, or take a copy of it that is whole"
MOST_WORDS = 100_000  # bytes of an entry that is read alone


def read_archive(path: Path) -> dict[str, bytes]:
    """The entries of an archive that is not compressed, by their names; raises ``InvalidInputError`` for other files.

    Sizes that the archive declares are added up before anything is read: a few bytes may stand for any number of them.
    """
    if path.is_dir():
        raise InvalidInputError("it is a folder")
    content = path.read_bytes()
    with _name_damage(), zipfile.ZipFile(io.BytesIO(content)) as archive:
        entries = archive.infolist()
        declared = sum(entry.file_size for entry in entries)
        found = {} if declared > len(content) else {entry.filename: archive.read(entry) for entry in entries}
    if declared > len(content):
        raise InvalidInputError(
            f"its entries have {declared} bytes, more than the {len(content)} of the file: it is compressed, or "
            f"damaged; {MENDING}"
        )
    if len(found) != len(entries):
        raise InvalidInputError("it has several entries of one name")
    return found


def read_archived_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays in a file of NumPy's by their names, none of them objects; raises ``InvalidInputError`` for other
    files."""
    entries = read_archive(path)
    with _name_damage():
        return {name.removesuffix(".npy"): _array(content) for name, content in entries.items()}


def archived_words(path: Path, text: str, array: str) -> str:
    """The words of a text entry, or else of an array with one string; empty without both. No other entry is read."""
    with path.open("rb") as file, _name_damage(), zipfile.ZipFile(file) as archive:
        name = next((name for name in (text, array) if name in archive.namelist()), None)
        if name is None:
            return ""
        with archive.open(name) as entry:
            content = entry.read(MOST_WORDS)
        return content.decode() if name == text else str(_array(content))


@contextmanager
def _name_damage() -> Iterator[None]:
    """A context that raises ``InvalidInputError`` instead of what zipfile, zlib and NumPy raise for other bytes."""
    try:
        yield
    except Exception as error:  # these raise about everything for bytes that they did not write
        raise InvalidInputError(
            f"it is damaged, or not an archive of arrays ({type(error).__name__}: {error}); {MENDING}"
        ) from error


def _array(content: bytes) -> np.ndarray:
    """The array in an ``.npy`` file; never an object."""
    stream = io.BytesIO(content)
    array = np.lib.format.read_array(stream, allow_pickle=False)
    if stream.read(1):
        raise ValueError("an entry is longer than its array")
    return array
