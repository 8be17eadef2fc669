"""Former public names, which work for one more release with a ``DeprecationWarning``."""

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any


def former(module: str, names: Mapping[str, str], name: str) -> Any:
    """The object of a module that had this name.

    ``names``: the present names by the former ones. Raises ``AttributeError`` for a name that the module never had.
    """
    if name not in names:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    warnings.warn(f"{module}.{name} is deprecated; use {names[name]}", DeprecationWarning, stacklevel=3)
    return getattr(import_module(module), names[name])
