"""Archives that the library wrote, which are read as a whole, within the size of their file, or not at all."""

import io
import zipfile
from pathlib import Path

import numpy as np

from ..manifolds import InvalidInputError

MENDING = "save it again, or take a copy of it that is whole"


def archived(path: Path) -> dict[str, bytes]:
    """The entries of an archive that is not compressed, by their names; raises ``InvalidInputError`` for other files.

    Sizes that the archive declares are added up before anything is read: a few bytes may stand for any number of them.
    """
    if path.is_dir():
        raise InvalidInputError("it is a folder")
    content = path.read_bytes()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            declared = sum(entry.file_size for entry in entries)
            found = {} if declared > len(content) else {entry.filename: archive.read(entry) for entry in entries}
    except Exception as error:  # zipfile and zlib raise about everything for bytes that they did not write
        raise InvalidInputError(
            f"it is damaged, or not an archive of arrays ({type(error).__name__}: {error}); {MENDING}"
        ) from error
    if declared > len(content):
        raise InvalidInputError(
            f"its entries have {declared} bytes, more than the {len(content)} of the file: it is compressed, or "
            f"damaged; {MENDING}"
        )
    if len(found) != len(entries):
        raise InvalidInputError("it has several entries of one name")
    return found


def archived_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays in a file of NumPy's by their names, none of them objects; raises ``InvalidInputError`` for other
    files."""
    entries = archived(path)
    try:
        return {name.removesuffix(".npy"): _array(content) for name, content in entries.items()}
    except Exception as error:  # NumPy raises about everything for bytes that it did not write
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
