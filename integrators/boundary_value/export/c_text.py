"""Constants and templates as C source."""

import re
import textwrap
from collections.abc import Mapping
from importlib import resources
from typing import Any

import numpy as np

PACKAGE = "retrax.integrators.boundary_value.export"
NUMBERS_WIDTH = 112  # of a line of numbers


def number(value: Any) -> str:
    """A number that C reads without rounding."""
    if isinstance(value, bool | np.bool_ | int | np.integer):
        return str(int(value))
    value = float(value)
    if np.isfinite(value):
        return repr(value)
    return "NAN" if np.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"


def braces(array: np.ndarray) -> str:
    """An initializer of an array, with braces for each axis."""
    array = np.asarray(array)
    parts = [braces(part) for part in array] if array.ndim > 1 else [number(value) for value in array.tolist()]
    text = f"{{{', '.join(parts)}}}"
    if len(text) <= NUMBERS_WIDTH and "\n" not in text:
        return text
    inside = ",\n".join(parts) if array.ndim > 1 else "\n".join(textwrap.wrap(", ".join(parts), NUMBERS_WIDTH))
    return f"{{\n{textwrap.indent(inside, '    ')}}}"


def constant(kind: str, name: str, array: np.ndarray, comment: str) -> str:
    """The definition of a constant array with a comment; empty for an array without entries."""
    array = np.asarray(array)
    if not array.size:
        return ""
    lengths = "".join(f"[{length}]" for length in array.shape)
    return f"/* {comment} */\nstatic const {kind} {name}{lengths} = {braces(array)};\n"


def fill_template(template: str, values: Mapping[str, str]) -> str:
    """A template with values in the places of ``@names@``."""
    text = resources.files(PACKAGE).joinpath("templates", template).read_text(encoding="utf-8")
    found = re.sub(r"@(\w+)@", lambda match: values[match[1]], text)
    return re.sub(r"\n{3,}", "\n\n", found)
