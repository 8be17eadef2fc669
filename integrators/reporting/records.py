"""Records: how they print, and their files, checked as a whole against the annotations of the fields before they are
used."""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import equinox as eqx
import numpy as np

from ...manifolds import InvalidInputError
from .archives import archived_words, read_archived_arrays
from .text import brief

LOADERS = {
    "Solution": "load_solution",
    "Trajectory": "load_trajectory",
    "ClosedLoop": "load_closed_loop",
}  # what reads the files of which class
BATCH_ENTRY = "schema.txt"  # the entry of a batch with its kind
LONGEST_TEXT = 100  # characters
REAL_TYPES = tuple(map(np.dtype, (np.float32, np.float64)))
NUMBER_TYPES = (*REAL_TYPES, *map(np.dtype, (np.complex64, np.complex128)))


class Along(NamedTuple):
    """Annotation of an array of numbers, or of nested tuples or a dictionary of them: its leading ``axis``.

    ``ndim``: the number of axes, if that is fixed; then the numbers are real. ``like``: an entry before it with the
    same structure and with arrays that have the same shapes and types of numbers along theirs. ``optional``: None fits
    too.
    """

    axis: str
    ndim: int | None = None
    like: str | None = None
    optional: bool = False


class Values(NamedTuple):
    """Annotation of numbers and arrays of them, in nested tuples and dictionaries; None fits too."""


class _Context(NamedTuple):
    """All values, and the lengths of the axes, each as it was met first."""

    values: dict[str, Any]
    sizes: dict[str, int]


@dataclass(frozen=True)
class RecordFile:
    """The ``.npz`` file of a class, with its name, its version, and its fields with their annotations; no pickled
    objects.

    ``disagreement`` says in words what is wrong with values that fit their annotations one by one; else it is empty.
    """

    name: str
    version: int
    schema: dict[str, Any]
    disagreement: Callable[[dict[str, Any]], str]

    def write(self, path: str | Path, values: dict[str, Any]) -> None:
        """Write the values of all fields; raises ``InvalidInputError`` if they are no record that could be read
        again."""
        try:
            self._require(values)
        except InvalidInputError as error:
            raise InvalidInputError(f"this {self.name.lower()} cannot be saved: {error}") from error
        flat = {"schema": np.asarray(self._mark), **_flatten(values)}
        with _writable(path).open("wb") as file:  # a file, because a path without the ending .npz would be given it
            np.savez(file, allow_pickle=False, **flat)

    def read(self, path: str | Path) -> dict[str, Any]:
        """Values of the fields, with dataclasses made; raises ``InvalidInputError`` if the file is something else."""
        try:
            return self._require(self._values(read_archived_arrays(_path(path))))
        except (InvalidInputError, RecursionError) as error:  # the second for tuples in tuples, a thousand deep
            expected = f"expected a file from {self.name}.save"
            raise InvalidInputError(f"{path} is not a saved {self.name.lower()}: {error}; {expected}") from error

    def _values(self, flat: dict[str, np.ndarray]) -> dict[str, Any]:
        """The fields from all of the entries."""
        mark = flat.pop("schema", None)
        if mark is None or mark.shape or str(mark) != self._mark:
            came = "no entry schema" if mark is None else f"the schema {mark!s:.60}"
            kind = str(mark).removeprefix("retrax.").partition(" ")[0]
            hint = f"; try {LOADERS[kind]}" if kind in LOADERS and kind != self.name else ""
            raise InvalidInputError(f"it has {came}, where this version of retrax reads {self._mark!r}{hint}")
        values = {name: _unflatten(name, flat) for name in self.schema}
        if flat:
            raise InvalidInputError(f"it has the entry {min(flat)!r}, which nothing reads")
        return values

    @property
    def _mark(self) -> str:
        return f"retrax.{self.name} {self.version}"

    def _require(self, values: dict[str, Any]) -> dict[str, Any]:
        """The values, with dataclasses made of their fields; raises if they do not fit the schema or each other."""
        sizes: dict[str, int] = {}
        made = {name: _fit(name, values[name], hint, _Context(values, sizes)) for name, hint in self.schema.items()}
        steps = sizes["nodes"] - 1
        if sizes["stages"] % steps or not sizes["stages"] if steps > 0 else sizes["stages"] or steps:
            raise InvalidInputError(
                f"it has {sizes['nodes']} nodes and {sizes['stages']} stages, expected as many stages for each step "
                "between nodes"
            )
        for name in ("times", "stage_times"):
            if not _are_ordered(values[name]):
                raise InvalidInputError(f"{name} are not finite real numbers in ascending or descending order")
        wrong = self.disagreement(values)
        if wrong:
            raise InvalidInputError(wrong)
        return made


def record_kind(path: str | Path) -> str:
    """The name of the class whose record a file holds, empty for a file that names no class.

    Raises ``InvalidInputError`` for a file that is damaged or no archive.
    """
    try:
        mark = archived_words(_path(path), BATCH_ENTRY, "schema.npy")
    except InvalidInputError as error:
        raise InvalidInputError(f"{path} is not a record of retrax: {error}") from error
    return mark.removeprefix("retrax.").partition(" ")[0]


def _path(path: Any) -> Path:
    try:
        return Path(path)
    except TypeError as error:
        raise InvalidInputError(f"the path must be a text or a pathlib.Path, got {path!r}") from error


def _writable(path: Any) -> Path:
    """The path of a file, in a folder that exists."""
    target = _path(path)
    if target.is_dir():
        raise InvalidInputError(
            f"the path {str(target)!r} is that of a folder, expected one of a file; try a file in it"
        )
    if not target.parent.is_dir():
        raise InvalidInputError(
            f"the path {str(target)!r} leads to a folder that does not exist, expected one that does; try "
            "Path(path).parent.mkdir(parents=True)"
        )
    return target


def _are_ordered(times: Any) -> bool:
    """Whether these are finite real numbers in ascending or descending order, each column for itself."""
    if not (isinstance(times, np.ndarray) and times.dtype in REAL_TYPES and np.all(np.isfinite(times))):
        return False
    change = np.diff(times, axis=0)
    return bool(np.all(change >= 0) or np.all(change <= 0))


def shapes(value: Any) -> str:
    """Nested tuples and dictionaries with arrays by type and shape, on one line, as ``(f64[5,3,3], f64[5,3])``."""
    text = " ".join(eqx.tree_pformat(value).replace("(numpy)", "").split())
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]}..."


def not_finite(values: dict[str, Any]) -> str:
    """The entry that has numbers that are not finite, in words; empty if there is none."""
    flat = _flatten(values)
    bad = [name for name, a in flat.items() if a.dtype.kind in "fc" and not np.all(np.isfinite(a))]
    return f"{bad[0]} has entries that are NaN or infinite" if bad else ""


def _flatten(values: dict[str, Any]) -> dict[str, np.ndarray]:
    """Entries ``name/0``, ... for the parts of a tuple or dictionary, with their number or keys, and a mark for
    None."""
    flat: dict[str, np.ndarray] = {}
    for name, value in values.items():
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ()
        if isinstance(value, dict):
            flat[f"{name}/keys"] = np.asarray(list(value), dtype=str)
        elif isinstance(value, tuple):
            flat[f"{name}/length"] = np.asarray(len(value))
        elif value is None:
            flat[f"{name}/none"] = np.asarray(True)
        else:
            flat[name] = np.asarray(value)
        flat.update(_flatten({f"{name}/{index}": part for index, part in enumerate(parts)}))
    return flat


def _unflatten(name: str, flat: dict[str, np.ndarray]) -> Any:
    """The value that ``_flatten`` took apart, removed from ``flat``; raises if something is missing."""
    if f"{name}/none" in flat:
        if flat.pop(f"{name}/none").tolist() is not True:
            raise InvalidInputError(f"{name}/none is not True")
        return None
    if f"{name}/keys" in flat:
        keys = flat.pop(f"{name}/keys")
        if keys.dtype.kind != "U" or keys.ndim != 1 or len(set(keys.tolist())) != len(keys):
            raise InvalidInputError(f"{name}/keys are not different words")
        return {key: _unflatten(f"{name}/{index}", flat) for index, key in enumerate(keys.tolist())}
    if f"{name}/length" in flat:
        length = flat.pop(f"{name}/length")
        if length.dtype.kind != "i" or length.ndim or length < 0:
            raise InvalidInputError(f"{name}/length is not a number of parts")
        return tuple(_unflatten(f"{name}/{index}", flat) for index in range(int(length)))
    if name not in flat:
        raise InvalidInputError(f"it lacks the entry {name}")
    value = flat.pop(name)
    return value.item() if not value.ndim and (value.dtype in REAL_TYPES or value.dtype.kind in "biU") else value


def _fit(name: str, value: Any, hint: Any, context: _Context) -> Any:
    """The value as its annotation wants it; raises if it does not fit."""
    kind, arguments = get_origin(hint), get_args(hint)
    if kind is UnionType:
        return None if value is None else _fit(name, value, _which(value, arguments), context)
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        if not (isinstance(value, dict) and set(value) == set(hints)):
            raise InvalidInputError(f"{name} is {_words(value)}, expected the fields {', '.join(hints)}")
        made: Any = hint
        return made(**{key: _fit(f"{name}: {key}", part, hints[key], context) for key, part in value.items()})
    if kind is dict or (kind is Annotated and get_origin(arguments[0]) is dict):
        if not isinstance(value, dict):
            raise InvalidInputError(f"{name} is {_words(value)}, expected values by their names")
        each = arguments[1] if kind is dict else Annotated[Any, arguments[1]]
        return {key: _fit(f"{name}: {key}", part, each, context) for key, part in value.items()}
    if kind is Annotated and isinstance(arguments[1], Values):
        _require_numbers(name, value)
        return value
    if kind is Annotated:
        _require_along(name, value, arguments[1], context)
    elif type(value.item() if isinstance(value, np.generic) else value) is not hint:
        raise InvalidInputError(f"{name} is {_words(value)}, expected a value of type {hint.__name__}")
    return value


def _require_numbers(name: str, tree: Any) -> None:
    """Raise unless these are numbers and arrays in nested tuples and in dictionaries with words as keys, or None."""
    if isinstance(tree, tuple | dict):
        if not all(isinstance(key, str) for key in tree if isinstance(tree, dict)):
            raise InvalidInputError(f"{name} has a key that is no word")
        for part in tree.values() if isinstance(tree, dict) else tree:
            _require_numbers(name, part)
    elif tree is not None and np.asarray(tree).dtype.kind not in "biuf":
        raise InvalidInputError(
            f"{name} is {_words(tree)}, expected real numbers and arrays in tuples and dictionaries"
        )


def _which(value: Any, hints: tuple[Any, ...]) -> Any:
    """The first of several annotations, or the one among them that is a dataclass with these fields."""
    fit = (
        hint
        for hint in hints
        if isinstance(value, dict) and is_dataclass(hint) and set(get_type_hints(hint)) == set(value)
    )
    return next(fit, hints[0])


def _require_along(name: str, tree: Any, along: Along, context: _Context) -> None:
    """Raise unless these are arrays of numbers, as long as their axis, and shaped like the entry that they belong
    to."""
    if tree is None and along.optional:
        return
    like = context.values[along.like] if along.like else None
    if like is not None and _rows(tree) != _rows(like):
        raise InvalidInputError(f"{name} has other parts, shapes or types of numbers than {along.like}")
    for leaf in _leaves(tree):
        if not (
            isinstance(leaf, np.ndarray) and leaf.ndim and leaf.dtype in (REAL_TYPES if along.ndim else NUMBER_TYPES)
        ):
            raise InvalidInputError(f"{name} is {_words(leaf)}, expected an array of numbers")
        if along.ndim and leaf.ndim != along.ndim:
            raise InvalidInputError(f"{name} has {leaf.ndim} axes, expected {along.ndim}")
        if len(leaf) != context.sizes.setdefault(along.axis, len(leaf)):
            expected = f"expected {context.sizes[along.axis]}, one for each of the {along.axis}"
            raise InvalidInputError(f"{name} has the length {len(leaf)}, {expected}")


def _leaves(tree: Any) -> list[Any]:
    """The leaves of nested tuples."""
    return [leaf for part in tree for leaf in _leaves(part)] if isinstance(tree, tuple) else [tree]


def _rows(tree: Any) -> Any:
    """Structure, shapes along the leading axis and types of the arrays in nested tuples."""
    if isinstance(tree, tuple):
        return tuple(map(_rows, tree))
    return (tree.shape[1:], tree.dtype.str) if isinstance(tree, np.ndarray) else type(tree)


def _words(value: Any) -> str:
    """A few words on a value."""
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} with shape {value.shape}"
    if isinstance(value, dict | tuple):
        return f"a {type(value).__name__} of {len(value)}"
    return f"{brief(value)}"


def write_protect(value: Any) -> None:
    """Make the arrays in nested tuples, lists and dictionaries read-only."""
    parts = [value]
    while parts:
        part = parts.pop()
        if type(part) is np.ndarray or isinstance(part, np.ndarray):  # the first is quick
            part.flags.writeable = False
        elif isinstance(part, (dict, tuple, list)):
            parts += part.values() if isinstance(part, dict) else part
