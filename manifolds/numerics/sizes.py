"""Sizes of manifolds and shapes of arrays, as a user gives them."""

from typing import Any

import numpy as np

from .errors import InvalidInputError


def are_whole(*values: Any) -> bool:
    """Whether all values are whole numbers: integers of Python or numpy, truth values left out."""
    return all(isinstance(value, int | np.integer) and not isinstance(value, bool) for value in values)


def plain(value: Any) -> Any:
    """An integer of numpy as one of Python, which equinox takes for static data without a warning; all else as it
    is."""
    return int(value) if isinstance(value, np.integer) else value


def require_size(owner: object, n: Any, least: int) -> None:
    """Raise ``InvalidInputError`` unless ``n`` is a whole number of at least ``least``."""
    if not are_whole(n) or n < least:
        kind = type(owner).__name__
        raise InvalidInputError(
            f"{kind}(n) takes a whole number n of at least {least}, got {n!r}; try {kind}({least + 1})"
        )


def as_shape(shape: Any) -> tuple[int, ...]:
    """The shape of an array from one length or several. Raises ``InvalidInputError`` for anything else."""
    lengths = (shape,) if are_whole(shape) else tuple(shape) if isinstance(shape, tuple | list) else None
    if lengths is None or not are_whole(*lengths) or any(length < 0 for length in lengths):
        raise InvalidInputError(
            f"a shape is one length or a tuple, whole numbers of at least 0, got {shape!r}; try (3,)"
        )
    return tuple(map(int, lengths))
