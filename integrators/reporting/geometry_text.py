"""Manifolds and retractions of the library as text, for the files of records: names of classes and numbers, nothing
else."""

import inspect
import json
from dataclasses import fields
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ... import manifolds, retractions
from ...manifolds import InvalidInputError
from .text import brief

ROOMS = manifolds, retractions
PLAIN_TYPES = bool, int, float, str


def as_text(*objects: Any) -> str | None:
    """The objects as text; None where one is not of the library's classes, or made with a function."""
    found = [_describe(item) for item in objects]
    return None if None in found else json.dumps(found)


def from_text(text: str) -> list[Any]:
    """The objects that ``as_text`` described; raises ``InvalidInputError`` for any other text."""
    try:
        return [_make(item) for item in json.loads(text)]
    except Exception as error:  # constructors raise about everything for what they do not take
        raise InvalidInputError(
            f"geometry is {brief(text)}, expected classes of manifolds and retractions with their numbers ({error})"
        ) from error


def _describe(value: Any) -> Any:
    """Nested lists and dictionaries of numbers; None for what has no such form."""
    if value is None:
        return {"none": True}
    if type(value) in PLAIN_TYPES:
        return value
    if isinstance(value, tuple):
        parts = [_describe(part) for part in value]
        return None if None in parts else parts
    if isinstance(value, np.ndarray | jax.Array) and np.isrealobj(value):
        return {"array": np.asarray(value).tolist(), "type": np.asarray(value).dtype.str}
    name = type(value).__name__
    if not isinstance(value, eqx.Module) or type(value) is not _class_of(name):
        return None
    parts = {field.name: _describe(getattr(value, field.name)) for field in fields(value)}
    return None if None in parts.values() else {"class": name, "made of": parts}


def _make(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_make, value))
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return np.array(value["array"], np.dtype(value["type"]))
    if "none" in value:
        return None
    kind = _class_of(value["class"])
    if kind is None:
        raise InvalidInputError(f"there is no class {value['class']!r}")
    parts = {name: _make(part) for name, part in value["made of"].items()}
    several = [p for p in inspect.signature(kind).parameters.values() if p.kind is p.VAR_POSITIONAL]
    return kind(*parts.pop(several[0].name), **parts) if several else kind(**parts)


def _class_of(name: str) -> Any:
    """The public class of a manifold, a metric or a retraction with a name, None where there is none."""
    found = next((getattr(room, name) for room in ROOMS if name in room.__all__), None)
    return found if isinstance(found, type) and issubclass(found, eqx.Module) else None
